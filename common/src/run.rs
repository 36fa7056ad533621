//! The configuration of a run, which the launcher passes to each stage: one JSON object, `--run` on
//! the stage's command line.
//!
//! Circle with `viewer`: a window begins at a pose as viewers have it, and viewers are told of a
//! database as stages are.

use crate::camera::{Camera, CameraError};
use crate::film::FrameEncoding;
use crate::ids::FrameNumber;
use crate::level::Measure;
use crate::light::{AirConfig, LightConfig};
use crate::rate::RateSettings;
use crate::rig::{Rig, Views};
use crate::texels::TexelFormat;
use crate::vehicle::VehiclesConfig;
use crate::viewer::ViewerPose;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// The end of a flight whose number of frames is not known beforehand: another program sends the
/// poses.
pub const OPEN_END: u64 = u64::MAX;

/// One run of the pipeline, validated by the launcher.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Prefix of the names of the run's shared-memory segments (see `shm::RunId`).
    pub run_id: String,
    /// Folder with the index of the terrain database: its manifest and height ranges.
    pub world: PathBuf,
    /// The source of its tiles.
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
    /// Format of tiles in the colour pool. Never compressed for rays, which are cast on the
    /// processor.
    #[serde(default)]
    pub texels: TexelFormat,
    /// Threads that decode tiles in the prefetcher, and that cast rays in the renderer.
    pub decoder_threads: u32,
    /// Options of the prefetcher.
    pub prefetch: PrefetchConfig,
    /// What colour tiles are lit with; `None`: they stay as they are stored.
    #[serde(default)]
    pub light: Option<LightConfig>,
    /// Options of the renderer, and the outputs of frames.
    pub render: RenderConfig,
    /// Options of a real-time flight; `None` in exact mode, in which every frame waits for all its
    /// tiles.
    #[serde(default)]
    pub realtime: Option<RealtimeConfig>,
    /// The cameras that a pose carries; `None`: only the camera of the pose.
    #[serde(default)]
    pub rig: Option<Rig>,
}

/// The realtime part of a [`RunConfig`]: frames may be skipped, and do not wait.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RealtimeConfig {
    /// Whether r_z and r_c follow the measured frame times; otherwise they are constant.
    pub has_feedback: bool,
    /// Coarsest screen resolutions of facets and texels, pixels.
    pub coarsest_px: [f64; 2],
    /// Finest screen resolutions of facets and texels while the camera rests, pixels.
    pub rest_px: [f64; 2],
}

impl RunConfig {
    /// The views of a frame whose pose is this camera's.
    ///
    /// # Errors
    /// [`CameraError`] of a view: from this pose the rig leads out of what a camera can be.
    pub fn views(&self, pose: &Camera) -> Result<Views, CameraError> {
        self.rig.as_ref().map_or_else(|| Ok(Views::single(pose)), |rig| rig.views_from(pose))
    }

    /// Numbers of the run's frames.
    #[must_use]
    pub fn frame_numbers(&self) -> Range<FrameNumber> {
        let [first, end] = self.frames.map(FrameNumber::new);
        first..end
    }

    /// Width and height of the pictures that are put out, pixels: those of a view where two views
    /// become one picture.
    #[must_use]
    pub fn output_size(&self) -> [u32; 2] {
        match &self.rig {
            Some(rig) if self.render.anaglyph => rig.view_size(),
            _ => [self.width, self.height],
        }
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

    /// Settings of the rate control of a realtime flight; `None` in exact mode and without
    /// feedback.
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
    /// Folder of the disk cache of remote databases; `None`: the default folder.
    pub cache: Option<PathBuf>,
    /// Upper bound of its bytes.
    pub cache_bytes: u64,
    /// Never use the network: tiles that are not in the cache are missing.
    pub is_offline: bool,
    /// Timeout of one request, milliseconds.
    pub request_timeout_ms: u64,
    /// Maximum number of concurrent requests.
    pub parallel_requests: u32,
}

impl DatabaseConfig {
    /// Whether it is on a server: a tile that fails may arrive later.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.location.contains("://") && !self.location.starts_with("file:")
    }

    /// A local database.
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
    /// How the view is predicted, to load its tiles in advance.
    pub prediction: Prediction,
    /// Whether a tile that could not be read is requested again after a while. Not in a run that
    /// waits for its tiles: its pictures must not depend on when a tile arrives.
    pub has_retries: bool,
}

impl PrefetchConfig {
    /// For a run that waits for every tile that it wants.
    pub const EXACT: Self = Self { prediction: Prediction::Off, has_retries: false };

    /// For a real-time flight.
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
    /// Constant speed and constant turn rate.
    Linear,
    /// Constant acceleration: better in long bends, worse when the path is jerky.
    Quadratic,
    /// The path is known: the launcher sends future cameras.
    Oracle,
}

