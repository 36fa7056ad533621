//! The algorithm of the want list, independent of where its entries are: one side replaces the list
//! at any time, and the other reads it completely or not at all. Neither waits for the other. It is
//! a sequence lock over a list of variable length.

use super::bell::Bell;
use super::cursor::Padded;
use super::seqlock::{LOOKS, relax};
use crate::sync::{AtomicU64, Ordering, fence};

/// Words of a list besides its entries.
pub(crate) const HEAD_WORDS: usize = 4;

/// The shared words of a want list.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct WantWords {
    /// Odd while the list is written; 0 before the first.
    version: Padded<AtomicU64>,
    head: [AtomicU64; HEAD_WORDS],
    /// The reader sleeps here.
    bell: Padded<Bell>,
}

#[cfg(not(loom))]
const _: () = assert!(size_of::<WantWords>() == 3 * 128);

/// One entry.
#[derive(Debug)]
#[repr(transparent)]
pub(crate) struct WantEntry(AtomicU64);

impl WantEntry {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self(AtomicU64::new(0))
    }
}

/// The result of reading the list.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// It has not changed.
    Unchanged,
    /// It has changed, and has been copied out.
    Changed {
        /// Its version.
        version: u64,
        /// Its head.
        head: [u64; HEAD_WORDS],
    },
    /// A write was in progress at every attempt; try again.
    Busy,
}

impl WantWords {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self {
            version: Padded(AtomicU64::new(0)),
            head: std::array::from_fn(|_| AtomicU64::new(0)),
            bell: Padded(Bell::new()),
        }
    }

    /// Where the reader sleeps.
    pub(crate) fn bell(&self) -> &Bell {
        &self.bell.0
    }

    /// Whether the list is newer than the version that the reader has seen.
    pub(crate) fn is_newer_than(&self, seen: u64) -> bool {
        // Relaxed: a hint; `read` checks properly.
        let version = self.version.0.load(Ordering::Relaxed);
        version != seen && version.is_multiple_of(2)
    }

    /// Replaces the list by as many `tiles` as fit. One writer at a time. A writer that is killed
    /// here leaves an odd version, which readers do not accept; the next write repairs it.
    pub(crate) fn write(
        &self,
        entries: &[WantEntry],
        head: [u64; HEAD_WORDS],
        tiles: impl ExactSizeIterator<Item = u64>,
    ) {
        // Relaxed: ours alone.
        let odd = self.version.0.load(Ordering::Relaxed).wrapping_add(1) | 1;
        self.version.0.store(odd, Ordering::Relaxed);
        // SYNC want-list.begin: a reader that reads one of the new words, and then fences, sees the
        // odd version.
        fence(Ordering::Release);
        for (word, value) in self.head.iter().zip(head) {
            word.store(value, Ordering::Relaxed);
        }
        for (entry, tile) in entries.iter().zip(tiles) {
            entry.0.store(tile, Ordering::Relaxed);
        }
        // Release: SYNC want-list.end, the words come before.
        self.version.0.store(odd.wrapping_add(1).max(2), Ordering::Release);
    }

    /// Copies the list into `out`, unless it has version `seen`. The last word of the head is the
    /// number of entries; entries beyond `entries` are not read, and the caller has to check the
    /// number.
    pub(crate) fn read(&self, entries: &[WantEntry], seen: u64, out: &mut Vec<u64>) -> Look {
        for _ in 0..LOOKS {
            // Acquire: SYNC want-list.end.
            let version = self.version.0.load(Ordering::Acquire);
            if version == seen || version == 0 {
                return Look::Unchanged;
            }
            if version.is_multiple_of(2) {
                let head: [u64; HEAD_WORDS] = std::array::from_fn(|i| self.head[i].load(Ordering::Relaxed));
                let count = usize::try_from(head[HEAD_WORDS - 1]).unwrap_or(usize::MAX);
                out.clear();
                out.extend(entries.iter().take(count).map(|entry| entry.0.load(Ordering::Relaxed)));
                // SYNC want-list.begin.
                fence(Ordering::Acquire);
                if self.version.0.load(Ordering::Relaxed) == version {
                    return Look::Changed { version, head };
                }
            }
            relax();
        }
        Look::Busy
    }

    /// For tests: overwrites the words as a faulty peer might.
    #[cfg(all(test, not(loom)))]
    pub(crate) fn overwrite(&self, version: u64, head: [u64; HEAD_WORDS]) {
        self.version.0.store(version, Ordering::Release);
        for (word, value) in self.head.iter().zip(head) {
            word.store(value, Ordering::Release);
        }
    }
}
