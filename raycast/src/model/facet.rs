//! The two facets of a cell, the same that the mesh draws.

use glam::Vec2;
use terravision_common::surface::facet::facet_slope;

/// Half of a cell, cut from south west to north east, and the plane through it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Facet {
    /// South west corner of its cell, from the tile's corner, cells.
    pub(crate) corner: Vec2,
    pub(crate) is_south_east: bool,
    /// Metres up per cell east and north.
    pub(crate) slope: Vec2,
    /// Height of its plane at the tile's corner, above the datum of the posts' heights.
    pub(crate) height: f32,
}

impl Facet {
    /// The two facets of a cell, south eastern half first, given the heights of its corners.
    #[inline(always)]
    pub(crate) fn of_cell(corner: Vec2, corners: [f32; 4]) -> [Self; 2] {
        [true, false].map(|is_south_east| {
            let slope = Vec2::from_array(facet_slope(corners, is_south_east));
            Self { corner, is_south_east, slope, height: corners[0] - slope.dot(corner) }
        })
    }

    /// Whether a point, cells from the tile's corner, lies over it.
    #[inline(always)]
    pub(crate) fn holds(&self, at: Vec2) -> bool {
        let by = at - self.corner;
        let [first, second] = if self.is_south_east { [by.y, by.x] } else { [by.x, by.y] };
        0.0 <= first && first <= second && second <= 1.0
    }
}
