//! The ground at a point.

use super::{TileError, TileScratch, TileSource};
use crate::node::NodeId;
use crate::validity::{GROUND_PLANE, MEASURED_PLANE, Validity};
use crate::world::World;

/// The ground at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPoint {
    /// Height, metres; also where there is a hole: that of the surface that has it.
    pub height_m: f64,
    /// Whether it was measured.
    pub validity: Validity,
}

/// The ground at a point in world coordinates: facet-linear on the finest elevation level that is there, as it is drawn close by (cells are
/// split along their SW-NE diagonal). `None` outside the extent. Blocks on storage.
///
/// # Errors
/// [`TileError`] when the tile cannot be had.
pub fn ground_at(
    source: &dyn TileSource,
    world: &World,
    x: f64,
    y: f64,
    scratch: &mut TileScratch,
) -> Result<Option<GroundPoint>, TileError> {
    let [width, height] = world.extent_m();
    if !(x >= 0.0 && y >= 0.0 && x <= width && y <= height) {
        return Ok(None);
    }
    let posts = world.elevation_posts() as usize;
    let mut values = vec![0f32; world.elevation_values()];
    let mut q = world.finest_elevation_level();
    let (m, n) = loop {
        let (side_m, [columns, rows]) = (world.node_side_m(q), world.nodes_at(q));
        let index = |v: f64, count: u32| ((v / side_m) as u32).min(count - 1);
        let (m, n) = (index(x, columns), index(y, rows));
        let Some(node) = NodeId::new(m, n, q) else { return Ok(None) };
        match source.read_elevation(node, &mut values, scratch) {
            Ok(()) => break (m, n),
            // A sparse level that is not there.
            Err(TileError::Missing { .. }) if q < world.complete_level() => q += 1,
            Err(error) => return Err(error),
        }
    };
    let side_m = world.node_side_m(q);
    let cell = |v: f64, index: u32| {
        let at = (v - f64::from(index) * side_m) / world.elevation_spacing_m(q);
        let whole = at.floor().clamp(0.0, (posts - 2) as f64);
        (whole as usize, at - whole)
    };
    let ((column, u), (row, v)) = (cell(x, m), cell(y, n));
    let at = |plane: usize| {
        let plane = &values[plane * posts * posts..];
        let z = |i: usize, j: usize| f64::from(plane[(row + j) * posts + column + i]);
        let (z00, z10, z01, z11) = (z(0, 0), z(1, 0), z(0, 1), z(1, 1));
        if u >= v { z00 + u * (z10 - z00) + v * (z11 - z10) } else { z00 + v * (z01 - z00) + u * (z11 - z01) }
    };
    let validity = match world.has_validity() {
        true => Validity::of_shares(at(GROUND_PLANE), at(MEASURED_PLANE)),
        false => Validity::Measured,
    };
    Ok(Some(GroundPoint { height_m: at(0), validity }))
}

/// Height of the ground at a point: that of [`ground_at`], whether it was measured or not.
///
/// # Errors
/// [`TileError`] when the tile cannot be had.
pub fn ground_height(
    source: &dyn TileSource,
    world: &World,
    x: f64,
    y: f64,
    scratch: &mut TileScratch,
) -> Result<Option<f64>, TileError> {
    Ok(ground_at(source, world, x, y, scratch)?.map(|ground| ground.height_m))
}
