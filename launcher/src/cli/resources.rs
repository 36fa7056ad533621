//! What a run may use, as typed.

use super::values::MemorySize;
use clap::Args;

/// What a run may use; shared by `fly` and `still`.
#[derive(Debug, Args)]
#[command(next_help_heading = "Resources")]
pub struct ResourceArgs {
    /// Memory for the pools of tiles, e.g. 256MiB or 2GiB
    ///
    /// The picture does not depend on it, as long as it suffices. More saves loading when a flight comes back to where
    /// it has been. All processes together use about 300 MB more than this. Half of it is shared memory: see
    /// 'terravision doctor'.
    #[arg(long, value_name = "SIZE", default_value = "512MiB")]
    pub memory: MemorySize,
    /// Threads that load and decode tiles, and that cast rays [default: RAYON_NUM_THREADS, else one per core]
    ///
    /// The picture does not depend on it.
    #[arg(long, value_name = "N")]
    pub threads: Option<u32>,
    /// Ask for the Vulkan validation layer; its first complaint ends the run (for developers)
    #[arg(long)]
    pub validation: bool,
    /// Say nothing but warnings and errors
    #[arg(short, long)]
    pub quiet: bool,
}
