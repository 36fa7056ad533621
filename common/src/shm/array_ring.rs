//! Rings of arrays, written in place and read in place. First in, first out; the reader gives back
//! everything below a position.
//!
//! * The elevation ring: heights of vertices, from the preparer to the renderer and its device, which
//!   gives them back when their frame is drawn.
//! * The stream ring: frames of a film or of Y4M, from the renderer to the launcher, which gives them
//!   back when they are passed on.

use super::control::Control;
use super::cursor::{Positions, ReadCursor, WriteCursor};
use super::error::{ShmError, WaitError};
use super::header::{Role, RoleClaim, Segment};
use super::kind::SegmentKind;
use super::run_id::RunId;
use super::segments::{SegmentMemory, open_segment};
use crate::ids::RingPosition;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// What arrays are made of, which tells the ring that they are in.
pub trait ArrayItem: Pod {
    /// The ring.
    const KIND: SegmentKind;
}

impl ArrayItem for f32 {
    const KIND: SegmentKind = SegmentKind::ElevationRing;
}

impl ArrayItem for u8 {
    const KIND: SegmentKind = SegmentKind::StreamRing;
}

/// The preparer's end of the elevation ring.
pub type ElevationWriter = ArrayWriter<f32>;
/// The renderer's end of the elevation ring.
pub type ElevationReader = ArrayReader<f32>;
/// The renderer's end of the stream ring.
pub type StreamWriter = ArrayWriter<u8>;
/// The launcher's end of the stream ring.
pub type StreamReader = ArrayReader<u8>;

/// Items of an array.
fn array_len<T: ArrayItem>(segment: &Segment) -> Result<u64, ShmError> {
    let geometry = segment.geometry();
    if geometry.kind != T::KIND {
        return Err(ShmError::WrongKind { name: geometry.kind.name().to_owned(), kind: geometry.kind });
    }
    let (found, item) = (geometry.item_bytes, size_of::<T>() as u64);
    if found == 0 || !found.is_multiple_of(item) || found / item > u64::from(u32::MAX) {
        return Err(ShmError::corrupt(T::KIND, "the size of an array", found, "a number of its items"));
    }
    Ok(found / item)
}

/// The writing end.
#[derive(Debug)]
pub struct ArrayWriter<T> {
    segment: Arc<Segment>,
    cursor: WriteCursor,
    len: u64,
    item: PhantomData<fn(T) -> T>,
    _claim: RoleClaim,
}

impl<T: ArrayItem> ArrayWriter<T> {
    /// Opens the writing end; waits a short time for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, T::KIND)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let len = array_len::<T>(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        let cursor = WriteCursor::attach(segment.words(), T::KIND, segment.geometry().capacity)?;
        Ok(Self { segment: Arc::clone(segment), cursor, len, item: PhantomData, _claim: claim })
    }

    /// Number of arrays. A frame must not use more of the elevation ring: the renderer releases them
    /// only after the frame's end marker, so that a wait for another one would never end.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.segment.geometry().capacity as u32
    }

    /// Items of an array.
    #[must_use]
    pub fn array_len(&self) -> u64 {
        self.len
    }

    /// The position that the next array will have: one past the last that was published.
    #[must_use]
    pub fn next_position(&self) -> u64 {
        self.cursor.position()
    }

    /// Whether [`ArrayWriter::begin`] returns at once.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the reader's position is not valid.
    pub fn has_room(&mut self) -> Result<bool, ShmError> {
        Ok(self.cursor.room(self.segment.words(), 1)? > 0)
    }

    /// Waits for a free array. It becomes the reader's with [`ArrayGuard::publish`].
    ///
    /// # Errors
    /// The run ended, or the reader wrote an invalid value.
    pub fn begin(&mut self, control: &Control) -> Result<ArrayGuard<'_, T>, WaitError> {
        let cursor = &mut self.cursor;
        let positions: &Positions = self.segment.words();
        control
            .wait_for(positions.writable(), T::KIND.reader(), || Ok((cursor.room(positions, 1)? > 0).then_some(())))?;
        Ok(ArrayGuard { writer: self })
    }
}

/// An array that is being filled; derefs to its items. If dropped without
/// [`ArrayGuard::publish`], nothing happens: the next one has the same position.
#[derive(Debug)]
#[must_use]
pub struct ArrayGuard<'a, T> {
    writer: &'a mut ArrayWriter<T>,
}

