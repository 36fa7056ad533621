//! Where the camera goes, as typed.

use super::pose::{AglArgs, OrbitArgs, PoseArgs};
use super::values::FrameRange;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Where the camera goes; shared by `fly` and `path`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Flight")]
pub struct CourseArgs {
    /// The camera path: a file (JSON, KML or KMZ, GPX, CZML, GeoJSON), or 'orbit'
    ///
    /// 'orbit' circles the place with the strongest relief, or --around, in 240 frames a round.
    /// docs/camera-paths.md describes the files. With --eye or --look-at the camera stands still
    /// instead, for one frame or for --frames.
    #[arg(long, value_name = "FILE|orbit", default_value = "orbit")]
    pub path: PathBuf,
    /// Draw only frames A to B-1
    ///
    /// They have the same bytes as in the whole flight, so that a film can be made in pieces.
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Frames per second of the film; a path with times has more frames at a higher rate [default:
    /// the path's own, else 30]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,
    /// Fly a path that has times (keyframes, KML, GPX, CZML, GeoJSON) N times as fast
    #[arg(long, value_name = "N")]
    pub speed: Option<f64>,
    /// What becomes of rests in a recorded track
    ///
    /// 'shorten' flies a rest of two minutes or more within 30 m in a few seconds, and leaves out
    /// gaps of more than ten minutes within a segment. Gaps between segments and tracks are left
    /// out either way.
    #[arg(long, value_enum, default_value_t = Rests::Shorten)]
    pub rests: Rests,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub agl: AglArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub orbit: OrbitArgs,
    #[command(flatten)]
    #[expect(missing_docs, reason = "documented on the type; a text here would replace the command's help")]
    pub pose: PoseArgs,
}

impl CourseArgs {
    /// A path by itself, and nothing else asked for.
    #[must_use]
    pub fn of_path(path: PathBuf) -> Self {
        let (agl, orbit, pose) = (AglArgs::default(), OrbitArgs::default(), PoseArgs::default());
        Self { path, frames: None, fps: None, speed: None, rests: Rests::Shorten, agl, orbit, pose }
    }
}

/// What becomes of the rests of a recorded track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Rests {
    /// They become seconds
    Shorten,
    /// They are flown as they were
    Keep,
}
