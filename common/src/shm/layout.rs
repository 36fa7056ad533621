//! Which segments a run has, and how large they are.

use super::error::ShmError;
use crate::camera::Camera;
use crate::event::Event;
use crate::slot::Slot;
use crate::tree::{TreeHeader, TreeNode};
use crate::world::{COLOR_MIPS, World};
use std::fmt;

/// A stage of the pipeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum Stage {
    /// Searches the quad tree.
    Generator = 0,
    /// Makes elevation arrays and the ring's slots.
    Preparer = 1,
    /// Draws.
    Renderer = 2,
}

impl Stage {
    /// All stages, in the order of the data's flow.
    pub const ALL: [Self; 3] = [Self::Generator, Self::Preparer, Self::Renderer];

    /// Its name in messages and file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Generator => "generator",
            Self::Preparer => "preparer",
            Self::Renderer => "renderer",
        }
    }

    /// The ring in which it tells the launcher of its work.
    #[must_use]
    pub const fn events(self) -> SegmentKind {
        match self {
            Self::Generator => SegmentKind::EventsGenerator,
            Self::Preparer => SegmentKind::EventsPreparer,
            Self::Renderer => SegmentKind::EventsRenderer,
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The segments of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum SegmentKind {
    /// Run state, heartbeats, counters, newest camera: [`super::Control`].
    Control = 1,
    /// Truncated quad trees, generator to preparer: [`super::TreeWriter`], [`super::TreeReader`].
    PingPong = 2,
    /// [`Slot`]s, preparer to renderer.
    Ring = 3,
    /// Elevation arrays, preparer to renderer: [`super::ElevationWriter`], [`super::ElevationReader`].
    ElevationRing = 4,
    /// Colour tiles: [`super::PoolWriter`], [`super::PoolReader`].
    ColorPool = 5,
    /// Elevation tiles: [`super::PoolWriter`], [`super::PoolReader`].
    ElevationPool = 6,
    /// [`super::CameraRecord`]s, launcher to generator.
    CameraRing = 7,
    /// [`Event`]s of the generator, to the launcher.
    EventsGenerator = 8,
    /// [`Event`]s of the preparer, to the launcher.
    EventsPreparer = 9,
    /// [`Event`]s of the renderer, to the launcher.
    EventsRenderer = 10,
}

impl SegmentKind {
    /// All kinds.
    pub const ALL: [Self; 10] = [
        Self::Control,
        Self::PingPong,
        Self::Ring,
        Self::ElevationRing,
        Self::ColorPool,
        Self::ElevationPool,
        Self::CameraRing,
        Self::EventsGenerator,
        Self::EventsPreparer,
        Self::EventsRenderer,
    ];

    /// The last part of the segment's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Control => "control",
            Self::PingPong => "ping-pong",
            Self::Ring => "ring",
            Self::ElevationRing => "elevation-ring",
            Self::ColorPool => "color-pool",
            Self::ElevationPool => "elevation-pool",
            Self::CameraRing => "camera-ring",
            Self::EventsGenerator => "events-generator",
            Self::EventsPreparer => "events-preparer",
            Self::EventsRenderer => "events-renderer",
        }
    }

    /// The stage that writes it; `None` for the launcher, or for several.
    #[must_use]
    pub const fn writer(self) -> Option<Stage> {
        match self {
            Self::Control | Self::CameraRing => None,
            Self::PingPong | Self::EventsGenerator => Some(Stage::Generator),
            Self::Ring | Self::ElevationRing | Self::ColorPool | Self::ElevationPool | Self::EventsPreparer => {
                Some(Stage::Preparer)
            }
            Self::EventsRenderer => Some(Stage::Renderer),
        }
    }

    /// The stage that reads it; `None` for the launcher, or for several.
    #[must_use]
    pub const fn reader(self) -> Option<Stage> {
        match self {
            Self::Control | Self::ElevationPool => None,
            Self::EventsGenerator | Self::EventsPreparer | Self::EventsRenderer => None,
            Self::CameraRing => Some(Stage::Generator),
            Self::PingPong => Some(Stage::Preparer),
            Self::Ring | Self::ElevationRing | Self::ColorPool => Some(Stage::Renderer),
        }
    }
}

