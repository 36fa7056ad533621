//! Tile pools: slots of equal size, each for one tile, in a segment that the renderer and the
//! device read in place.
//!
//! The table before the slots has for each slot its tile, its generation, and the last frame that
//! wanted it. A slot that a frame in flight uses is not refilled: its last frame has to be
//! completed first. When the pool is full, [`PoolWriter::allocate`] returns `None`, and the caller
//! waits for frames to complete.

mod index;
mod reader;
mod writer;

pub use super::slot_words::{SlotInfo, SlotState};
pub use index::PoolIndex;
pub use reader::{PoolBytes, PoolReader};
pub use writer::{FillGuard, PoolWriter, Residency};

use super::error::ShmError;
use super::header::Segment;
use super::kind::SegmentKind;
use super::region::SharedWords;
use super::slot_words::SlotWords;

// SAFETY: atomics alone, repr(C), aligned to 8.
unsafe impl SharedWords for SlotWords {}

/// The table of a segment that is a pool.
pub(crate) fn table(segment: &Segment) -> &[SlotWords] {
    let geometry = segment.geometry();
    segment.region().words_slice(geometry.table_offset, geometry.capacity)
}

pub(crate) fn check_is_pool(segment: &Segment) -> Result<(), ShmError> {
    match segment.kind() {
        SegmentKind::ColorPool | SegmentKind::ElevationPool => Ok(()),
        kind => Err(ShmError::WrongKind { name: kind.name().to_owned(), kind }),
    }
}
