//! Whether the numbers of a tile are those of a tile.

use super::TileFault;
use terravision_common::slot::{ElevationTile, TileSlot};
use terravision_common::surface::{BlockFault, DrawnBlock};
use terravision_common::world::World;

/// Checks the numbers of an elevation tile against the world and the pool.
///
/// # Errors
/// The first fault.
pub(super) fn check_elevation(tile: &ElevationTile, world: &World, slots: u32) -> Result<(), TileFault> {
    tile.node().filter(|node| world.contains(*node) && world.has_elevation(*node)).ok_or(TileFault::Node)?;
    if tile.slot < slots { Ok(()) } else { Err(TileFault::ElevationSlot) }
}

/// Checks the numbers of a tile against the world and the pool. Positions in the elevation ring are
/// checked when the frame is complete.
///
/// # Errors
/// The first fault.
pub fn check_tile(tile: &TileSlot, world: &World, color_slots: u32) -> Result<(), TileFault> {
    let intervals = world.elevation_tile();
    let block = |axis: usize| (u32::from(tile.start[axis]), u32::from(tile.end[axis]));
    if (0..2).any(|axis| block(axis).0 >= block(axis).1 || block(axis).1 > intervals) {
        return Err(TileFault::Block);
    }
    let levels = world.levels();
    if tile.elevation_level >= levels || tile.color_level >= levels {
        return Err(TileFault::Level);
    }
    let drawn = DrawnBlock {
        node: tile.node(),
        levels: [tile.elevation_level, tile.color_level],
        origins: [tile.elevation_origin, tile.color_origin],
        posts: [tile.start.map(u32::from), tile.end.map(u32::from)],
    };
    match world.surface().fault_of(&drawn) {
        Some(BlockFault::Origin) => return Err(TileFault::Origin),
        Some(BlockFault::Cover) => return Err(TileFault::Cover),
        None => {}
    }
    if tile.edge_snap.iter().any(|&snap| u32::from(snap) > intervals.ilog2() || snap < tile.grid_snap) {
        return Err(TileFault::Snap);
    }
    let is_between = |post: u16| u32::from(post) & ((1 << tile.grid_snap) - 1) != 0;
    if tile.start.into_iter().chain(tile.end).any(is_between) {
        return Err(TileFault::Block);
    }
    if tile.color_slot >= color_slots {
        return Err(TileFault::ColorSlot);
    }
    Ok(())
}
