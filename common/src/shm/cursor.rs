//! Two monotonic positions: how many items the writer has published, and how many the reader has
//! released. The ring, the ping-pong buffer (a ring of two halves) and the elevation ring share
//! this, and differ in their items.
//!
//! Each side keeps a private copy of its own position, and of the last position that it saw of the
//! other side. It reads the other position once, into a local, and checks it: more filled items
//! than the capacity is an error, never a loop.

use super::bell::Bell;
use super::error::ShmError;
use super::kind::SegmentKind;
use crate::sync::{AtomicU64, Ordering};

/// 128 bytes: x86-64 prefetches cache lines in pairs, and some aarch64 cores have lines of this
/// size.
#[derive(Debug)]
#[repr(C, align(128))]
pub(crate) struct Padded<T>(pub(crate) T);

/// The shared words of a writer and a reader, one per cache line.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Positions {
    /// Items published since the segment was made. Written by the writer.
    write: Padded<AtomicU64>,
    /// Items released. Written by the reader.
    read: Padded<AtomicU64>,
    /// The reader sleeps here.
    readable: Padded<Bell>,
    /// The writer sleeps here.
    writable: Padded<Bell>,
}

#[cfg(not(loom))]
const _: () = {
    assert!(size_of::<Positions>() == 512 && align_of::<Positions>() == 128);
    assert!(std::mem::offset_of!(Positions, read) == 128 && std::mem::offset_of!(Positions, readable) == 256);
};

impl Positions {
    #[cfg(loom)]
    pub(crate) fn new() -> Self {
        Self {
            write: Padded(AtomicU64::new(0)),
            read: Padded(AtomicU64::new(0)),
            readable: Padded(Bell::new()),
            writable: Padded(Bell::new()),
        }
    }

    /// Where the reader sleeps.
    pub(crate) fn readable(&self) -> &Bell {
        &self.readable.0
    }

    /// Where the writer sleeps.
    pub(crate) fn writable(&self) -> &Bell {
        &self.writable.0
    }

    /// For tests: overwrites the words as a faulty peer might.
    #[cfg(all(test, not(loom)))]
    pub(crate) fn overwrite(&self, write: u64, read: u64) {
        self.write.0.store(write, Ordering::Release);
        self.read.0.store(read, Ordering::Release);
    }
}

fn checked_distance(kind: SegmentKind, write: u64, read: u64, capacity: u64, found: u64) -> Result<u64, ShmError> {
    let filled = write.wrapping_sub(read);
    if filled > capacity {
        let expected = "at most the capacity away from the other side's position";
        return Err(ShmError::corrupt(kind, "a position", found, expected));
    }
    Ok(filled)
}

/// The writer's side.
#[derive(Debug)]
pub(crate) struct WriteCursor {
    kind: SegmentKind,
    position: u64,
    read_seen: u64,
    capacity: u64,
}

impl WriteCursor {
    /// Continues at the current positions: at 0 in a new segment, or where a dead writer stopped.
    pub(crate) fn attach(positions: &Positions, kind: SegmentKind, capacity: u64) -> Result<Self, ShmError> {
        // Acquire, both: SYNC ring.publish, ring.release of a writer before this one.
        let position = positions.write.0.load(Ordering::Acquire);
        let read_seen = positions.read.0.load(Ordering::Acquire);
        checked_distance(kind, position, read_seen, capacity, read_seen)?;
        Ok(Self { kind, position, read_seen, capacity })
    }

    /// The next position to fill.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// Number of items that may be filled now; reads the reader's position again only when there
    /// was room for fewer than `enough`.
    pub(crate) fn room(&mut self, positions: &Positions, enough: u64) -> Result<u64, ShmError> {
        let known = self.capacity - self.position.wrapping_sub(self.read_seen).min(self.capacity);
        if known >= enough {
            return Ok(known);
        }
        // Acquire: SYNC ring.release, the reader is done with the items below this position.
        let read = positions.read.0.load(Ordering::Acquire);
        let filled = checked_distance(self.kind, self.position, read, self.capacity, read)?;
        self.read_seen = read;
        Ok(self.capacity - filled)
    }

    /// Makes the next `count` filled items visible. The last statement of every write.
    pub(crate) fn publish(&mut self, positions: &Positions, count: u64) {
        self.position = self.position.wrapping_add(count);
        // Release: SYNC ring.publish, the items' bytes come before.
        positions.write.0.store(self.position, Ordering::Release);
        positions.readable().ring();
    }
}

/// The reader's side.
#[derive(Debug)]
pub(crate) struct ReadCursor {
    kind: SegmentKind,
    position: u64,
    write_seen: u64,
    capacity: u64,
}

impl ReadCursor {
    /// Continues at the current positions.
    pub(crate) fn attach(positions: &Positions, kind: SegmentKind, capacity: u64) -> Result<Self, ShmError> {
        let position = positions.read.0.load(Ordering::Acquire);
        // Acquire: SYNC ring.publish.
        let write_seen = positions.write.0.load(Ordering::Acquire);
        checked_distance(kind, write_seen, position, capacity, write_seen)?;
        Ok(Self { kind, position, write_seen, capacity })
    }

    /// The next position to read.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// Number of items that may be read now; reads the writer's position again only when none was
    /// left.
    pub(crate) fn filled(&mut self, positions: &Positions) -> Result<u64, ShmError> {
        self.filled_beyond(positions, 0)
    }

    /// Number of items that may be read now after the next `held`, which the reader has read and
    /// keeps; reads the writer's position again only when none was left.
    pub(crate) fn filled_beyond(&mut self, positions: &Positions, held: u64) -> Result<u64, ShmError> {
        let known = self.write_seen.wrapping_sub(self.position);
        let filled = if known > held { known } else { self.filled_now(positions)? };
        Ok(filled.saturating_sub(held))
    }

    /// Number of items that may be read now, by the writer's newest position.
    pub(crate) fn filled_now(&mut self, positions: &Positions) -> Result<u64, ShmError> {
        // Acquire: SYNC ring.publish, the bytes of the items below this position are written.
        let write = positions.write.0.load(Ordering::Acquire);
        let filled = checked_distance(self.kind, write, self.position, self.capacity, write)?;
        self.write_seen = write;
        Ok(filled)
    }

    /// Releases the next `count` items to the writer; at most as many as are known to be filled.
    pub(crate) fn release(&mut self, positions: &Positions, count: u64) {
        debug_assert!(count <= self.write_seen.wrapping_sub(self.position));
        self.position = self.position.wrapping_add(count);
        // Release: SYNC ring.release, our reads of the items come before.
        positions.read.0.store(self.position, Ordering::Release);
        positions.writable().ring();
    }
}
