//! The protocol of one slot of the frame ring: a sequence lock over words, with the number of the
//! publication in it.
//!
//! Publication n (from 1) goes to slot (n - 1) modulo the number of slots. The slot's sequence is
//! 2n - 1 while it is written and 2n when it is complete; then `newest` becomes n. So a single
//! comparison tells a reader that its copy is complete and that it is the publication it wanted.
//! The writer never waits.

use crate::sync::{AtomicU64, Ordering, fence};

/// Where the writer stores words: in a file that it does not map (a peer that truncates the file
/// must not kill it), or in atomics under the model checker.
pub(crate) trait Outlet {
    /// Why a word cannot be written.
    type Error;

    /// Stores a slot's sequence, relaxed.
    fn sequence(&mut self, value: u64) -> Result<(), Self::Error>;

    /// Stores the number of the newest publication, relaxed.
    fn newest(&mut self, number: u64) -> Result<(), Self::Error>;
}

/// Begins publication `number`; from here on the words may be stored (relaxed). One writer at a
/// time.
pub(crate) fn begin<O: Outlet>(out: &mut O, number: u64) -> Result<(), O::Error> {
    out.sequence(number.wrapping_mul(2).wrapping_sub(1))?;
    // A reader that loads one of the new words, and then fences, sees the odd sequence.
    fence(Ordering::Release); // SYNC frame.begin
    Ok(())
}

/// Ends publication `number`, which becomes the newest.
pub(crate) fn publish<O: Outlet>(out: &mut O, number: u64) -> Result<(), O::Error> {
    // The words come before. For readers that use `newest`, the fence below would suffice.
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
    /// The result of `copy` on the words (relaxed loads), if all of them belong to publication
    /// `number`. Otherwise the result is dropped: `copy` must accept any words.
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

/// The number of the newest publication; 0 before the first.
pub(crate) fn newest(newest: &AtomicU64) -> u64 {
    // Acquire: SYNC frame.newest, the slot is whole.
    newest.load(Ordering::Acquire)
}
