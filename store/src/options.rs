//! How a remote database is read.

use crate::retry::{FailedTiles, RetryOptions};
use std::path::PathBuf;
use std::time::Duration;
use terravision_common::run::DatabaseConfig;

/// Bytes of the disk cache unless told otherwise.
pub const DEFAULT_CACHE_BYTES: u64 = 10 << 30;

/// How a remote database is read. None of it matters to one in a folder of this machine, but for
/// [`StoreOptions::failed_tiles`].
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// Folder of the disk cache; [`default_cache_dir`] when there is none here.
    pub cache_dir: Option<PathBuf>,
    /// Most bytes that the cache may take, all databases together; 0 keeps no tiles.
    pub cache_bytes: u64,
    /// Never ask the network: what the cache does not have is missing.
    pub is_offline: bool,
    /// Longest time that one request may take. Shorter gives up on slow links, longer waits for
    /// servers that hang.
    pub request_timeout: Duration,
    /// Longest time that one read may take, all its requests and the waits between them together.
    pub deadline: Duration,
    /// How failed requests are asked again.
    pub retries: RetryOptions,
    /// Requests for tiles are made anew when their answer takes much longer than usual, before they
    /// time out. Better on links that lose requests silently, and more load for a server that is
    /// slow.
    pub is_hasty: bool,
    /// What becomes of tiles that could not be read.
    pub failed_tiles: FailedTiles,
    /// Most requests at a time. More use a link of long delay better, and load the server.
    pub parallel_requests: usize,
    /// A folder that has the index already, checked: it is used as it is, and the server is not
    /// asked for it.
    pub index: Option<PathBuf>,
}

impl Default for StoreOptions {
    fn default() -> Self {
        Self {
            cache_dir: None,
            cache_bytes: DEFAULT_CACHE_BYTES,
            is_offline: false,
            request_timeout: Duration::from_secs(20),
            deadline: Duration::from_secs(60),
            retries: RetryOptions::default(),
            is_hasty: false,
            failed_tiles: FailedTiles::Rest,
            parallel_requests: 16,
            index: None,
        }
    }
}

impl StoreOptions {
    /// As a run is configured. All requests of a read together may take three times as long as one.
    #[must_use]
    pub fn of(config: &DatabaseConfig) -> Self {
        let request_timeout = Duration::from_millis(config.request_timeout_ms.max(1));
        Self {
            cache_dir: config.cache.clone(),
            cache_bytes: config.cache_bytes,
            is_offline: config.is_offline,
            request_timeout,
            deadline: request_timeout.saturating_mul(3),
            parallel_requests: config.parallel_requests as usize,
            ..Self::default()
        }
    }
}

/// The cache's folder when none is asked for: `$XDG_CACHE_HOME/terravision`, else
/// `~/.cache/terravision`, else one in the folder of temporary files.
#[must_use]
pub fn default_cache_dir() -> PathBuf {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    absolute("XDG_CACHE_HOME")
        .or_else(|| absolute("HOME").map(|home| home.join(".cache")))
        .unwrap_or_else(std::env::temp_dir)
        .join("terravision")
}
