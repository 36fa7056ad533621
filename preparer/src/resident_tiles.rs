//! Realtime mode: a frame uses the tiles that are resident, and does not wait for others.
//!
//! Each tile is looked up once a frame. The frame does not use a tile that arrives a moment later,
//! although it is in the pool by then: the frame has not pinned it, so its slot could be reused
//! before the frame is completed.

use crate::frame_tree::Tile;
use crate::loader::{TileLoader, TileState};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::shm::{Control, WaitError};

/// Pins the wanted tiles that are resident for a frame, and asks for the others. Returns how many
/// are missing. Does not block.
///
/// # Errors
/// The run ended.
pub fn pin_resident(
    wanted: &[Tile],
    loader: &mut impl TileLoader,
    frame: FrameNumber,
    sequence: Sequence,
    control: &Control,
) -> Result<u32, WaitError> {
    loader.drain()?;
    let is_missing = |tile: &&Tile| loader.want(**tile, frame, sequence, control) != TileState::Resident;
    let missing = wanted.iter().filter(is_missing).count() as u32;
    loader.ask(frame, sequence);
    Ok(missing)
}
