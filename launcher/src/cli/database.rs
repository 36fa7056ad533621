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
    /// Several runs may share one. What is damaged in it is read anew; a cache that cannot be written is done without.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Most bytes that the disk cache may take, or 0 for none
    ///
    /// What was not used for longest makes room. More saves reading again what a flight has seen before.
    #[arg(long, value_name = "SIZE", default_value = "10GiB", value_parser = values::parse_cache_size)]
    pub cache_size: MemorySize,
    /// Fly from the disk cache alone: ask no server
    #[arg(long)]
    pub offline: bool,
    /// Longest time that one request to a server may take, seconds
    ///
    /// A request that fails is repeated, for at most three times this long; then its tile is drawn from coarser ones.
    #[arg(long, value_name = "SECONDS", default_value = "20", value_parser = values::parse_timeout)]
    pub timeout: Duration,
    /// Most requests to a server at a time
    ///
    /// More use a link of long delay better, and load the server.
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=256))]
    pub requests: u32,
}
