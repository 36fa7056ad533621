//! The height of the ground at a point, linear on facets as everywhere (`terravision_common::surface::facet`).

use super::Ground;
use super::tile::Tile;
use super::tree::Found;

impl Ground {
    /// Height of the surface at a point, linear on facets, metres above the datum; `None` where no tile
    /// is. Lattice units.
    #[must_use]
    pub fn height_at(&self, point: [f64; 2]) -> Option<f32> {
        match self.tree.find(point) {
            Found::Tile(tile) => Some(self.height_in(&self.tiles[tile as usize], point)),
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// Height in a tile; a point outside of its cells is taken to their border.
    pub(super) fn height_in(&self, tile: &Tile, point: [f64; 2]) -> f32 {
        let unit = f64::from(1u32 << tile.log_spacing);
        let place = |axis: usize| {
            let at = (point[axis] - f64::from(tile.origin[axis])) / unit;
            let at = at.clamp(0.0, f64::from(tile.cells[axis]));
            let cell = (at as usize).min(tile.cells[axis] as usize - 1);
            (cell, (at - cell as f64) as f32)
        };
        let ((i, u), (j, v)) = (place(0), place(1));
        let stride = tile.posts()[0];
        let heights = self.heights(tile);
        let z = |i: usize, j: usize| heights[j * stride + i];
        let (sw, ne) = (z(i, j), z(i + 1, j + 1));
        if u >= v {
            let se = z(i + 1, j);
            sw + (se - sw) * u + (ne - se) * v
        } else {
            let nw = z(i, j + 1);
            sw + (nw - sw) * v + (ne - nw) * u
        }
    }
}
