//! One picture by the pipeline: `terravision still`.

use crate::flight::{Pose, read_png};
use crate::folder::TestFolder;
use crate::process::{Finished, Terravision};
use crate::worlds::TestWorld;
use serde_json::Value;
use terravision_common::camera::Camera;
use terravision_testkit::floats::read_floats;
use terravision_testkit::reference::{Picture, RenderOptions, render};

/// Vertical field of view of all test pictures, degrees.
pub const VFOV_DEG: f64 = 60.0;

/// A picture to be taken.
#[derive(Debug, Clone)]
pub struct Shot<'a> {
    /// Of what.
    pub world: &'a TestWorld,
    /// From where.
    pub pose: Pose,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Colour of the sky.
    pub sky_rgb: [u8; 3],
}

/// A picture that was taken.
#[derive(Debug)]
pub struct Taken {
    /// Colours, rows from the top.
    pub rgb: Vec<[u8; 3]>,
    /// Metres along the view axis, NaN for sky; empty unless asked for.
    pub depth: Vec<f64>,
    /// Easting, northing, height, NaN for sky; empty unless asked for.
    pub ground: Vec<[f64; 3]>,
    /// The report.
    pub report: Value,
    /// The process.
    pub finished: Finished,
}

impl Taken {
    /// Which pixels have exactly this colour, the sky's.
    #[must_use]
    pub fn is_sky(&self, sky_rgb: [u8; 3]) -> Vec<bool> {
        self.rgb.iter().map(|rgb| *rgb == sky_rgb).collect()
    }
}

impl<'a> Shot<'a> {
    /// A shot of 1280 x 720 with the usual sky.
    #[must_use]
    pub fn new(world: &'a TestWorld, pose: Pose) -> Self {
        Self { world, pose, size: [1280, 720], sky_rgb: [150, 190, 235] }
    }

    /// The camera of the shot.
    #[must_use]
    pub fn camera(&self) -> Camera {
        self.pose.camera(self.size, VFOV_DEG)
    }

    /// The command, its outputs in `folder`.
    #[must_use]
    pub fn command(&self, folder: &TestFolder) -> Terravision {
        let [r, g, b] = self.sky_rgb;
        Terravision::verb("still")
            .arg(self.world.database())
            // Tests are of flights' pictures, unless they say otherwise: the last flag wins.
            .arg("--quality=default")
            .args(self.pose.arguments())
            .args([format!("--size={}x{}", self.size[0], self.size[1]), format!("--vfov={VFOV_DEG}")])
            .arg(format!("--sky={r},{g},{b}"))
            .arg("-o")
            .arg(folder.join("a.png"))
            .arg("--report")
            .arg(folder.join("report.json"))
    }

    /// Takes it with more arguments, and with depth and ground when they are asked for.
    ///
    /// # Panics
    /// When the process fails or warns, or what it wrote is not as it should be.
    #[must_use]
    pub fn take(&self, arguments: &[&str], has_ground: bool) -> Taken {
        let folder = TestFolder::new("shot");
        let mut command = self.command(&folder).args(arguments);
        if has_ground {
            command = command.arg("--depth").arg(folder.join("d.tif")).arg("--ground").arg(folder.join("g.tif"));
        }
        let finished = command.succeed();
        let pixels = (self.size[0] * self.size[1]) as usize;
        let (width, height, rgb) = read_png(&folder.join("a.png"));
        assert_eq!([width as u32, height as u32], self.size, "the picture has the size asked for");
        let floats = |name: &str, bands: usize| {
            let (width, height, values) = read_floats(&folder.join(name)).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!([width as u32, height as u32], self.size, "{name} has the picture's size");
            assert_eq!(values.len(), bands * pixels, "{name} has {bands} bands");
            values
        };
        let (depth, ground) = if has_ground {
            let triples = floats("g.tif", 3).chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
            (floats("d.tif", 1), triples)
        } else {
            (Vec::new(), Vec::new())
        };
        let report = read_report(&folder);
        Taken { rgb, depth, ground, report, finished }
    }

    /// What the picture should be, by `rays` x `rays` rays per pixel.
    #[must_use]
    pub fn reference(&self, rays: u32) -> Picture {
        let options = RenderOptions { rays_per_side: rays, sky_rgb: self.sky_rgb, exaggeration: 1.0 };
        render(self.world.scene(), &self.camera(), &options)
    }
}

/// `report.json` of a folder.
///
/// # Panics
/// When it is not there or no report.
#[must_use]
pub fn read_report(folder: &TestFolder) -> Value {
    let path = folder.join("report.json");
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let report: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    assert_eq!(report["schema"], "terravision-fly-1", "{report}");
    report
}

/// Three oblique views of a synthetic world: along a valley at medium height, down a slope from
/// close by, and a far panorama. Their pictures hold near and far ground, little or no sky.
#[must_use]
pub fn oblique_poses(world: &TestWorld) -> [(&'static str, Pose); 3] {
    [
        ("medium", Pose::new(world.above(0.45, 0.30, 900.0), 20.0, -28.0)),
        ("near", Pose::new(world.above(0.55, 0.50, 250.0), 110.0, -20.0)),
        ("far", Pose::new(world.above(0.20, 0.15, 2500.0), 45.0, -25.0)),
    ]
}
