//! Tiles of a database that is elsewhere: directories by need, small tiles by extents, large ones by themselves.
//!
//! ```text
//!   tile ─▶ directory: root, then a leaf ─▶ range ─▶ pieces ─▶ checksum of the tile ─▶ bytes
//!                                                     │  ▲            │ wrong: forget the pieces, read them anew
//!                             memory, disk cache, network ◀───────────┘
//! ```
//!
//! Elevation tiles are small and their archive keeps neighbours together, so they are read by aligned extents; a colour
//! tile is read by itself. Nothing goes to the disk cache before something in it has passed a checksum.

use crate::cache::{CacheFigures, DiskCache, Key};
use crate::error::{Cause, Fault, FetchError};
use crate::error_log::ErrorLog;
use crate::etags::Etags;
use crate::flights::Flights;
use crate::memory::{Memory, Piece};
use crate::network::{Network, Request};
use crate::transport::Answer;
use bytes::{Bytes, BytesMut};
use futures_util::future::try_join_all;
use pmtiles::TileId;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use terravision_common::database::{
    ARCHIVE_HEADER_BYTES, ArchiveError, ArchiveLayout, ArchiveRecord, COLOR_FILE, Directory, ELEVATION_FILE, Layer,
    Leaves, MANIFEST_FILE, MOST_MANIFEST_BYTES, Manifest, Place, TileDamage, check_tile, max_payload_bytes, tile_place,
};
use terravision_common::node::NodeId;
use terravision_common::world::World;
use tokio::sync::OnceCell;

/// Elevation tiles are read in aligned extents of this size: about 150 neighbours.
const EXTENT_BYTES: u64 = 32 << 10;
/// Extents kept in memory.
const MEMORY_BYTES: usize = 16 << 20;
/// The header and the root directory of a PMTiles archive lie in its first bytes (specification v3, section 3).
const HEAD_BYTES: u64 = 16_384;
/// Damaged bytes of a server are read anew this many times.
const DAMAGED_RETRIES: u32 = 5;
/// After failed reads the manifest is asked for once in this time.
const LOOK_EVERY: Duration = Duration::from_secs(10);
/// Pieces that wait to be written to the disk cache, and their bytes; more are not kept.
const MOST_PENDING: usize = 256;
const MOST_PENDING_BYTES: usize = 64 << 20;

/// A database on a server, or as much of it as the disk cache has.
#[derive(Debug)]
pub(crate) struct Remote {
    world: World,
    manifest_text: Bytes,
    /// None when nothing is to be asked.
    network: Option<Network>,
    cache: Arc<DiskCache>,
    archives: [RemoteArchive; 2],
    memory: Memory,
    flights: Flights<Key, Arc<Piece>>,
    changed: OnceLock<Arc<Fault>>,
    /// Held while it is found out whether the database has changed; when a failed read last was the reason.
    verifying: tokio::sync::Mutex<Option<Instant>>,
    pending: Arc<AtomicUsize>,
    pending_bytes: Arc<AtomicUsize>,
    place: String,
    log: Arc<ErrorLog>,
}

#[derive(Debug)]
struct RemoteArchive {
    layer: Layer,
    file: &'static str,
    record: ArchiveRecord,
    head: OnceCell<Head>,
    leaves: Leaves,
    etags: Mutex<Etags>,
}

