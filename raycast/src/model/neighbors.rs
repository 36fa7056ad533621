//! Heights around a tile, taken from its neighbours.

use super::Ground;
use super::tile::Tile;
use super::tree::Found;

impl Ground {
    /// Heights of a tile's posts, and of `radius` more posts on each side, metres above the datum.
    /// The latter come from its neighbours, so that two tiles of a level compute the same along an
    /// edge that they share. Where there is no neighbour, the border is repeated.
    pub(super) fn gather(&self, tile: &Tile, radius: usize, out: &mut Vec<f32>) {
        out.clear();
        let [columns, rows] = tile.posts();
        let heights = self.heights(tile);
        let radius = radius as i64;
        for j in -radius..rows as i64 + radius {
            for i in -radius..columns as i64 + radius {
                let inside = |at: i64, count: usize| at.clamp(0, count as i64 - 1);
                let (x, y) = (inside(i, columns), inside(j, rows));
                let own = heights[y as usize * columns + x as usize];
                let neighbor = |post| self.neighbor_height(tile, post);
                out.push(match (x, y) == (i, j) {
                    true => own,
                    // Past the corner of two tiles at the border of all ground, the border is
                    // repeated as well.
                    false => neighbor([i, j]).or_else(|| neighbor([i, y])).or_else(|| neighbor([x, j])).unwrap_or(own),
                });
            }
        }
    }

    /// Height of a post outside of a tile, given by its column and row in it.
    fn neighbor_height(&self, tile: &Tile, post: [i64; 2]) -> Option<f32> {
        let unit = 1i64 << tile.log_spacing;
        let point = [0, 1].map(|axis| (i64::from(tile.origin[axis]) + post[axis] * unit) as f64);
        // A post on the border of two tiles belongs to both; the tile nearer to this one always has
        // it.
        let nudge = [0, 1].map(|axis| if post[axis] > 0 { point[axis] - 0.5 } else { point[axis] });
        match self.tree.find(nudge) {
            Found::Tile(neighbor) => {
                let neighbor = &self.tiles[neighbor as usize];
                neighbor.holds(point).then(|| self.height_in(neighbor, point))
            }
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// Heights of a post on a tile's border: its own, and the height there of the coarser tile that
    /// lies half a lattice unit further out.
    pub(super) fn heights_at_border(&self, tile: &Tile, post: [u32; 2], out: [f64; 2]) -> Option<[f32; 2]> {
        let point = [0, 1].map(|axis| f64::from(tile.origin[axis] + (post[axis] << tile.log_spacing)));
        // A post at the end of the side belongs to the tile beside this one.
        let inward = [0, 1].map(|axis| if post[axis] == tile.cells[axis] { -0.5 } else { 0.5 });
        let outside = [0, 1].map(|axis| point[axis] + if out[axis] == 0.0 { inward[axis] } else { out[axis] });
        let Found::Tile(other) = self.tree.find(outside) else { return None };
        let other = &self.tiles[other as usize];
        if other.log_spacing <= tile.log_spacing {
            return None;
        }
        let own = self.heights(tile)[post[1] as usize * tile.posts()[0] + post[0] as usize];
        Some([own, self.height_in(other, point)])
    }
}
