//! Stretches of ground between two steps, from the planes to rows of the picture.

use super::lanes::{Floats, LANES, floor, larger, largest, smaller, smallest};
use super::strip::Strip;
use super::trace::{NO_SLOPE, Points, State, Tracer};

/// Rows between two points are at least this, when one is divided by them.
pub(super) const LEAST_ROWS: f32 = 1e-6;
/// A point that is this many pixels above or below the picture's middle is beside the camera, or
/// behind it.
const FURTHEST_PX: f32 = 1e5;
/// Stretches are cut off at this share of the depth of the end that is before the camera.
const LEAST_DEPTH: f32 = 1e-3;

/// Straight ground between two steps, in the picture: rows of its ends, and one over their depth.
#[derive(Debug, Default)]
struct Stretch {
    row_before: Floats,
    seen_before: Floats,
    row: Floats,
    seen: Floats,
}

impl Tracer<'_> {
    /// Fills the rows that planes see between their last points and these.
    #[inline(always)]
    pub(super) fn fill<const IS_UP: bool>(&self, state: &mut State, points: &Points, strip: &mut Strip, first: usize) {
        let mut stretch = Stretch::default();
        let (last, block) = (&state.last, self.block);
        let mut before = [0.0; LANES];
        let mut nearness_before = [0.0; LANES];
        let mut is_seen = [false; LANES];
        let mut far = 0u32;
        for k in 0..LANES {
            let (slope, horizon) = (points.slope[k], state.horizon[k]);
            is_seen[k] = if IS_UP { slope > horizon } else { (slope < horizon) & (slope > NO_SLOPE) };
            // Behind a gap the ground begins with a wall.
            let is_gap = last.slope[k] == NO_SLOPE;
            before[k] = if is_gap { horizon } else { last.slope[k] };
            nearness_before[k] = if is_gap { points.nearness[k] } else { last.nearness[k] };
            let place = |slope: f32, nearness: f32| {
                let depth = block.depth[k] + slope * self.per_slope[1];
                let height = (block.rise[k] + slope * self.per_slope[0]) * self.focal_px;
                let is_far = depth * FURTHEST_PX < height.abs();
                let per_depth = 1.0 / depth;
                (height * per_depth + self.middle, nearness * per_depth, is_far)
            };
            let is_far;
            let is_far_before;
            (stretch.row[k], stretch.seen[k], is_far) = place(slope, points.nearness[k]);
            (stretch.row_before[k], stretch.seen_before[k], is_far_before) = place(before[k], nearness_before[k]);
            far |= u32::from(is_seen[k] & (is_far | is_far_before));
        }
        if far != 0 {
            self.clip(&mut stretch, [&before, &points.slope], [&nearness_before, &points.nearness]);
        }
        let (mut base, mut per_row) = ([0.0; LANES], [0.0; LANES]);
        // Rows from `low` to `high` are filled; of planes that see nothing there are none.
        let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let by = stretch.row[k] - stretch.row_before[k];
            let by = if IS_UP { larger(by, LEAST_ROWS) } else { smaller(by, -LEAST_ROWS) };
            per_row[k] = (stretch.seen[k] - stretch.seen_before[k]) / by;
            base[k] = stretch.seen_before[k] + (0.5 - stretch.row_before[k]) * per_row[k];
            let end = floor(smaller(larger(stretch.row[k] + 0.5, self.rows[0]), self.rows[1]));
            let next = state.next[k];
            let [from, to] = if IS_UP { [next, end] } else { [end, next] };
            let is_filled = is_seen[k] & (from < to);
            low[k] = if is_filled { from } else { f32::INFINITY };
            high[k] = if is_filled { to } else { f32::NEG_INFINITY };
            state.next[k] = if is_filled { end } else { next };
            state.horizon[k] = if is_seen[k] { points.slope[k] } else { state.horizon[k] };
        }
        let (from, to) = (smallest(&low), largest(&high));
        if from < to {
            strip.fill(first, [from as usize, to as usize], [&low, &high], [&base, &per_row]);
        }
    }

    /// Cuts stretches off that go on beside or behind the camera.
    #[inline(never)]
    fn clip(&self, stretch: &mut Stretch, slopes: [&Floats; 2], nearness: [&Floats; 2]) {
        let block = self.block;
        for k in 0..LANES {
            // Height and depth of both ends, metres.
            let ends = [0, 1].map(|end| {
                let (slope, distance) = (slopes[end][k], 1.0 / nearness[end][k]);
                let height = (block.rise[k] + slope * self.per_slope[0]) * self.focal_px;
                let depth = block.depth[k] + slope * self.per_slope[1];
                (height * distance, depth * distance, depth * FURTHEST_PX < height.abs())
            });
            let [(height_before, depth_before, is_far_before), (height, depth, is_far)] = ends;
            // Where the stretch is a small share of the nearer end's depth away from the camera's
            // plane.
            let cut = |height: f32, depth: f32, other: f32, other_depth: f32| {
                let least = depth * LEAST_DEPTH;
                let share = (depth - least) / (depth - other_depth);
                [(height + (other - height) * share) / least + self.middle, 1.0 / least]
            };
            match (is_far_before, is_far) {
                (false, false) => {}
                (false, true) if depth < depth_before * LEAST_DEPTH => {
                    [stretch.row[k], stretch.seen[k]] = cut(height_before, depth_before, height, depth);
                }
                (true, false) if depth_before < depth * LEAST_DEPTH => {
                    [stretch.row_before[k], stretch.seen_before[k]] = cut(height, depth, height_before, depth_before);
                }
                // Both ends are beside the picture: as if each were on its edge.
                _ => {
                    [stretch.row_before[k], stretch.seen_before[k]] = self.seen(k, slopes[0][k], nearness[0][k]);
                    [stretch.row[k], stretch.seen[k]] = self.seen(k, slopes[1][k], nearness[1][k]);
                }
            }
        }
    }
}
