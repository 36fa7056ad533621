//! A flight against the clock, as typed.

use clap::{Args, ValueEnum};
use terravision_common::run::Prediction;

/// A flight against the clock; of `fly`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Real time")]
pub struct RealtimeArgs {
    /// Whether frames wait for their tiles, or follow the clock
    ///
    /// 'exact' draws every frame with all the tiles that it needs, however long that takes.
    /// 'realtime' follows the clock: frames show the tiles that are loaded, and frames that would
    /// be too late are left out (docs/realtime.md).
    #[arg(long, value_enum, default_value_t = Mode::Exact)]
    pub mode: Mode,
    /// Whether facets and texels grow when frames take too long [default: on]
    #[arg(long, value_enum, value_name = "on|off")]
    pub feedback: Option<Switch>,
    /// Largest size that facets may grow to, pixels [default: four times --facet-px]
    #[arg(long, value_name = "PIXELS")]
    pub coarsest_facet_px: Option<f64>,
    /// Largest size that texels may grow to, pixels [default: four times --texel-px]
    #[arg(long, value_name = "PIXELS")]
    pub coarsest_texel_px: Option<f64>,
    /// Size that facets may shrink to while the camera rests and there is time, pixels [default: 3,
    /// of a sweep 1.4, at most --facet-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_facet_px: Option<f64>,
    /// Size that texels may shrink to while the camera rests and there is time, pixels [default:
    /// --texel-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_texel_px: Option<f64>,
    /// How the camera is predicted, so that tiles are loaded before it needs them
    /// (docs/prefetch.md) [default: linear]
    #[arg(long, value_enum, value_name = "HOW")]
    pub prediction: Option<PredictionChoice>,
}

/// [`Prediction`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PredictionChoice {
    /// Not at all: tiles are requested when a frame lacks them
    Off,
    /// It keeps its speed and its turn
    Linear,
    /// It also keeps its acceleration: better in long bends, worse on jerky paths
    Quadratic,
    /// From the path itself, which is known: to measure the others by
    Oracle,
}

impl From<PredictionChoice> for Prediction {
    fn from(choice: PredictionChoice) -> Self {
        match choice {
            PredictionChoice::Off => Self::Off,
            PredictionChoice::Linear => Self::Linear,
            PredictionChoice::Quadratic => Self::Quadratic,
            PredictionChoice::Oracle => Self::Oracle,
        }
    }
}

/// Whether frames wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// Every frame waits for its tiles: the same input gives the same bytes
    Exact,
    /// Frames follow the clock and wait for nothing
    Realtime,
}

/// On or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// On
    On,
    /// Off
    Off,
}
