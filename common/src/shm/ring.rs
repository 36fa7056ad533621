//! The ring: fixed-size records from one producer to one consumer, in order.
//!
//! When the ring is full, [`Producer::push`] waits and [`Producer::try_push`] returns the item;
//! when it is empty, [`Consumer::pop`] waits. Writers of the slot ring and the camera ring wait;
//! writers of event rings drop events and count them.

use super::control::Control;
use super::cursor::Positions;
use super::error::{ShmError, WaitError};
use super::header::{Role, RoleClaim, Segment};
use super::kind::{SegmentKind, Stage};
use super::region::SharedWords;
use super::ring_core::{Items, ReadEnd, WriteEnd};
use super::run_id::RunId;
use super::segments::open_segment;
use crate::event::monotonic_nanos;
use crate::ids::RingPosition;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::sync::Arc;

// SAFETY: atomics alone, repr(C), aligned to 128.
unsafe impl SharedWords for Positions {}

/// Slots in a segment.
struct SegmentItems<T> {
    segment: Arc<Segment>,
    item: PhantomData<fn(T) -> T>,
}

// SAFETY: `put` and `take` compute the slot's address from the checked geometry; the positions lie
// in the segment.
unsafe impl<T: Pod> Items for SegmentItems<T> {
    type Item = T;

    fn positions(&self) -> &Positions {
        self.segment.words()
    }

    unsafe fn put(&self, index: u64, item: &T) {
        // SAFETY: the slot is the caller's, by its promise.
        unsafe { self.segment.region().write(self.segment.item_offset(index), item) }
    }

    unsafe fn take(&self, index: u64) -> T {
        // SAFETY: the slot is the caller's, by its promise.
        unsafe { self.segment.region().read(self.segment.item_offset(index)) }
    }
}

/// Checks that a segment is a ring of `T`s.
fn typed<T: Pod>(segment: &Arc<Segment>) -> Result<SegmentItems<T>, ShmError> {
    let kind = segment.kind();
    let is_ring = !matches!(
        kind,
        SegmentKind::Control
            | SegmentKind::PingPong
            | SegmentKind::ElevationRing
            | SegmentKind::ColorPool
            | SegmentKind::ElevationPool
            | SegmentKind::WantList
            | SegmentKind::StreamRing
            | SegmentKind::VehicleTable
    );
    if !is_ring {
        return Err(ShmError::WrongKind { name: kind.name().to_owned(), kind });
    }
    let item_bytes = segment.geometry().item_bytes;
    if item_bytes != size_of::<T>() as u64 {
        return Err(ShmError::corrupt(kind, "the size of a slot", item_bytes, "the size of the records it carries"));
    }
    Ok(SegmentItems { segment: Arc::clone(segment), item: PhantomData })
}

/// The writing end of a ring. One per ring, across all processes.
pub struct Producer<T: Pod> {
    end: WriteEnd<SegmentItems<T>>,
    reader: Option<Stage>,
    _claim: RoleClaim,
}

impl<T: Pod> std::fmt::Debug for Producer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Producer").field("reader", &self.reader).finish_non_exhaustive()
    }
}

impl<T: Pod> Producer<T> {
    /// Opens the writing end of a run's ring; waits a short time for the segment to become ready.
    /// After a killed producer it continues after the last published item.
    ///
    /// # Errors
    /// See [`ShmError`]; [`ShmError::RoleTaken`] while another producer is alive.
    pub fn open(run: &RunId, kind: SegmentKind) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, kind)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let items = typed(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        let geometry = segment.geometry();
        let end = WriteEnd::attach(items, geometry.kind, geometry.capacity)?;
        Ok(Self { end, reader: geometry.kind.reader(), _claim: claim })
    }

    /// Number of slots.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.end.items.segment.geometry().capacity as u32
    }

    /// Writes an item; waits while the ring is full.
    ///
    /// # Errors
    /// The run ended, or the reader wrote an invalid value.
    pub fn push(&mut self, item: &T, control: &Control) -> Result<(), WaitError> {
        self.push_all(std::slice::from_ref(item), control).map(drop)
    }

    /// Writes items in order; waits while the ring is full. All items that fit become visible
    /// together, with one check of the reader's position and at most one wake-up: use this for
    /// frames. Returns the time waited, nanoseconds.
    ///
    /// # Errors
    /// The run ended (some of the items may have been written), or the reader wrote an invalid
    /// value.
    pub fn push_all(&mut self, items: &[T], control: &Control) -> Result<u64, WaitError> {
        let end = &mut self.end;
        let segment = Arc::clone(&end.items.segment);
        let positions: &Positions = segment.words();
        let (mut rest, mut waited_nanos) = (items, 0);
        while !rest.is_empty() {
            let mut count = end.try_push_some(rest).map_err(WaitError::from)?;
            if count == 0 {
                let started = monotonic_nanos();
                count = control.wait_for(positions.writable(), self.reader, || {
                    let count = end.try_push_some(rest)?;
                    Ok((count > 0).then_some(count))
                })?;
                waited_nanos += monotonic_nanos() - started;
            }
            rest = rest.get(count..).unwrap_or_default();
        }
        Ok(waited_nanos)
    }

    /// The last published item, by this producer or the one before; `None` before the first.
    #[must_use]
    pub fn last(&self) -> Option<T> {
        self.end.last()
    }

    /// Writes an item without waiting.
    ///
    /// # Errors
    /// Returns the item when the ring is full (or its positions are corrupt: then nothing would
    /// ever be read from it).
    pub fn try_push(&mut self, item: T) -> Result<(), T> {
        match self.end.try_push(&item) {
            Ok(true) => Ok(()),
            Ok(false) | Err(_) => Err(item),
        }
    }
}

