//! The facet: half of a cell, over which elevation is linear, as in the drawn mesh.
//!
//! Each cell of the lattice of a level is split along its diagonal from south west to north east.
//! So the surface of a level is the same set of facets whether it is drawn from its own posts or,
//! after a split, from posts twice as dense: nothing pops. (`renderer/shaders/surface.wgsl` has the
//! same for graphics devices.)
//!
//! ```text
//!   z01 ----- z11       u, v in [0, 1], east and north
//!    | v>u  /  |
//!    |    /    |        u >= v:  z00 + u(z10 − z00) + v(z11 − z10)
//!    |  /  u>v |        else:    z00 + v(z01 − z00) + u(z11 − z01)
//!   z00 ----- z10
//! ```
//!
//! Posts are multiples of 1/128 m below 65 km, and u, v are multiples of 2^-24 at worst: every step
//! is exact in double precision, so any order of evaluation, from any leaf, gives the same bits.

use crate::simd::Simd;
use std::ops::{Add, Mul, Sub};

/// The number type of heights: single or double precision.
pub trait Height: Copy + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {}

impl Height for f32 {}
impl Height for f64 {}

/// Elevation inside one cell.
#[inline(always)]
#[must_use]
pub fn facet_linear<H: Height>(z00: H, z10: H, z01: H, z11: H, u: H, v: H) -> H {
    if is_south_east(u, v) { z00 + u * (z10 - z00) + v * (z11 - z10) } else { z00 + v * (z01 - z00) + u * (z11 - z01) }
}

/// The same in each lane. Corners: south west, south east, north west, north east.
#[inline(always)]
#[must_use]
pub fn facet_linear_of_lanes<S: Simd>(simd: S, [sw, se, nw, ne]: [S::Floats; 4], [u, v]: [S::Floats; 2]) -> S::Floats {
    let is_south_east = simd.at_most(v, u);
    let per_east = simd.select(is_south_east, se - sw, ne - nw);
    let per_north = simd.select(is_south_east, ne - se, nw - sw);
    sw + u * per_east + v * per_north
}

/// Whether a point of a cell is on its south eastern half.
#[inline(always)]
#[must_use]
pub fn is_south_east<H: Height>(u: H, v: H) -> bool {
    u >= v
}

/// The corners of the two facets of a cell, south eastern half first, each counter-clockwise seen
/// from above. Corners: 0 south west, 1 south east, 2 north west, 3 north east.
pub const FACET_CORNERS: [[usize; 3]; 2] = [[0, 1, 3], [0, 3, 2]];

/// Rise per cell east and north, on the south eastern half of a cell or on the other half. Corners:
/// south west, south east, north west, north east.
#[inline(always)]
#[must_use]
pub fn facet_slope<H: Height>([sw, se, nw, ne]: [H; 4], is_south_east: bool) -> [H; 2] {
    if is_south_east { [se - sw, ne - se] } else { [ne - nw, nw - sw] }
}

/// Bilinear elevation inside one cell: what programs make of the same posts that know no facets.
/// Corners: south west, south east, north west, north east.
#[inline(always)]
#[must_use]
pub fn bilinear<H: Height>([sw, se, nw, ne]: [H; 4], u: H, v: H) -> H {
    let (south, north) = (sw + u * (se - sw), nw + u * (ne - nw));
    south + v * (north - south)
}

/// Rise per cell east and north of [`bilinear`] elevation, at a point.
#[inline(always)]
#[must_use]
pub fn bilinear_slope<H: Height>([sw, se, nw, ne]: [H; 4], u: H, v: H) -> [H; 2] {
    let ([south, north], [west, east]) = ([se - sw, ne - nw], [nw - sw, ne - se]);
    [south + v * (north - south), west + u * (east - west)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_posts_at_the_corners_and_linear_along_edges_and_the_diagonal() {
        let f = |u, v| facet_linear(1.0, 2.0, 4.0, 8.0, u, v);
        assert_eq!([f(0.0, 0.0), f(1.0, 0.0), f(0.0, 1.0), f(1.0, 1.0)], [1.0, 2.0, 4.0, 8.0]);
        assert_eq!([f(0.5, 0.0), f(0.0, 0.5), f(1.0, 0.5), f(0.5, 1.0)], [1.5, 2.5, 5.0, 6.0]);
        assert_eq!([f(0.25, 0.25), f(0.5, 0.5)], [2.75, 4.5]);
    }

    #[test]
    fn bilinear_elevation_is_linear_along_edges_and_has_its_slope() {
        let corners = [1.0, 2.0, 4.0, 8.0];
        let f = |u, v| bilinear(corners, u, v);
        assert_eq!([f(0.0, 0.0), f(1.0, 0.0), f(0.0, 1.0), f(1.0, 1.0)], corners);
        assert_eq!([f(0.5, 0.0), f(0.0, 0.5), f(0.5, 0.5)], [1.5, 2.5, 3.75]);
        let [east, north] = bilinear_slope(corners, 0.25, 0.5);
        assert_eq!([f(0.5, 0.5) - f(0.0, 0.5), f(0.25, 0.75) - f(0.25, 0.25)], [0.5 * east, 0.5 * north]);
    }

    #[test]
    fn slopes_are_those_of_the_formula() {
        let corners = [1.0f32, 2.0, 4.0, 8.0];
        for (u, v) in [(0.75f32, 0.25f32), (0.25, 0.75)] {
            let f = |u: f32, v: f32| facet_linear(corners[0], corners[1], corners[2], corners[3], u, v);
            let [east, north] = facet_slope(corners, is_south_east(u, v));
            assert_eq!((f(u + 0.125, v) - f(u, v), f(u, v + 0.125) - f(u, v)), (0.125 * east, 0.125 * north));
        }
    }
}
