//! What rows see through holes: a second way outwards along the planes that met one.
//!
//! A sweep takes the whole surface for ground. A ray that met a hole from above goes on below the
//! surface. It comes out where the surface falls through it, and hits ground from above where the
//! surface rises through it:
//!
//! ```text
//!   ─ ─ ─ ─ ─ ─.hole. ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─ ─▶ ray
//!  ground ____/      \____ground             here ┐ it rises through the ray
//!                          \___             ____/
//!                              \___________/
//! ```
//!
//! So the rows of a plane that met a hole wait, steps are gone once more, and a stretch that rises is
//! what those of its rows see that still wait, unless it is a hole there, too. Where ground is seen
//! from below, one that falls is the same.

use super::heights::Place;
use super::strip::{Rows, Strip};
use super::trace::{GROUPS, NO_SLOPE, Points, Tracer};
use terravision_common::simd::{LANES, Simd};
use terravision_common::validity::HALF;

/// Bits of all planes.
const ALL: u32 = (1 << LANES) - 1;

/// Rows of planes that wait.
struct Waiting {
    count: u32,
    /// The smallest slope of them.
    lowest: f32,
    /// Where the first of them has met a hole, metres along the ground.
    nearest: f32,
    /// Whether some of them have passed a gap.
    is_behind_gap: bool,
}

/// A row of sixteen planes where they see ground.
struct Spot<S: Simd> {
    slope: S::Floats,
    distance: S::Floats,
    place: Place<S>,
}

