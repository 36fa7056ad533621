//! The vehicle table: where vehicles are in each frame, from the launcher to the renderer.
//!
//! Frame f lies in place f modulo the number of places, each behind a sequence lock of its own
//! ([`super::want_core`]). The one that writes frame f has to know that the frame that was there
//! before is drawn. Other programs may read the table, too (docs/vehicles.md).

use super::error::ShmError;
use super::header::{Role, RoleClaim, Segment};
use super::kind::SegmentKind;
use super::run_id::RunId;
use super::segments::open_segment;
use super::vehicle_layout::{FRAME_HEAD_BYTES, RECORD_WORDS};
use super::want_core::{Look, WantEntry, WantWords};
use crate::ids::FrameNumber;
use crate::vehicle::VehicleRecord;
use std::sync::Arc;

/// What no version of a list is: it is read whether it has changed or not.
const NONE_SEEN: u64 = u64::MAX;

const _: () = assert!(size_of::<WantWords>() as u64 == FRAME_HEAD_BYTES);

/// What stands before the vehicles of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TableHead {
    /// The frame.
    pub frame: FrameNumber,
    /// The moment of the vehicles' own time, seconds since 1970 or since the beginning of what has
    /// no dates.
    pub time_s: f64,
}

/// Vehicles that a frame has room for.
fn room(segment: &Segment) -> Result<u64, ShmError> {
    let geometry = segment.geometry();
    if geometry.kind != SegmentKind::VehicleTable {
        return Err(ShmError::WrongKind { name: geometry.kind.name().to_owned(), kind: geometry.kind });
    }
    let bytes = geometry.item_bytes.checked_sub(FRAME_HEAD_BYTES);
    let record = size_of::<VehicleRecord>() as u64;
    bytes.filter(|bytes| bytes.is_multiple_of(record)).map(|bytes| bytes / record).ok_or_else(|| {
        ShmError::corrupt(geometry.kind, "the size of a frame", geometry.item_bytes, "a head and whole records")
    })
}

/// Head and entries of the place of a frame.
fn place(segment: &Segment, frame: FrameNumber, room: u64) -> (&WantWords, &[WantEntry]) {
    let index = frame.get() & (segment.geometry().capacity - 1);
    let offset = segment.item_offset(index);
    let entries = segment.region().words_slice(offset + FRAME_HEAD_BYTES, room * RECORD_WORDS as u64);
    (segment.region().words(offset), entries)
}

/// The launcher's end.
#[derive(Debug)]
pub struct VehicleTableWriter {
    segment: Arc<Segment>,
    room: u64,
    words: Vec<u64>,
    _claim: RoleClaim,
}

impl VehicleTableWriter {
    /// Opens the writing end; waits a short time for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::VehicleTable)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let room = room(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        Ok(Self { segment: Arc::clone(segment), room, words: Vec::new(), _claim: claim })
    }

    /// Frames that it holds.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.segment.geometry().capacity
    }

    /// Writes the vehicles of a frame, as far as there is room, in place of those of the frame
    /// [`VehicleTableWriter::frames`] before it. Does not block.
    pub fn write(&mut self, head: TableHead, vehicles: &[VehicleRecord]) {
        let vehicles = &vehicles[..vehicles.len().min(self.room as usize)];
        self.words.clear();
        self.words.extend(vehicles.iter().flat_map(|vehicle| bytemuck::cast::<_, [u64; RECORD_WORDS]>(*vehicle)));
        let (words, entries) = place(&self.segment, head.frame, self.room);
        let count = self.words.len() as u64;
        words.write(entries, [head.frame.get(), head.time_s.to_bits(), 0, count], self.words.iter().copied());
    }
}

/// The renderer's end.
#[derive(Debug)]
pub struct VehicleTableReader {
    segment: Arc<Segment>,
    room: u64,
    words: Vec<u64>,
    _claim: RoleClaim,
}

impl VehicleTableReader {
    /// Opens the reading end; waits a short time for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::VehicleTable)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        let room = room(segment)?;
        let claim = RoleClaim::take(segment, Role::Reader)?;
        Ok(Self { segment: Arc::clone(segment), room, words: Vec::new(), _claim: claim })
    }

    /// The vehicles of a frame; `None` where the table does not have that frame, now. Vehicles
    /// whose numbers are none are left out ([`VehicleRecord::is_valid`]).
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when it counts more vehicles than fit.
    pub fn read(&mut self, frame: FrameNumber) -> Result<Option<(TableHead, Vec<VehicleRecord>)>, ShmError> {
        let (words, entries) = place(&self.segment, frame, self.room);
        let Look::Changed { head, .. } = words.read(entries, NONE_SEEN, &mut self.words) else { return Ok(None) };
        let [found, time, _, count] = head;
        if found != frame.get() {
            return Ok(None);
        }
        if count > entries.len() as u64 || !count.is_multiple_of(RECORD_WORDS as u64) {
            let expected = "whole records, at most as many as there is room for";
            return Err(ShmError::corrupt(SegmentKind::VehicleTable, "the number of words", count, expected));
        }
        let records = self.words.as_chunks::<RECORD_WORDS>().0.iter().map(|words| bytemuck::cast(*words));
        let vehicles = records.filter(VehicleRecord::is_valid).collect();
        Ok(Some((TableHead { frame, time_s: f64::from_bits(time) }, vehicles)))
    }
}
