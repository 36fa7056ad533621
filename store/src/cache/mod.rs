//! The disk cache: pieces of archives of databases that are elsewhere.
//!
//! ```text
//! cache/
//!   ledger                      bytes that all entries take, under a lock
//!   gate                        locked by all that write, together, or by the one that makes room, alone
//!   locations/<location>        which database was there last
//!   index/<database>/           manifest.json, nodes.tvn
//!   tiles/<database>/<xx>/<archive>-<first byte>-<bytes>
//! ```
//!
//! Folders are this user's alone (0700): what others could write there would be drawn, and what
//! they could read shows where somebody flew. A sweep removes what has such a name, and nothing
//! else that may lie there.
//!
//! Several processes may use it at once: entries appear whole, by renaming, and room is reserved in
//! the ledger before an entry is written. A process that dies between the two leaves the ledger too
//! high, never too low; the next sweep sets it right. Each entry carries a checksum; one that fails
//! it is removed. Nothing that goes wrong here is fatal: the cache then keeps still for a while,
//! and that is noted once.
//!
//! An entry's time of modification is when it was used last, to the second; a sweep removes the
//! ones longest unused.

mod entry;
mod ledger;
mod sweep;

use crate::error::{Cause, Fault};
use crate::error_log::ErrorLog;
use bytes::Bytes;
use ledger::Ledger;
use std::fs::{self, FileTimes};
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant, SystemTime};
use terravision_common::files::{claim_folder, open_regular, private_folder};

/// Entries that were used within this time are not marked again.
const MARK_EVERY: Duration = Duration::from_secs(1);
/// After a failure the cache writes nothing for so long.
const PAUSE: Duration = Duration::from_secs(30);
/// What an entry takes on disk is counted in whole blocks.
const BLOCK_BYTES: u64 = 4096;

/// What lies in a cache's folder; the worlds of benches, too.
const NAMES: [&str; 6] = ["bench", "gate", "index", "ledger", "locations", "tiles"];

/// Makes sure that a cache's folder is there and that nobody else writes into it.
///
/// # Errors
/// Why it cannot be used.
pub(crate) fn claim_cache(folder: &Path) -> io::Result<()> {
    claim_folder(folder, &NAMES)
}

/// What an entry is a piece of.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(crate) struct Key {
    /// Name of the archive.
    pub(crate) file: &'static str,
    /// Its bytes.
    pub(crate) range: Range<u64>,
}

/// Counts of a cache.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Pieces that were there.
    pub hits: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Pieces that were not.
    pub misses: u64,
    /// Pieces written.
    pub written: u64,
    /// Entries that were damaged, and removed.
    pub damaged: u64,
}

#[derive(Debug, Default)]
struct Counters {
    hits: AtomicU64,
    bytes: AtomicU64,
    misses: AtomicU64,
    written: AtomicU64,
    damaged: AtomicU64,
}

/// The entries of one database.
#[derive(Debug)]
pub(crate) struct DiskCache {
    folder: PathBuf,
    tiles: PathBuf,
    most_bytes: u64,
    is_readable: bool,
    ledger: Option<Ledger>,
    paused: Mutex<Option<Instant>>,
    counters: Counters,
    log: Arc<ErrorLog>,
}

/// Bytes on disk of an entry with so much content.
fn disk_bytes(content: u64) -> u64 {
    (content + entry::HEADER_BYTES as u64).div_ceil(BLOCK_BYTES) * BLOCK_BYTES
}

impl DiskCache {
    /// The cache in a folder, for one database, and at most `most_bytes` for all databases. Never
    /// fails: a cache that does not work keeps nothing.
    pub(crate) fn open(folder: &Path, database: &str, most_bytes: u64, log: Arc<ErrorLog>) -> Self {
        let tiles = folder.join("tiles").join(database);
        let mut cache = Self {
            folder: folder.to_owned(),
            tiles,
            most_bytes,
            is_readable: true,
            ledger: None,
            paused: Mutex::new(None),
            counters: Counters::default(),
            log,
        };
        if most_bytes > 0 {
            let claimed = claim_cache(folder);
            // What another user may have written is not read either.
            cache.is_readable = claimed.is_ok();
            match claimed.and_then(|()| private_folder(&cache.tiles)).and_then(|()| Ledger::open(folder)) {
                Ok(ledger) => cache.ledger = Some(ledger),
                Err(error) => cache.fail(&error),
            }
        }
        cache
    }

    pub(crate) fn stats(&self) -> CacheStats {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        CacheStats {
            hits: read(&self.counters.hits),
            bytes: read(&self.counters.bytes),
            misses: read(&self.counters.misses),
            written: read(&self.counters.written),
            damaged: read(&self.counters.damaged),
        }
    }

    fn path(&self, key: &Key) -> PathBuf {
        let length = key.range.end - key.range.start;
        // Neighbours share a folder: 4 MiB of an archive, so that no folder has too many entries.
        let shard = format!("{:x}", key.range.start >> 22);
        self.tiles.join(shard).join(format!("{}-{}-{length}", key.file, key.range.start))
    }

    /// Counts a file that was written into the cache's folder by another part of this crate.
    pub(crate) fn account(&self, content: u64) {
        if let Some(ledger) = &self.ledger {
            ledger.add(disk_bytes(content)).unwrap_or_else(|error| self.fail(&error));
        }
    }

