//! How the picture is made: what flags, path and defaults come to.

use super::checks::in_range;
use super::drawing::{Drawing, DrawingQuestion};
use crate::cli::picture::{PictureArgs, Quality};
use crate::cli::values::{PictureSize, Rgb};
use crate::failure::Failure;
use crate::path::PathSettings;
use crate::rig_file::RigFile;
use terravision_common::rig::Rig;
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::shm::Layout;
use terravision_common::technique::Decision;
use terravision_common::texels::TexelFormat;
use terravision_common::world::World;
use terravision_store::Store;

/// Size of a picture for which neither the command line nor the path says one.
pub const DEFAULT_SIZE: PictureSize = PictureSize { width: 1280, height: 720 };
/// Vertical field of view, degrees, if nothing else is said.
const DEFAULT_VFOV_DEG: f64 = 60.0;

const DEFAULT_SKY: [u8; 3] = [150, 190, 235];

/// The sky that a body has unless the user says: dust on Mars, haze on Venus and Titan, none where
/// there is no air.
fn sky_of(body: &str) -> [u8; 3] {
    match body {
        "Mars" => [210, 170, 125],
        "Venus" => [215, 180, 110],
        "Titan" => [190, 140, 60],
        "Moon" | "Mercury" | "Ceres" | "Vesta" => [0, 0, 0],
        _ => DEFAULT_SKY,
    }
}

/// How the picture is made.
#[derive(Debug, Clone)]
pub(super) struct PictureChoice {
    /// Of the pose's own camera, and of views that say nothing else.
    pub(super) size: PictureSize,
    pub(super) vfov_rad: f64,
    /// The cameras that the pose carries.
    pub(super) rig: Option<Rig>,
    pub(super) decision: Decision,
    pub(super) texels: TexelFormat,
    /// Wanted sizes of facets (r_z) and texels (r_c), pixels.
    pub(super) wanted_px: [f64; 2],
    /// Size of facets while the camera of a flight against the clock rests, pixels: that of the best
    /// quality.
    pub(super) rest_facet_px: f64,
    pub(super) samples: u32,
    /// What is done differently than asked, a sentence.
    pub(super) warning: Option<String>,
}

impl PictureChoice {
    /// `usual`: the preset if none is asked for.
    pub(super) fn new(
        picture: &PictureArgs,
        rig: Option<&RigFile>,
        settings: &PathSettings,
        usual: Quality,
        drawing: DrawingQuestion,
        world: &World,
    ) -> Result<Self, Failure> {
        let size = picture.size.unwrap_or(PictureSize {
            width: settings.width.unwrap_or(DEFAULT_SIZE.width),
            height: settings.height.unwrap_or(DEFAULT_SIZE.height),
        });
        let of_path = settings.vfov_of(size.width, size.height);
        let vfov_rad = vfov_rad(picture, of_path, size)?;
        let rig = rig.map(|file| file.rig([size.width, size.height], vfov_rad)).transpose();
        let rig = rig.map_err(Failure::bad_input)?;
        let Drawing { decision, texels, warning } = drawing.decide()?;
        let is_rays = decision.technique == TechniqueChoice::Rays;
        let is_swept = decision.is_swept();
        let best_facet_px = if is_swept { 1.4 } else { 3.0 };
        let (facet_px, samples) = match picture.quality.unwrap_or(usual) {
            // What rays through voxels cost grows with pixels: facets of half the area make up for
            // what sampling loses.
            Quality::Default if is_rays && decision.rays == RaysChoice::Coherent => (7.0, 1),
            // A sweep reads heights in place: facets cost little.
            Quality::Default if is_swept => (3.0, 1),
            Quality::Default => (10.0, 1),
            Quality::Best => (best_facet_px, 4),
            Quality::Finest => (Layout::finest_facet_px(world, pixels(size, rig.as_ref())), 4),
        };
        let facet_px =
            in_range("--facet-px", picture.facet_px.unwrap_or(facet_px), 0.5, 1e4, "pixels from 0.5 to 10000")?;
        let texel_px = in_range("--texel-px", picture.texel_px.unwrap_or(1.0), 0.25, 1e4, "pixels from 0.25 to 10000")?;
        let samples = if is_rays { 1 } else { picture.samples.unwrap_or(samples) };
        let (wanted_px, rest_facet_px) = ([facet_px, texel_px], best_facet_px);
        Ok(Self { size, vfov_rad, rig, decision, texels, wanted_px, rest_facet_px, samples, warning })
    }

    /// Pixels of all views together.
    pub(super) fn pixels(&self) -> u64 {
        pixels(self.size, self.rig.as_ref())
    }

    /// Width and height of the picture that holds all views, pixels.
    pub(super) fn picture_size(&self) -> [u32; 2] {
        self.rig.as_ref().map_or([self.size.width, self.size.height], Rig::picture)
    }
}

fn pixels(size: PictureSize, rig: Option<&Rig>) -> u64 {
    rig.map_or(u64::from(size.width) * u64::from(size.height), Rig::pixels)
}

/// The sky: as asked, as the path has it, or the body's.
pub(super) fn sky(picture: &PictureArgs, settings: &PathSettings, database: &Store) -> [u8; 3] {
    let usual = || match database.world().globe() {
        // Seen from space, and without an atmosphere.
        Some(_) => [0; 3],
        None => sky_of(&database.manifest().fields().body.name),
    };
    picture.sky.map(|Rgb(rgb)| rgb).or(settings.sky_rgb).unwrap_or_else(usual)
}

/// The vertical field of view of a picture of that size, radians: as asked, as the path has it, or
/// the default.
pub(super) fn vfov_rad(picture: &PictureArgs, of_path: Option<f64>, size: PictureSize) -> Result<f64, Failure> {
    const EXPECTED: &str = "degrees from 1 to 170";
    if let Some(hfov) = picture.hfov {
        let half = 0.5 * in_range("--hfov", hfov, 1.0, 170.0, EXPECTED)?.to_radians();
        let vfov = 2.0 * (half.tan() * f64::from(size.height) / f64::from(size.width)).atan();
        let shown = format!("--hfov {hfov} is a vertical field of view of");
        return in_range(&shown, vfov.to_degrees(), 1.0, 170.0, EXPECTED).map(f64::to_radians);
    }
    let vfov_deg = picture.vfov.or(of_path.map(f64::to_degrees)).unwrap_or(DEFAULT_VFOV_DEG);
    Ok(in_range("--vfov", vfov_deg, 1.0, 170.0, EXPECTED)?.to_radians())
}
