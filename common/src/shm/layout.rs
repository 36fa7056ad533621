//! The sizes of a run's segments.

use super::error::ShmError;
use super::geometry::{Geometry, half_bytes};
use super::kind::SegmentKind;
use super::vehicle_layout::{table_frame_bytes, table_frames};
use crate::camera::CameraFields;
use crate::event::Event;
use crate::outcome::TileOutcome;
use crate::slot::Slot;
use crate::texels::TexelFormat;
use crate::world::World;

/// One pose of the flight, in the camera ring; 80 bytes.
#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct CameraRecord {
    /// The film frame's number.
    pub frame: u64,
    /// Its camera.
    pub camera: CameraFields,
}

const _: () = assert!(size_of::<CameraRecord>() == 80);

/// Numbers from which the sizes of all segments follow. All rings' capacities are powers of two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Slots of the ring.
    pub(crate) ring_slots: u32,
    /// Nodes of one half of the ping-pong buffer.
    pub(crate) tree_nodes: u32,
    /// Arrays of the elevation ring.
    pub(crate) elevation_arrays: u32,
    /// Numbers in one elevation array, (Nz + 1)²; arrays begin at multiples of 64 bytes.
    pub(crate) elevation_array_f32: u32,
    /// Slots of the colour pool.
    pub(crate) color_slots: u32,
    /// Bytes of one slot of the colour pool, a multiple of 4096: mips back to back.
    pub(crate) color_slot_bytes: u64,
    /// Slots of the elevation pool.
    pub(crate) elevation_slots: u32,
    /// Bytes of one slot of the elevation pool, a multiple of 64.
    pub(crate) elevation_slot_bytes: u64,
    /// Records of the camera ring, and of the path ring.
    pub(crate) camera_slots: u32,
    /// Events of each stage's event ring.
    pub(crate) event_slots: u32,
    /// Tiles that a want list holds; a frame that wants more asks for the rest when these are
    /// resident.
    pub(crate) want_tiles: u32,
    /// Outcomes in the ring of tile outcomes.
    pub(crate) outcome_slots: u32,
    /// Bytes of a frame of the stream ring; 0 where no stream is made.
    pub(crate) stream_frame_bytes: u64,
    /// Vehicles of a frame.
    pub(crate) vehicles: u32,
}

/// Layers of an image array that every known Vulkan device supports; a colour slot is a layer.
const MAX_COLOR_SLOTS: u64 = 2048;
/// With fewer colour slots, hardly any view has all tiles that it wants.
const MIN_COLOR_SLOTS: u64 = 64;
/// Upper bound of the bytes of the elevation ring of large tiles.
const ELEVATION_RING_BYTES: u64 = 64 << 20;
/// For facets of at most this many pixels, ring and trees are as large as the picture requires.
const FINE_FACET_PX: f64 = 2.0;
/// Maximum number of arrays of the elevation ring for such a picture.
const MAX_FINE_ARRAYS: u64 = 65_536;
/// Facets of a fine picture per square of their wanted size: leaves extend beyond the picture and
/// behind ground. Views of mountains have 2.5 to 3.5.
const FACETS_PER_WANTED: f64 = 5.0;

/// Cells of an elevation tile.
fn tile_facets(world: &World) -> f64 {
    f64::from(world.elevation_tile()).powi(2)
}

