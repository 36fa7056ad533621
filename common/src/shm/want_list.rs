//! The want list: the tiles that the newest frame wants and that are not in the pools, from the
//! preparer to the prefetcher. Each list replaces the one before; the prefetcher may miss all but
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

/// The head of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WantHead {
    /// The frame's sequence; [`Sequence::NONE`] for tiles that are wanted before the first frame.
    pub sequence: Sequence,
    /// The frame.
    pub frame: FrameNumber,
    /// This is the last list: all frames of the run are prepared.
    pub is_last: bool,
}

/// The preparer's end.
#[derive(Debug)]
pub struct WantListWriter {
    segment: Arc<Segment>,
    /// The last list was empty, so that the reader is not woken for another empty one.
    is_empty: bool,
    _claim: RoleClaim,
}

impl WantListWriter {
    /// Opens the writing end; waits a short time for the segment to become ready. The last complete
    /// list of a killed writer remains until this one publishes a list.
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

    /// Maximum number of tiles of a list.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.segment.geometry().capacity as u32
    }

    /// Replaces the list by `tiles`, in the order in which they are wanted, as far as they fit.
    /// Wakes the reader, unless both this list and the one before are empty. Neither blocks nor
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
    watcher: WantListWatcher,
    _claim: RoleClaim,
}

/// Looks at the list; there may be several.
#[derive(Debug)]
pub struct WantListWatcher {
    segment: Arc<Segment>,
    seen: u64,
    packed: Vec<u64>,
}

impl WantListWatcher {
    /// Opens the list; waits a moment for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::WantList)?)
    }

    fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        check(segment)?;
        let packed = Vec::with_capacity(segment.geometry().capacity as usize);
        Ok(Self { segment: Arc::clone(segment), seen: 0, packed })
    }

    /// Copies the newest list into `tiles` if it is new; otherwise returns `None` and leaves
    /// `tiles` unchanged. Skips invalid numbers. Does not block.
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the list counts more tiles than fit.
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
        Ok(Self { watcher: WantListWatcher::attach(segment)?, _claim: claim })
    }

    /// As [`WantListWatcher::read`].
    ///
    /// # Errors
    /// [`ShmError::Corrupt`] when the list counts more tiles than fit.
    pub fn read(&mut self, tiles: &mut Vec<Tile>) -> Result<Option<WantHead>, ShmError> {
        self.watcher.read(tiles)
    }

    /// Sleeps until there is a newer list, the bell is rung ([`WantListReader::bell`]), `is_due`
    /// returns `true`, or `bound` has passed; at most [`super::WAIT_BOUND`]. Allocates nothing.
    ///
    /// # Errors
    /// The run ended.
    pub fn wait(&self, control: &Control, bound: Duration, is_due: impl Fn() -> bool) -> Result<(), WaitError> {
        let words: &WantWords = self.watcher.segment.words();
        control.wait_once(words.bell(), bound, || {
            Ok((words.is_newer_than(self.watcher.seen) || is_due()).then_some(()))
        })?;
        Ok(())
    }

    /// A bell that wakes [`WantListReader::wait`], from any thread of this process.
    #[must_use]
    pub fn bell(&self) -> WantBell {
        WantBell { segment: Arc::clone(&self.watcher.segment) }
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
