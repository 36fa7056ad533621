//! The slots of the ring between preparer and renderer.
//!
//! A frame is one [`Slot`] of kind [`FRAME_MARKER`], one of kind [`FRAME_VIEW`] per view that is drawn, one of kind [`TILE`]
//! per colour leaf, near to far, and one of kind [`FRAME_END`]. All slots have one size; the kind says which payload the
//! bytes are. The reader ([`Slot::read`]) trusts none of them. A marker within a frame breaks that frame off, when it is of another preparer than
//! the one that was killed in it.

use crate::camera::CameraFields;
use crate::ids::SlotKey;
use crate::node::NodeId;
use bytemuck::{Pod, Zeroable};

/// Kind of a [`FrameMarker`] slot.
pub const FRAME_MARKER: u64 = 1;
/// Kind of a [`TileSlot`] slot.
pub const TILE: u64 = 2;
/// Kind of a [`FrameEnd`] slot.
pub const FRAME_END: u64 = 3;
/// Kind of a [`ViewSlot`] slot.
pub const FRAME_VIEW: u64 = 4;

/// Opens a frame.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FrameMarker {
    /// The frame's number.
    pub frame: u64,
    /// The camera that the tree was made for: the pose that carries the frame's views. Heights of the frame's elevation arrays
    /// are metres above its eye; its own size and field of view are those of no picture.
    pub camera: CameraFields,
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// The frame's place among those of the run that were prepared, from 1 ([`crate::ids::Sequence`]).
    pub sequence: u64,
    /// Position in the elevation ring of its first array. Arrays between the end of the frame before and this one
    /// belong to no frame: their preparer was killed.
    pub elevation_start: u64,
    /// Which preparer of the run makes it, counted from 1: one that was started again breaks off the frame before.
    pub maker: u64,
    /// Width and height of the picture that holds all views, pixels.
    pub picture: [u32; 2],
}

/// One view of a frame; follows the marker, in the order of the run's rig. All of a frame's views are drawn from the same tiles.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ViewSlot {
    /// The camera that draws it, and the size of its picture.
    pub camera: CameraFields,
    /// Its upper left corner in the frame's picture, pixels.
    pub at: [u32; 2],
    /// Which of the frame's views it is, from 0.
    pub index: u32,
    /// How many views the frame has, 1 to [`crate::rig::MAX_VIEWS`].
    pub count: u32,
}

/// One colour leaf: a block of the elevation array of its elevation leaf, and the colour tile that covers it.
///
/// A vertex `(i, j)` of the block, `start <= (i, j) <= end`, both multiples of `1 << grid_snap`, is elevation `[j][i]` of the array (row 0 is the southern
/// one), at lattice point `min(elevation_origin + ((i, j) << elevation_level), extent)`. Facets are split along the
/// diagonal from south west to north east.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TileSlot {
    /// [`NodeId::pack`] of the colour leaf ([`TileSlot::node`]); for overlays and messages, drawing does not need it.
    pub node: u64,
    /// Position in the elevation ring (monotonic; modulo the ring's capacity it is the array's index).
    pub elevation_position: u64,
    /// Lower left corner of the elevation leaf, lattice units.
    pub elevation_origin: [u32; 2],
    /// Lower left corner of the node whose colour tile is used, lattice units. That node is the colour leaf, or the
    /// finest ancestor of it that has a tile; then the block uses a sub-square of the tile.
    pub color_origin: [u32; 2],
    /// First column and row of the block within the elevation array.
    pub start: [u16; 2],
    /// Last column and row of the block (a vertex, not one past it).
    pub end: [u16; 2],
    /// Slot of the colour pool.
    pub color_slot: u32,
    /// Generation that the colour slot has to have.
    pub color_generation: u32,
    /// Level of the elevation leaf.
    pub elevation_level: u8,
    /// Level of the node whose colour tile is used.
    pub color_level: u8,
    /// log2 of the posts from vertex to vertex on the west, east, south and north edge of the *elevation array*, because
    /// the neighbour there is drawn that many levels coarser: on the edge, index `k` is drawn at `k & !((1 << snap) - 1)`.
    /// At least `grid_snap`.
    pub edge_snap: [u8; 4],
    /// log2 of the posts from vertex to vertex: 0 draws all of them. `start` and `end` are multiples of that step.
    pub grid_snap: u8,
    /// Not 0: the whole block lies behind nearer ground, as facets are drawn. The mesh leaves it out; a technique with a surface of
    /// its own may see some of it past the edge of what hides it.
    pub is_hidden: u8,
}

