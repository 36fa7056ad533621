//! What a run may use, as typed.

use super::values::MemorySize;
use clap::Args;

/// What a run may use; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Resources")]
pub struct ResourceArgs {
    /// Memory for the pools of tiles, e.g. 256MiB or 2GiB
    ///
    /// It does not change the picture, as long as it is enough. With more, a flight that comes back
    /// to a place loads less again. All processes together use about 300 MB more than this. Half of
    /// it is shared memory: see 'terravision doctor'.
    #[arg(long, value_name = "SIZE", default_value = "512MiB")]
    pub memory: MemorySize,
    /// Threads that load and decode tiles, and that cast rays [default: RAYON_NUM_THREADS, else one
    /// per core]
    ///
    /// It does not change the picture.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
    /// Use the Vulkan validation layer, whose first error ends the run (for developers)
    #[arg(long)]
    pub validation: bool,
    /// Print only warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}
