//! Frames as they come out of the ring: read slot by slot, checked, kept in memory that is used
//! again.
//!
//! Nothing that came through shared memory is trusted: code that gets a [`Frame`] may index with
//! its numbers.

mod check;
mod error;
mod reader;

pub use check::check_tile;
pub use error::{FrameError, TileFault};
pub use reader::FrameReader;

use terravision_common::camera::Camera;
use terravision_common::ids::{FrameNumber, RingPosition, Sequence};
use terravision_common::node::NodeId;
use terravision_common::rig::{PictureLayout, Views};
use terravision_common::slot::{ElevationTile, FrameEnd, FrameMarker, TileSlot};

/// Lattice coordinates stay below this, so that differences of two of them fit into 32 bits on the
/// device.
const MAX_NODE_SIDE: u64 = 1 << 29;
/// Tiles of one frame: as many as a tree has nodes.
pub const MAX_TILES: usize = 65536;

/// A checked frame.
#[derive(Debug)]
pub struct Frame {
    /// Its first slot.
    pub marker: FrameMarker,
    /// The marker's camera.
    pub pose: Camera,
    /// Its views. They lie within the frame's picture.
    pub views: Views,
    /// Tiles of the elevation pool in which its heights lie, a node after the one above it; empty
    /// where it has elevation arrays.
    pub elevations: Vec<ElevationTile>,
    /// Its tiles, near to far.
    pub tiles: Vec<TileSlot>,
    /// Its last slot.
    pub end: FrameEnd,
    /// Position of its first elevation array.
    pub elevation_start: u64,
    /// Counts the frames of the run that were made from 1.
    pub sequence: Sequence,
    /// One past its last slot.
    pub slots_end: RingPosition,
}

impl Frame {
    /// Its number.
    #[must_use]
    pub fn number(&self) -> FrameNumber {
        FrameNumber::new(self.marker.frame)
    }

    /// Where its views lie in its picture, whose size is the frame's own.
    #[must_use]
    pub fn layout(&self) -> PictureLayout {
        PictureLayout::new(self.marker.picture, &self.views)
    }
}

/// Level of the colour leaf of a tile, for overlays; 0 when its number is not a node's.
#[must_use]
pub fn leaf_level(tile: &TileSlot) -> u8 {
    tile.node().map_or(0, NodeId::q)
}
