//! One tile of a frame: a block of an elevation array, and its colour tile.

use crate::ids::SlotKey;
use crate::node::NodeId;
use bytemuck::{Pod, Zeroable};

/// One colour leaf: a block of the elevation array of its elevation leaf, and the colour tile that
/// covers it.
///
/// A vertex `(i, j)` of the block, `start <= (i, j) <= end`, both multiples of `1 << grid_snap`, is
/// elevation `[j][i]` of the array (row 0 is the southern one), at lattice point
/// `min(elevation_origin + ((i, j) << elevation_level), extent)`. Facets are split along the
/// diagonal from south west to north east.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TileSlot {
    /// [`NodeId::pack`] of the colour leaf ([`TileSlot::node`]); for overlays and messages, not for
    /// drawing.
    pub node: u64,
    /// Position in the elevation ring (monotonic; modulo the ring's capacity it is the array's
    /// index). In a frame that names tiles of the elevation pool, which of them is that of the
    /// elevation leaf, from 0.
    pub elevation_position: u64,
    /// Lower left corner of the elevation leaf, lattice units.
    pub elevation_origin: [u32; 2],
    /// Lower left corner of the node whose colour tile is used, lattice units. That node is the
    /// colour leaf, or the finest ancestor of it that has a tile; then the block uses a sub-square
    /// of the tile.
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
    /// log2 of the posts from vertex to vertex on the west, east, south and north edge of the
    /// *elevation array*, because the neighbour there is drawn that many levels coarser: on the
    /// edge, index `k` is drawn at `k & !((1 << snap) - 1)`. At least `grid_snap`.
    pub edge_snap: [u8; 4],
    /// log2 of the posts from vertex to vertex: 0 draws all of them. `start` and `end` are
    /// multiples of that step.
    pub grid_snap: u8,
    /// Bit n: view n of the frame sees nothing of the block as facets are drawn, because all of it
    /// lies behind nearer ground or outside of the picture. The mesh leaves it out of that view. A
    /// technique with a surface of its own may see some of it past the edge of what hides it.
    pub unseen_by: u8,
}

// A bit for each view.
const _: () = assert!(crate::rig::MAX_VIEWS <= u8::BITS as usize);

impl TileSlot {
    /// The colour leaf; `None` when the number is not valid (it came from shared memory).
    #[must_use]
    pub const fn node(&self) -> Option<NodeId> {
        NodeId::unpack(self.node)
    }

    /// Whether a view of the frame, counted from 0, may see any facet of the block.
    #[must_use]
    pub const fn may_be_seen_by(&self, view: usize) -> bool {
        self.unseen_by as usize >> view & 1 == 0
    }

    /// The place of the colour tile in its pool.
    #[must_use]
    pub const fn color(&self) -> SlotKey {
        SlotKey::new(self.color_slot, self.color_generation)
    }

    /// The same block with another colour tile.
    #[must_use]
    pub const fn with_color(self, key: SlotKey) -> Self {
        Self { color_slot: key.slot.get(), color_generation: key.generation.get(), ..self }
    }
}
