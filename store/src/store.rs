//! A terrain database, local or remote.

use crate::cache::CacheStats;
use crate::error::{Cause, FetchError, StoreError};
use crate::error_log::ErrorLog;
use crate::local::local_payload;
use crate::location::Location;
use crate::mirror::OnProgress;
use crate::network::Network;
use crate::options::StoreOptions;
use crate::payload::Payload;
use crate::remote_backend::{RemoteBackend, unfinished};
use crate::retry::NegativeCache;
use crate::transport::Transport;
use bytes::Bytes;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use terravision_common::database::{
    Database, Index, Layer, Manifest, NodeRanges, Tile, TileError, TileScratch, TileSource, decode_color,
    decode_elevation,
};
use terravision_common::node::NodeId;
use terravision_common::outcome::TileFailure;
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;

/// Statistics of a store.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StoreStats {
    /// Requests to the server, those for credentials included.
    pub requests: u64,
    /// Of these, repeated after a failure.
    pub repeated: u64,
    /// Bytes of content received.
    pub bytes: u64,
    /// Pieces being read now.
    pub under_way: usize,
    /// The disk cache.
    pub cache: CacheStats,
}

/// A terrain database, local or remote, open for reading. Used by any thread; concurrent reads of
/// the same bytes are shared, and the checksums of tiles are verified.
///
/// It has threads of its own for the network. When dropped, it waits a moment for pieces that are
/// still being written to its cache.
#[derive(Debug)]
pub struct Store {
    location: Location,
    log: Arc<ErrorLog>,
    failed: NegativeCache,
    backend: Backend,
}

#[derive(Debug)]
enum Backend {
    Local(Arc<Database>),
    Remote(Box<RemoteBackend>),
}

impl Backend {
    fn index(&self) -> &Index {
        match self {
            Self::Local(database) => database.index(),
            Self::Remote(remote) => remote.index(),
        }
    }
}

impl Store {
    /// Opens a database: reads its manifest, mirrors its index, checks that its archives exist.
    /// Blocks; not for threads of an async runtime.
    ///
    /// # Errors
    /// [`StoreError`]: it does not exist, cannot be reached, is damaged, or has another version.
    pub fn open(location: &Location, options: &StoreOptions) -> Result<Self, StoreError> {
        Self::open_with_progress(location, options, &mut |_, _| {})
    }

    /// [`Store::open`], with a callback for the progress of reading the index, which may have
    /// megabytes.
    ///
    /// # Errors
    /// See [`Store::open`].
    pub fn open_with_progress(
        location: &Location,
        options: &StoreOptions,
        on_progress: OnProgress<'_>,
    ) -> Result<Self, StoreError> {
        let log = Arc::new(ErrorLog::default());
        let backend = match (location.as_folder(), Transport::new(location, options)?) {
            (None, Some(transport)) => {
                Backend::Remote(Box::new(RemoteBackend::open(transport, location, options, &log, on_progress)?))
            }
            (folder, _) => Backend::Local(Arc::new(Database::open(folder.unwrap_or(Path::new(".")))?)),
        };
        let root = backend.index().world().coarsest_level();
        let (vital, _) = top_levels(backend.index().world());
        let failed = NegativeCache::new(options.failed_tiles, root, vital);
        Ok(Self { location: location.clone(), log, failed, backend })
    }

    /// Where it is.
    #[must_use]
    pub fn location(&self) -> &Location {
        &self.location
    }

    /// Its manifest, world and ranges of height. Its path is a local folder with manifest and
    /// height ranges: that of the database itself, or a mirror that lives as long as this store.
    #[must_use]
    pub fn index(&self) -> &Index {
        self.backend.index()
    }

