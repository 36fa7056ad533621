//! A sequence lock: a value that one side replaces at any time and others read completely or not at
//! all, without waiting.

use crate::sync::{AtomicU64, Ordering, fence};

/// `N` words behind a counter that is odd while they are written.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct SeqLock<const N: usize> {
    sequence: AtomicU64,
    words: [AtomicU64; N],
}

/// Attempts to read a changing value before a reader gives up. A write takes some 20 ns.
pub(crate) const LOOKS: u32 = if cfg!(loom) { 2 } else { 64 };

impl<const N: usize> SeqLock<N> {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self { sequence: AtomicU64::new(0), words: std::array::from_fn(|_| AtomicU64::new(0)) }
    }

    /// Replaces the value. One writer at a time; a second one would mix the words, which readers
    /// must expect anyway. A writer that is killed here leaves an odd counter, which the next write
    /// repairs.
    pub(crate) fn write(&self, value: &[u64; N]) {
        // Relaxed: ours alone.
        let before = self.sequence.load(Ordering::Relaxed);
        let odd = before.wrapping_add(1) | 1;
        self.sequence.store(odd, Ordering::Relaxed);
        // SYNC seqlock.begin: a reader that reads one of the new words, and then fences, sees the
        // odd counter.
        fence(Ordering::Release);
        for (word, value) in self.words.iter().zip(value) {
            word.store(*value, Ordering::Relaxed);
        }
        // Release: SYNC seqlock.end, the words come before.
        self.sequence.store(odd.wrapping_add(1), Ordering::Release);
    }

    /// The complete value; `None` before the first write, or when a write never ends (because its
    /// writer died).
    pub(crate) fn read(&self) -> Option<[u64; N]> {
        self.read_numbered().map(|(_, value)| value)
    }

    /// The counter, which changes with the value.
    #[cfg_attr(loom, expect(dead_code, reason = "for poses, which the checker is built without"))]
    pub(crate) fn counter(&self) -> u64 {
        // Relaxed: only a hint to read.
        self.sequence.load(Ordering::Relaxed)
    }

    /// The value with its counter, which differs for every value.
    pub(crate) fn read_numbered(&self) -> Option<(u64, [u64; N])> {
        for _ in 0..LOOKS {
            // Acquire: SYNC seqlock.end.
            let before = self.sequence.load(Ordering::Acquire);
            if before == 0 {
                return None;
            }
            if before.is_multiple_of(2) {
                let value = std::array::from_fn(|i| self.words[i].load(Ordering::Relaxed));
                // SYNC seqlock.begin.
                fence(Ordering::Acquire);
                if self.sequence.load(Ordering::Relaxed) == before {
                    return Some((before, value));
                }
            }
            relax();
        }
        None
    }
}

#[cfg(not(loom))]
pub(crate) fn relax() {
    std::hint::spin_loop();
}

#[cfg(loom)]
pub(crate) fn relax() {
    loom::thread::yield_now();
}
