//! Realtime mode: a frame takes the tiles that are there, and waits for none.
//!
//! What is there is looked at once a frame. A tile that comes a moment later is not used by the frame, although it is in the
//! pool by then: the frame has not marked it as wanted, so nothing would keep its slot until the frame is completed.

use crate::frame_tree::Tile;
use crate::loader::{Loaded, TileLoader, TileState};
use crate::truncation::Tiles;
use terravision_common::database::Layer;
use terravision_common::node::NodeId;
use terravision_common::node_table::NodeTable;
use terravision_common::shm::Control;

/// Tiles that may be on their way at a time. More would only queue: the next frame may want others more.
const IN_FLIGHT: usize = 128;

/// Which of a frame's tiles are there; keeps its buffers.
#[derive(Debug)]
pub struct ThereTiles {
    /// By layer.
    there: [NodeTable; 2],
    absent: Vec<Tile>,
}

impl ThereTiles {
    /// Buffers for frames that want up to `wanted` tiles.
    #[must_use]
    pub fn new(wanted: usize) -> Self {
        Self { there: [NodeTable::new(wanted), NodeTable::new(wanted)], absent: Vec::with_capacity(wanted) }
    }

    /// Looks which of the wanted tiles are there, and keeps those for the frame; the coarsest of the others are asked for.
    /// Returns how many are not there. Does not block. `tell` hears of every load that has ended.
    pub fn look(
        &mut self,
        wanted: &[Tile],
        loader: &mut impl TileLoader,
        frame: u64,
        sequence: u64,
        control: &Control,
        tell: impl FnMut(&Loaded),
    ) -> u32 {
        let Self { there, absent } = self;
        there.iter_mut().for_each(NodeTable::clear);
        absent.clear();
        loader.drain(tell);
        for tile in wanted {
            let is_there = match tile.layer {
                Layer::Elevation => loader.elevation(tile.node).is_some(),
                Layer::Color => loader.color(tile.node).is_some(),
            };
            // Wanting a tile that is there starts nothing, it marks the tile as wanted by this frame.
            let is_kept = is_there && loader.want(*tile, frame, sequence, control) == TileState::Resident;
            // The tables have room for every tile of a tree.
            if !is_kept || there[tile.layer as usize].insert(tile.node, 0).is_err() {
                absent.push(*tile);
            }
        }
        let missing = absent.len() as u32;
        // Coarse to fine: a tile without those above it cannot be drawn. Of a level, the order of the tree: near first.
        for q in (0..=absent.iter().map(|tile| tile.node.q()).max().unwrap_or(0)).rev() {
            for tile in absent.iter().filter(|tile| tile.node.q() == q) {
                if loader.in_flight() >= IN_FLIGHT {
                    return missing;
                }
                if loader.want(*tile, frame, sequence, control) == TileState::NoRoom {
                    return missing;
                }
            }
        }
        missing
    }

    /// The tiles that were there when the frame looked.
    #[must_use]
    pub fn of<'a, L>(&'a self, loader: &'a L) -> FrameTiles<'a, L> {
        FrameTiles { there: &self.there, loader }
    }
}

/// Tiles of one frame.
#[derive(Debug)]
pub struct FrameTiles<'a, L> {
    there: &'a [NodeTable; 2],
    loader: &'a L,
}

impl<L: Tiles> Tiles for FrameTiles<'_, L> {
    fn color(&self, node: NodeId) -> Option<(u32, u32)> {
        self.there[Layer::Color as usize].get(node)?;
        self.loader.color(node)
    }

    fn elevation(&self, node: NodeId) -> Option<&[f32]> {
        self.there[Layer::Elevation as usize].get(node)?;
        self.loader.elevation(node)
    }
}
