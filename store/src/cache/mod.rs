//! The disk cache: pieces of the archives of remote databases.
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
//! Folders are private to the user (0700): files that others wrote there would be drawn, and files
//! that others read would show where the user flew. A sweep removes only files and folders with the
//! names above.
//!
//! Several processes may use the cache at the same time: entries appear whole, by renaming, and
//! room is reserved in the ledger before an entry is written. If a process dies in between, the
//! ledger is too high, never too low; the next sweep corrects it. Each entry has a checksum and is
//! removed if that does not match. No failure here is fatal: the cache then pauses for a while, and
//! logs this once.
//!
//! The modification time of an entry is the time of its last use, to the second; a sweep removes
//! the least recently used entries.

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

/// The time of last use is updated at most this often.
const MARK_EVERY: Duration = Duration::from_secs(1);
/// After a failure the cache writes nothing for this long.
const PAUSE: Duration = Duration::from_secs(30);
/// The size of entries on disk is counted in whole blocks.
const BLOCK_BYTES: u64 = 4096;

/// Names in the folder of a cache, including that for the worlds of benches.
const NAMES: [&str; 6] = ["bench", "gate", "index", "ledger", "locations", "tiles"];

/// Makes sure that the folder of a cache exists and that only its owner can write to it.
///
/// # Errors
/// Why it cannot be used.
pub(crate) fn claim_cache(folder: &Path) -> io::Result<()> {
    claim_folder(folder, &NAMES)
}

/// The key of an entry: a piece of an archive.
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
    /// Pieces found.
    pub hits: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Pieces not found.
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

/// Bytes on disk of an entry with `content` bytes.
fn disk_bytes(content: u64) -> u64 {
    (content + entry::HEADER_BYTES as u64).div_ceil(BLOCK_BYTES) * BLOCK_BYTES
}

impl DiskCache {
    /// Opens the cache in a folder for one database, with a bound of `most_bytes` for all databases
    /// together. Never fails: a cache that does not work stores nothing.
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
            // A folder that other users can write to is not read either.
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
        // Neighbouring pieces share a folder, one for each 4 MiB of an archive, so that no folder
        // has too many entries.
        let shard = format!("{:x}", key.range.start >> 22);
        self.tiles.join(shard).join(format!("{}-{}-{length}", key.file, key.range.start))
    }

    /// Counts a file that was written into the cache's folder by another part of this crate.
    pub(crate) fn account(&self, content: u64) {
        if let Some(ledger) = &self.ledger {
            ledger.add(disk_bytes(content)).unwrap_or_else(|error| self.fail(&error));
        }
    }

    /// A piece, if it is in the cache and undamaged. Blocks on the disk.
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
                let why = "entries of the disk cache were damaged; they are read again from the server".to_owned();
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

    /// Stores a piece, if there is room or room can be made. Blocks on the disk.
    pub(crate) fn put(&self, key: &Key, content: &[u8]) {
        let Some(ledger) = &self.ledger else { return };
        let size = disk_bytes(content.len() as u64);
        let path = self.path(key);
        if self.is_paused() || size > self.most_bytes || path.exists() {
            return;
        }
        let kept = self.keep(ledger, &path, content, size).and_then(|is_kept| match is_kept {
            true => Ok(true),
            // If another process is already making room, this piece is not stored: nothing waits.
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

    /// Stores a piece, if there is room and no process is making room.
    fn keep(&self, ledger: &Ledger, path: &Path, content: &[u8], size: u64) -> io::Result<bool> {
        // Each write opens the file again, because locks belong to open files.
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

    /// Removes a piece that turned out to be damaged.
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
            // The first piece of its folder; or a sweep has just removed the empty folder.
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
        let why = format!("the disk cache does not work ({error}); the flight continues without it");
        self.log.note(&Fault { cause: Cause::Cache, why, place: self.folder.display().to_string() });
    }
}

/// A name that no other write uses: neither of this process, which may have opened the folder
/// several times, nor of a process with the same id in another container.
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
        // This may fail: another process may just have removed the entry, or the folder is
        // read-only.
        let marked = open_regular(path).and_then(|file| file.set_times(FileTimes::new().set_modified(now)));
        marked.unwrap_or_default();
    }
}

#[cfg(test)]
mod tests;
