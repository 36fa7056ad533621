//! What the launcher tells each stage about the run that it is part of: one JSON object, `--run` on
//! the stage's command line.

use crate::camera::Camera;
use crate::film::FrameEncoding;
use crate::level::Measure;
use crate::rate::RateSettings;
use crate::rig::{Rig, Views};
use crate::texels::TexelFormat;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// End of the frames of a flight of which nobody knows the number beforehand: another program sends
/// the poses.
pub const OPEN_END: u64 = u64::MAX;

/// One run of the pipeline, validated by the launcher.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Prefix of the names of the run's shared-memory segments (see `shm::RunId`).
    pub run_id: String,
    /// Folder with the index of the terrain database: its manifest and height ranges.
    pub world: PathBuf,
    /// Where its tiles are.
    pub database: DatabaseConfig,
    /// Width of a frame's picture, which holds all of its views, pixels.
    pub width: u32,
    /// Its height, pixels.
    pub height: u32,
    /// Frames per second that a film plays at.
    pub fps: f64,
    /// First frame, and one past the last (or [`OPEN_END`]): numbers in the flight, kept in file
    /// names.
    pub frames: [u64; 2],
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// How screen resolution is measured.
    pub measure: Measure,
    /// Factor on all heights of the terrain.
    pub exaggeration: f64,
    /// How the colour pool holds its tiles. Rays read them on the processor: for them, never
    /// compressed.
    #[serde(default)]
    pub texels: TexelFormat,
    /// Threads that decode tiles in the prefetcher, and that cast rays in the renderer.
    pub decoder_threads: u32,
    /// What the prefetcher does beyond what frames ask of it.
    pub prefetch: PrefetchConfig,
    /// What the renderer draws and where frames go.
    pub render: RenderConfig,
    /// How a flight against the clock is flown; `None` in exact mode, in which every frame waits
    /// for all its tiles.
    #[serde(default)]
    pub realtime: Option<RealtimeConfig>,
    /// The cameras that a pose carries; `None` for one, the pose's own.
    #[serde(default)]
    pub rig: Option<Rig>,
}

/// The realtime part of a [`RunConfig`]: frames may be skipped, none waits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealtimeConfig {
    /// Whether r_z and r_c follow the measured frame times; else they stay as wanted.
    pub has_feedback: bool,
    /// Coarsest screen resolutions of facets and texels, pixels.
    pub coarsest_px: [f64; 2],
    /// Finest screen resolutions of facets and texels while the camera rests, pixels.
    pub rest_px: [f64; 2],
}

impl RunConfig {
    /// The views of a frame whose pose is this camera's.
    #[must_use]
    pub fn views(&self, pose: &Camera) -> Views {
        self.rig.as_ref().map_or_else(|| Views::single(pose), |rig| rig.views(pose))
    }

    /// Pixels of all views of a frame together.
    #[must_use]
    pub fn pixels(&self) -> u64 {
        self.rig.as_ref().map_or(u64::from(self.width) * u64::from(self.height), Rig::pixels)
    }

    /// The time of a frame, nanoseconds.
    #[must_use]
    pub fn period_nanos(&self) -> f64 {
        1e9 / self.fps
    }

    /// What the rate control of a realtime flight holds; `None` in exact mode and without feedback.
    #[must_use]
    pub fn rate_settings(&self) -> Option<RateSettings> {
        let RealtimeConfig { coarsest_px, rest_px, .. } = self.realtime.as_ref().filter(|r| r.has_feedback)?;
        let (target_nanos, wanted_px) = (self.period_nanos(), [self.r_z_px, self.r_c_px]);
        Some(RateSettings { target_nanos, wanted_px, coarsest_px: *coarsest_px, rest_px: *rest_px })
    }
}

/// Where the tiles of a run's database are, and how they are read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatabaseConfig {
    /// A folder, or a URL as the user gave it.
    pub location: String,
    /// Folder of the disk cache of remote databases; the user's own when there is none here.
    pub cache: Option<PathBuf>,
    /// Most bytes that it may take.
    pub cache_bytes: u64,
    /// Ask nobody: what the cache does not have is missing.
    pub is_offline: bool,
    /// Longest time that one request may take, milliseconds.
    pub request_timeout_ms: u64,
    /// Most requests at a time.
    pub parallel_requests: u32,
}

impl DatabaseConfig {
    /// Whether a server has it: a tile that does not come may come later.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.location.contains("://") && !self.location.starts_with("file:")
    }

    /// A database in a folder of this machine.
    #[must_use]
    pub fn folder(path: &Path) -> Self {
        Self {
            location: path.display().to_string(),
            cache: None,
            cache_bytes: 0,
            is_offline: false,
            request_timeout_ms: 1,
            parallel_requests: 1,
        }
    }
}

/// The prefetcher's part of a [`RunConfig`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrefetchConfig {
    /// How the view is predicted, to have its tiles before it comes.
    pub prediction: Prediction,
    /// Whether a tile that could not be read is tried again after a while. A run that waits for its
    /// tiles does not: what it draws must not depend on when a tile came.
    pub has_retries: bool,
}

impl PrefetchConfig {
    /// For a run that waits for every tile that it wants.
    pub const EXACT: Self = Self { prediction: Prediction::Off, has_retries: false };

