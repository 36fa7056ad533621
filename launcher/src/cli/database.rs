//! How a database that is elsewhere is read, as typed.

use super::values::{self, MemorySize};
use clap::Args;
use std::path::PathBuf;
use std::time::Duration;

/// How a database on a server is read; shared by all commands that open one.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Databases on servers")]
pub struct DatabaseArgs {
    /// Folder of the disk cache for tiles from servers [default: ~/.cache/terravision]
    ///
    /// Several runs may share one. Damaged entries are read from the server again. Where the cache
    /// cannot be written to, the run goes on without it.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Most bytes that the disk cache may take, or 0 for none
    ///
    /// Entries that were not used for longest are removed first. A larger cache has to read less
    /// again.
    #[arg(long, value_name = "SIZE", default_value = "10GiB", value_parser = values::parse_cache_size)]
    pub cache_size: MemorySize,
    /// Use only the disk cache, and no server
    #[arg(long)]
    pub offline: bool,
    /// Longest time that one request to a server may take, seconds
    ///
    /// A request that fails is repeated for at most three times this long; after that a coarser
    /// tile is drawn in its place.
    #[arg(long, value_name = "SECONDS", default_value = "20", value_parser = values::parse_timeout)]
    pub timeout: Duration,
    /// Most requests to a server at a time
    ///
    /// More of them make better use of a link with a long delay, and put more load on the server.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub requests: u32,
}
