//! Walls between tiles: where a tile's border does not lie on that of a neighbour with fewer posts.

use super::Ground;
use super::steep::{CellSlopes, Steep};
use super::tile::Tile;

/// The smallest step between two tiles that counts as a wall, in voxels of the finer tile. Nearly
/// every edge between two levels has a step; to treat all of them as walls would double the cost of
/// rays, for the sake of less than a pixel per line.
const LEAST_WALL: f32 = 0.5;

impl Ground {
    /// Stores the walls around a tile. Only for voxels: exact rays hit facets, which form no walls.
    pub(super) fn push_border_walls(&mut self, tile: &Tile) {
        let first = self.steep.len();
        let [columns, rows] = tile.cells;
        // For each side its first post, the axis along it, how many cells it has, and the outward
        // direction.
        let sides = [
            ([0, 0], 0, columns, [0.0, -0.5]),
            ([0, rows], 0, columns, [0.0, 0.5]),
            ([0, 0], 1, rows, [-0.5, 0.0]),
            ([columns, 0], 1, rows, [0.5, 0.0]),
        ];
        for (start, axis, count, out) in sides {
            for step in 0..=count {
                let mut post: [u32; 2] = start;
                post[axis] += step;
                let Some([own, other]) = self.heights_at_border(tile, post, out) else { continue };
                if (own - other).abs() <= LEAST_WALL * tile.spacing_m {
                    continue;
                }
                let top_m = own.max(other) + tile.spacing_m;
                let steep = Steep { slopes: CellSlopes::WALL, top_m };
                // The cells on both sides of the post.
                for before in [1, 0] {
                    let mut cell = post;
                    cell[axis] = cell[axis].saturating_sub(before);
                    let cell = [cell[0].min(columns - 1), cell[1].min(rows - 1)];
                    self.note_steep(tile, first, cell.map(|n| n as usize), steep);
                }
            }
        }
    }
}
