//! Stretches of ground between two steps, from the planes to rows of the picture.

use super::edges::BEHIND;
use super::strip::{Rows, Strip};
use super::trace::{Crest, NO_ROW, NO_SLOPE, Points, State, Tracer};
use terravision_common::simd::{LANES, Simd, Sixteen};

/// Rows between two points are at least this, when one is divided by them.
pub(super) const LEAST_ROWS: f32 = 1e-6;
/// A point that is this many pixels above or below the picture's middle is beside the camera, or
/// behind it.
const FURTHEST_PX: f32 = 1e5;
/// Stretches are cut off at this share of the depth of the end that is before the camera.
const LEAST_DEPTH: f32 = 1e-3;

/// Straight ground between two steps, in the picture: rows of its ends, and one over their depth.
#[derive(Clone, Copy)]
pub(super) struct Stretch<S: Simd> {
    pub(super) row_before: S::Floats,
    seen_before: S::Floats,
    pub(super) row: S::Floats,
    seen: S::Floats,
}

/// A point in the picture: its row, one over its depth, and whether it lies beside or behind the
/// camera.
pub(super) struct Place<S: Simd> {
    pub(super) row: S::Floats,
    seen: S::Floats,
    is_far: S::Mask,
}

impl<S: Simd> Tracer<'_, S> {
    /// Fills the rows that planes see between their last points and these. `seen`: which of these
    /// points are.
    #[inline(always)]
    pub(super) fn fill<const IS_UP: bool>(
        &self,
        state: &mut State<S>,
        points: &Points<S>,
        seen: S::Mask,
        strip: &mut Strip,
        first: usize,
    ) {
        let simd = self.simd;
        let last = &state.last;
        // Behind a gap the ground begins with a wall.
        let is_gap = simd.at_most(last.slope, simd.floats(NO_SLOPE));
        let before = Points {
            slope: simd.select(is_gap, state.horizon, last.slope),
            rise: last.rise,
            nearness: simd.select(is_gap, points.nearness, last.nearness),
        };
        let stretch = self.stretch(&before, points, seen);
        let [base, per_row] = self.straight::<IS_UP>(&stretch);
        let end = self.row_behind(stretch.row);
        let [from, to] = if IS_UP { [state.next, end] } else { [end, state.next] };
        let filled = seen & simd.less(from, to);
        if IS_UP && self.finds_edges {
            self.find_edges(state, &stretch, [base, per_row], [seen, filled], strip, first);
        }
        if simd.any(filled) {
            // Of planes that see nothing there are no rows.
            let low = simd.select(filled, from, simd.floats(f32::INFINITY));
            let high = simd.select(filled, to, simd.floats(f32::NEG_INFINITY));
            let rows = Rows { low, high, base, per_row };
            strip.fill(simd, first, &rows);
            if simd.any(is_gap) {
                strip.put_gap(simd, &rows, is_gap);
            }
            state.next = simd.select(filled, end, state.next);
        }
        state.horizon = simd.select(seen, points.slope, state.horizon);
    }

    /// Finds edges: ground that comes up from behind other ground. `straight`: nearness at the
    /// middle of row 0 and from row to row.
    #[inline(always)]
    fn find_edges(
        &self,
        state: &mut State<S>,
        stretch: &Stretch<S>,
        [base, per_row]: [S::Floats; 2],
        [seen, filled]: [S::Mask; 2],
        strip: &mut Strip,
        first: usize,
    ) {
        let (simd, crest) = (self.simd, state.crest);
        let none = simd.floats(NO_ROW);
        let was_hidden = seen & simd.less(state.last.slope, state.horizon);
        let far = base + (crest.row - simd.floats(0.5)) * per_row;
        let is_new = was_hidden
            & simd.less(none, crest.row)
            & simd.at_most(crest.edge, none)
            & simd.less(far, crest.seen * simd.floats(1.0 - BEHIND));
        let edge = simd.select(is_new, crest.row, crest.edge);
        let is_below = simd.less(simd.floats(self.rows[0]), state.next);
        strip.put_edges(simd, first, [edge, state.next], filled & is_below & simd.less(none, edge));
        state.crest = Crest {
            row: simd.select(seen, stretch.row, crest.row),
            seen: simd.select(seen, stretch.seen, crest.seen),
            edge: simd.select(filled, none, edge),
        };
    }

    /// Between points before and these. `seen`: which of these are looked at.
    #[inline(always)]
    pub(super) fn stretch(&self, before: &Points<S>, points: &Points<S>, seen: S::Mask) -> Stretch<S> {
        let (end, begin) = (self.place(points), self.place(before));
        let stretch = Stretch { row_before: begin.row, seen_before: begin.seen, row: end.row, seen: end.seen };
        if self.simd.any(seen & (end.is_far | begin.is_far)) {
            return self.clip(stretch, before, points);
        }
        stretch
    }

    /// One over depth along a stretch, at the middle of row 0, and its change from row to row.
    #[inline(always)]
    pub(super) fn straight<const IS_UP: bool>(&self, stretch: &Stretch<S>) -> [S::Floats; 2] {
        let simd = self.simd;
        let by = stretch.row - stretch.row_before;
        let by =
            if IS_UP { simd.larger(by, simd.floats(LEAST_ROWS)) } else { simd.smaller(by, simd.floats(-LEAST_ROWS)) };
        let per_row = (stretch.seen - stretch.seen_before) / by;
        [stretch.seen_before + (simd.floats(0.5) - stretch.row_before) * per_row, per_row]
    }

    /// The first row of the picture whose middle is above a point of it.
    #[inline(always)]
    pub(super) fn row_behind(&self, row: S::Floats) -> S::Floats {
        let simd = self.simd;
        let [lowest, highest] = [simd.floats(self.rows[0]), simd.floats(self.rows[1])];
        simd.floor(simd.smaller(simd.larger(row + simd.floats(0.5), lowest), highest))
    }

    /// Where points are in the picture.
    #[inline(always)]
    pub(super) fn place(&self, points: &Points<S>) -> Place<S> {
        let (simd, block) = (self.simd, self.block);
        let [per_height, per_depth] = self.per_slope.map(|per| simd.floats(per));
        let depth = simd.load(&block.depth) + points.slope * per_depth;
        let height = (simd.load(&block.rise) + points.slope * per_height) * simd.floats(self.focal_px);
        let per_depth = simd.floats(1.0) / depth;
        Place {
            row: height * per_depth + simd.floats(self.sight_row),
            seen: points.nearness * per_depth,
            is_far: simd.less(depth * simd.floats(FURTHEST_PX), simd.magnitude(height)),
        }
    }

    /// Cuts stretches off that go on beside or behind the camera.
    #[inline(always)]
    fn clip(&self, stretch: Stretch<S>, before: &Points<S>, points: &Points<S>) -> Stretch<S> {
        let simd = self.simd;
        let mut ends = [[0.0; LANES]; 4];
        let [row_before, seen_before, row, seen] = &mut ends;
        simd.store(stretch.row_before, row_before);
        simd.store(stretch.seen_before, seen_before);
        simd.store(stretch.row, row);
        simd.store(stretch.seen, seen);
        let mut sides = [[0.0; LANES]; 4];
        let [slope_before, slope, nearness_before, nearness] = &mut sides;
        simd.store(before.slope, slope_before);
        simd.store(points.slope, slope);
        simd.store(before.nearness, nearness_before);
        simd.store(points.nearness, nearness);
        self.clip_each(&mut ends, &sides);
        let [row_before, seen_before, row, seen] = &ends;
        Stretch {
            row_before: simd.load(row_before),
            seen_before: simd.load(seen_before),
            row: simd.load(row),
            seen: simd.load(seen),
        }
    }

    /// The same, plane by plane. `ends`: rows and nearness before and here; `points`: slopes before
    /// and here, and one over distances.
    #[inline(never)]
    fn clip_each(&self, ends: &mut [Sixteen<f32>; 4], points: &[Sixteen<f32>; 4]) {
        let block = self.block;
        let [row_before, seen_before, row, seen] = ends;
        let (slopes, nearness) = (&points[..2], &points[2..]);
        for k in 0..LANES {
            // Height and depth of both ends, metres.
            let sides = [0, 1].map(|end| {
                let (slope, distance) = (slopes[end][k], 1.0 / nearness[end][k]);
                let height = (block.rise[k] + slope * self.per_slope[0]) * self.focal_px;
                let depth = block.depth[k] + slope * self.per_slope[1];
                (height * distance, depth * distance, depth * FURTHEST_PX < height.abs())
            });
            let [(height_before, depth_before, is_far_before), (height, depth, is_far)] = sides;
            // Where the stretch is a small share of the nearer end's depth away from the camera's
            // plane.
            let cut = |height: f32, depth: f32, other: f32, other_depth: f32| {
                let least = depth * LEAST_DEPTH;
                let share = (depth - least) / (depth - other_depth);
                [(height + (other - height) * share) / least + self.sight_row, 1.0 / least]
            };
            match (is_far_before, is_far) {
                (false, false) => {}
                (false, true) if depth < depth_before * LEAST_DEPTH => {
                    [row[k], seen[k]] = cut(height_before, depth_before, height, depth);
                }
                (true, false) if depth_before < depth * LEAST_DEPTH => {
                    [row_before[k], seen_before[k]] = cut(height, depth, height_before, depth_before);
                }
                // Both ends are beside the picture: as if each were on its edge.
                _ => {
                    [row_before[k], seen_before[k]] = self.seen(k, slopes[0][k], nearness[0][k]);
                    [row[k], seen[k]] = self.seen(k, slopes[1][k], nearness[1][k]);
                }
            }
        }
    }
}
