//! The algorithm of the ring, independent of where its slots are: in a mapping, or on the heap
//! under the model checker.

use super::cursor::{Positions, ReadCursor, WriteCursor};
use super::error::ShmError;
use super::kind::SegmentKind;

/// Where the slots of a ring are.
///
/// # Safety
/// - `put` and `take` reach the one slot that `index` names, any index below the capacity, and no
///   other.
/// - All clones or views of one store have the same positions.
pub(crate) unsafe trait Items {
    /// The item in a slot.
    type Item: Copy;

    fn positions(&self) -> &Positions;

    /// Fills a slot.
    ///
    /// # Safety
    /// - `index` is below the capacity, and the protocol gives the slot to the caller.
    unsafe fn put(&self, index: u64, item: &Self::Item);

    /// Copies a slot out.
    ///
    /// # Safety
    /// - `index` is below the capacity, and the protocol gives the slot to the caller.
    unsafe fn take(&self, index: u64) -> Self::Item;
}

/// The writer's end.
#[derive(Debug)]
pub(crate) struct WriteEnd<S> {
    pub(crate) items: S,
    cursor: WriteCursor,
    mask: u64,
}

impl<S: Items> WriteEnd<S> {
    /// `capacity` is a power of two, checked when the segment was opened; the caller is the only
    /// writer.
    pub(crate) fn attach(items: S, kind: SegmentKind, capacity: u64) -> Result<Self, ShmError> {
        debug_assert!(capacity.is_power_of_two());
        let cursor = WriteCursor::attach(items.positions(), kind, capacity)?;
        Ok(Self { items, cursor, mask: capacity - 1 })
    }

    /// Writes one item; `false` when the ring is full.
    pub(crate) fn try_push(&mut self, item: &S::Item) -> Result<bool, ShmError> {
        Ok(self.try_push_some(std::slice::from_ref(item))? == 1)
    }

    /// Writes as many items as there is room for, and makes them visible together. Returns how
    /// many.
    pub(crate) fn try_push_some(&mut self, items: &[S::Item]) -> Result<usize, ShmError> {
        let positions = self.items.positions();
        let room = self.cursor.room(positions, items.len() as u64)?;
        let count = room.min(items.len() as u64);
        for (offset, item) in (0..count).zip(items) {
            let index = self.cursor.position().wrapping_add(offset) & self.mask;
            // SAFETY: masked; the slot is ours since `room` found it given back (SYNC
            // ring.release), and we have not published it.
            unsafe { self.items.put(index, item) }
        }
        if count > 0 {
            self.cursor.publish(positions, count);
        }
        Ok(count as usize)
    }

    /// The last published item, by this writer or the one before; `None` before the first.
    pub(crate) fn last(&self) -> Option<S::Item> {
        let index = self.cursor.position().checked_sub(1)? & self.mask;
        // SAFETY: masked; only the writer, which is us, ever changes a slot, and the position's
        // Acquire (SYNC ring.publish) made the writes of earlier writers visible.
        Some(unsafe { self.items.take(index) })
    }
}

/// The reader's end.
#[derive(Debug)]
pub(crate) struct ReadEnd<S> {
    pub(crate) items: S,
    cursor: ReadCursor,
    mask: u64,
    /// Items that were taken and not released: the writer does not touch them.
    held: u64,
}

impl<S: Items> ReadEnd<S> {
    /// As [`WriteEnd::attach`], for the only reader.
    pub(crate) fn attach(items: S, kind: SegmentKind, capacity: u64) -> Result<Self, ShmError> {
        debug_assert!(capacity.is_power_of_two());
        let cursor = ReadCursor::attach(items.positions(), kind, capacity)?;
        Ok(Self { items, cursor, mask: capacity - 1, held: 0 })
    }

    /// Takes one item out; `None` when the ring is empty.
    pub(crate) fn try_pop(&mut self) -> Result<Option<S::Item>, ShmError> {
        debug_assert!(self.held == 0, "items that are held come first");
        let item = self.try_take()?;
        self.give_back(1);
        Ok(item)
    }

    /// Takes one item and holds it: if this reader dies, the next reader gets it again. `None` when
    /// there is none after the held ones.
    pub(crate) fn try_take(&mut self) -> Result<Option<S::Item>, ShmError> {
        let positions = self.items.positions();
        if self.cursor.filled_beyond(positions, self.held)? == 0 {
            return Ok(None);
        }
        // SAFETY: masked; the slot is ours since `filled_beyond` found it published (SYNC
        // ring.publish), and we have not given it back.
        let item = unsafe { self.items.take(self.position() & self.mask) };
        self.held += 1;
        Ok(Some(item))
    }

    /// Releases the oldest `count` of the held items to the writer, or all if there are fewer.
    pub(crate) fn give_back(&mut self, count: u64) {
        let count = count.min(self.held);
        if count > 0 {
            self.held -= count;
            self.cursor.release(self.items.positions(), count);
        }
    }

    /// Stops holding items: they will be taken again.
    pub(crate) fn put_back(&mut self) {
        self.held = 0;
    }

    /// Number of items that are held.
    pub(crate) fn held(&self) -> u64 {
        self.held
    }

    /// Position of the next item to be taken.
    pub(crate) fn position(&self) -> u64 {
        self.cursor.position().wrapping_add(self.held)
    }

    /// Number of items to be taken.
    pub(crate) fn len(&mut self) -> Result<u64, ShmError> {
        self.cursor.filled_now(self.items.positions())
    }
}
