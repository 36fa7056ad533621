//! The first bytes of every segment, and the checks between a mapping and its use.

use super::error::ShmError;
use super::geometry::{Geometry, WORDS_OFFSET};
use super::kind::SegmentKind;
use super::process::ProcessId;
use super::region::{Region, SharedWords};
use crate::event::monotonic_nanos;
use crate::sync::{AtomicU32, AtomicU64, Ordering};
use std::sync::Arc;

/// "TVSHMSEG", read as a little-endian number.
const MAGIC: u64 = u64::from_le_bytes(*b"TVSHMSEG");
/// Must change with every change of a segment's layout, in the same commit.
pub const LAYOUT_VERSION: u32 = 9;
/// State of a header that is complete.
const READY: u32 = 0x5245_4459;

/// 256 bytes at the start of a segment. The creator fills it and publishes `state` last.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Header {
    magic: AtomicU64,
    layout_version: AtomicU32,
    kind: AtomicU32,
    total_bytes: AtomicU64,
    /// When the segment was created, monotonic nanoseconds: distinguishes segments of the same
    /// name.
    generation: AtomicU64,
    capacity: AtomicU64,
    item_bytes: AtomicU64,
    state: AtomicU32,
    reserved: AtomicU32,
    /// [`ProcessId::word`] of the process that has the writer's role; 0 when it is free.
    writer: AtomicU64,
    /// The same for the reader's role.
    reader: AtomicU64,
    /// How often the writer's role was taken: distinguishes a restarted writer from a slow one.
    writer_generation: AtomicU64,
    /// The same for the reader's role.
    reader_generation: AtomicU64,
}

// SAFETY: atomics alone, repr(C), aligned to 8.
unsafe impl SharedWords for Header {}

const _: () = {
    assert!(size_of::<Header>() == 88 && size_of::<Header>() as u64 <= WORDS_OFFSET);
    assert!(std::mem::offset_of!(Header, layout_version) == 8 && std::mem::offset_of!(Header, state) == 48);
    assert!(std::mem::offset_of!(Header, writer) == 56);
};

/// Whether the first bytes of a file are those of a segment, or of a segment whose creator died
/// before it wrote anything.
pub(crate) fn begins_like_a_segment(first: &[u8]) -> bool {
    first.iter().all(|byte| *byte == 0) || first.get(..8) == Some(&MAGIC.to_le_bytes()[..])
}

/// Why a segment is not usable now.
#[derive(Debug)]
pub(crate) enum NotUsable {
    /// Its creator has not finished; try again.
    NotYet,
    /// It will never be usable.
    Never(ShmError),
}

/// A region with a checked header: its geometry fits into it.
#[derive(Debug)]
pub(crate) struct Segment {
    region: Region,
    geometry: Geometry,
}

impl Segment {
    /// Fills the header of a zeroed region and publishes it. The region has `geometry.total_bytes`
    /// bytes.
    pub(crate) fn create(region: Region, geometry: Geometry) -> Result<Self, ShmError> {
        let found = region.len();
        if found < geometry.total_bytes {
            let name = geometry.kind.name().to_owned();
            return Err(ShmError::TooSmall { name, needed: geometry.total_bytes, found });
        }
        let header: &Header = region.words(0);
        // Relaxed: the state's Release publishes them all.
        header.magic.store(MAGIC, Ordering::Relaxed);
        header.layout_version.store(LAYOUT_VERSION, Ordering::Relaxed);
        header.kind.store(geometry.kind as u32, Ordering::Relaxed);
        header.total_bytes.store(geometry.total_bytes, Ordering::Relaxed);
        header.generation.store(monotonic_nanos(), Ordering::Relaxed);
        header.capacity.store(geometry.capacity, Ordering::Relaxed);
        header.item_bytes.store(geometry.item_bytes, Ordering::Relaxed);
        // Release: SYNC header.ready.
        header.state.store(READY, Ordering::Release);
        Ok(Self { region, geometry })
    }

    /// Checks the header that another process wrote.
    pub(crate) fn check(region: Region, kind: SegmentKind, name: &str) -> Result<Self, NotUsable> {
        let geometry = Self::check_header(&region, kind, name)?;
        Ok(Self { region, geometry })
    }

