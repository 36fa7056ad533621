//! The height of the ground at a point, linear on facets (`terravision_common::surface::facet`).

use super::Ground;
use super::tile::Tile;
use super::tree::Found;
use terravision_common::surface::facet::facet_linear;
use terravision_common::surface::tile::CellPosition;

impl Ground {
    /// Height of the surface at a point, linear on facets, metres above the datum; `None` where no
    /// tile is. Lattice units.
    #[must_use]
    pub fn height_at(&self, point: [f64; 2]) -> Option<f32> {
        match self.tree.find(point) {
            Found::Tile(tile) => Some(self.height_in(&self.tiles[tile as usize], point)),
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// Height in a tile; a point outside of its cells is moved to their border.
    pub(super) fn height_in(&self, tile: &Tile, point: [f64; 2]) -> f32 {
        let unit = f64::from(1u32 << tile.log_spacing);
        let place = |axis: usize| {
            let at = (point[axis] - f64::from(tile.origin[axis])) / unit;
            CellPosition::within(at, tile.cells[axis])
        };
        let (x, y) = (place(0), place(1));
        let stride = tile.posts()[0];
        let south = y.cell as usize * stride + x.cell as usize;
        let z = self.heights(tile);
        let by = [x.offset as f32, y.offset as f32];
        facet_linear(z[south], z[south + 1], z[south + stride], z[south + stride + 1], by[0], by[1])
    }
}