    /// For a flight against the clock.
    #[must_use]
    pub const fn realtime(prediction: Prediction) -> Self {
        Self { prediction, has_retries: true }
    }
}

/// How the view is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prediction {
    /// Not at all.
    Off,
    /// The camera goes on and turns as it does.
    Linear,
    /// It also goes on to gain or lose speed as it does: better in long bends, worse when the path
    /// is jerky.
    Quadratic,
    /// The path is known: the launcher tells the cameras to come.
    Oracle,
}

impl Prediction {
    /// As flags and reports name it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Linear => "linear",
            Self::Quadratic => "quadratic",
            Self::Oracle => "oracle",
        }
    }
}

/// The renderer's part of a [`RunConfig`].
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderConfig {
    /// How the ground is drawn.
    #[serde(default)]
    pub technique: TechniqueChoice,
    /// How rays are cast, when they are.
    #[serde(default)]
    pub rays: RaysChoice,
    /// Colour of the sky, 8 bit RGB.
    pub sky_rgb: [u8; 3],
    /// Samples per pixel: 1 or 4.
    pub samples: u32,
    /// Height of the world's lowest ground as it is drawn, metres: walls go down to it where the
    /// world ends; `None` for none.
    #[serde(default)]
    pub skirt_low_m: Option<f64>,
    /// Draw the tree's colour leaves over the picture.
    pub has_tree_overlay: bool,
    /// Ask for the Vulkan validation layer; one message of it ends the renderer with an error.
    pub has_validation: bool,
    /// Frames recorded or drawn at a time; 0 leaves it to the renderer, which knows the device.
    pub frames_in_flight: u32,
    /// Where frames go.
    pub sink: SinkConfig,
    /// Also write depth: float32 TIFF, metres along the view axis, NaN for sky. A target for each
    /// view, or none at all.
    #[serde(default)]
    pub depth: Vec<PlaneTarget>,
    /// Also write ground position: 3 x float64 TIFF of easting, northing, height; NaN for sky.
    /// Likewise.
    #[serde(default)]
    pub ground: Vec<PlaneTarget>,
    /// Also put every frame into a frame ring, for other programs.
    #[serde(default)]
    pub share: Option<ShareConfig>,
    /// What depth and ground say where the ground was made up.
    #[serde(default)]
    pub made_up: MadeUp,
}

/// How depth and ground positions tell ground that was made up from ground that was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MadeUp {
    /// They are NaN there, as they are for sky.
    #[default]
    Nan,
    /// They have its values, and files have one band more: 1 where it was measured, 0 where it was
    /// made up, NaN for sky.
    Mark,
}

impl MadeUp {
    /// As the command line spells it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nan => "nan",
            Self::Mark => "mark",
        }
    }
}

/// How the ground is drawn (docs/techniques.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TechniqueChoice {
    /// As a mesh where there is a Vulkan device, else by rays.
    #[default]
    Auto,
    /// As triangles, by a Vulkan device.
    Mesh,
    /// By rays; see [`RaysChoice`] for what casts them.
    Rays,
}

impl TechniqueChoice {
    /// As flags and reports name it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Mesh => "mesh",
            Self::Rays => "rays",
        }
    }
}

/// How rays are cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RaysChoice {
    /// One exact ray per pixel, through maxima of the heights.
    #[default]
    Mipmap,
    /// Samples of voxels along lines of pixels.
    Coherent,
    /// One exact ray per pixel, by a Vulkan device.
    Compute,
    /// By a GPU, if there is one; else whichever of the first two is faster on one of the first
    /// frames.
    Auto,
}

/// How the renderer's words of what casts rays begin as long as [`RaysChoice::Auto`] has not been
/// decided.
pub const UNDECIDED_RAYS: &str = "not tried yet:";

/// Where one plane of values, depth or ground, of every frame goes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaneTarget {
    /// One file, of the only frame.
    File(PathBuf),
    /// `frame-000000.tif` and so on, in this folder.
    Folder(PathBuf),
}

impl PlaneTarget {
    /// The file of a frame.
    #[must_use]
    pub fn path(&self, frame: u64) -> PathBuf {
        match self {
            Self::File(path) => path.clone(),
            Self::Folder(folder) => folder.join(frame_file_name(frame, "tif")),
        }
    }
}

/// Name of a frame's file in a folder of frames.
#[must_use]
pub fn frame_file_name(frame: u64, extension: &str) -> String {
    format!("frame-{frame:06}.{extension}")
}

/// What other programs get.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShareConfig {
    /// The name of the frame ring (see `shm::SharedName`).
    pub name: String,
    /// Depth of every pixel.
    pub has_depth: bool,
    /// Ground position of every pixel.
    pub has_ground: bool,
}

/// Where finished frames go.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SinkConfig {
    /// `frame-000000.png` and so on, in this folder.
    PngFolder(PathBuf),
    /// One PNG file (a run of one frame).
    PngFile(PathBuf),
    /// As a stream of packets of this encoding to the launcher, on standard output (see
    /// [`crate::film`]).
    Stream(FrameEncoding),
    /// Nowhere: frames are read back and dropped (benches).
    Null,
    /// Each view of the rig into one of these, in its order.
    EachView(Vec<SinkConfig>),
}
