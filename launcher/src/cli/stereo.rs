//! Stereo pairs, as typed.

use clap::{Args, ValueEnum};

const HEADING: &str = "Stereo (docs/views.md)";

/// How a stereo pair is drawn; shared by `fly` and `still`.
#[derive(Debug, Clone, Args)]
pub struct StereoArgs {
    /// Draw a left and a right eye
    ///
    /// Both eyes look in the direction of the pose, from half the separation to its left and to its
    /// right, and are drawn from one tree. Their frusta are off-axis, so that what is as far away
    /// as --convergence is at the same place in both pictures.
    #[arg(long, help_heading = HEADING, value_enum, value_name = "HOW", conflicts_with = "views")]
    pub stereo: Option<StereoArg>,
    /// Distance between the eyes, metres [default: a thirtieth of --convergence]
    ///
    /// Distances of human eyes (0.065) show no relief in terrain that is a kilometre away.
    #[arg(long, help_heading = HEADING, value_name = "METRES", requires = "stereo")]
    pub eye_separation: Option<f64>,
    /// What is this far away, metres along the line of sight, appears in the plane of the screen;
    /// what is nearer in front of it [default: as far as the ground in the middle of the first
    /// picture]
    #[arg(long, help_heading = HEADING, value_name = "METRES", requires = "stereo")]
    pub convergence: Option<f64>,
}

/// What becomes of the two pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StereoArg {
    /// One picture of twice the width, the left eye's at the left
    SideBySide,
    /// One picture for glasses, red at the left eye and cyan at the right one
    Anaglyph,
    /// A picture of each: a-left.png and a-right.png, or folders view-left and view-right
    Pair,
}
