//! Tiles of a remote database: directories are read when needed, small tiles in extents, large
//! tiles individually.
//!
//! ```text
//!   tile ─▶ directory: root, then a leaf ─▶ range ─▶ pieces ─▶ checksum of the tile ─▶ bytes
//!                                                     │  ▲            │ wrong: forget the pieces, read them anew
//!                             memory, disk cache, network ◀───────────┘
//! ```
//!
//! Elevation tiles are small, and neighbours are close together in their archive, so they are read
//! in aligned extents; a colour tile is read individually. A piece is written to the disk cache
//! only after something in it has passed a checksum.

mod archive;
mod extents;
mod identity;

use crate::cache::{CacheStats, DiskCache, Key};
use crate::coalescing::RequestCoalescer;
use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use crate::memory::{Memory, Piece};
use crate::network::{Network, Request};
use crate::payload::Payload;
use crate::retry::{Allowance, DAMAGED_RETRIES};
use archive::RemoteArchive;
use bytes::Bytes;
use extents::{EXTENT_BYTES, assemble, extents};
use futures_util::future::try_join_all;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use terravision_common::database::{
    ArchiveError, COLOR_FILE, ELEVATION_FILE, Layer, Manifest, Tile, TileDamage, check_tile, max_payload_bytes,
    tile_place,
};
use terravision_common::world::World;

/// Bytes of extents that are kept in memory.
const MEMORY_BYTES: usize = 16 << 20;
/// Bounds of the pieces that wait to be written to the disk cache, and of their bytes; further
/// pieces are not written.
const MOST_PENDING: usize = 256;
const MOST_PENDING_BYTES: usize = 64 << 20;

/// A database on a server, or the part of it that is in the disk cache.
#[derive(Debug)]
pub(crate) struct Remote {
    world: World,
    manifest_text: Bytes,
    /// `None` when the network must not be used.
    network: Option<Network>,
    cache: Arc<DiskCache>,
    archives: [RemoteArchive; 2],
    memory: Memory,
    reads: RequestCoalescer<Key, Arc<Piece>>,
    changed: OnceLock<Arc<Fault>>,
    /// Held during the check whether the database has changed. The time of the last check that a
    /// failed read caused.
    verifying: tokio::sync::Mutex<Option<Instant>>,
    pending: Arc<AtomicUsize>,
    pending_bytes: Arc<AtomicUsize>,
    place: String,
    log: Arc<ErrorLog>,
}

/// Verified content of pieces, and when the last of them was requested again, if any was.
struct Verified<T> {
    content: T,
    resent_at: Option<Instant>,
}

impl Remote {
    pub(crate) fn new(
        manifest: &Manifest,
        manifest_text: Bytes,
        network: Option<Network>,
        cache: DiskCache,
        place: String,
        log: Arc<ErrorLog>,
    ) -> Self {
        Self {
            world: *manifest.world(),
            manifest_text,
            network,
            cache: Arc::new(cache),
            archives: [
                RemoteArchive::new(Layer::Elevation, ELEVATION_FILE, manifest.fields().elevation.archive),
                RemoteArchive::new(Layer::Color, COLOR_FILE, manifest.fields().color.archive),
            ],
            memory: Memory::new(MEMORY_BYTES),
            reads: RequestCoalescer::default(),
            changed: OnceLock::new(),
            verifying: tokio::sync::Mutex::default(),
            pending: Arc::default(),
            pending_bytes: Arc::default(),
            place,
            log,
        }
    }

    pub(crate) fn network(&self) -> Option<&Network> {
        self.network.as_ref()
    }

    /// Whether the breaker of a layer's archive is open: its requests fail in a row.
    pub(crate) fn is_silent(&self, layer: Layer) -> bool {
        let file = self.archives[layer as usize].file;
        self.network.as_ref().is_some_and(|network| network.policy().is_silent(file))
    }

    pub(crate) fn cache_stats(&self) -> CacheStats {
        self.cache.stats()
    }

    /// Pieces being read, and pieces waiting to be written to disk.
    pub(crate) fn under_way(&self) -> (usize, usize) {
        // Acquire: SYNC store.pending, pairs with the release after a piece was written.
        (self.reads.under_way(), self.pending.load(Ordering::Acquire))
    }

    /// Reads the beginnings of both archives, to check that they exist and can be read.
    pub(crate) async fn open_archives(self: &Arc<Self>) -> Result<(), FetchError> {
        let [elevation, color] = &self.archives;
        futures_util::future::try_join(self.head(elevation), self.head(color)).await.map(drop)
    }

    /// A stored tile, its checksum verified. `is_vital`: there is no picture without it.
    pub(crate) async fn payload(self: &Arc<Self>, tile: Tile, is_vital: bool) -> Result<Payload, FetchError> {
        let begun = Instant::now();
        let Tile { layer, node } = tile;
        let tile = tile_place(&self.world, layer, node).ok_or(FetchError::Absent)?;
        let archive = &self.archives[layer as usize];
        let range = self.place_of(archive, tile).await?.ok_or(FetchError::Absent)?;
        let most = max_payload_bytes(&self.world, layer);
        let found = range.end - range.start;
        if found > most as u64 {
            return Err(damaged(ArchiveError::TileLength { expected: most, found }.into()));
        }
        let keys = match layer {
            Layer::Elevation => extents(archive.file, &range, archive.record.bytes),
            Layer::Color => vec![Key { file: archive.file, range: range.clone() }],
        };
        let check = |bytes: &Bytes| check_tile(layer, bytes).map(|()| bytes.clone());
        let Verified { content: bytes, resent_at } = self.verified(archive, &keys, &range, is_vital, check).await?;
        // Pieces from memory may have been requested long ago.
        Ok(Payload { bytes, resent_at: resent_at.filter(|at| *at > begun) })
    }

