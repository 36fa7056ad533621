//! Facet-linear interpolation: elevation between the posts of a tile, as the mesh is drawn.
//!
//! Each cell of the lattice of a level is split along its diagonal from south west to north east, and elevation is
//! linear over each half. So the surface of a level is the same set of facets whether it is drawn from its own posts
//! or, after a split, from posts twice as dense: nothing pops.
//!
//! ```text
//!   z01 ----- z11       u, v in [0, 1], east and north
//!    | v>u  /  |
//!    |    /    |        u >= v:  z00 + u(z10 − z00) + v(z11 − z10)
//!    |  /  u>v |        else:    z00 + v(z01 − z00) + u(z11 − z01)
//!   z00 ----- z10
//! ```
//!
//! Posts are multiples of 1/128 m below 65 km, and u, v are multiples of 2^-24 at worst: every step is exact in double
//! precision, so any order of evaluation, from any leaf, gives the same bits.

use crate::node::NodeId;
use crate::world::World;

/// Elevation inside one cell.
#[inline(always)]
#[must_use]
pub fn facet_linear(z00: f64, z10: f64, z01: f64, z11: f64, u: f64, v: f64) -> f64 {
    if u >= v { z00 + u * (z10 - z00) + v * (z11 - z10) } else { z00 + v * (z01 - z00) + u * (z11 - z01) }
}

/// Where one coordinate of a lattice point falls in a tile: the cell, and the offset within it in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CellPosition {
    /// Index of the cell, 0 to Nz − 1.
    pub cell: u32,
    /// Offset within the cell, 0 to 1.
    pub offset: f64,
}

impl CellPosition {
    /// Position of lattice coordinate `at` in a tile that begins at `origin` and has `cells` cells of `1 << level`
    /// lattice units. A coordinate outside of the tile is taken to its border; the last post belongs to the last cell.
    #[inline]
    #[must_use]
    pub fn new(at: u64, origin: u64, level: u8, cells: u32) -> CellPosition {
        let inside = at.saturating_sub(origin).min(u64::from(cells) << level);
        let cell = ((inside >> level) as u32).min(cells - 1);
        let rest = inside - (u64::from(cell) << level);
        CellPosition { cell, offset: rest as f64 / (1u64 << level) as f64 }
    }
}

/// Elevation of a tile at a position; `posts` has `(cells + 1)²` values, row 0 the southern one.
#[inline]
#[must_use]
pub fn tile_elevation(posts: &[f32], cells: u32, x: CellPosition, y: CellPosition) -> f64 {
    let stride = cells as usize + 1;
    let south = y.cell as usize * stride + x.cell as usize;
    let z = |index: usize| f64::from(posts[index]);
    facet_linear(z(south), z(south + 1), z(south + stride), z(south + stride + 1), x.offset, y.offset)
}

/// Elevation of the tile of `node` at lattice point `(x, y)`, metres. `posts` are the tile's, `(Nz + 1)²`, row 0 the
/// southern one. A point outside of the node is taken to its border.
#[must_use]
pub fn node_elevation(world: &World, node: NodeId, posts: &[f32], x: u64, y: u64) -> f64 {
    let cells = world.elevation_tile();
    let [x0, y0] = world.node_origin(node);
    let (x, y) = (CellPosition::new(x, x0, node.q(), cells), CellPosition::new(y, y0, node.q(), cells));
    tile_elevation(posts, cells, x, y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn it_is_the_posts_at_the_corners_and_linear_along_edges_and_the_diagonal() {
        let f = |u, v| facet_linear(1.0, 2.0, 4.0, 8.0, u, v);
        assert_eq!([f(0.0, 0.0), f(1.0, 0.0), f(0.0, 1.0), f(1.0, 1.0)], [1.0, 2.0, 4.0, 8.0]);
        assert_eq!([f(0.5, 0.0), f(0.0, 0.5), f(1.0, 0.5), f(0.5, 1.0)], [1.5, 2.5, 5.0, 6.0]);
        assert_eq!([f(0.25, 0.25), f(0.5, 0.5)], [2.75, 4.5]);
    }

    #[test]
    fn the_last_post_is_the_end_of_the_last_cell() {
        assert_eq!(CellPosition::new(164, 100, 4, 4), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(CellPosition::new(116, 100, 4, 4), CellPosition { cell: 1, offset: 0.0 });
        assert_eq!(CellPosition::new(999, 100, 4, 4), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(CellPosition::new(7, 100, 4, 4), CellPosition { cell: 0, offset: 0.0 });
    }

    proptest! {
        /// Splitting a facet at the next finer lattice changes nothing: interpolating the interpolated posts gives
        /// the same bits.
        #[test]
        fn a_finer_lattice_draws_the_same_surface(
            posts in prop::collection::vec(-8_000_000i32..8_000_000, 25),
            x in 0u64..=64, y in 0u64..=64,
        ) {
            let posts: Vec<f32> = posts.iter().map(|&p| p as f32 / 128.0).collect();
            let at = |x: u64, y: u64| tile_elevation(&posts, 4, CellPosition::new(x, 0, 4, 4), CellPosition::new(y, 0, 4, 4));
            let finer: Vec<f64> = (0..81).map(|i| at(i % 9 * 8, i / 9 * 8)).collect();
            let (fx, fy) = (CellPosition::new(x, 0, 3, 8), CellPosition::new(y, 0, 3, 8));
            let z = |i: u32, j: u32| finer[((fy.cell + j) * 9 + fx.cell + i) as usize];
            let twice = facet_linear(z(0, 0), z(1, 0), z(0, 1), z(1, 1), fx.offset, fy.offset);
            prop_assert_eq!(at(x, y).to_bits(), twice.to_bits());
        }
    }
}
