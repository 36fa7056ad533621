//! What becomes of stages that die.

use clap::Args;

/// Supervision of the stages; of `fly`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Supervision (docs/supervision.md)")]
pub struct SupervisionArgs {
    /// Start stages that die or hang again, at most N times within a minute, and N times without a picture; 0 ends the flight at the
    /// first death
    /// [default: 5 with --mode realtime, else 0]
    ///
    /// The flight goes on where it was, with the last picture meanwhile: in a folder, a film, Y4M and the frame ring.
    #[arg(long, value_name = "N")]
    pub restarts: Option<u32>,
    /// A stage, or ffmpeg, that gets nothing done for so long hangs and is killed: a stage is started again, by --restarts, else
    /// the flight ends [default: 10 with --mode realtime, else 30]
    ///
    /// Who computes or waits for a disk has twenty times as long, and the database the time of its own timeouts.
    #[arg(long, value_name = "SECONDS")]
    pub hang_after: Option<f64>,
}
