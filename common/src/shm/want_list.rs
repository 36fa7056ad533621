//! The want list: the tiles that the newest frame wants and that are not in the pools, from the
//! preparer to the prefetcher. Each list replaces the one before; the prefetcher may miss any but
//! the newest.

use super::control::Control;
use super::error::{ShmError, WaitError};
use super::header::{Role, RoleClaim, Segment};
use super::kind::SegmentKind;
use super::region::SharedWords;
use super::run_id::RunId;
use super::segments::open_segment;
use super::want_core::{HEAD_WORDS, Look, WantEntry, WantWords};
use crate::database::Tile;
use crate::ids::{FrameNumber, Sequence};
use std::sync::Arc;
use std::time::Duration;

// SAFETY: atomics alone (padding between them is never read), repr(C), aligned to 128.
unsafe impl SharedWords for WantWords {}
// SAFETY: one atomic, repr(transparent), aligned to 8.
unsafe impl SharedWords for WantEntry {}

/// Set in the last list of a run.
const LAST: u64 = 1;

fn check(segment: &Segment) -> Result<(), ShmError> {
    match segment.geometry() {
        g if g.kind != SegmentKind::WantList => {
            Err(ShmError::WrongKind { name: g.kind.name().to_owned(), kind: g.kind })
        }
        g if g.item_bytes != size_of::<WantEntry>() as u64 => {
            let expected = "the size of a packed tile";
            Err(ShmError::corrupt(g.kind, "the size of an entry", g.item_bytes, expected))
        }
        _ => Ok(()),
    }
}

fn entries(segment: &Segment) -> &[WantEntry] {
    let geometry = segment.geometry();
    segment.region().words_slice(geometry.data_offset, geometry.capacity)
}

/// What a list is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WantHead {
    /// The frame's place in the run; none for what is wanted before the first.
    pub sequence: Sequence,
    /// The frame.
    pub frame: FrameNumber,
    /// No other list will come: the run's frames are all prepared.
    pub is_last: bool,
}

/// The preparer's end.
#[derive(Debug)]
pub struct WantListWriter {
    segment: Arc<Segment>,
    /// The reader knows of an empty list, and is not woken for another.
    is_empty: bool,
    _claim: RoleClaim,
}

impl WantListWriter {
    /// Opens the writing end; waits a moment for the segment to become ready. After a writer that
    /// was killed its last whole list stays until the first of this one.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::WantList)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        check(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        Ok(Self { segment: Arc::clone(segment), is_empty: false, _claim: claim })
    }

    /// Tiles that a list holds.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.segment.geometry().capacity as u32
    }

    /// Replaces the list: as many of `tiles`, which come in the order in which they are wanted, as
    /// it holds. Wakes the reader, unless nothing is wanted now and before. Neither blocks nor
    /// allocates.
    pub fn publish(&mut self, head: WantHead, tiles: &[Tile]) {
        let WantHead { sequence, frame, is_last } = head;
        let tiles = &tiles[..tiles.len().min(self.capacity() as usize)];
        let words: &WantWords = self.segment.words();
        let head = [sequence.get(), frame.get(), u64::from(is_last) * LAST, tiles.len() as u64];
        words.write(entries(&self.segment), head, tiles.iter().map(|tile| tile.pack()));
        if !tiles.is_empty() || !self.is_empty || is_last {
            words.bell().ring();
        }
        self.is_empty = tiles.is_empty();
    }
}

/// The prefetcher's end.
#[derive(Debug)]
pub struct WantListReader {
    segment: Arc<Segment>,
    seen: u64,
    packed: Vec<u64>,
    _claim: RoleClaim,
}

impl WantListReader {
    /// Opens the reading end; waits a moment for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::WantList)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        check(segment)?;
        let claim = RoleClaim::take(segment, Role::Reader)?;
        let packed = Vec::with_capacity(segment.geometry().capacity as usize);
        Ok(Self { segment: Arc::clone(segment), seen: 0, packed, _claim: claim })
    }

    /// Copies the newest list into `tiles`, when it is another one than last time; else `None`, and
    /// `tiles` stays as it is. Numbers that are no tiles are left out. Does not block.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the list counts more tiles than it holds.
    pub fn read(&mut self, tiles: &mut Vec<Tile>) -> Result<Option<WantHead>, ShmError> {
        let words: &WantWords = self.segment.words();
        let entries = entries(&self.segment);
        let Look::Changed { version, head } = words.read(entries, self.seen, &mut self.packed) else {
            return Ok(None);
        };
        self.seen = version;
        let [sequence, frame, flags, count] = head;
        const { assert!(HEAD_WORDS == 4) }
        if count > entries.len() as u64 {
            let expected = "at most the capacity";
            return Err(ShmError::corrupt(SegmentKind::WantList, "the number of tiles", count, expected));
        }
        tiles.clear();
        tiles.extend(self.packed.iter().filter_map(|packed| Tile::unpack(*packed)));
        let (sequence, frame) = (Sequence::new(sequence), FrameNumber::new(frame));
        Ok(Some(WantHead { sequence, frame, is_last: flags & LAST != 0 }))
    }

    /// Sleeps until there is a newer list, somebody rings ([`WantListReader::bell`]), `is_due` says
    /// so, or `bound` has passed; at most [`super::WAIT_BOUND`]. Allocates nothing.
    ///
    /// # Errors
    /// The run ended.
    pub fn wait(&self, control: &Control, bound: Duration, is_due: impl Fn() -> bool) -> Result<(), WaitError> {
        let words: &WantWords = self.segment.words();
        control.wait_once(words.bell(), bound, || Ok((words.is_newer_than(self.seen) || is_due()).then_some(())))?;
        Ok(())
    }

    /// What wakes [`WantListReader::wait`], from any thread of this process.
    #[must_use]
    pub fn bell(&self) -> WantBell {
        WantBell { segment: Arc::clone(&self.segment) }
    }
}

/// Wakes the reader of a want list for other reasons than a new list.
#[derive(Debug, Clone)]
pub struct WantBell {
    segment: Arc<Segment>,
}

impl WantBell {
    /// Wakes the reader, if it sleeps.
    pub fn ring(&self) {
        self.segment.words::<WantWords>().bell().ring();
    }
}
