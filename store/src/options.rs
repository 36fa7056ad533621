//! How a remote database is read.

use crate::retry::{FailedTiles, RetryOptions};
use std::path::PathBuf;
use std::time::Duration;
use terravision_common::run::DatabaseConfig;

/// Default size of the disk cache, bytes.
pub const DEFAULT_CACHE_BYTES: u64 = 10 << 30;

/// How a remote database is read. For a local folder, only [`StoreOptions::failed_tiles`] matters.
#[derive(Debug, Clone)]
pub struct StoreOptions {
    /// Folder of the disk cache; `None`: [`default_cache_dir`].
    pub cache_dir: Option<PathBuf>,
    /// Maximum size of the cache, all databases together, bytes; 0 stores no tiles.
    pub cache_bytes: u64,
    /// Never use the network: tiles that are not in the cache are missing.
    pub is_offline: bool,
    /// Timeout of one request. A shorter one gives up on slow links, a longer one waits for servers
    /// that hang.
    pub request_timeout: Duration,
    /// Deadline of one read, including all its requests and the waits between them.
    pub deadline: Duration,
    /// How failed requests are repeated.
    pub retries: RetryOptions,
    /// Whether requests for tiles are repeated before they time out, when the answer takes much
    /// longer than usual. This helps on links that lose requests silently, and puts more load on a
    /// slow server.
    pub is_hasty: bool,
    /// When tiles that could not be read may be requested again.
    pub failed_tiles: FailedTiles,
    /// Maximum number of concurrent requests. More of them use a link with a long delay better, and
    /// load the server more.
    pub parallel_requests: usize,
    /// A folder that already contains the checked index: it is used, and not requested from the
    /// server.
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
    /// The options of a run. The deadline of a read is three times the timeout of a request.
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

/// The default folder of the cache: `$XDG_CACHE_HOME/terravision`, otherwise
/// `~/.cache/terravision`, otherwise one in the folder of temporary files.
#[must_use]
pub fn default_cache_dir() -> PathBuf {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    absolute("XDG_CACHE_HOME")
        .or_else(|| absolute("HOME").map(|home| home.join(".cache")))
        .unwrap_or_else(std::env::temp_dir)
        .join("terravision")
}