impl Layout {
    /// The layout for a world, with at most `memory_bytes` for the tile pools and the device's copy
    /// of the colour pool together. `texels`: the format of colour tiles. The picture's size does
    /// not matter: trees are bounded by `tree_nodes`.
    ///
    /// # Errors
    /// [`ShmError::MemoryTooSmall`].
    pub fn for_run(world: &World, memory_bytes: u64, texels: TexelFormat) -> Result<Self, ShmError> {
        let array_values = world.elevation_values();
        let array_bytes = array_values as u64 * 4;
        let elevation_slot_bytes = array_bytes.next_multiple_of(64);
        let slot_bytes = |format: TexelFormat| format.tile_bytes(world.color_stored()).next_multiple_of(4096);
        let color_slot_bytes = slot_bytes(texels);
        // Two copies of each colour tile, one of them on the device; and for elevation a sixteenth
        // of their uncompressed size, at least four tiles: fine facets under coarse texels need
        // many more elevation tiles than colour tiles.
        let elevation_per_color = (slot_bytes(TexelFormat::Rgba8) / (8 * elevation_slot_bytes)).max(4);
        let per_color_slot = 2 * color_slot_bytes + elevation_per_color * elevation_slot_bytes;
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
            elevation_array_f32: array_values as u32,
            color_slots: color_slots as u32,
            color_slot_bytes,
            elevation_slots: (elevation_per_color * color_slots) as u32,
            elevation_slot_bytes,
            camera_slots: 256,
            event_slots: 16384,
            want_tiles: 16384,
            outcome_slots: 16384,
            stream_frame_bytes: 0,
            vehicles: 0,
        })
    }

    /// Makes room for the trees of a picture of this many pixels, if its facets are so small (2
    /// pixels or less) that the default would cut them short. What is added to the elevation pool
    /// is taken from the colour pool.
    #[must_use]
    pub fn for_picture(self, world: &World, pixels: u64, r_z_px: f64) -> Self {
        if r_z_px > FINE_FACET_PX {
            return self;
        }
        let leaves = FACETS_PER_WANTED * pixels as f64 / r_z_px.powi(2) / tile_facets(world);
        let fitting = 4 * ELEVATION_RING_BYTES / self.elevation_slot_bytes.max(1);
        let most = MAX_FINE_ARRAYS.min(fitting) as f64;
        let arrays = (leaves.ceil().clamp(1.0, most) as u32).next_power_of_two().clamp(1, MAX_FINE_ARRAYS as u32);
        if arrays <= self.elevation_arrays {
            return self;
        }
        let elevation_slots = self.elevation_slots.max(2 * arrays);
        let more_bytes = u64::from(elevation_slots - self.elevation_slots) * self.elevation_slot_bytes;
        let fewer = more_bytes.div_ceil(2 * self.color_slot_bytes.max(1)).min(u64::from(self.color_slots)) as u32;
        Self {
            elevation_arrays: arrays,
            tree_nodes: self.tree_nodes.max(4 * arrays),
            elevation_slots,
            color_slots: (self.color_slots - fewer).max(self.color_slots.min(MIN_COLOR_SLOTS as u32)),
            ..self
        }
    }

    /// The same for a run of frames that only a sweep draws: it reads heights out of the elevation pool,
    /// and no elevation array is made.
    #[must_use]
    pub fn without_arrays(self) -> Self {
        Self { elevation_arrays: 1, ..self }
    }

    /// The smallest facets, at least 1 pixel, for which trees of a picture of this many pixels have
    /// room.
    #[must_use]
    pub fn finest_facet_px(world: &World, pixels: u64) -> f64 {
        let facet_px = (FACETS_PER_WANTED * pixels as f64 / (MAX_FINE_ARRAYS as f64 * tile_facets(world))).sqrt();
        // Rounded up to a tenth, for display.
        ((facet_px * 10.0).ceil() / 10.0).max(1.0)
    }

    /// Sets the slots of the ring and the nodes of half of the ping-pong buffer, for benches: both
    /// are rounded up to a power of two.
    #[must_use]
    pub fn with_room(self, ring_slots: u32, tree_nodes: u32) -> Self {
        let power = |count: u32| count.clamp(1, 1 << 24).next_power_of_two();
        Self { ring_slots: power(ring_slots), tree_nodes: power(tree_nodes), ..self }
    }

    /// Makes room for a stream whose frames have this many bytes.
    #[must_use]
    pub fn for_stream(self, frame_bytes: u64) -> Self {
        Self { stream_frame_bytes: frame_bytes, ..self }
    }

    /// Makes room for this many vehicles in each frame.
    #[must_use]
    pub fn for_vehicles(self, count: u32) -> Self {
        Self { vehicles: count, ..self }
    }

    /// A small layout for tests and examples: every segment is there, a few hundred kilobytes in
    /// all.
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
            want_tiles: 64,
            outcome_slots: 64,
            stream_frame_bytes: 96,
            vehicles: 4,
        }
    }

    /// Arrays of the elevation ring.
    #[must_use]
    pub fn elevation_arrays(&self) -> u32 {
        self.elevation_arrays
    }

    /// Slots of the colour pool.
    #[must_use]
    pub fn color_slots(&self) -> u32 {
        self.color_slots
    }

    /// Slots of the elevation pool.
    #[must_use]
    pub fn elevation_slots(&self) -> u32 {
        self.elevation_slots
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
            SegmentKind::CameraRing | SegmentKind::PathRing => {
                (self.camera_slots.into(), size_of::<CameraRecord>() as u64)
            }
            SegmentKind::EventsGenerator
            | SegmentKind::EventsPreparer
            | SegmentKind::EventsRenderer
            | SegmentKind::EventsPrefetcher => (self.event_slots.into(), size_of::<Event>() as u64),
            SegmentKind::WantList => (self.want_tiles.into(), 8),
            // One is written while the other one is passed on.
            SegmentKind::StreamRing => (2, self.stream_frame_bytes),
            SegmentKind::VehicleTable => (table_frames(self.vehicles), table_frame_bytes(self.vehicles)),
            SegmentKind::TileOutcomes => (self.outcome_slots.into(), size_of::<TileOutcome>() as u64),
        };
        Geometry::new(kind, capacity, item_bytes)
    }
}
