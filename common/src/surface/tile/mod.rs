//! Elevation between the posts of a tile: the height at a point of the lattice or of the plane.
//!
//! Tiles and elevation arrays have `(cells + 1)²` numbers, row 0 the southern one.

use super::facet::{bilinear, bilinear_slope, facet_linear, facet_slope, is_south_east};
use super::{LatticePoint, Surface};
use crate::node::NodeId;
use crate::validity::{GROUND_PLANE, MEASURED_PLANE, PLANES, Validity};
use glam::DVec2;

mod sampler;

pub use sampler::TileSampler;

/// The position of one coordinate in a tile: the cell, and the offset within it in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CellPosition {
    /// Index of the cell, 0 to Nz − 1.
    pub cell: u32,
    /// Offset within the cell, 0 to 1.
    pub offset: f64,
}

impl CellPosition {
    /// Position of a coordinate given in cells from the tile's corner, clamped in the same way.
    #[inline]
    #[must_use]
    pub fn within(at: f64, cells: u32) -> CellPosition {
        let at = at.clamp(0.0, f64::from(cells));
        let cell = (at as u32).min(cells - 1);
        CellPosition { cell, offset: at - f64::from(cell) }
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

/// Elevation of the tile of `node` at a lattice point, metres. `posts` are the tile's, `(Nz + 1)²`,
/// row 0 the southern one. A point outside of the node is taken to its border.
#[inline]
#[must_use]
pub fn node_elevation(surface: &Surface, node: NodeId, posts: &[f32], point: LatticePoint) -> f64 {
    let [columns, rows] = surface.post_lines(node);
    let y = rows.position(point.y);
    if surface.joined_rows(node).contains(&Some(point.y)) {
        return joined_elevation(posts, surface.cells(), columns.every_second().position(point.x), y);
    }
    tile_elevation(posts, surface.cells(), columns.position(point.x), y)
}

/// Elevation on an edge of a tile on which every second post counts: `x` is a position among these.
#[inline]
#[must_use]
pub fn joined_elevation(posts: &[f32], cells: u32, x: CellPosition, y: CellPosition) -> f64 {
    let row = (y.cell as usize + usize::from(y.offset > 0.5)) * (cells as usize + 1);
    let [a, b] = [0, 2].map(|beside| f64::from(posts[row + 2 * x.cell as usize + beside]));
    a + x.offset * (b - a)
}

/// The ground at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundPoint {
    /// Height, metres; in a hole, the height of the surface that contains it.
    pub height_m: f64,
    /// Whether it was measured.
    pub validity: Validity,
}

/// The ground at a foot in the tile of `node`, which has these `values`: heights, and behind them
/// the planes of validity of a world that has them. A foot outside of the node is taken to its
/// border.
#[must_use]
pub fn node_ground(surface: &Surface, node: NodeId, values: &[f32], foot: DVec2) -> GroundPoint {
    node_ground_with_slope(surface, node, values, foot, Interpolation::Facet).ground
}

/// How heights between posts are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Linear on facets: the ground as it is drawn, and as everything that is drawn with it needs
    /// it.
    #[default]
    Facet,
    /// Bilinear in cells, as in most programs that read rasters.
    Bilinear,
}

/// The ground at a point, and how it rises there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SlopedGround {
    /// The ground.
    pub ground: GroundPoint,
    /// Rise over a cell of the tile, metres: east and north.
    pub slope: [f64; 2],
}

/// [`node_ground`] with its slope, by either interpolation. Validity is linear on facets in both.
#[inline]
#[must_use]
pub fn node_ground_with_slope(
    surface: &Surface,
    node: NodeId,
    values: &[f32],
    foot: DVec2,
    interpolation: Interpolation,
) -> SlopedGround {
    let cells = surface.cells();
    let stride = cells as usize + 1;
    let place = surface.place_in_node(foot, node);
    let [x, y] = [place.x, place.y].map(|at| CellPosition::within(at, cells));
    let (south, plane) = (y.cell as usize * stride + x.cell as usize, stride * stride);
    let z = |index: usize| f64::from(values[index]);
    let corners = [z(south), z(south + 1), z(south + stride), z(south + stride + 1)];
    let (u, v) = (x.offset, y.offset);
    let (height_m, slope) = match interpolation {
        Interpolation::Facet => {
            let [sw, se, nw, ne] = corners;
            (facet_linear(sw, se, nw, ne, u, v), facet_slope(corners, is_south_east(u, v)))
        }
        Interpolation::Bilinear => (bilinear(corners, u, v), bilinear_slope(corners, u, v)),
    };
    let share = |index: usize| tile_elevation(&values[index * plane..], cells, x, y);
    let validity = match values.len() >= PLANES * plane {
        true => Validity::of_shares(share(GROUND_PLANE), share(MEASURED_PLANE)),
        false => Validity::Measured,
    };
    SlopedGround { ground: GroundPoint { height_m, validity }, slope }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::PostLine;
    use proptest::prelude::*;

    #[test]
    fn the_last_post_is_the_end_of_the_last_cell() {
        let line = PostLine::even(100, 4, 4);
        assert_eq!(line.position(164), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(line.position(116), CellPosition { cell: 1, offset: 0.0 });
        assert_eq!(line.position(999), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(line.position(7), CellPosition { cell: 0, offset: 0.0 });
        // Ground that ends within a cell, at either end: the post beyond is there.
        let line = PostLine::new(-20, 4, 4, [0, 30]);
        assert_eq!([0, 1, 2, 3, 4].map(|index| line.post(index)), [0, 0, 12, 28, 30]);
        assert_eq!(line.position(0), CellPosition { cell: 1, offset: 0.0 });
        assert_eq!(line.position(6), CellPosition { cell: 1, offset: 0.5 });
        assert_eq!(line.position(29), CellPosition { cell: 3, offset: 0.5 });
        assert_eq!(line.position(30), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!([0.0, 6.0, 20.0, 29.0].map(|at| line.place(at)), [1.0, 1.5, 2.5, 3.5]);
    }

    #[test]
    fn a_place_in_cells_is_taken_to_the_border_likewise() {
        assert_eq!(CellPosition::within(4.0, 4), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(CellPosition::within(9.5, 4), CellPosition { cell: 3, offset: 1.0 });
        assert_eq!(CellPosition::within(-0.5, 4), CellPosition { cell: 0, offset: 0.0 });
        assert_eq!(CellPosition::within(1.25, 4), CellPosition { cell: 1, offset: 0.25 });
    }

    proptest! {
        /// Splitting a facet at the next finer lattice changes nothing: interpolating the
        /// interpolated posts gives the same bits.
        #[test]
        fn a_finer_lattice_draws_the_same_surface(
            posts in prop::collection::vec(-8_000_000i32..8_000_000, 25),
            x in 0u64..=64, y in 0u64..=64,
        ) {
            let posts: Vec<f32> = posts.iter().map(|&p| p as f32 / 128.0).collect();
            let line = PostLine::even(0, 4, 4);
            let at = |x: u64, y: u64| tile_elevation(&posts, 4, line.position(x), line.position(y));
            let finer: Vec<f64> = (0..81).map(|i| at(i % 9 * 8, i / 9 * 8)).collect();
            let line = PostLine::even(0, 3, 8);
            let (fx, fy) = (line.position(x), line.position(y));
            let z = |i: u32, j: u32| finer[((fy.cell + j) * 9 + fx.cell + i) as usize];
            let twice = facet_linear(z(0, 0), z(1, 0), z(0, 1), z(1, 1), fx.offset, fy.offset);
            prop_assert_eq!(at(x, y).to_bits(), twice.to_bits());
        }
    }
}
