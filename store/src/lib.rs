//! A terrain database anywhere: in a folder, in an archive, on a web server that honours byte
//! ranges, in an S3 bucket.
//!
//! [`Store::open`] opens the database at a [`Location`]. [`Store::payload`] reads stored tiles for
//! async readers; for threads that may block, the store is a
//! [`TileSource`](terravision_common::database::TileSource). Data from a network goes through a
//! disk cache, and is verified by the checksums of manifest and tiles. Only the module `retry`
//! decides what is requested again, and when ([`StoreOptions`], [`Store::recent_failure`]).
//! Failures are folded by cause ([`ErrorLog`]).
//!
//! ```no_run
//! use terravision_common::database::Layer;
//! use terravision_store::{Location, Store, StoreOptions};
//!
//! let location = Location::parse("https://example.org/alps.tv")?;
//! let store = Store::open(&location, &StoreOptions::default())?;
//! let root = store.world().root();
//! let tile = async { store.payload(Layer::Color, root).await };
//! # drop(tile);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cache;
mod coalescing;
mod error;
mod error_log;
mod etags;
mod local;
mod location;
mod memory;
mod mirror;
mod network;
mod options;
mod payload;
mod redirect;
mod remote;
mod remote_backend;
mod retry;
mod store;
mod tar;
mod transport;
mod wire;
mod wire_error;

pub use cache::CacheStats;
pub use error::{Cause, Fault, FetchError, StoreError};
pub use error_log::{ErrorLog, Folded};
pub use location::{Location, LocationError};
pub use mirror::OnProgress;
pub use options::{DEFAULT_CACHE_BYTES, StoreOptions, default_cache_dir};
pub use payload::Payload;
pub use retry::{FailedTiles, NegativeCache, RetryOptions, patience};
pub use store::{Store, StoreStats};

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks a mutex, also after a panic of its holder: no code of this crate panics between two writes
/// that belong together.
fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
