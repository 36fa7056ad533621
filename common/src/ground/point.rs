//! The ground at a point, for programs that ask once.

use crate::database::{TileError, TileScratch, TileSource};
use crate::surface::tile::{GroundPoint, node_ground};
use crate::world::World;
use glam::DVec2;

/// The ground at a point in world coordinates: facet-linear on the finest elevation level that
/// exists there, as it is drawn at close range (cells are split along their SW-NE diagonal). `None`
/// outside the extent. Blocks on storage.
///
/// # Errors
/// [`TileError`] when the tile cannot be read.
pub fn ground_at(
    source: &dyn TileSource,
    world: &World,
    x: f64,
    y: f64,
    scratch: &mut TileScratch,
) -> Result<Option<GroundPoint>, TileError> {
    let (surface, foot) = (world.surface(), DVec2::new(x, y));
    if !surface.holds(foot) {
        return Ok(None);
    }
    let mut values = vec![0f32; world.elevation_values()];
    let mut q = world.finest_elevation_level();
    loop {
        let Some(node) = surface.node_at(foot, q) else { return Ok(None) };
        match source.read_elevation(node, &mut values, scratch) {
            Ok(()) => return Ok(Some(node_ground(surface, node, &values, foot))),
            // A sparse level without a tile here.
            Err(TileError::Missing { .. }) if q < world.complete_level() => q += 1,
            Err(error) => return Err(error),
        }
    }
}

/// Height of the ground at a point, as [`ground_at`], whether it was measured or not.
///
/// # Errors
/// [`TileError`] when the tile cannot be read.
pub fn ground_height(
    source: &dyn TileSource,
    world: &World,
    x: f64,
    y: f64,
    scratch: &mut TileScratch,
) -> Result<Option<f64>, TileError> {
    Ok(ground_at(source, world, x, y, scratch)?.map(|ground| ground.height_m))
}