impl<S: Simd> Tracer<'_, S> {
    /// Finds what rows see through holes and behind gaps.
    #[inline(always)]
    pub(super) fn look_beyond(&mut self, strip: &mut Strip, first: usize) {
        let mut waiting = self.have_rows_wait(strip, first);
        if waiting.count == 0 || self.fan.steps.is_empty() {
            return;
        }
        self.go_on(&mut waiting, strip, first);
        if waiting.is_behind_gap {
            for row in self.rows[0] as usize..self.rows[1] as usize {
                if strip.behind_gap(row) != 0 {
                    strip.close_gap(self.simd, first, row);
                }
            }
        }
    }

    /// Goes steps once more, as long as rows wait.
    #[inline(always)]
    fn go_on(&mut self, waiting: &mut Waiting, strip: &mut Strip, first: usize) {
        let steps = &self.fan.steps;
        let mut at = steps.partition_point(|step| step.distance < waiting.nearest).max(1);
        let mut last = self.first_points(&steps[at - 1]);
        let mut is_known = true;
        let mut many_rise_until = 0;
        while at < steps.len() && waiting.count > 0 && !self.is_all_below(at, waiting.lowest) {
            if let Some(end) = self.end_of_hidden(at, waiting.lowest, &mut many_rise_until) {
                at = end;
                is_known = false;
                continue;
            }
            if !is_known {
                last = self.points(&steps[at - 1], last.rise);
                is_known = true;
            }
            let end = steps.len().min(at + GROUPS[1]);
            for step in &steps[at..end] {
                let points = self.points(step, last.rise);
                self.meet::<true>([&last, &points], waiting, strip, first);
                if self.scene.has_undersides {
                    self.meet::<false>([&last, &points], waiting, strip, first);
                }
                last = points;
            }
            at = end;
        }
    }

    /// Has all rows wait that have met a hole, or have passed a gap: behind it, a sweep has ground begin
    /// with a wall, which is not there.
    #[inline(always)]
    fn have_rows_wait(&mut self, strip: &mut Strip, first: usize) -> Waiting {
        let simd = self.simd;
        let mut waiting = Waiting { count: 0, lowest: f32::INFINITY, nearest: f32::INFINITY, is_behind_gap: false };
        for row in self.rows[0] as usize..self.rows[1] as usize {
            let seen = strip.nearness(simd, first, row);
            let land = simd.bits(simd.less(simd.floats(0.0), seen));
            let mut bits = 0;
            if land != 0 {
                let spot = self.spot(row, seen);
                let gap = strip.behind_gap(row);
                waiting.is_behind_gap |= gap != 0;
                bits = land & (!self.ground(&spot) | gap);
                if bits != 0 {
                    let (mask, none) = (simd.mask(bits), simd.floats(f32::INFINITY));
                    waiting.lowest = waiting.lowest.min(simd.smallest(simd.select(mask, spot.slope, none)));
                    waiting.nearest = waiting.nearest.min(simd.smallest(simd.select(mask, spot.distance, none)));
                    waiting.count += bits.count_ones();
                }
            }
            strip.wait(simd, first, row, bits);
        }
        waiting
    }

    /// Where a row sees ground, whose nearness in it is given.
    #[inline(always)]
    fn spot(&self, row: usize, seen: S::Floats) -> Spot<S> {
        let (simd, block) = (self.simd, self.block);
        // Of points of the plane of depth 1: the other way round than from slopes to rows.
        let height = (row as f32 + 0.5 - self.sight_row) / self.focal_px;
        let [per_height, per_depth] = self.per_slope;
        let depth = simd.load(&block.depth);
        let slope = (depth * simd.floats(height) - simd.load(&block.rise))
            * simd.floats(1.0 / (per_height - height * per_depth));
        let slope = simd.smaller(simd.larger(slope, simd.load(&block.lowest)), simd.load(&block.highest));
        let distance = simd.floats(1.0) / (seen * (depth + slope * simd.floats(per_depth)));
        let distance = simd.smaller(simd.larger(distance, simd.load(&block.begin)), simd.load(&block.end));
        let rise = slope * distance;
        let place = Place {
            east: simd.load(&block.east) * distance,
            north: simd.load(&block.north) * distance,
            away2: distance * distance + rise * rise,
        };
        Spot { slope, distance, place }
    }

    /// A bit of each plane whose surface is no hole there.
    #[inline(always)]
    fn ground(&mut self, spot: &Spot<S>) -> u32 {
        let simd = self.simd;
        match self.heights.shares(simd, &spot.place) {
            Some([ground, _]) => simd.bits(simd.at_most(simd.floats(HALF), ground)),
            None => ALL,
        }
    }

    /// Puts what rows that wait see of the stretch between two points, if it rises, or with `IS_UP`
    /// false, if it falls.
    #[inline(always)]
    fn meet<const IS_UP: bool>(
        &mut self,
        [last, points]: [&Points<S>; 2],
        waiting: &mut Waiting,
        strip: &mut Strip,
        first: usize,
    ) {
        let simd = self.simd;
        let [lower, upper] = if IS_UP { [last, points] } else { [points, last] };
        let is_meant = simd.less(lower.slope, upper.slope)
            & simd.less(simd.floats(NO_SLOPE), lower.slope)
            & simd.less(simd.floats(waiting.lowest), upper.slope);
        if !simd.any(is_meant) {
            return;
        }
        let stretch = self.stretch(last, points, is_meant);
        let [begin, end] = [self.row_behind(stretch.row_before), self.row_behind(stretch.row)];
        let [low, high] = if IS_UP { [begin, end] } else { [end, begin] };
        let has_rows = is_meant & simd.less(low, high);
        if !simd.any(has_rows) {
            return;
        }
        let [base, per_row] = self.straight::<IS_UP>(&stretch);
        let low = simd.select(has_rows, low, simd.floats(f32::INFINITY));
        let high = simd.select(has_rows, high, simd.floats(f32::NEG_INFINITY));
        let rows = Rows { low, high, base, per_row };
        for row in simd.smallest(low) as usize..simd.largest(high) as usize {
            if strip.waiting(row) != 0 {
                waiting.count -= self.meet_in_row(&rows, row, strip, first);
            }
        }
    }

    /// The same in one row; for how many planes that was what they waited for.
    #[inline(always)]
    fn meet_in_row(&mut self, rows: &Rows<S>, row: usize, strip: &mut Strip, first: usize) -> u32 {
        let simd = self.simd;
        let number = simd.floats(row as f32);
        let seen = rows.base + number * rows.per_row;
        let is_here = simd.at_most(rows.low, number) & simd.less(number, rows.high) & simd.less(simd.floats(0.0), seen);
        let mut found = simd.bits(is_here) & strip.waiting(row);
        if found != 0 {
            found &= self.ground(&self.spot(row, seen));
            strip.put_beyond(simd, first, row, [seen, rows.per_row], found);
        }
        found.count_ones()
    }
}
