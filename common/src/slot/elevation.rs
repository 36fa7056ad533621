//! Tiles of the elevation pool that a frame's heights are read out of, in place.

use crate::ids::SlotKey;
use crate::node::NodeId;
use bytemuck::{Pod, Zeroable};

/// A tile of the elevation pool: that of an elevation leaf, or of a node above one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ElevationTile {
    /// [`NodeId::pack`] of its node ([`ElevationTile::node`]).
    pub node: u64,
    /// Slot of the elevation pool.
    pub slot: u32,
    /// Generation that the slot has to have.
    pub generation: u32,
}

impl ElevationTile {
    /// The tile of a node.
    #[must_use]
    pub const fn new(node: NodeId, key: SlotKey) -> Self {
        Self { node: node.pack(), slot: key.slot.get(), generation: key.generation.get() }
    }

    /// Its node; `None` when the number is not valid (it came from shared memory).
    #[must_use]
    pub const fn node(&self) -> Option<NodeId> {
        NodeId::unpack(self.node)
    }

    /// Its place in the pool.
    #[must_use]
    pub const fn key(&self) -> SlotKey {
        SlotKey::new(self.slot, self.generation)
    }
}

/// Some of a frame's elevation tiles. Over all slots of a frame, a node comes after the one above
/// it; [`crate::slot::TileSlot::elevation_position`] counts them from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ElevationSlot {
    /// Those behind the last one have generation 0.
    tiles: [ElevationTile; ElevationSlot::MOST],
}

impl ElevationSlot {
    /// Tiles of a slot.
    pub const MOST: usize = 8;

    /// A slot of these tiles, [`ElevationSlot::MOST`] at most: more are left out.
    #[must_use]
    pub fn of(tiles: &[ElevationTile]) -> Self {
        let mut slot = Self::zeroed();
        slot.tiles.iter_mut().zip(tiles).for_each(|(out, tile)| *out = *tile);
        slot
    }

    /// Its tiles.
    pub fn tiles(&self) -> impl Iterator<Item = ElevationTile> {
        self.tiles.into_iter().take_while(|tile| tile.generation != 0)
    }
}
