//! A tile of heights as exact rays walk it: the pyramid of maxima, and below it the facets of cells, the same that the mesh
//! draws.

use crate::frame::exit;
use crate::model::{Ground, Tile};
use crate::view::Ray;
use glam::Vec2;

/// Half of a cell, cut from south west to north east, and the plane through it. Heights are from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Facet {
    /// South west corner of its cell, from the tile's corner, cells.
    pub(crate) corner: Vec2,
    pub(crate) is_south_east: bool,
    /// Metres up per cell east and north.
    pub(crate) slope: Vec2,
    /// Height of its plane above the tile's corner.
    pub(crate) height: f32,
}

/// Where a ray meets the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    pub(crate) s: f32,
    pub(crate) facet: Facet,
}

/// A ray lies under the ground when it is lower by so many metres, and by this share of the distance: less is rounding.
pub(crate) const LEAST_BELOW_M: f32 = 1e-3;
pub(crate) const LEAST_BELOW: f32 = 1e-5;

/// How a ray crossed a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Crossing {
    /// It met the ground, or came out of it.
    Hit(Hit),
    /// It left, or reached its limit, at this parameter.
    Left(f32),
}

/// A tile that rays are in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Entered<'a> {
    pub(crate) index: u32,
    pub(crate) tile: &'a Tile,
    pub(crate) heights: &'a [f32],
    pub(crate) maxima: &'a [f32],
    /// Cells per metre.
    pub(crate) per_m: f32,
    /// The eye's place, cells from the tile's corner.
    pub(crate) at_0: Vec2,
    /// The eye, metres above the datum.
    pub(crate) eye_height: f32,
}

/// A ray along a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Along {
    /// Cells per unit of s.
    pub(crate) per_s: Vec2,
    /// Metres up per unit of s.
    pub(crate) rise: f32,
}

impl Facet {
    /// Those of a cell, south eastern half first; heights of its corners from the eye.
    #[inline(always)]
    pub(crate) fn of_cell(corner: Vec2, [sw, se, nw, ne]: [f32; 4]) -> [Self; 2] {
        [(true, Vec2::new(se - sw, ne - se)), (false, Vec2::new(ne - nw, nw - sw))].map(|(is_south_east, slope)| Self {
            corner,
            is_south_east,
            slope,
            height: sw - slope.dot(corner),
        })
    }

    /// Height of a ray over the plane: `s` times the first, plus the second.
    #[inline(always)]
    pub(crate) fn above(&self, along: &Along, at_0: Vec2) -> [f32; 2] {
        [along.rise - self.slope.dot(along.per_s), -(self.height + self.slope.dot(at_0))]
    }

    /// Whether a point, cells from the tile's corner, lies over it.
    #[inline(always)]
    pub(crate) fn holds(&self, at: Vec2) -> bool {
        let by = at - self.corner;
        let [first, second] = if self.is_south_east { [by.y, by.x] } else { [by.x, by.y] };
        0.0 <= first && first <= second && second <= 1.0
    }
}

impl Ground {
    /// Highest post of block `at` of `2^level` cells a side, `level >= 1`.
    #[inline(always)]
    pub(crate) fn block_maximum(tile: &Tile, maxima: &[f32], level: u32, at: [u32; 2]) -> f32 {
        let mut start = 0;
        for finer in 1..level {
            let [columns, rows] = tile.cells.map(|n| n.div_ceil(1 << finer) as usize);
            start += columns * rows;
        }
        let columns = tile.cells[0].div_ceil(1 << level) as usize;
        maxima.get(start + at[1] as usize * columns + at[0] as usize).copied().unwrap_or(f32::INFINITY)
    }
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

    /// The number of a facet among those of the tile: twice that of its south western post ([`crate::exact::projected`]), and which half.
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

    /// Where a ray that is in the air up to `from` meets a facet, when it is over that facet from there on.
    #[inline(always)]
    pub(crate) fn meets(&self, along: &Along, facet: &Facet, from: f32) -> Option<f32> {
        let [per_s, at_eye] = facet.above(along, self.at_0);
        let s = -at_eye / per_s;
        (per_s < 0.0 && s >= from && facet.holds(self.at(along, s)) && facet.holds(self.at(along, from))).then_some(s)
    }

