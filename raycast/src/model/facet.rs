//! The two facets of a cell, the same that the mesh draws.

use glam::Vec2;

/// Half of a cell, cut from south west to north east, and the plane through it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Facet {
    /// South west corner of its cell, from the tile's corner, cells.
    pub(crate) corner: Vec2,
    pub(crate) is_south_east: bool,
    /// Metres up per cell east and north.
    pub(crate) slope: Vec2,
    /// Height of its plane above the tile's corner, from wherever the posts' heights count.
    pub(crate) height: f32,
}

impl Facet {
    /// Those of a cell, south eastern half first, given the heights of its corners.
    #[inline(always)]
    pub(crate) fn of_cell(corner: Vec2, [sw, se, nw, ne]: [f32; 4]) -> [Self; 2] {
        [(true, Vec2::new(se - sw, ne - se)), (false, Vec2::new(ne - nw, nw - sw))].map(|(is_south_east, slope)| Self {
            corner,
            is_south_east,
            slope,
            height: sw - slope.dot(corner),
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
