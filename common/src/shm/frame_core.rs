//! The protocol of one slot of the frame ring: a sequence lock over words, with the number of the publication in it.
//!
//! Publication n (from 1) goes to slot (n - 1) modulo the number of slots. The slot's sequence is 2n - 1 while it is
//! written and 2n when it is whole, and then `newest` becomes n. So one comparison tells a reader both that its copy is
//! whole and that it is the publication that it went for. The writer waits for nobody.

use crate::sync::{AtomicU64, Ordering, fence};

/// Borrowed words of a slot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameSlot<'a> {
    pub(crate) sequence: &'a AtomicU64,
    pub(crate) words: &'a [AtomicU64],
}

impl FrameSlot<'_> {
    /// Publication `number` begins; the words may be stored (relaxed) from here on. One writer at a time.
    pub(crate) fn begin(&self, number: u64) {
        self.sequence.store(number.wrapping_mul(2).wrapping_sub(1), Ordering::Relaxed);
        // SYNC frame.begin: whoever loads one of the new words, and then fences, sees the odd sequence.
        fence(Ordering::Release);
    }

    /// Publication `number` is whole, and the newest.
    pub(crate) fn publish(&self, number: u64, newest: &AtomicU64) {
        // Release: SYNC frame.end, the words come before. For who goes by `newest`, its Release would do.
        self.sequence.store(number.wrapping_mul(2), Ordering::Release);
        // Release: SYNC frame.newest, the sequence comes before.
        newest.store(number, Ordering::Release);
    }

    /// What `copy` makes of the words (relaxed loads), if they were those of publication `number` from first to last.
    /// What it made of others is dropped: it must be able to take any words.
    pub(crate) fn copy<R>(&self, number: u64, copy: impl FnOnce(&[AtomicU64]) -> R) -> Option<R> {
        let whole = number.wrapping_mul(2);
        // Acquire: SYNC frame.end.
        if self.sequence.load(Ordering::Acquire) != whole {
            return None;
        }
        let copied = copy(self.words);
        // SYNC frame.begin.
        fence(Ordering::Acquire);
        (self.sequence.load(Ordering::Relaxed) == whole).then_some(copied)
    }
}

/// The publication to go for; 0 before the first.
pub(crate) fn newest(newest: &AtomicU64) -> u64 {
    // Acquire: SYNC frame.newest, the slot is whole.
    newest.load(Ordering::Acquire)
}