    /// Follows the ray from `from` until it hits, leaves, or is past `until`.
    pub(crate) fn cross(&self, along: &Along, from: f32, until: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(along.per_s, -self.at_0, size - self.at_0).min(until).max(from);
        let most = cells[0].max(cells[1]).next_power_of_two().ilog2();
        let start = self.at(along, from).clamp(Vec2::ZERO, size);
        let per_s_reciprocal = along.per_s.recip();
        let is_east = along.per_s.x > 0.0;
        let is_north = along.per_s.y > 0.0;
        let height = |s: f32| along.rise * s + self.eye_height;
        let mut level = 0;
        let mut at = [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)];
        let mut s = from;
        loop {
            *samples += 1;
            let side = (1u32 << level) as f32;
            let low = Vec2::new(at[0] as f32, at[1] as f32) * side;
            let leave = |axis: usize, is_up: bool| {
                let border = if is_up { low[axis] + side } else { low[axis] };
                if along.per_s[axis] == 0.0 {
                    f32::INFINITY
                } else {
                    (border - self.at_0[axis]) * per_s_reciprocal[axis]
                }
            };
            let leaves = [leave(0, is_east), leave(1, is_north)];
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let lowest = height(s).min(height(out));
            if level == 0 {
                let corners = self.corners(at);
                let highest = corners[0].max(corners[1]).max(corners[2].max(corners[3]));
                if lowest <= highest
                    && let Some(hit) = self.root::<false>(along, corners, low, [s, out])
                {
                    return Crossing::Hit(hit);
                }
            } else if lowest <= Ground::block_maximum(self.tile, self.maxima, level, at) {
                level -= 1;
                let middle = self.at(along, s);
                let half = 0.5 * side;
                for axis in 0..2 {
                    let last = (cells[axis] - 1) >> level;
                    at[axis] = (2 * at[axis] + u32::from(middle[axis] >= low[axis] + half)).min(last);
                }
                continue;
            }
            s = out;
            if s >= end {
                return Crossing::Left(end);
            }
            let axis = usize::from(leaves[1] < leaves[0]);
            let before = at[axis] >> 1;
            if along.per_s[axis] > 0.0 {
                at[axis] += 1;
                if at[axis] > (cells[axis] - 1) >> level {
                    return Crossing::Left(end);
                }
            } else if at[axis] == 0 {
                return Crossing::Left(end);
            } else {
                at[axis] -= 1;
            }
            if at[axis] >> 1 != before && level < most {
                level += 1;
                at = [at[0] >> 1, at[1] >> 1];
            }
        }
    }

    /// Whether a ray lies under the ground at a parameter at which it is over the tile.
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

    /// Follows a ray that is under the ground from `from` until it comes out of it, leaves, or is past `until`.
    pub(crate) fn emerge(&self, along: &Along, from: f32, until: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(along.per_s, -self.at_0, size - self.at_0).min(until).max(from);
        let highest = |from: f32, to: f32| (along.rise * from).max(along.rise * to) + self.eye_height;
        if highest(from, end) < self.tile.lowest_m {
            return Crossing::Left(end);
        }
        let start = self.at(along, from).clamp(Vec2::ZERO, size);
        let mut at = [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)];
        let mut s = from;
        loop {
            *samples += 1;
            let low = Vec2::new(at[0] as f32, at[1] as f32);
            let leaves = [0, 1].map(|axis| match along.per_s[axis] {
                d if d > 0.0 => (low[axis] + 1.0 - self.at_0[axis]) / d,
                d if d < 0.0 => (low[axis] - self.at_0[axis]) / d,
                _ => f32::INFINITY,
            });
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let corners = self.corners(at);
            if highest(s, out) >= corners.into_iter().fold(f32::INFINITY, f32::min)
                && let Some(hit) = self.root::<true>(along, corners, low, [s, out])
            {
                return Crossing::Hit(hit);
            }
            s = out;
            let axis = usize::from(leaves[1] < leaves[0]);
            let next = if along.per_s[axis] > 0.0 { at[axis].checked_add(1) } else { at[axis].checked_sub(1) };
            match next.filter(|next| s < end && *next < cells[axis]) {
                Some(next) => at[axis] = next,
                None => return Crossing::Left(end),
            }
        }
    }

    /// The first parameter from `from` to `to` at which the ray is not above the facets of the cell whose corner is `low`, or with
    /// `IS_BELOW` not under them.
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
        // Where it changes from one half to the other, if it does.
        let change = if across * per_s < 0.0 { from - across / per_s } else { f32::INFINITY };
        let is_south_east_first = across > 0.0 || (across == 0.0 && per_s >= 0.0);
        let order = if is_south_east_first { [0, 1] } else { [1, 0] };
        let mut begin = from;
        for facet in order.map(|n| facets[n]) {
            let end = if begin < change { to.min(change) } else { to };
            let [per_s, at_eye] = facet.above(along, self.at_0);
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
            // An eye at the tile's corner, straight down beside it.
            let [_, above] = facet.above(&Along { per_s: Vec2::ZERO, rise: -1.0 }, at);
            assert!((above + height).abs() < 1e-5, "{above} {height}");
        }
    }
}
