//! Where the camera goes, as typed.

use super::pose::{AglArgs, OrbitArgs, PoseArgs};
use super::values::FrameRange;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Where the camera goes; shared by `fly` and `path`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Flight")]
pub struct CourseArgs {
    /// The camera path: a file (JSON, KML or KMZ, GPX), or 'orbit'
    ///
    /// 'orbit' circles the point of the world with the strongest relief, or --around, once in 240 frames. The formats of files
    /// are in docs/camera-paths.md. With --eye or --look-at there is no path: the camera stands there (one frame, or --frames).
    #[arg(long, value_name = "FILE|orbit", default_value = "orbit")]
    pub path: PathBuf,
    /// Only frames A up to, not including, B
    ///
    /// They are the same bytes that these frames have in the whole flight, so that a film can be made in pieces.
    #[arg(long, value_name = "A..B")]
    pub frames: Option<FrameRange>,
    /// Frames per second of the film; of a path that is given in time also how many are made [default: the path's own,
    /// else 30]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,
    /// Fly a path that is given in time N times as fast
    #[arg(long, value_name = "N")]
    pub speed: Option<f64>,
    /// Whether rests and silence within a segment of a recorded track are flown in full
    ///
    /// 'shorten' makes seconds of two minutes and more within 30 m, and leaves out silence of more than ten minutes. Gaps between
    /// segments and tracks are left out either way.
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

/// What becomes of the rests of a recorded track.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Rests {
    /// They become seconds
    Shorten,
    /// They are flown as they were
    Keep,
}
