//! The tile of heights that an exact ray is in, and the intersections with its facets.

use crate::model::Tile;
use crate::model::facet::Facet;
use crate::view::Ray;
use glam::Vec2;

/// Where a ray meets the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    pub(crate) s: f32,
    pub(crate) facet: Facet,
}

/// A ray is below the ground when it is lower by this many metres plus this share of the distance;
/// less is rounding. Parameters and heights have 24 bits, so that the error is a ten-millionth of
/// the distance times the slope of the ground; a hundred times that is allowed for.
pub(crate) const LEAST_BELOW_M: f32 = 1e-3;
pub(crate) const LEAST_BELOW: f32 = 1e-5;

/// The tile that a ray is in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Entered<'a> {
    pub(crate) index: u32,
    pub(crate) tile: &'a Tile,
    pub(crate) heights: &'a [f32],
    pub(crate) maxima: &'a [f32],
    /// Cells per metre.
    pub(crate) per_m: f32,
    /// The eye's position, cells from the tile's corner.
    pub(crate) at_0: Vec2,
    /// The eye, metres above the datum.
    pub(crate) eye_height: f32,
}

/// A ray in the units of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Along {
    /// Cells per unit of s.
    pub(crate) per_s: Vec2,
    /// Metres up per unit of s.
    pub(crate) rise: f32,
}

/// Height of a ray over the plane: `s` times the first, plus the second.
#[inline(always)]
pub(super) fn above(facet: &Facet, along: &Along, at_0: Vec2) -> [f32; 2] {
    [along.rise - facet.slope.dot(along.per_s), -(facet.height + facet.slope.dot(at_0))]
}

impl Entered<'_> {
    #[inline(always)]
    pub(crate) fn along(&self, ray: &Ray) -> Along {
        Along { per_s: ray.direction.truncate() * self.per_m, rise: ray.direction.z }
    }

    #[inline(always)]
    pub(crate) fn at(&self, along: &Along, s: f32) -> Vec2 {
        along.per_s * s + self.at_0
    }

    /// Posts of a cell: south west, south east, north west, north east.
    #[inline(always)]
    pub(crate) fn corners(&self, [i, j]: [u32; 2]) -> [f32; 4] {
        let columns = self.tile.cells[0] as usize + 1;
        let south = j as usize * columns + i as usize;
        let north = south + columns;
        match (self.heights.get(south..south + 2), self.heights.get(north..north + 2)) {
            (Some(&[sw, se]), Some(&[nw, ne])) => [sw, se, nw, ne],
            _ => [f32::NEG_INFINITY; 4],
        }
    }

    /// The number of a facet within the tile: twice the number of its south western post
    /// ([`crate::exact::projected`]), plus which half it is.
    #[inline(always)]
    pub(crate) fn facet_number(&self, facet: &Facet) -> usize {
        let [i, j] = [facet.corner.x as usize + 1, facet.corner.y as usize + 1];
        2 * (j * (self.tile.cells[0] as usize + 3) + i) + usize::from(facet.is_south_east)
    }

    /// Whether a ray is over the tile at a parameter.
    #[inline(always)]
    pub(crate) fn is_under(&self, along: &Along, s: f32) -> bool {
        let at = self.at(along, s);
        let [columns, rows] = self.tile.cells;
        at.x >= 0.0 && at.y >= 0.0 && at.x < columns as f32 && at.y < rows as f32
    }

    /// Where a ray that is in the air up to `from` hits a facet that it is over from there on.
    #[inline(always)]
    pub(crate) fn meets(&self, along: &Along, facet: &Facet, from: f32) -> Option<f32> {
        let [per_s, at_eye] = above(facet, along, self.at_0);
        let s = -at_eye / per_s;
        (per_s < 0.0 && s >= from && facet.holds(self.at(along, s)) && facet.holds(self.at(along, from))).then_some(s)
    }

    /// Whether a ray is below the ground at a parameter at which it is over the tile.
    pub(crate) fn is_below(&self, along: &Along, s: f32) -> bool {
        let [columns, rows] = self.tile.cells;
        let at = self.at(along, s).clamp(Vec2::ZERO, Vec2::new(columns as f32, rows as f32));
        let cell = [(at.x as u32).min(columns - 1), (at.y as u32).min(rows - 1)];
        let low = Vec2::new(cell[0] as f32, cell[1] as f32);
        let facets = Facet::of_cell(low, self.corners(cell).map(|height| height - self.eye_height));
        let by = at - low;
        let facet = &facets[usize::from(by.x < by.y)];
        along.rise * s < facet.height + facet.slope.dot(at) - LEAST_BELOW * s - LEAST_BELOW_M
    }

    /// The first parameter from `from` to `to` at which the ray is not above the facets of the cell
    /// whose corner is `low`; with `IS_BELOW`, at which it is not below them.
    #[inline(always)]
    pub(crate) fn root<const IS_BELOW: bool>(
        &self,
        along: &Along,
        corners: [f32; 4],
        low: Vec2,
        [from, to]: [f32; 2],
    ) -> Option<Hit> {
        let is_met = |above: f32| if IS_BELOW { above >= 0.0 } else { above <= 0.0 };
        let facets = Facet::of_cell(low, corners.map(|height| height - self.eye_height));
        let place = self.at(along, from) - low;
        let (across, per_s) = (place.x - place.y, along.per_s.x - along.per_s.y);
        // Where it crosses the diagonal, if it does.
        let change = if across * per_s < 0.0 { from - across / per_s } else { f32::INFINITY };
        let is_south_east_first = across > 0.0 || (across == 0.0 && per_s >= 0.0);
        let order = if is_south_east_first { [0, 1] } else { [1, 0] };
        let mut begin = from;
        for facet in order.map(|n| facets[n]) {
            let end = if begin < change { to.min(change) } else { to };
            let [per_s, at_eye] = above(&facet, along, self.at_0);
            if is_met(per_s * begin + at_eye) {
                return Some(Hit { s: begin, facet });
            }
            if is_met(per_s * end + at_eye) {
                return Some(Hit { s: (-at_eye / per_s).clamp(begin, end), facet });
            }
            if change >= to {
                return None;
            }
            begin = change;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_meets_the_first_of_the_two_facets_that_it_reaches() {
        let tile_heights = [0.0f32, 0.0, 0.0, 10.0];
        let [south_east, north_west] = Facet::of_cell(Vec2::new(3.0, 5.0), tile_heights);
        for (u, v, height) in [(0.5, 0.25, 2.5), (0.25, 0.5, 2.5), (1.0, 1.0, 10.0), (0.7, 0.0, 0.0)] {
            let at = Vec2::new(3.0 + u, 5.0 + v);
            let facet = if u >= v { south_east } else { north_west };
            assert!(facet.holds(at), "{at}");
            // An eye at the tile's corner, looking straight down beside it.
            let [_, height_above] = above(&facet, &Along { per_s: Vec2::ZERO, rise: -1.0 }, at);
            assert!((height_above + height).abs() < 1e-5, "{height_above} {height}");
        }
    }
}