/// The reading end of a ring. One per ring, across all processes.
pub struct Consumer<T: Pod> {
    end: ReadEnd<SegmentItems<T>>,
    writer: Option<Stage>,
    _claim: RoleClaim,
}

impl<T: Pod> std::fmt::Debug for Consumer<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Consumer").field("writer", &self.writer).finish_non_exhaustive()
    }
}

impl<T: Pod> Consumer<T> {
    /// Opens the reading end of a run's ring; waits a short time for the segment to become ready.
    /// After a killed consumer it continues with the first item that was not released.
    ///
    /// # Errors
    /// See [`ShmError`]; [`ShmError::RoleTaken`] while another consumer is alive.
    pub fn open(run: &RunId, kind: SegmentKind) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, kind)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let items = typed(segment)?;
        let claim = RoleClaim::take(segment, Role::Reader)?;
        let geometry = segment.geometry();
        let end = ReadEnd::attach(items, geometry.kind, geometry.capacity)?;
        Ok(Self { end, writer: geometry.kind.writer(), _claim: claim })
    }

    /// Number of slots.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.end.items.segment.geometry().capacity as u32
    }

    /// Takes the next item out; waits while the ring is empty.
    ///
    /// # Errors
    /// The run ended, or the writer wrote an invalid value.
    pub fn pop(&mut self, control: &Control) -> Result<T, WaitError> {
        // The common case avoids reference counting.
        if let Some(item) = self.end.try_pop()? {
            return Ok(item);
        }
        let end = &mut self.end;
        let segment = Arc::clone(&end.items.segment);
        let positions: &Positions = segment.words();
        control.wait_for(positions.readable(), self.writer, || end.try_pop())
    }

    /// Waits for an item, at most [`super::WAIT_BOUND`]. Returns whether there is one.
    ///
    /// # Errors
    /// The run ended, or the writer wrote an invalid value.
    pub fn wait(&mut self, control: &Control) -> Result<bool, WaitError> {
        let end = &mut self.end;
        let segment = Arc::clone(&end.items.segment);
        let positions: &Positions = segment.words();
        let waited =
            control.wait_once(positions.readable(), super::WAIT_BOUND, || Ok((end.len()? > 0).then_some(())))?;
        Ok(waited.is_some() || end.len()? > 0)
    }

    /// Takes the next item out, if there is one.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer's position is not valid.
    pub fn try_pop(&mut self) -> Result<Option<T>, ShmError> {
        self.end.try_pop()
    }

    /// Takes the next item and holds it: it remains in the ring until [`Consumer::give_back`], for
    /// the next consumer in case this one is killed. Waits while the ring is empty. Must not be
    /// called while the whole ring is held ([`Consumer::is_all_held`]): it would wait for ever.
    ///
    /// # Errors
    /// The run ended, or the writer wrote an invalid value.
    pub fn take(&mut self, control: &Control) -> Result<T, WaitError> {
        loop {
            if let Some(item) = self.take_unless(control, || false)? {
                return Ok(item);
            }
        }
    }

    /// [`Consumer::take`]; `None` when there is no item, and `is_over` says that no more will come.
    ///
    /// # Errors
    /// As [`Consumer::take`].
    pub fn take_unless(
        &mut self,
        control: &Control,
        mut is_over: impl FnMut() -> bool,
    ) -> Result<Option<T>, WaitError> {
        if let Some(item) = self.end.try_take()? {
            return Ok(Some(item));
        }
        let end = &mut self.end;
        let segment = Arc::clone(&end.items.segment);
        let positions: &Positions = segment.words();
        control.wait_for(positions.readable(), self.writer, || match end.try_take()? {
            Some(item) => Ok(Some(Some(item))),
            None => Ok(is_over().then_some(None)),
        })
    }

    /// [`Consumer::take`], if there is an item.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer's position is not valid.
    pub fn try_take(&mut self) -> Result<Option<T>, ShmError> {
        self.end.try_take()
    }

    /// Releases the held items before `position` ([`Consumer::position`]).
    pub fn give_back(&mut self, position: RingPosition) {
        let behind = self.end.position().wrapping_sub(position.get());
        self.end.give_back(self.end.held().saturating_sub(behind));
    }

    /// Stops holding items: they will be taken again.
    pub fn put_back(&mut self) {
        self.end.put_back();
    }

    /// Position of the next item to be taken; counts all items.
    #[must_use]
    pub fn position(&self) -> RingPosition {
        RingPosition::new(self.end.position())
    }

    /// Whether every slot of the ring is held, so that the writer cannot write.
    #[must_use]
    pub fn is_all_held(&self) -> bool {
        self.end.held() >= self.end.items.segment.geometry().capacity
    }

    /// Number of items to be taken.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer's position is not valid.
    pub fn pending(&mut self) -> Result<u64, ShmError> {
        self.end.len()
    }
}
