//! Whether the numbers of a tile are those of a tile.

use super::TileFault;
use terravision_common::slot::{ElevationTile, TileSlot};
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
    let is_node = |origin: [u32; 2], level: u8| {
        let side = world.node_side(level);
        (0..2).all(|axis| u64::from(origin[axis]).is_multiple_of(side) && origin[axis] < world.extent()[axis])
    };
    if !is_node(tile.elevation_origin, tile.elevation_level) || !is_node(tile.color_origin, tile.color_level) {
        return Err(TileFault::Origin);
    }
    let is_covered = |axis: usize| {
        let at = |post: u32| u64::from(tile.elevation_origin[axis]) + (u64::from(post) << tile.elevation_level);
        let first = u64::from(tile.color_origin[axis]);
        first <= at(block(axis).0) && at(block(axis).1) <= first + world.node_side(tile.color_level)
    };
    if !is_covered(0) || !is_covered(1) {
        return Err(TileFault::Cover);
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