impl fmt::Display for SegmentKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One pose of the flight, in the camera ring; 80 bytes.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct CameraRecord {
    /// The film frame's number.
    pub frame: u64,
    /// Its camera.
    pub camera: Camera,
}

const _: () = assert!(size_of::<CameraRecord>() == 80);

/// Numbers from which the sizes of all segments follow. All rings' capacities are powers of two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Slots of the ring.
    pub ring_slots: u32,
    /// Nodes of one half of the ping-pong buffer.
    pub tree_nodes: u32,
    /// Arrays of the elevation ring.
    pub elevation_arrays: u32,
    /// Numbers in one elevation array, (Nz + 1)²; arrays begin at multiples of 64 bytes.
    pub elevation_array_f32: u32,
    /// Slots of the colour pool.
    pub color_slots: u32,
    /// Bytes of one slot of the colour pool, a multiple of 4096: RGBA8 mips back to back.
    pub color_slot_bytes: u64,
    /// Slots of the elevation pool.
    pub elevation_slots: u32,
    /// Bytes of one slot of the elevation pool, a multiple of 64.
    pub elevation_slot_bytes: u64,
    /// Records of the camera ring.
    pub camera_slots: u32,
    /// Events of each stage's event ring.
    pub event_slots: u32,
}

/// Layers that an image array has on every Vulkan device that we know; a colour slot is a layer.
const MAX_COLOR_SLOTS: u64 = 2048;
/// With fewer colour slots than this, hardly any view has all tiles that it wants.
const MIN_COLOR_SLOTS: u64 = 64;
/// The elevation ring of large tiles is kept below this.
const ELEVATION_RING_BYTES: u64 = 64 << 20;

impl Layout {
    /// The layout for a world, at most `memory_bytes` for the tile pools and the device's copy of the colour pool
    /// together. The picture's size does not matter yet: trees are bounded by `tree_nodes`.
    ///
    /// # Errors
    /// [`ShmError::MemoryTooSmall`].
    pub fn for_run(world: &World, memory_bytes: u64, _width: u32, _height: u32) -> Result<Self, ShmError> {
        let posts = u64::from(world.elevation_posts());
        let array_bytes = posts * posts * 4;
        let elevation_slot_bytes = array_bytes.next_multiple_of(64);
        let stored = u64::from(world.color_stored());
        let color_bytes: u64 = (0..COLOR_MIPS).map(|mip| (stored >> mip).pow(2) * 4).sum();
        let color_slot_bytes = color_bytes.next_multiple_of(4096);
        // Two copies of each colour tile, one of them the device's, and four elevation tiles: elevation has tiles for
        // ancestors and neighbours as well, and costs a twentieth.
        let per_color_slot = 2 * color_slot_bytes + 4 * elevation_slot_bytes;
        let color_slots = (memory_bytes / per_color_slot).min(MAX_COLOR_SLOTS);
        if color_slots < MIN_COLOR_SLOTS {
            let needed = MIN_COLOR_SLOTS * per_color_slot;
            return Err(ShmError::MemoryTooSmall { needed, available: memory_bytes });
        }
        let fitting = (ELEVATION_RING_BYTES / elevation_slot_bytes).max(1);
        let elevation_arrays = (1u32 << fitting.ilog2()).clamp(256, 4096);
        Ok(Self {
            ring_slots: 8192,
            tree_nodes: 65536,
            elevation_arrays,
            elevation_array_f32: (posts * posts) as u32,
            color_slots: color_slots as u32,
            color_slot_bytes,
            elevation_slots: 4 * color_slots as u32,
            elevation_slot_bytes,
            camera_slots: 256,
            event_slots: 16384,
        })
    }

    /// A small layout for tests and examples: every segment is there, a few hundred kilobytes in all.
    #[must_use]
    pub fn small() -> Self {
        Self {
            ring_slots: 64,
            tree_nodes: 256,
            elevation_arrays: 16,
            elevation_array_f32: 25,
            color_slots: 8,
            color_slot_bytes: 8192,
            elevation_slots: 32,
            elevation_slot_bytes: 128,
            camera_slots: 16,
            event_slots: 64,
        }
    }

