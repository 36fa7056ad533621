//! The layout of a frame ring. It is public: docs/frame-ring.md documents it, and other programs
//! rely on it.

use super::super::error::ShmError;
use super::super::region::{Region, SharedWords};
use crate::sync::{AtomicU32, AtomicU64, Ordering};

/// Slots of a ring. One of them is being written, so a reader has the time of this many frames,
/// less one, to copy a frame.
pub(super) const SLOTS: u32 = 4;
const LARGEST_SIDE: u32 = 1 << 16;
/// Entries of the table of pose times: more than there can be poses in flight.
pub(super) const POSE_TIMES: u64 = 1024;
pub(super) const POSE_TIMES_OFFSET: u64 = 4096;
/// Bytes of an entry: moment of the camera, time.
pub(super) const POSE_TIME_BYTES: u64 = 16;
/// Bytes of a slot before its pixels.
pub(super) const SLOT_HEADER_BYTES: u64 = 256;
/// The planes of all frames of a ring, and the size of the largest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameShape {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Metres along the view axis of every pixel.
    pub has_depth: bool,
    /// Easting, northing and height of what every pixel sees.
    pub has_ground: bool,
}

const HAS_DEPTH: u32 = 1;
const HAS_GROUND: u32 = 2;

/// Pixels of a picture.
pub(super) fn pixels_of([width, height]: [u32; 2]) -> u64 {
    u64::from(width) * u64::from(height)
}

/// Offsets, in bytes; those of planes from the start of a slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RingLayout {
    pub(super) shape: FrameShape,
    pub(super) slots: u32,
    pub(super) slots_offset: u64,
    pub(super) slot_bytes: u64,
    pub(super) color: u64,
    /// 0 without this plane.
    pub(super) depth: u64,
    /// 0 without this plane.
    pub(super) ground: u64,
    pub(super) total_bytes: u64,
}

/// The words of a ring's header, behind those that all named segments have.
#[derive(Debug)]
#[repr(C)]
pub(super) struct RingHeader {
    width: AtomicU32,
    height: AtomicU32,
    planes: AtomicU32,
    slots: AtomicU32,
    slots_offset: AtomicU64,
    slot_bytes: AtomicU64,
    color: AtomicU64,
    depth: AtomicU64,
    ground: AtomicU64,
    reserved: AtomicU64,
    /// The newest publication, from 1; 0 before the first.
    pub(super) newest: AtomicU64,
}

pub(super) const RING_HEADER_OFFSET: u64 = 64;
pub(super) const NEWEST_OFFSET: u64 = RING_HEADER_OFFSET + std::mem::offset_of!(RingHeader, newest) as u64;
/// Bytes before the table of pose times: both headers.
pub(super) const HEAD_BYTES: usize = POSE_TIMES_OFFSET as usize;

const _: () = {
    assert!(std::mem::offset_of!(RingHeader, slots_offset) == 16);
    assert!(std::mem::offset_of!(RingHeader, newest) as u64 + RING_HEADER_OFFSET == 128);
    assert!(RING_HEADER_OFFSET + size_of::<RingHeader>() as u64 <= POSE_TIMES_OFFSET);
};

// SAFETY: atomics alone, repr(C), aligned to 8.
unsafe impl SharedWords for RingHeader {}

impl RingLayout {
    /// The layout of a ring of such frames; `None` for an invalid size.
    pub(super) fn new(shape: FrameShape, slots: u32) -> Option<Self> {
        let [width, height] = shape.size;
        if !(1..=LARGEST_SIDE).contains(&width) || !(1..=LARGEST_SIDE).contains(&height) || !(2..=64).contains(&slots) {
            return None;
        }
        let pixels = pixels_of(shape.size);
        let mut end = SLOT_HEADER_BYTES;
        // 2^32 pixels of 24 bytes and 64 slots are far from the end of u64.
        let mut plane = |bytes_per_pixel: u64, is_there: bool| {
            let start = end;
            end = if is_there { (start + pixels * bytes_per_pixel).next_multiple_of(64) } else { start };
            if is_there { start } else { 0 }
        };
        let color = plane(4, true);
        let depth = plane(4, shape.has_depth);
        let ground = plane(24, shape.has_ground);
        let slot_bytes = end.next_multiple_of(4096);
        let slots_offset = POSE_TIMES_OFFSET + POSE_TIMES * POSE_TIME_BYTES;
        let total_bytes = slots_offset + u64::from(slots) * slot_bytes;
        Some(Self { shape, slots, slots_offset, slot_bytes, color, depth, ground, total_bytes })
    }