impl Prediction {
    /// Its name in flags and reports.
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
    pub technique: TechniqueChoice,
    /// Why that draws, a clause (see [`crate::technique`]).
    pub technique_reason: String,
    /// How rays are cast, if they are used.
    pub rays: RaysChoice,
    /// Colour of the sky, 8 bit RGB.
    pub sky_rgb: [u8; 3],
    /// Haze, and a sky with a gradient; `None`: the sky has one colour.
    #[serde(default)]
    pub air: Option<AirConfig>,
    /// Samples per pixel: 1 or 4.
    pub samples: u32,
    /// Height of the world's lowest ground, exaggerated, metres: skirts at the world's border reach
    /// down to it; `None`: no skirts.
    #[serde(default)]
    pub skirt_low_m: Option<f64>,
    /// Draw the tree's colour leaves over the picture.
    pub has_tree_overlay: bool,
    /// Enable the Vulkan validation layer; a message from it ends the renderer with an error.
    pub has_validation: bool,
    /// Frames in flight on the device; 0: chosen by the renderer.
    pub frames_in_flight: u32,
    /// Where frames go.
    pub sink: SinkConfig,
    /// Also write depth: float32 TIFF, metres along the view axis, NaN for sky. One target for each
    /// view, or none.
    #[serde(default)]
    pub depth: Vec<PlaneTarget>,
    /// Also write ground position: 3 x float64 TIFF of easting, northing, height; NaN for sky.
    /// Likewise.
    #[serde(default)]
    pub ground: Vec<PlaneTarget>,
    /// Also write every frame to a frame ring, for other programs.
    #[serde(default)]
    pub share: Option<ShareConfig>,
    /// Also show every frame in a window, in which a person flies.
    #[serde(default)]
    pub window: Option<WindowConfig>,
    /// Values of depth and ground where the ground was made up.
    #[serde(default)]
    pub made_up: MadeUp,
    /// What is burnt into files and streams; `None`: nothing.
    #[serde(default)]
    pub labels: Option<LabelsConfig>,
    /// What vehicles look like; `None`: there are none.
    #[serde(default)]
    pub vehicles: Option<VehiclesConfig>,
    /// Two views are put out as one picture for glasses, red at the left eye and cyan at the right
    /// one.
    pub anaglyph: bool,
}

/// Labels of pictures.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LabelsConfig {
    /// A line of text.
    pub text: Option<String>,
    /// How long a distance is, where the middle of the picture is.
    pub has_scale_bar: bool,
    /// An arrow to grid north.
    pub has_north_arrow: bool,
    /// The time since the first frame of the flight's path.
    pub has_clock: bool,
}

impl RenderConfig {
    /// Whether frames are drawn by a sweep and by nothing else, which reads heights out of the
    /// elevation pool.
    #[must_use]
    pub fn is_swept(&self) -> bool {
        self.technique == TechniqueChoice::Rays && self.rays == RaysChoice::Sweep
    }
}

/// How depth and ground positions distinguish ground that was made up from measured ground.
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
    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Nan => "nan",
            Self::Mark => "mark",
        }
    }
}

/// How the ground is drawn (docs/techniques.md).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TechniqueChoice {
    /// As triangles, by a Vulkan device.
    Mesh,
    /// By rays; see [`RaysChoice`] for what casts them.
    Rays,
}

impl TechniqueChoice {
    /// Its name in flags and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mesh => "mesh",
            Self::Rays => "rays",
        }
    }
}

/// How rays are cast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RaysChoice {
    /// One exact ray per pixel, through maxima of the heights.
    Mipmap,
    /// Samples of voxels along lines of pixels.
    Coherent,
    /// Vertical planes through the eye, swept outwards once.
    Sweep,
    /// One exact ray per pixel, by a Vulkan device.
    Compute,
    /// On a GPU, if there is one; otherwise the faster of the first two, measured on one of the
    /// first frames. In exact mode the first.
    Auto,
}

/// Prefix of the renderer's description of how rays are cast while [`RaysChoice::Auto`] has not
/// been decided.
pub const UNDECIDED_RAYS: &str = "not tried yet:";

/// The output of one plane of values, depth or ground, of every frame.
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

/// Options of the frame ring for other programs.
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

/// Options of a window: frames are shown, and poses come from the person before it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowConfig {
    /// The name of the segment of poses (see `shm::SharedName`).
    pub name: String,
    /// What stands in its title bar.
    pub title: String,
    /// Where the camera is when nobody has moved it.
    pub start: ViewerPose,
    /// Its first width and height, in the desktop's pixels.
    pub size: [u32; 2],
    /// It begins as large as the screen.
    pub is_full_screen: bool,
    /// Pictures are shown between two refreshes of the screen only.
    pub has_vsync: bool,
    /// Pixels of the picture for each of the window's, along a side.
    pub scale: f64,
    /// Whether the picture's size follows the window's.
    pub has_sizes: bool,
    /// The path that the window plays, if there is one.
    #[serde(default)]
    pub path: Option<WindowPath>,
}

/// A path for a window: a pose for each of its frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowPath {
    /// A file with its poses, as [`crate::viewer::poses_to_bytes`] writes them. The launcher has it
    /// as long as it lives.
    pub file: PathBuf,
    /// Frames in a second.
    pub fps: f64,
}

/// The output of finished frames.
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