    /// Its manifest.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        self.index().manifest()
    }

    /// Its geometry.
    #[must_use]
    pub fn world(&self) -> &World {
        self.index().world()
    }

    /// Lowest and highest ground under each node.
    #[must_use]
    pub fn ranges(&self) -> &NodeRanges {
        self.index().ranges()
    }

    /// All failures so far, folded, including those after which a repeated request succeeded.
    #[must_use]
    pub fn errors(&self) -> &ErrorLog {
        &self.log
    }

    /// Statistics so far; all zeros for a local folder.
    #[must_use]
    pub fn stats(&self) -> StoreStats {
        let Backend::Remote(backend) = &self.backend else { return StoreStats::default() };
        let remote = backend.remote();
        let wire = |read: fn(&Network) -> u64| remote.network().map_or(0, read);
        StoreStats {
            requests: wire(|network| network.transport().wire().requests()),
            repeated: wire(|network| network.policy().repeated()),
            bytes: wire(|network| network.transport().wire().bytes()),
            under_way: remote.under_way().0,
            cache: remote.cache_stats(),
        }
    }

    /// A stored tile, its checksum verified. Dropping the future cancels the read, whether queued
    /// or in flight, unless another read waits for the same bytes. Any executor may drive it.
    ///
    /// After a failure, the same error is returned at once for a while, without a request.
    ///
    /// # Errors
    /// [`FetchError`].
    pub async fn payload(&self, layer: Layer, node: NodeId) -> Result<Bytes, FetchError> {
        self.fetch(Tile { layer, node }).await.map(|payload| payload.bytes)
    }

    /// [`Store::payload`], with information about the request.
    ///
    /// # Errors
    /// [`FetchError`].
    pub async fn fetch(&self, tile: Tile) -> Result<Payload, FetchError> {
        if let Some(error) = self.failed.find(tile, Instant::now()) {
            return Err(error);
        }
        let read = match &self.backend {
            Backend::Local(database) => match tokio::runtime::Handle::try_current() {
                Ok(runtime) => {
                    let (database, log) = (Arc::clone(database), Arc::clone(&self.log));
                    let task = runtime.spawn_blocking(move || local_payload(&database, tile, &log));
                    task.await.unwrap_or_else(|error| Err(unfinished(&error)))
                }
                Err(_no_runtime) => local_payload(database, tile, &self.log),
            }
            .map(Payload::new),
            Backend::Remote(remote) => remote.payload(tile, self.failed.is_vital(tile)).await,
        };
        match (&self.backend, &read) {
            (Backend::Remote(remote), Err(error)) if error.is_passing() && remote.is_silent(tile.layer) => {
                self.failed.note_silence(tile, error, Instant::now());
            }
            _ => self.failed.note(tile, read.as_ref().err(), Instant::now()),
        }
        read
    }

    /// Why a tile must not be requested at this moment: it could not be read, and rests, or is
    /// given up for good ([`StoreOptions::failed_tiles`]). `None` when it may be requested. Sends
    /// no request.
    #[must_use]
    pub fn recent_failure(&self, tile: Tile) -> Option<TileFailure> {
        self.failed.find(tile, Instant::now()).map(|error| error.failure())
    }

    /// Records that a tile cannot be decoded: it is treated like one that could not be read.
    pub fn reject(&self, tile: Tile) {
        let error = FetchError::failed(Cause::Damaged, "what came cannot be decoded", tile.to_string());
        self.failed.note(tile, Some(&error), Instant::now());
    }

    /// [`Store::payload`] for threads that belong to no async runtime.
    fn payload_blocking(&self, layer: Layer, node: NodeId) -> Result<Bytes, TileError> {
        let read = match &self.backend {
            Backend::Local(database) => local_payload(database, Tile { layer, node }, &self.log),
            Backend::Remote(remote) => remote.block_on(self.payload(layer, node)),
        };
        read.map_err(|error| error.into_tile_error(layer, node))
    }
}

/// Blocks on the network; not for threads of an async runtime.
impl TileSource for Store {
    fn read_elevation(&self, node: NodeId, out: &mut [f32], scratch: &mut TileScratch) -> Result<(), TileError> {
        if let Backend::Local(database) = &self.backend {
            return database.read_elevation(node, out, scratch);
        }
        let payload = self.payload_blocking(Layer::Elevation, node)?;
        decode_elevation(self.world(), node, &payload, out, scratch)
    }

    fn read_color(&self, node: NodeId, out: &mut [u8], scratch: &mut TileScratch) -> Result<(), TileError> {
        if let Backend::Local(database) = &self.backend {
            return database.read_color(node, out, scratch);
        }
        let payload = self.payload_blocking(Layer::Color, node)?;
        decode_color(self.world(), node, &payload, out)
    }
}