    /// The size that a slot tells of, where the ring has room for it; else that of the largest.
    pub(super) fn checked_size(&self, told: [u32; 2]) -> [u32; 2] {
        let is_ours = (0..2).all(|axis| (1..=self.shape.size[axis]).contains(&told[axis]));
        if is_ours { told } else { self.shape.size }
    }

    fn planes(&self) -> u32 {
        (if self.shape.has_depth { HAS_DEPTH } else { 0 }) | (if self.shape.has_ground { HAS_GROUND } else { 0 })
    }

    pub(super) fn write(&self, region: &Region) {
        let header: &RingHeader = region.words(RING_HEADER_OFFSET);
        // Relaxed: the segment's name, which comes last, publishes all of it.
        header.width.store(self.shape.size[0], Ordering::Relaxed);
        header.height.store(self.shape.size[1], Ordering::Relaxed);
        header.planes.store(self.planes(), Ordering::Relaxed);
        header.slots.store(self.slots, Ordering::Relaxed);
        header.slots_offset.store(self.slots_offset, Ordering::Relaxed);
        header.slot_bytes.store(self.slot_bytes, Ordering::Relaxed);
        header.color.store(self.color, Ordering::Relaxed);
        header.depth.store(self.depth, Ordering::Relaxed);
        header.ground.store(self.ground, Ordering::Relaxed);
    }

    /// Reads the layout from the header of a ring (`region` contains at least the first page of its
    /// file), and checks that it follows from the sizes.
    pub(super) fn read(region: &Region, file_bytes: u64, name: &str) -> Result<Self, ShmError> {
        let corrupt = |field, found, expected| ShmError::Corrupt { name: name.to_owned(), field, found, expected };
        let room = RING_HEADER_OFFSET + size_of::<RingHeader>() as u64;
        if region.len() < room {
            return Err(ShmError::TooSmall { name: name.to_owned(), needed: room, found: region.len() });
        }
        let header: &RingHeader = region.words(RING_HEADER_OFFSET);
        let (width, height) = (header.width.load(Ordering::Relaxed), header.height.load(Ordering::Relaxed));
        let planes = header.planes.load(Ordering::Relaxed);
        let slots = header.slots.load(Ordering::Relaxed);
        if planes > HAS_DEPTH | HAS_GROUND {
            return Err(corrupt("the set of planes", planes.into(), "1 for depth, 2 for ground, their sum, or 0"));
        }
        let shape = FrameShape {
            size: [width, height],
            has_depth: planes & HAS_DEPTH != 0,
            has_ground: planes & HAS_GROUND != 0,
        };
        let Some(layout) = Self::new(shape, slots) else {
            let found = u64::from(width) << 32 | u64::from(height);
            return Err(corrupt("the size of its pictures or the number of its slots", found, "a possible one"));
        };
        let told = [
            ("the offset of the slots", header.slots_offset.load(Ordering::Relaxed), layout.slots_offset),
            ("the size of a slot", header.slot_bytes.load(Ordering::Relaxed), layout.slot_bytes),
            ("the offset of the colours", header.color.load(Ordering::Relaxed), layout.color),
            ("the offset of the depths", header.depth.load(Ordering::Relaxed), layout.depth),
            ("the offset of the ground positions", header.ground.load(Ordering::Relaxed), layout.ground),
            ("the layout size", file_bytes, layout.total_bytes),
        ];
        match told.into_iter().find(|(_, found, expected)| found != expected) {
            Some((field, found, _)) => Err(corrupt(field, found, "what follows from size, planes and slots")),
            None => Ok(layout),
        }
    }

    /// Offset of the slot of a publication, from 1.
    pub(super) fn slot_offset(&self, number: u64) -> u64 {
        self.slots_offset + (number.wrapping_sub(1) % u64::from(self.slots)) * self.slot_bytes
    }

    /// Offset of a table entry; they are used in turn.
    pub(super) fn pose_time_offset(entry: u64) -> u64 {
        POSE_TIMES_OFFSET + (entry % POSE_TIMES) * POSE_TIME_BYTES
    }
}