impl TileSlot {
    /// The colour leaf; `None` when the number is no node's (it came from shared memory).
    #[must_use]
    pub const fn node(&self) -> Option<NodeId> {
        NodeId::unpack(self.node)
    }

    /// Where the colour tile lies in its pool.
    #[must_use]
    pub const fn color(&self) -> SlotKey {
        SlotKey::new(self.color_slot, self.color_generation)
    }

    /// The same block, with the colour tile that lies there.
    #[must_use]
    pub const fn with_color(self, key: SlotKey) -> Self {
        Self { color_slot: key.slot.get(), color_generation: key.generation.get(), ..self }
    }
}

/// Closes a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct FrameEnd {
    /// The frame's number, again.
    pub frame: u64,
    /// Number of tile slots since the marker; a reader that counted another number lost its place.
    pub tile_count: u32,
    /// Tiles that the frame wanted and that could not be read; 0 for a settled frame.
    pub unavailable_count: u32,
    /// One past the last position of the elevation ring that the frame uses: the reader releases up to here.
    pub elevation_end: u64,
    /// Tiles (colour and elevation) that the frame wanted.
    pub wanted_count: u32,
    /// Nodes of the frame's tree after truncation.
    pub node_count: u32,
}

/// A ring slot, 136 bytes: the kind, then the payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Slot {
    kind: u64,
    payload: [u64; 16],
}

const _: () = assert!(size_of::<FrameMarker>() == 128 && size_of::<ViewSlot>() == 88);
const _: () = assert!(size_of::<TileSlot>() == 56 && size_of::<FrameEnd>() == 32);

/// What a slot says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SlotContent {
    /// A frame opens.
    Marker(FrameMarker),
    /// One view of it.
    View(ViewSlot),
    /// One tile to draw.
    Tile(TileSlot),
    /// The frame is complete.
    End(FrameEnd),
}

impl Slot {
    /// A slot with this content.
    #[must_use]
    pub fn new(content: &SlotContent) -> Self {
        let mut slot = Slot::zeroed();
        let (kind, bytes) = match content {
            SlotContent::Marker(marker) => (FRAME_MARKER, bytemuck::bytes_of(marker)),
            SlotContent::View(view) => (FRAME_VIEW, bytemuck::bytes_of(view)),
            SlotContent::Tile(tile) => (TILE, bytemuck::bytes_of(tile)),
            SlotContent::End(end) => (FRAME_END, bytemuck::bytes_of(end)),
        };
        slot.kind = kind;
        bytemuck::bytes_of_mut(&mut slot.payload)[..bytes.len()].copy_from_slice(bytes);
        slot
    }

    /// What it says; `None` for a kind that does not exist. The numbers inside are still to be checked against the
    /// rings and pools that they index.
    #[must_use]
    pub fn read(&self) -> Option<SlotContent> {
        let bytes: &[u8] = bytemuck::bytes_of(&self.payload);
        Some(match self.kind {
            FRAME_MARKER => SlotContent::Marker(bytemuck::pod_read_unaligned(&bytes[..size_of::<FrameMarker>()])),
            FRAME_VIEW => SlotContent::View(bytemuck::pod_read_unaligned(&bytes[..size_of::<ViewSlot>()])),
            TILE => SlotContent::Tile(bytemuck::pod_read_unaligned(&bytes[..size_of::<TileSlot>()])),
            FRAME_END => SlotContent::End(bytemuck::pod_read_unaligned(&bytes[..size_of::<FrameEnd>()])),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_reads_back_what_was_put_into_it() {
        let tile = TileSlot { node: 7, end: [32, 31], edge_snap: [0, 1, 2, 0], ..TileSlot::zeroed() };
        assert_eq!(Slot::new(&SlotContent::Tile(tile)).read(), Some(SlotContent::Tile(tile)));
        let end = FrameEnd { frame: 9, tile_count: 3, ..FrameEnd::zeroed() };
        assert_eq!(Slot::new(&SlotContent::End(end)).read(), Some(SlotContent::End(end)));
        let marker = FrameMarker { frame: 9, r_z_px: 10.0, ..FrameMarker::zeroed() };
        assert_eq!(Slot::new(&SlotContent::Marker(marker)).read(), Some(SlotContent::Marker(marker)));
        let view = ViewSlot { at: [640, 0], index: 1, count: 2, ..ViewSlot::zeroed() };
        assert_eq!(Slot::new(&SlotContent::View(view)).read(), Some(SlotContent::View(view)));
    }

    #[test]
    fn a_slot_of_no_kind_says_nothing() {
        assert_eq!(Slot::zeroed().read(), None);
    }
}