    /// Reads pieces until the content of `range` passes the check; then stores them.
    async fn verified<T>(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        keys: &[Key],
        range: &Range<u64>,
        is_vital: bool,
        check: impl Fn(&Bytes) -> Result<T, TileDamage>,
    ) -> Result<Verified<T>, FetchError> {
        let mut attempt = 0;
        loop {
            let pieces = try_join_all(keys.iter().map(|key| self.piece(key, is_vital))).await?;
            let damage = match check(&assemble(keys, &pieces, range)) {
                Ok(content) => {
                    keys.iter().zip(&pieces).for_each(|(key, piece)| self.keep(archive, key, piece));
                    let resent_at = pieces.iter().filter_map(|piece| piece.resent_at).max();
                    return Ok(Verified { content, resent_at });
                }
                Err(damage) => damage,
            };
            let place = format!("{}/{}", self.place, archive.file);
            let why = format!("the bytes are not those that were written ({damage})");
            self.log.note(&Fault { cause: Cause::Damaged, why, place });
            for key in keys {
                self.memory.remove(key);
            }
            let cache = Arc::clone(&self.cache);
            let gone = keys.to_vec();
            blocking(move || gone.iter().for_each(|key| cache.remove(key))).await;
            let is_repeated = match &self.network {
                // A local file would give the same bytes again, unless it is being written.
                Some(network) => network.policy().again_after_damage(attempt, DAMAGED_RETRIES).await,
                None => false,
            };
            attempt += 1;
            if !is_repeated {
                return Err(self.look_for_change(archive, damaged(damage)).await);
            }
        }
    }

    /// A piece from memory, the disk cache or the network.
    async fn piece(self: &Arc<Self>, key: &Key, is_vital: bool) -> Result<Arc<Piece>, FetchError> {
        if let Some(piece) = self.memory.get(key) {
            return Ok(piece);
        }
        let read = self.reads.join(key, || {
            let (this, key) = (Arc::clone(self), key.clone());
            async move {
                let cache = Arc::clone(&this.cache);
                let wanted = key.clone();
                if let Some(bytes) = blocking(move || cache.get(&wanted)).await.flatten() {
                    return Ok(Arc::new(Piece::new(bytes, true)));
                }
                let (bytes, resent_at) = this.fetch(&key, is_vital).await?;
                Ok(Arc::new(Piece::fetched(bytes, resent_at)))
            }
        });
        read.await
    }

    /// A piece, from the network.
    async fn fetch(&self, key: &Key, is_vital: bool) -> Result<(Bytes, Option<Instant>), FetchError> {
        if let Some(changed) = self.changed.get() {
            return Err(FetchError::failed_as(Arc::clone(changed)));
        }
        let Some(network) = &self.network else {
            let why = "it is not in the cache, and --offline asks no server";
            let place = format!("{}/{}", self.place, key.file);
            let error = FetchError::failed(Cause::Offline, why, place);
            if let FetchError::Failed { fault } = &error {
                self.log.note(fault);
            }
            return Err(error);
        };
        let archive = self.archives.iter().find(|archive| archive.file == key.file);
        let request = Request {
            file: key.file,
            range: Some(key.range.clone()),
            most_bytes: key.range.end - key.range.start,
            allowance: Allowance { retries: network.policy().most_retries(), is_vital, may_be_hasty: true },
        };
        let read = network
            .read(&request, |answer| async move {
                let resent_at = answer.resent_at;
                match archive {
                    Some(archive) => Ok((self.same_file(network, archive, answer).await?, resent_at)),
                    None => Ok((answer.bytes, resent_at)),
                }
            })
            .await;
        match (read, archive) {
            (Err(error), Some(archive)) => Err(self.look_for_change(archive, error).await),
            (read, _) => read,
        }
    }

    /// Stores a piece of which some content was verified.
    fn keep(&self, archive: &RemoteArchive, key: &Key, piece: &Arc<Piece>) {
        if archive.layer == Layer::Elevation && key.range.start.is_multiple_of(EXTENT_BYTES) {
            self.memory.put(key, piece);
        }
        if !piece.begin_keeping() {
            return;
        }
        // Acquire and release: SYNC store.pending, so that a thread that sees none pending sees the
        // final state of the cache.
        let bytes = piece.bytes.len();
        // Relaxed: only a sum.
        let before = self.pending_bytes.fetch_add(bytes, Ordering::Relaxed);
        if self.pending.fetch_add(1, Ordering::AcqRel) >= MOST_PENDING || before + bytes > MOST_PENDING_BYTES {
            self.pending_bytes.fetch_sub(bytes, Ordering::Relaxed);
            self.pending.fetch_sub(1, Ordering::AcqRel);
            return;
        }
        let (cache, key, piece) = (Arc::clone(&self.cache), key.clone(), Arc::clone(piece));
        let (pending, pending_bytes) = (Arc::clone(&self.pending), Arc::clone(&self.pending_bytes));
        drop(tokio::task::spawn_blocking(move || {
            cache.put(&key, &piece.bytes);
            pending_bytes.fetch_sub(bytes, Ordering::Relaxed);
            pending.fetch_sub(1, Ordering::AcqRel);
        }));
    }
}

fn damaged(reason: TileDamage) -> FetchError {
    FetchError::Damaged { reason: Arc::new(reason) }
}

/// Runs disk work on a thread where it delays no other read; `None` when the runtime ends.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    tokio::task::spawn_blocking(work).await.ok()
}
