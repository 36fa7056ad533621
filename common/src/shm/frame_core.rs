//! The protocol of one slot of the frame ring: a sequence lock over words, with the number of the
//! publication in it.
//!
//! Publication n (from 1) goes to slot (n - 1) modulo the number of slots. The slot's sequence is
//! 2n - 1 while it is written and 2n when it is whole, and then `newest` becomes n. So one
//! comparison tells a reader both that its copy is whole and that it is the publication that it
//! went for. The writer waits for nobody.

use crate::sync::{AtomicU64, Ordering, fence};

/// Where the writer's words go: into a file, of which it holds no mapping (a peer that cuts the
/// file short must not kill it), or into words under the model checker.
pub(crate) trait Outlet {
    /// Why a word cannot be written.
    type Error;

    /// Stores a slot's sequence, relaxed.
    fn sequence(&mut self, value: u64) -> Result<(), Self::Error>;

    /// Stores the number of the newest publication, relaxed.
    fn newest(&mut self, number: u64) -> Result<(), Self::Error>;
}

/// Publication `number` begins; the words may be stored (relaxed) from here on. One writer at a
/// time.
pub(crate) fn begin<O: Outlet>(out: &mut O, number: u64) -> Result<(), O::Error> {
    out.sequence(number.wrapping_mul(2).wrapping_sub(1))?;
    // Whoever loads one of the new words, and then fences, sees the odd sequence.
    fence(Ordering::Release); // SYNC frame.begin
    Ok(())
}

/// Publication `number` is whole, and the newest.
pub(crate) fn publish<O: Outlet>(out: &mut O, number: u64) -> Result<(), O::Error> {
    // The words come before. For who goes by `newest`, the fence below would do.
    fence(Ordering::Release); // SYNC frame.end
    out.sequence(number.wrapping_mul(2))?;
    // The sequence comes before.
    fence(Ordering::Release); // SYNC frame.newest
    out.newest(number)
}

/// Borrowed words of a slot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameSlot<'a> {
    pub(crate) sequence: &'a AtomicU64,
    pub(crate) words: &'a [AtomicU64],
}

impl FrameSlot<'_> {
    /// What `copy` makes of the words (relaxed loads), if they were those of publication `number`
    /// from first to last. What it made of others is dropped: it must be able to take any words.
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
