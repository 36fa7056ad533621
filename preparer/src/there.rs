//! Realtime mode: a frame takes the tiles that are there, and waits for none.
//!
//! What is there is looked at once a frame. A tile that comes a moment later is not used by the frame, although it is in the
//! pool by then: the frame has not kept it, so nothing would keep its slot until the frame is completed.

use crate::frame_tree::Tile;
use crate::loader::{LoadError, TileLoader, TileState};
use terravision_common::shm::Control;

/// Keeps those of the wanted tiles that are there for a frame, and asks for the others. Returns how many are not there.
/// Does not block.
///
/// # Errors
/// [`LoadError`].
pub fn take_what_is_there(
    wanted: &[Tile],
    loader: &mut impl TileLoader,
    frame: u64,
    sequence: u64,
    control: &Control,
) -> Result<u32, LoadError> {
    loader.drain()?;
    let is_absent = |tile: &&Tile| loader.want(**tile, frame, sequence, control) != TileState::Resident;
    let missing = wanted.iter().filter(is_absent).count() as u32;
    loader.ask(frame, sequence);
    Ok(missing)
}