    /// A piece, if it is there and whole. Blocks on the disk.
    pub(crate) fn get(&self, key: &Key) -> Option<Bytes> {
        if !self.is_readable {
            return None;
        }
        let path = self.path(key);
        match entry::read(&path, key.range.end - key.range.start) {
            Ok(Some((content, modified))) => {
                self.counters.hits.fetch_add(1, Ordering::Relaxed);
                self.counters.bytes.fetch_add(content.len() as u64, Ordering::Relaxed);
                mark_used(&path, modified);
                Some(content)
            }
            Ok(None) => {
                self.counters.damaged.fetch_add(1, Ordering::Relaxed);
                self.counters.misses.fetch_add(1, Ordering::Relaxed);
                let why = "entries of the disk cache were damaged; they are read anew".to_owned();
                self.log.note(&Fault { cause: Cause::Cache, why, place: self.folder.display().to_string() });
                self.remove(key);
                None
            }
            Err(error) => {
                self.counters.misses.fetch_add(1, Ordering::Relaxed);
                if error.kind() != io::ErrorKind::NotFound {
                    self.fail(&error);
                }
                None
            }
        }
    }

    /// Keeps a piece, if there is room or room can be made. Blocks on the disk.
    pub(crate) fn put(&self, key: &Key, content: &[u8]) {
        let Some(ledger) = &self.ledger else { return };
        let size = disk_bytes(content.len() as u64);
        let path = self.path(key);
        if self.is_paused() || size > self.most_bytes || path.exists() {
            return;
        }
        let kept = self.keep(ledger, &path, content, size).and_then(|is_kept| match is_kept {
            true => Ok(true),
            // Another process may be at it: then this piece is not kept, and nobody waits.
            false => {
                sweep::sweep(&self.folder, ledger, size, self.most_bytes)?;
                self.keep(ledger, &path, content, size)
            }
        });
        match kept {
            Ok(true) => {
                self.counters.written.fetch_add(1, Ordering::Relaxed);
            }
            Ok(false) => {}
            Err(error) => self.fail(&error),
        }
    }

    /// Keeps a piece if there is room and nobody is making room.
    fn keep(&self, ledger: &Ledger, path: &Path, content: &[u8], size: u64) -> io::Result<bool> {
        // A file of its own for each write: locks belong to open files.
        let gate = sweep::open_gate(&self.folder)?;
        match gate.try_lock_shared() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Ok(false),
            Err(fs::TryLockError::Error(error)) => return Err(error),
        }
        if !ledger.reserve(size, self.most_bytes)? {
            return Ok(false);
        }
        match self.write(path, content) {
            Ok(()) => Ok(true),
            Err(error) => {
                ledger.release(size).unwrap_or_default();
                Err(error)
            }
        }
    }

    /// Removes a piece that turned out to be wrong.
    pub(crate) fn remove(&self, key: &Key) {
        let path = self.path(key);
        if fs::remove_file(path).is_ok()
            && let Some(ledger) = &self.ledger
        {
            ledger.release(disk_bytes(key.range.end - key.range.start)).unwrap_or_default();
        }
    }

    fn write(&self, path: &Path, content: &[u8]) -> io::Result<()> {
        let Some(shard) = path.parent() else { return Ok(()) };
        let temporary = shard.join(temporary_name());
        let written = entry::write(&temporary, content).or_else(|error| match error.kind() {
            // The first of its shard; or a sweep has just removed the empty folder.
            io::ErrorKind::NotFound => fs::create_dir_all(shard).and_then(|()| entry::write(&temporary, content)),
            _ => Err(error),
        });
        let renamed = written.and_then(|()| fs::rename(&temporary, path));
        if renamed.is_err() {
            drop(fs::remove_file(&temporary));
        }
        renamed
    }

    fn is_paused(&self) -> bool {
        let mut paused = self.paused.lock().unwrap_or_else(PoisonError::into_inner);
        *paused = paused.filter(|since| since.elapsed() < PAUSE);
        paused.is_some()
    }

    fn fail(&self, error: &io::Error) {
        *self.paused.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let why = format!("the disk cache does not work ({error}), the flight goes on without it");
        self.log.note(&Fault { cause: Cause::Cache, why, place: self.folder.display().to_string() });
    }
}

/// A name that no other write has: not of this process, which may have opened the folder several
/// times, and not of a process of another container with the same id.
fn temporary_name() -> String {
    static NUMBER: AtomicU64 = AtomicU64::new(0);
    static BEGUN_NANOS: OnceLock<u128> = OnceLock::new();
    let begun = BEGUN_NANOS
        .get_or_init(|| SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0, |since| since.as_nanos()));
    // Relaxed: numbers only have to differ.
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    format!("{}{}-{begun:x}-{number}", sweep::TEMPORARY, std::process::id())
}

fn mark_used(path: &Path, modified: SystemTime) {
    let now = SystemTime::now();
    if now.duration_since(modified).is_ok_and(|age| age > MARK_EVERY) {
        // An entry that another process removes just now needs no mark; nor does one in a folder
        // that is read only.
        let marked = open_regular(path).and_then(|file| file.set_times(FileTimes::new().set_modified(now)));
        marked.unwrap_or_default();
    }
}

#[cfg(test)]
mod tests;
