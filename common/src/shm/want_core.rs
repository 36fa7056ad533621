//! The want list's algorithm, apart from where its entries live: a list that one side replaces at
//! will, and that the other reads whole or not at all. Neither waits for the other. It is the
//! seqlock, over a list of changing length.

use super::bell::Bell;
use super::cursor::Padded;
use super::seqlock::{LOOKS, relax};
use crate::sync::{AtomicU64, Ordering, fence};

/// Words of a list apart from its entries.
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

/// How a look at the list went.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// It is the one that was seen.
    Unchanged,
    /// It is another one, which has been copied out.
    Changed {
        /// Which.
        version: u64,
        /// Its head.
        head: [u64; HEAD_WORDS],
    },
    /// A write was under way at every look; look again.
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

    /// Whether the list is another one than the reader has seen.
    pub(crate) fn is_newer_than(&self, seen: u64) -> bool {
        // Relaxed: a hint; `read` looks properly.
        let version = self.version.0.load(Ordering::Relaxed);
        version != seen && version.is_multiple_of(2)
    }

    /// Replaces the list by as many `tiles` as there are entries for. One writer at a time. A
    /// writer that was killed in here leaves an odd version, with which no reader takes anything;
    /// the next write mends it.
    pub(crate) fn write(
        &self,
        entries: &[WantEntry],
        head: [u64; HEAD_WORDS],
        tiles: impl ExactSizeIterator<Item = u64>,
    ) {
        // Relaxed: ours alone.
        let odd = self.version.0.load(Ordering::Relaxed).wrapping_add(1) | 1;
        self.version.0.store(odd, Ordering::Relaxed);
        // SYNC want-list.begin: whoever reads one of the new words, and then fences, sees the odd
        // version.
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

    /// Copies the list into `out`, unless it is the one of version `seen`. The last word of the
    /// head is the number of entries; what lies beyond `entries` is not read, for the caller to
    /// find the number wrong.
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

    /// What a peer that lost its mind may do.
    #[cfg(all(test, not(loom)))]
    pub(crate) fn overwrite(&self, version: u64, head: [u64; HEAD_WORDS]) {
        self.version.0.store(version, Ordering::Release);
        for (word, value) in self.head.iter().zip(head) {
            word.store(value, Ordering::Release);
        }
    }
}