/// What an archive begins with.
#[derive(Debug)]
struct Head {
    first: Bytes,
    layout: ArchiveLayout,
    root: Directory,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Remote {
    pub(crate) fn new(
        manifest: &Manifest,
        manifest_text: Bytes,
        world: World,
        network: Option<Network>,
        cache: DiskCache,
        place: String,
        log: Arc<ErrorLog>,
    ) -> Self {
        let archive = |layer, file, record| RemoteArchive {
            layer,
            file,
            record,
            head: OnceCell::new(),
            leaves: Leaves::default(),
            etags: Mutex::default(),
        };
        Self {
            world,
            manifest_text,
            network,
            cache: Arc::new(cache),
            archives: [
                archive(Layer::Elevation, ELEVATION_FILE, manifest.elevation.archive),
                archive(Layer::Color, COLOR_FILE, manifest.color.archive),
            ],
            memory: Memory::new(MEMORY_BYTES),
            flights: Flights::default(),
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

    pub(crate) fn cache_figures(&self) -> CacheFigures {
        self.cache.figures()
    }

    /// Pieces being read, and pieces waiting to be written to disk.
    pub(crate) fn under_way(&self) -> (usize, usize) {
        // Acquire: SYNC store.pending, with the release of who has written a piece.
        (self.flights.under_way(), self.pending.load(Ordering::Acquire))
    }

    /// Reads what both archives begin with: whether they are there, and whole enough to begin.
    pub(crate) async fn open_archives(self: &Arc<Self>) -> Result<(), FetchError> {
        let [elevation, color] = &self.archives;
        futures_util::future::try_join(self.head(elevation), self.head(color)).await.map(drop)
    }

    /// A tile as it is stored, its checksum verified. Without one that is vital there is no picture.
    pub(crate) async fn payload(
        self: &Arc<Self>,
        layer: Layer,
        node: NodeId,
        is_vital: bool,
    ) -> Result<Bytes, FetchError> {
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
        self.verified(archive, &keys, &range, is_vital, check).await
    }

    async fn place_of(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        tile: TileId,
    ) -> Result<Option<Range<u64>>, FetchError> {
        let broken = |error: ArchiveError| damaged(error.into());
        let head = self.head(archive).await?;
        match head.layout.place(&head.root, tile).map_err(broken)? {
            None => Ok(None),
            Some(Place::Tile(range)) => Ok(Some(range)),
            Some(Place::Leaf { index, range }) => {
                let leaf = self.leaf(archive, head, index, range).await?;
                head.layout.place_in_leaf(&leaf, tile).map_err(broken)
            }
        }
    }

    async fn head<'a>(self: &Arc<Self>, archive: &'a RemoteArchive) -> Result<&'a Head, FetchError> {
        archive.head.get_or_try_init(|| self.read_head(archive)).await
    }

    async fn read_head(self: &Arc<Self>, archive: &RemoteArchive) -> Result<Head, FetchError> {
        let bytes = archive.record.bytes;
        let range = 0..HEAD_BYTES.min(bytes);
        if range.end < ARCHIVE_HEADER_BYTES as u64 {
            return Err(damaged(ArchiveError::NotPmtiles.into()));
        }
        let key = Key { file: archive.file, range: range.clone() };
        let parse = |first: &Bytes| {
            let layout = ArchiveLayout::parse(first, bytes)?;
            let root = layout.root();
            let inside = (root.end <= first.len() as u64).then(|| first.slice(root.start as usize..root.end as usize));
            let root = inside.map(|root| layout.directory(&root)).transpose()?;
            Ok((first.clone(), layout, root))
        };
        let (first, layout, root) = self.verified(archive, &[key], &range, true, parse).await?;
        let root = match root {
            Some(root) => root,
            None => self.directory(archive, &layout, layout.root()).await?,
        };
        Ok(Head { first, layout, root })
    }

    async fn leaf(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        head: &Head,
        index: usize,
        range: Range<u64>,
    ) -> Result<Arc<Directory>, FetchError> {
        if let Some(leaf) = archive.leaves.get(index) {
            return Ok(leaf);
        }
        let key = Key { file: archive.file, range: range.clone() };
        let parse = |bytes: &Bytes| archive.leaves.get_or_parse(index, || Ok(head.layout.directory(bytes)?));
        self.verified(archive, &[key], &range, true, parse).await
    }

    async fn directory(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        layout: &ArchiveLayout,
        range: Range<u64>,
    ) -> Result<Directory, FetchError> {
        let key = Key { file: archive.file, range: range.clone() };
        self.verified(archive, &[key], &range, true, |bytes| Ok(layout.directory(bytes)?)).await
    }

    /// Reads pieces until what lies in `range` passes the check; then they are worth keeping.
    async fn verified<T>(
        self: &Arc<Self>,
        archive: &RemoteArchive,
        keys: &[Key],
        range: &Range<u64>,
        is_vital: bool,
        check: impl Fn(&Bytes) -> Result<T, TileDamage>,
    ) -> Result<T, FetchError> {
        let mut attempt = 0;
        loop {
            let pieces = try_join_all(keys.iter().map(|key| self.piece(key, is_vital))).await?;
            let damage = match check(&assemble(keys, &pieces, range)) {
                Ok(checked) => {
                    keys.iter().zip(&pieces).for_each(|(key, piece)| self.keep(archive, key, piece));
                    return Ok(checked);
                }
                Err(damage) => damage,
            };
            let place = format!("{}/{}", self.place, archive.file);
            let why = format!("what came is not what was written ({damage})");
            self.log.note(&Fault { cause: Cause::Damaged, why, place });
            for key in keys {
                self.memory.remove(key);
            }
            let cache = Arc::clone(&self.cache);
            let gone = keys.to_vec();
            blocking(move || gone.iter().for_each(|key| cache.remove(key))).await;
            let is_repeated = match &self.network {
                // Of a file of this machine they are the same again, but for one that is being written.
                Some(network) if attempt < network.retries_at_most(DAMAGED_RETRIES) => network.again(attempt).await,
                _ => false,
            };
            attempt += 1;
            if !is_repeated {
                return Err(self.look_for_change(archive, damaged(damage)).await);
            }
        }
    }

    /// A piece, from where it is had soonest.
    async fn piece(self: &Arc<Self>, key: &Key, is_vital: bool) -> Result<Arc<Piece>, FetchError> {
        if let Some(piece) = self.memory.get(key) {
            return Ok(piece);
        }
        let flight = self.flights.join(key, || {
            let (this, key) = (Arc::clone(self), key.clone());
            async move {
                let cache = Arc::clone(&this.cache);
                let wanted = key.clone();
                if let Some(bytes) = blocking(move || cache.get(&wanted)).await.flatten() {
                    return Ok(Arc::new(Piece::new(bytes, true)));
                }
                let bytes = this.fetch(&key, is_vital).await?;
                Ok(Arc::new(Piece::new(bytes, false)))
            }
        });
        flight.await
    }

    /// A piece, from the network.
    async fn fetch(&self, key: &Key, is_vital: bool) -> Result<Bytes, FetchError> {
        if let Some(changed) = self.changed.get() {
            return Err(FetchError::Failed(Arc::clone(changed)));
        }
        let Some(network) = &self.network else {
            let why = "it is not in the cache, and --offline asks no server";
            let place = format!("{}/{}", self.place, key.file);
            let error = FetchError::failed(Cause::Offline, why, place);
            if let FetchError::Failed(fault) = &error {
                self.log.note(fault);
            }
            return Err(error);
        };
        let archive = self.archives.iter().find(|archive| archive.file == key.file);
        let request = Request {
            file: key.file,
            range: Some(key.range.clone()),
            most_bytes: key.range.end - key.range.start,
            retries: network.most_retries(),
            is_vital,
        };
        let read = network
            .read(&request, |answer| async move {
                match archive {
                    Some(archive) => self.same_file(network, archive, answer).await,
                    None => Ok(answer.bytes),
                }
            })
            .await;
        match (read, archive) {
            (Err(error), Some(archive)) => Err(self.look_for_change(archive, error).await),
            (read, _) => read,
        }
    }

    /// Why a read has failed: often an archive that was replaced by a smaller one refuses ranges (416), or gives other bytes, and no
    /// mark of its content tells. Then its manifest does, which is asked for now and then.
    async fn look_for_change(&self, archive: &RemoteArchive, error: FetchError) -> FetchError {
        let may_tell = matches!(
            error.cause(),
            Some(Cause::Refused | Cause::NotFound | Cause::BadAnswer | Cause::Interrupted | Cause::Damaged)
        );
        let Some(network) = self.network.as_ref().filter(|_| may_tell) else { return error };
        let mut looked = self.verifying.lock().await;
        if let Some(changed) = self.changed.get() {
            return FetchError::Failed(Arc::clone(changed));
        }
        if looked.is_some_and(|at| at.elapsed() < LOOK_EVERY) {
            return error;
        }
        *looked = Some(Instant::now());
        let request =
            Request { file: MANIFEST_FILE, range: None, most_bytes: MOST_MANIFEST_BYTES, retries: 0, is_vital: false };
        let Ok(text) = network.read(&request, |answer| async move { Ok(answer.bytes) }).await else { return error };
        // One that was damaged on its way tells nothing.
        if text == self.manifest_text || Manifest::parse(&String::from_utf8_lossy(&text)).is_err() {
            return error;
        }
        let changed = self.has_changed(archive, "its manifest is another one");
        if let FetchError::Failed(fault) = &changed {
            self.log.note(fault);
        }
        changed
    }

    /// The bytes of an answer, if they are of the file that the manifest describes.
    async fn same_file(&self, network: &Network, archive: &RemoteArchive, answer: Answer) -> Result<Bytes, FetchError> {
        let expected = archive.record.bytes;
        if answer.file_bytes != expected {
            let why = format!("it has {} bytes, expected {expected}", answer.file_bytes);
            return Err(self.has_changed(archive, &why));
        }
        let Some(etag) = answer.etag else { return Ok(answer.bytes) };
        let is_known = |etag: &String| lock(&archive.etags).is_known(etag);
        if is_known(&etag) {
            return Ok(answer.bytes);
        }
        // Another mark: another database, or the same once more. The manifest and the directory tell.
        let _alone = self.verifying.lock().await;
        if is_known(&etag) {
            return Ok(answer.bytes);
        }
        if let Some(changed) = self.changed.get() {
            // Whoever looked before this one has found out.
            return Err(FetchError::Failed(Arc::clone(changed)));
        }
        let ask = |file, range: Option<Range<u64>>, most_bytes| {
            let request = Request { file, range, most_bytes, retries: network.most_retries(), is_vital: true };
            async move { network.read(&request, |answer| async move { Ok(answer.bytes) }).await }
        };
        let manifest = ask(MANIFEST_FILE, None, MOST_MANIFEST_BYTES).await;
        let is_same = match (manifest, archive.head.get()) {
            (Ok(manifest), _) if manifest != self.manifest_text => false,
            (Ok(_), Some(head)) => {
                let range = 0..head.first.len() as u64;
                ask(archive.file, Some(range.clone()), range.end).await? == head.first
            }
            // Nothing of the old content is known.
            (Ok(_), None) => true,
            (Err(error), _) if error.cause() == Some(Cause::BadAnswer) => false,
            (Err(error), _) => return Err(error),
        };
        if !is_same {
            return Err(self.has_changed(archive, "its manifest or its directory is another one"));
        }
        lock(&archive.etags).learn(&etag);
        let why = "the server replaced it by an equal one while it was read".to_owned();
        self.log.note(&Fault { cause: Cause::Touched, why, place: network.transport().place(archive.file) });
        Ok(answer.bytes)
    }

    /// From now on nothing more is read from the server.
    fn has_changed(&self, archive: &RemoteArchive, how: &str) -> FetchError {
        let fault = self.changed.get_or_init(|| {
            let why = format!("the database on the server is not the one that was opened ({how}); open it anew");
            Arc::new(Fault { cause: Cause::Changed, why, place: format!("{}/{}", self.place, archive.file) })
        });
        FetchError::Failed(Arc::clone(fault))
    }

    /// Keeps a piece of which something was verified.
    fn keep(&self, archive: &RemoteArchive, key: &Key, piece: &Arc<Piece>) {
        if archive.layer == Layer::Elevation && key.range.start.is_multiple_of(EXTENT_BYTES) {
            self.memory.put(key, piece);
        }
        if !piece.begin_keeping() {
            return;
        }
        // Acquire and release: SYNC store.pending, so that who sees none pending sees the cache as it was left.
        let bytes = piece.bytes.len();
        // Relaxed: a sum that orders nothing.
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

/// Work on the disk, where it holds up no other read; `None` when the runtime ends.
async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    tokio::task::spawn_blocking(work).await.ok()
}

/// The aligned extents of a file that cover a range; the last one ends with the file.
fn extents(file: &'static str, range: &Range<u64>, file_bytes: u64) -> Vec<Key> {
    let key = |number: u64| Key { file, range: number * EXTENT_BYTES..((number + 1) * EXTENT_BYTES).min(file_bytes) };
    (range.start / EXTENT_BYTES..range.end.div_ceil(EXTENT_BYTES)).map(key).collect()
}

/// The bytes of a range that pieces, one after the other, cover.
fn assemble(keys: &[Key], pieces: &[Arc<Piece>], range: &Range<u64>) -> Bytes {
    let part = |key: &Key, piece: &Piece| {
        let start = range.start.max(key.range.start) - key.range.start;
        let end = range.end.min(key.range.end) - key.range.start;
        piece.bytes.slice(start as usize..end as usize)
    };
    match (keys, pieces) {
        ([key], [piece]) => part(key, piece),
        _ => {
            let mut bytes = BytesMut::with_capacity((range.end - range.start) as usize);
            keys.iter().zip(pieces).for_each(|(key, piece)| bytes.extend_from_slice(&part(key, piece)));
            bytes.freeze()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn extents_cover_a_range_and_give_its_bytes(file_bytes in 1u64..200_000, a: prop::sample::Index, b: prop::sample::Index) {
            let (a, b) = (a.index(file_bytes as usize) as u64, b.index(file_bytes as usize) as u64);
            let range = a.min(b)..a.max(b) + 1;
            let keys = extents("x", &range, file_bytes);
            let byte = |at: u64| (at * 31 % 251) as u8;
            let piece = |key: &Key| Arc::new(Piece::new(key.range.clone().map(byte).collect(), false));
            let pieces: Vec<_> = keys.iter().map(piece).collect();
            prop_assert!(keys.iter().all(|key| key.range.end <= file_bytes && key.range.start % EXTENT_BYTES == 0));
            prop_assert_eq!(assemble(&keys, &pieces, &range), range.map(byte).collect::<Vec<_>>());
        }
    }
}