impl<T: ArrayItem> ArrayGuard<'_, T> {
    fn offset(&self) -> u64 {
        let mask = self.writer.segment.geometry().capacity - 1;
        self.writer.segment.item_offset(self.writer.cursor.position() & mask)
    }

    /// Its position: counts up over all arrays; modulo the capacity it is the array's index.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.writer.cursor.position()
    }

    /// The items, of heights rows from the south, with whatever an earlier array left there.
    pub fn values_mut(&mut self) -> &mut [T] {
        // SAFETY: the array is ours: `begin` found it given back, and it is not published. The
        // slice borrows `self`.
        unsafe { self.writer.segment.region().slice_mut(self.offset(), self.writer.len) }
    }

    /// Makes the array visible to the reader and returns its position.
    pub fn publish(self) -> u64 {
        let position = self.position();
        let writer = self.writer;
        writer.cursor.publish(writer.segment.words(), 1);
        position
    }
}

impl<T: ArrayItem> Deref for ArrayGuard<'_, T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        // SAFETY: as in `values_mut`; shared here.
        unsafe { self.writer.segment.region().slice(self.offset(), self.writer.len) }
    }
}

impl<T: ArrayItem> DerefMut for ArrayGuard<'_, T> {
    fn deref_mut(&mut self) -> &mut [T] {
        self.values_mut()
    }
}

/// The reading end.
#[derive(Debug)]
pub struct ArrayReader<T> {
    segment: Arc<Segment>,
    cursor: ReadCursor,
    len: u64,
    item: PhantomData<fn(T) -> T>,
    _claim: RoleClaim,
}

impl<T: ArrayItem> ArrayReader<T> {
    /// Opens the reading end; waits a short time for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, T::KIND)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let len = array_len::<T>(segment)?;
        let claim = RoleClaim::take(segment, Role::Reader)?;
        let cursor = ReadCursor::attach(segment.words(), T::KIND, segment.geometry().capacity)?;
        Ok(Self { segment: Arc::clone(segment), cursor, len, item: PhantomData, _claim: claim })
    }

    /// Number of arrays, a power of two.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.segment.geometry().capacity as u32
    }

    /// Items of an array.
    #[must_use]
    pub fn array_len(&self) -> u64 {
        self.len
    }

    /// Bytes from the start of an array to the start of the next, a multiple of 64.
    #[must_use]
    pub fn stride_bytes(&self) -> u64 {
        self.segment.geometry().stride
    }

    /// Bytes from the start of the segment to the array of index 0, a multiple of 4096.
    #[must_use]
    pub fn data_offset(&self) -> u64 {
        self.segment.geometry().data_offset
    }

    /// The whole segment, for import into a device: address and length are multiples of 4096.
    #[must_use]
    pub fn memory(&self) -> SegmentMemory {
        SegmentMemory::new(&self.segment)
    }

    /// The position up to which arrays have been released.
    #[must_use]
    pub fn released_position(&self) -> RingPosition {
        RingPosition::new(self.cursor.position())
    }

    /// Whether the array at `position` is published and not released, so that it may be
    /// read. To be called for each position that comes out of the ring.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the writer's position cannot be.
    pub fn holds(&mut self, position: u64) -> Result<bool, ShmError> {
        let behind = position.wrapping_sub(self.cursor.position());
        // Check the known positions first: the writer's word is read only if necessary.
        Ok(behind < self.cursor.filled(self.segment.words())?
            || behind < self.cursor.filled_now(self.segment.words())?)
    }

    /// Index of the array at `position` within the segment, if the reader holds it.
    ///
    /// # Errors
    /// As [`ArrayReader::holds`].
    pub fn index_of(&mut self, position: u64) -> Result<Option<u32>, ShmError> {
        let mask = self.segment.geometry().capacity - 1;
        Ok(self.holds(position)?.then_some((position & mask) as u32))
    }

    /// The items of the array at `position`, in place; `None` when the reader does not hold it.
    ///
    /// # Errors
    /// As [`ArrayReader::holds`].
    pub fn read_array(&mut self, position: u64) -> Result<Option<&[T]>, ShmError> {
        let Some(index) = self.index_of(position)? else { return Ok(None) };
        let offset = self.segment.item_offset(index.into());
        // SAFETY: the array is ours until `released`, which needs `&mut self` that the slice's
        // lifetime keeps from it.
        Ok(Some(unsafe { self.segment.region().slice(offset, self.len) }))
    }

    /// Releases all arrays below the position `upto`, when nobody reads them any more. A
    /// position that has been released before changes nothing.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when that is more than was published; then nothing is released.
    pub fn released(&mut self, upto: RingPosition) -> Result<(), ShmError> {
        let upto = upto.get();
        let count = upto.wrapping_sub(self.cursor.position());
        if count == 0 || count > u64::MAX / 2 {
            return Ok(());
        }
        let positions: &Positions = self.segment.words();
        if count > self.cursor.filled_now(positions)? {
            let expected = "at most the writer's position";
            return Err(ShmError::corrupt(T::KIND, "the end of a frame's arrays", upto, expected));
        }
        self.cursor.release(positions, count);
        Ok(())
    }
}
