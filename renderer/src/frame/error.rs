//! What is wrong with a frame from the ring.

use crate::source::SourceError;
use terravision_common::camera::CameraError;
use terravision_common::ids::FrameNumber;

/// What is wrong with a frame from the ring.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The source failed.
    #[error(transparent)]
    Source {
        /// Why.
        #[from]
        source: SourceError,
    },
    /// A slot is not the one that has to come now.
    #[error("the ring lost its order in frame {frame}: found {found}, expected {expected}")]
    Order {
        /// The frame being read.
        frame: FrameNumber,
        /// What the slot is.
        found: &'static str,
        /// What it should have been.
        expected: &'static str,
    },
    /// A number of a frame's first or last slot is wrong.
    #[error("frame {frame} from the ring is corrupt: {field} is {found}, expected {expected}")]
    Marker {
        /// The frame.
        frame: FrameNumber,
        /// Which number.
        field: &'static str,
        /// What it is.
        found: u64,
        /// What it should have been.
        expected: u64,
    },
    /// The camera that carries a frame's views is not valid.
    #[error("frame {frame} from the ring has no valid camera: {source}")]
    Camera {
        /// The frame.
        frame: FrameNumber,
        /// What is wrong with it.
        source: CameraError,
    },
    /// A view of a frame cannot be drawn.
    #[error(
        "view {index} of frame {frame} from the ring has no valid camera within a picture of {}x{} pixels",
        .picture[0], .picture[1]
    )]
    View {
        /// The frame.
        frame: FrameNumber,
        /// Which of its views.
        index: usize,
        /// The size of the frame's picture.
        picture: [u32; 2],
    },
    /// The picture of a frame is empty or larger than the run's pictures are.
    #[error(
        "frame {frame} from the ring is a picture of {}x{} pixels, expected one of {}x{} at most",
        .found[0], .found[1], .most[0], .most[1]
    )]
    PictureSize {
        /// The frame.
        frame: FrameNumber,
        /// Its size.
        found: [u32; 2],
        /// The largest of the run.
        most: [u32; 2],
    },
    /// A number of a tile is wrong.
    #[error("tile {index} of frame {frame} from the ring is corrupt: {fault}")]
    Tile {
        /// The frame.
        frame: FrameNumber,
        /// Which of its tiles.
        index: usize,
        /// What is wrong with it.
        fault: TileFault,
    },
    /// A tile of the elevation pool that a frame names is wrong.
    #[error("elevation tile {index} of frame {frame} from the ring is corrupt: {fault}")]
    Elevation {
        /// The frame.
        frame: FrameNumber,
        /// Which of its elevation tiles.
        index: usize,
        /// What is wrong with it.
        fault: TileFault,
    },
    /// The world's lattice is too large for the device's 32-bit numbers.
    #[error("the world has nodes of {side} lattice units, at most 2^29 can be drawn")]
    WorldTooLarge {
        /// Side of the root.
        side: u64,
    },
}

/// What is wrong with a tile slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TileFault {
    /// The block is empty or not inside its array.
    #[error("its block does not lie inside an elevation array")]
    Block,
    /// A level is not one of the world's.
    #[error("a level is not one of the world's")]
    Level,
    /// A corner is not that of a node.
    #[error("a lower left corner is not that of a node of the world")]
    Origin,
    /// The colour tile does not cover the block.
    #[error("its colour tile does not cover its block")]
    Cover,
    /// More vertices would collapse than an edge has, or fewer than inside of it.
    #[error("more vertices collapse than an edge has, or fewer than inside")]
    Snap,
    /// The colour slot is not one of the pool's.
    #[error("its colour slot is not one of the pool's")]
    ColorSlot,
    /// Its number is not that of a node with elevation, or the node above it does not come before it.
    #[error("it is not of a node with elevation, or the one above it is missing")]
    Node,
    /// The elevation slot is not one of the pool's, or the renderer reads none.
    #[error("its slot is not one of the elevation pool's")]
    ElevationSlot,
    /// The elevation array does not belong to the frame.
    #[error("its elevation array does not belong to the frame")]
    Elevation,
    /// One colour slot has two generations in one frame.
    #[error("its colour slot has another generation than for an earlier tile of the frame")]
    Generation,
    /// A height of its block is not a number.
    #[error("a height of its block is not a finite number")]
    Height,
    /// Another tile of the frame is at its place.
    #[error("another tile of the frame is at its place")]
    Occupied,
    /// The pool's slot holds another tile by now.
    #[error("its colour slot holds another generation than it names")]
    Stale,
    /// The elevation pool's slot holds another tile by now.
    #[error("its elevation slot holds another generation than it names")]
    StaleElevation,
}
