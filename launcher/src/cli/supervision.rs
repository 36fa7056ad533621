//! What becomes of stages that die.

use clap::Args;

/// Supervision of the stages; of `fly`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Supervision (docs/supervision.md)")]
pub struct SupervisionArgs {
    /// Restart stages that die or hang, at most N times within a minute and N times between two
    /// pictures; 0 ends the flight at the first death [default: 5 with --mode realtime, else 0]
    ///
    /// The flight goes on where it was. Meanwhile the last picture is shown, in a folder, a film,
    /// Y4M and the frame ring alike.
    #[arg(long, value_name = "N")]
    pub restarts: Option<u32>,
    /// Kill a stage, or ffmpeg, that makes no progress for this many seconds; a stage is then
    /// restarted, by --restarts, or else the flight ends [default: 10 with --mode realtime, else
    /// 30]
    ///
    /// A process that computes or waits for a disk has twenty times as long; requests to servers
    /// have timeouts of their own.
    #[arg(long, value_name = "SECONDS")]
    pub hang_after: Option<f64>,
}
