//! A flight against the clock, as typed.

use clap::{Args, ValueEnum};
use terravision_common::run::Prediction;

/// A flight against the clock; of `fly`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Real time")]
pub struct RealtimeArgs {
    /// Whether frames wait for their tiles, or for nothing
    ///
    /// 'exact' draws every frame with all that it wants, however long it takes. 'realtime' plays the path against the
    /// clock: frames show what is there, and those that come too late are left out (docs/realtime.md).
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
    /// Size that facets may shrink to while the camera rests and there is time, pixels [default: 3, at most --facet-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_facet_px: Option<f64>,
    /// Size that texels may shrink to while the camera rests and there is time, pixels [default: --texel-px]
    #[arg(long, value_name = "PIXELS")]
    pub rest_texel_px: Option<f64>,
    /// How the camera is predicted, to have its tiles before it comes (docs/prefetch.md) [default: linear]
    #[arg(long, value_enum, value_name = "HOW")]
    pub prediction: Option<PredictionChoice>,
}

/// [`Prediction`] as typed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum PredictionChoice {
    /// Not at all: tiles are asked for when a frame lacks them
    Off,
    /// It goes on and turns as it does
    Linear,
    /// It also goes on to gain or lose speed as it does: better in long bends, worse on jerky paths
    Quadratic,
    /// The path is known: what the others are measured against
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