    /// Bytes of shared memory that the run's segments take together.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        SegmentKind::ALL.iter().map(|&kind| self.geometry(kind).total_bytes).sum()
    }

    /// Number and size of the items of a segment.
    pub(crate) fn geometry(&self, kind: SegmentKind) -> Geometry {
        let (capacity, item_bytes) = match kind {
            SegmentKind::Control => (1, 0),
            SegmentKind::PingPong => (2, half_bytes(u64::from(self.tree_nodes))),
            SegmentKind::Ring => (self.ring_slots.into(), size_of::<Slot>() as u64),
            SegmentKind::ElevationRing => (self.elevation_arrays.into(), u64::from(self.elevation_array_f32) * 4),
            SegmentKind::ColorPool => (self.color_slots.into(), self.color_slot_bytes),
            SegmentKind::ElevationPool => (self.elevation_slots.into(), self.elevation_slot_bytes),
            SegmentKind::CameraRing => (self.camera_slots.into(), size_of::<CameraRecord>() as u64),
            SegmentKind::EventsGenerator | SegmentKind::EventsPreparer | SegmentKind::EventsRenderer => {
                (self.event_slots.into(), size_of::<Event>() as u64)
            }
        };
        Geometry::new(kind, capacity, item_bytes)
    }
}

/// Bytes of a half of the ping-pong buffer that holds `nodes` nodes.
pub(crate) const fn half_bytes(nodes: u64) -> u64 {
    size_of::<TreeHeader>() as u64 + nodes * size_of::<TreeNode>() as u64
}

/// Offset of a segment's control words: the header comes before them.
pub(crate) const WORDS_OFFSET: u64 = 256;
/// Bytes of control words, the pools' tables apart.
pub(crate) const WORDS_BYTES: u64 = 4096 - WORDS_OFFSET;
/// Bytes of an entry of a pool's table.
pub(crate) const TABLE_ENTRY_BYTES: u64 = 32;

/// Where the items of a segment lie. All offsets are from its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) kind: SegmentKind,
    /// Number of items.
    pub(crate) capacity: u64,
    /// Bytes of an item that are used.
    pub(crate) item_bytes: u64,
    /// Bytes from an item to the next.
    pub(crate) stride: u64,
    /// Offset of a pool's table; the items' offset in other segments.
    pub(crate) table_offset: u64,
    /// Offset of the first item.
    pub(crate) data_offset: u64,
    /// Bytes of the whole segment, a multiple of 4096.
    pub(crate) total_bytes: u64,
}

impl Geometry {
    /// The geometry of a segment of our own making; numbers are small enough not to overflow.
    pub(crate) fn new(kind: SegmentKind, capacity: u64, item_bytes: u64) -> Self {
        Self::checked(kind, capacity, item_bytes).unwrap_or(Self {
            kind,
            capacity,
            item_bytes,
            stride: item_bytes,
            table_offset: 0,
            data_offset: 0,
            // Never fits: creating such a segment fails with "too little room".
            total_bytes: u64::MAX / 64,
        })
    }

    /// The geometry of a segment of that many items of that size; `None` when that cannot be (a count that is no
    /// power of two where it has to be one, or sizes that overflow). Numbers may come from a segment's header.
    pub(crate) fn checked(kind: SegmentKind, capacity: u64, item_bytes: u64) -> Option<Self> {
        let (align, has_table, is_ring) = match kind {
            SegmentKind::Control => (1, false, false),
            SegmentKind::PingPong => (4096, false, true),
            SegmentKind::ElevationRing => (64, false, true),
            SegmentKind::ColorPool => (4096, true, false),
            SegmentKind::ElevationPool => (64, true, false),
            _ => (8, false, true),
        };
        if capacity == 0 || capacity > 1 << 31 || item_bytes > 1 << 40 || (is_ring && !capacity.is_power_of_two()) {
            return None;
        }
        let stride = item_bytes.next_multiple_of(align);
        let table_offset = WORDS_OFFSET + WORDS_BYTES;
        let table_bytes = if has_table { capacity.checked_mul(TABLE_ENTRY_BYTES)? } else { 0 };
        let data_offset = table_offset.checked_add(table_bytes)?.checked_next_multiple_of(4096)?;
        let data_end = capacity.checked_mul(stride)?.checked_add(data_offset)?;
        let total_bytes = data_end.checked_next_multiple_of(4096)?;
        Some(Self { kind, capacity, item_bytes, stride, table_offset, data_offset, total_bytes })
    }
}