    fn check_header(region: &Region, kind: SegmentKind, name: &str) -> Result<Geometry, NotUsable> {
        let name = || name.to_owned();
        let found = region.len();
        // The length first: a missing page must not be touched. Between its creation and its
        // resizing, the file is empty.
        if found == 0 {
            return Err(NotUsable::NotYet);
        }
        if found < WORDS_OFFSET {
            return Err(NotUsable::Never(ShmError::TooSmall { name: name(), needed: WORDS_OFFSET, found }));
        }
        let header: &Header = region.words(0);
        // Acquire: SYNC header.ready, all other fields are written.
        if header.state.load(Ordering::Acquire) != READY {
            return Err(NotUsable::NotYet);
        }
        let magic = header.magic.load(Ordering::Relaxed);
        if magic != MAGIC {
            return Err(NotUsable::Never(ShmError::NotOurs { name: name(), found: magic, expected: MAGIC }));
        }
        let theirs = header.layout_version.load(Ordering::Relaxed);
        if theirs != LAYOUT_VERSION {
            return Err(NotUsable::Never(ShmError::VersionMismatch { name: name(), ours: LAYOUT_VERSION, theirs }));
        }
        let corrupt =
            |field, found, expected| NotUsable::Never(ShmError::Corrupt { name: name(), field, found, expected });
        let kind_found = header.kind.load(Ordering::Relaxed);
        if kind_found != kind as u32 {
            return Err(corrupt("the kind", kind_found.into(), "the kind that its name says"));
        }
        let capacity = header.capacity.load(Ordering::Relaxed);
        let item_bytes = header.item_bytes.load(Ordering::Relaxed);
        let Some(geometry) = Geometry::checked(kind, capacity, item_bytes) else {
            return Err(corrupt("the capacity", capacity, "a possible number of items (a power of two for a ring)"));
        };
        let total = header.total_bytes.load(Ordering::Relaxed);
        if total != geometry.total_bytes {
            return Err(corrupt("the layout size", total, "what follows from number and size of items"));
        }
        if found < total {
            return Err(NotUsable::Never(ShmError::TooSmall { name: name(), needed: total, found }));
        }
        Ok(geometry)
    }

    pub(crate) fn region(&self) -> &Region {
        &self.region
    }

    pub(crate) fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    pub(crate) fn kind(&self) -> SegmentKind {
        self.geometry.kind
    }

    fn header(&self) -> &Header {
        self.region.words(0)
    }

    /// The segment's control words.
    pub(crate) fn words<W: SharedWords>(&self) -> &W {
        self.region.words(WORDS_OFFSET)
    }

    /// Offset of item `index`, which must be below the capacity.
    pub(crate) fn item_offset(&self, index: u64) -> u64 {
        debug_assert!(index < self.geometry.capacity);
        self.geometry.data_offset + index * self.geometry.stride
    }
}

/// A role at a segment that only one process at a time may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Role {
    Writer,
    Reader,
}

/// The role, while it is held. It enforces "one producer, one consumer" across processes, which
/// makes the safe handles sound.
#[derive(Debug)]
pub(crate) struct RoleClaim {
    segment: Arc<Segment>,
    role: Role,
    word: u64,
}

impl RoleClaim {
    /// Takes the role if it is free, or if the process that has it is dead.
    pub(crate) fn take(segment: &Arc<Segment>, role: Role) -> Result<Self, ShmError> {
        let word = ProcessId::own()?.word();
        let claim = Self { segment: Arc::clone(segment), role, word };
        let (place, generation) = claim.place();
        // AcqRel and Acquire: SYNC role.hand-over, writes of the previous holder come before.
        let mut holder = place.load(Ordering::Acquire);
        loop {
            if holder != 0 && ProcessId::is_word_alive(holder) {
                let name = segment.kind().name().to_owned();
                let role = if role == Role::Writer { "writer" } else { "reader" };
                let taken = ShmError::RoleTaken { name, role, pid: (holder >> 32) as u32 };
                // Nothing to release: the role belongs to another process, and so does its word,
                // unless that is ours.
                std::mem::drop(claim.defused());
                return Err(taken);
            }
            match place.compare_exchange(holder, word, Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => break,
                Err(other) => holder = other,
            }
        }
        // Relaxed: a count for displays.
        generation.fetch_add(1, Ordering::Relaxed);
        Ok(claim)
    }

    fn defused(mut self) -> Self {
        self.word = 0;
        self
    }

    fn place(&self) -> (&AtomicU64, &AtomicU64) {
        let header = self.segment.header();
        match self.role {
            Role::Writer => (&header.writer, &header.writer_generation),
            Role::Reader => (&header.reader, &header.reader_generation),
        }
    }
}

impl Drop for RoleClaim {
    fn drop(&mut self) {
        if self.word != 0 {
            // Release: SYNC role.hand-over. Only our own word is removed; if it is another one,
            // there is nothing to free.
            let (place, _) = self.place();
            place.compare_exchange(self.word, 0, Ordering::Release, Ordering::Relaxed).ok();
        }
    }
}
