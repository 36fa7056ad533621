//! The ledger: total bytes of all entries, shared by all processes that use the cache.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

/// The file with the total. Locked for a moment at each change.
#[derive(Debug)]
pub(super) struct Ledger {
    /// A lock of the file excludes other processes, the mutex other threads.
    file: Mutex<File>,
}

impl Ledger {
    pub(super) fn open(folder: &Path) -> io::Result<Self> {
        let file = File::options().read(true).write(true).create(true).truncate(false).open(folder.join("ledger"))?;
        Ok(Self { file: Mutex::new(file) })
    }

    /// Changes the total under the lock; `change` returns the new total and a result.
    fn change<T>(&self, change: impl FnOnce(u64) -> (u64, T)) -> io::Result<T> {
        let file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.lock()?;
        let mut bytes = [0; 8];
        let read = file.read_at(&mut bytes, 0);
        // A new or truncated ledger starts at 0: the next sweep determines the real total.
        let total = if matches!(read, Ok(8)) { u64::from_le_bytes(bytes) } else { 0 };
        let (new, result) = change(total);
        let written = if new == total { Ok(()) } else { file.write_all_at(&new.to_le_bytes(), 0) };
        file.unlock()?;
        written.map(|()| result)
    }

    /// Whether there is room for `size` bytes.
    pub(super) fn has_room(&self, size: u64, most: u64) -> io::Result<bool> {
        self.change(|total| (total, total.checked_add(size).is_some_and(|sum| sum <= most)))
    }

    #[cfg(test)]
    pub(super) fn total(&self) -> io::Result<u64> {
        self.change(|total| (total, total))
    }

    /// Reserves room, if that leaves the total within `most`.
    pub(super) fn reserve(&self, size: u64, most: u64) -> io::Result<bool> {
        self.change(|total| match total.checked_add(size) {
            Some(sum) if sum <= most => (sum, true),
            _ => (total, false),
        })
    }

    /// Adds `size` bytes unconditionally.
    pub(super) fn add(&self, size: u64) -> io::Result<()> {
        self.change(|total| (total.saturating_add(size), ()))
    }

    pub(super) fn release(&self, size: u64) -> io::Result<()> {
        self.change(|total| (total.saturating_sub(size), ()))
    }

    /// Sets the total after a sweep, while no process writes.
    pub(super) fn settle(&self, left: u64) -> io::Result<()> {
        self.change(|_| (left, ()))
    }
}
