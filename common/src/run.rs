//! What the launcher tells each stage about the run that it is part of: one JSON object, `--run` on the stage's
//! command line.

use crate::level::Measure;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// One run of the pipeline, validated by the launcher.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunConfig {
    /// Prefix of the names of the run's shared-memory segments (see `shm::RunId`).
    pub run_id: String,
    /// Folder of the terrain database.
    pub world: PathBuf,
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Frames per second that a film plays at.
    pub fps: f64,
    /// First frame, and one past the last: numbers in the flight, kept in file names.
    pub frames: [u64; 2],
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// How screen resolution is measured.
    pub measure: Measure,
    /// Factor on all heights of the terrain.
    pub exaggeration: f64,
    /// Threads that decode tiles in the prefetcher.
    pub loader_threads: u32,
    /// What the prefetcher does beyond what frames ask of it.
    pub prefetch: PrefetchConfig,
    /// What the renderer draws and where frames go.
    pub render: RenderConfig,
}

/// The prefetcher's part of a [`RunConfig`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrefetchConfig {
    /// How the view is predicted, to have its tiles before it comes.
    pub prediction: Prediction,
    /// Whether a tile that could not be had is tried again after a while. A run that waits for its tiles does not: what
    /// it draws must not depend on when a tile came.
    pub has_retries: bool,
}

impl PrefetchConfig {
    /// For a run that waits for every tile that it wants.
    pub const EXACT: Self = Self { prediction: Prediction::Off, has_retries: false };
}

/// How the view is predicted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Prediction {
    /// Not at all.
    Off,
    /// The camera goes on and turns as it does.
    Linear,
    /// It also goes on to gain or lose speed as it does: better in long bends, worse when the path is jerky.
    Quadratic,
}

/// The renderer's part of a [`RunConfig`].
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RenderConfig {
    /// Colour of the sky, 8 bit RGB.
    pub sky_rgb: [u8; 3],
    /// Samples per pixel: 1 or 4.
    pub samples: u32,
    /// Draw the tree's colour leaves over the picture.
    pub has_tree_overlay: bool,
    /// Ask for the Vulkan validation layer; one message of it ends the renderer with an error.
    pub has_validation: bool,
    /// Frames recorded or drawn at a time; 0 leaves it to the renderer, which knows the device.
    pub frames_in_flight: u32,
    /// Where frames go.
    pub sink: SinkConfig,
    /// Also write depth (float32 GeoTIFF-like TIFF, metres along the view axis, NaN for sky) of the only frame.
    pub depth: Option<PathBuf>,
    /// Also write ground position (3 x float64 TIFF: easting, northing, height; NaN for sky) of the only frame.
    pub ground: Option<PathBuf>,
}

/// Where finished frames go.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SinkConfig {
    /// `frame-000000.png` and so on, in this folder.
    PngFolder(PathBuf),
    /// One PNG file (a run of one frame).
    PngFile(PathBuf),
    /// A film, made by ffmpeg, at this path.
    Film(PathBuf),
    /// Y4M (4:4:4) on standard output.
    Y4mStdout,
    /// Nowhere: frames are read back and dropped (benches).
    Null,
}
