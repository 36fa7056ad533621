//! Sixteen planes, swept outwards once: which nearness each pixel of their lines sees.
//!
//! A plane cuts the ground in a polyline over its line on the map. Seen from the eye, a point of it
//! has the slope `s = (height − eye) / distance`, and shows where `s` is above every slope before
//! it: then the rows between the highest slope so far and this one see the stretch from the last
//! point to this one. In a picture one over depth is linear along a straight stretch, so that two
//! numbers of a row and of a stretch are all that is needed.
//!
//! ```text
//!  row      ...........*  s of this step        what is above the highest slope so far is seen,
//!   |            . '       rows between         what is below is hidden: for the polyline this is
//!   |   *. . . '                                exact, there is nothing to step back for
//!   |  highest so far
//! ```
//!
//! For an eye beside the world, rows that pass under its edge see the ground from below: where `s`
//! is below every slope before it. The same, upside down.

use super::fan::{Block, Fan, Step};
use super::heights::{Heights, NOTHING, Place};
use super::stretch::LEAST_ROWS;
use super::strip::Strip;
use crate::scene::{Bounds, Scene};
use glam::Vec2;
use terravision_common::simd::{LANES, Simd, Sixteen};

const _: () = assert!(NOTHING == NO_SLOPE, "where no height is there is no slope");
/// Steps that are looked at together: hidden ones are left out together. Many first, then few.
pub(super) const GROUPS: [usize; 2] = [64, 8];
/// Bits of all planes.
const ALL: u32 = (1 << LANES) - 1;
/// The slope of a point where no ground is.
pub(super) const NO_SLOPE: f32 = f32::NEG_INFINITY;
/// The row where no edge is.
pub(super) const NO_ROW: f32 = f32::NEG_INFINITY;

/// What is swept, and where to.
pub(super) struct Tracer<'a, S> {
    pub(super) simd: S,
    pub(super) scene: &'a Scene<'a>,
    pub(super) fan: &'a Fan,
    pub(super) block: &'a Block,
    pub(super) heights: Heights<'a>,
    /// Of slopes: pixels of height and metres of depth on the plane of depth 1.
    pub(super) per_slope: [f32; 2],
    pub(super) focal_px: f32,
    /// The row on the line of sight, counted from the bottom of the turned picture.
    pub(super) sight_row: f32,
    /// Rows that are looked at.
    pub(super) rows: [f32; 2],
    pub(super) finds_edges: bool,
    /// Steps that were sampled.
    pub(super) samples: u64,
}

/// The points that a step has come to.
#[derive(Clone, Copy)]
pub(super) struct Points<S: Simd> {
    pub(super) slope: S::Floats,
    /// Height above the eye, or of the last ground before.
    pub(super) rise: S::Floats,
    /// One over their distance along the ground.
    pub(super) nearness: S::Floats,
}

/// What is known of the planes.
#[derive(Clone, Copy)]
pub(super) struct State<S: Simd> {
    /// Largest slope so far, or upside down the smallest.
    pub(super) horizon: S::Floats,
    /// The first row that is not filled yet, or upside down the last that is.
    pub(super) next: S::Floats,
    pub(super) last: Points<S>,
    pub(super) crest: Crest<S>,
}

/// The last crest of planes, to find edges of ground.
#[derive(Clone, Copy)]
pub(super) struct Crest<S: Simd> {
    /// Where the last ground that is seen ends, and one over its depth there.
    pub(super) row: S::Floats,
    pub(super) seen: S::Floats,
    /// Where an edge is that has been found, but no middle of a row above it yet.
    pub(super) edge: S::Floats,
}

impl<S: Simd> Crest<S> {
    pub(super) fn none(simd: S) -> Self {
        let none = simd.floats(NO_ROW);
        Self { row: none, seen: simd.floats(0.0), edge: none }
    }
}

/// The same, plane by plane.
struct States {
    horizon: Sixteen<f32>,
    next: Sixteen<f32>,
    slope: Sixteen<f32>,
    rise: Sixteen<f32>,
    nearness: Sixteen<f32>,
}

impl States {
    fn of<S: Simd>(simd: S, state: &State<S>) -> Self {
        let zeros = [0.0; LANES];
        let mut of = Self { horizon: zeros, next: zeros, slope: zeros, rise: zeros, nearness: zeros };
        simd.store(state.horizon, &mut of.horizon);
        simd.store(state.next, &mut of.next);
        simd.store(state.last.slope, &mut of.slope);
        simd.store(state.last.rise, &mut of.rise);
        simd.store(state.last.nearness, &mut of.nearness);
        of
    }

    fn state<S: Simd>(&self, simd: S) -> State<S> {
        State {
            horizon: simd.load(&self.horizon),
            next: simd.load(&self.next),
            last: Points {
                slope: simd.load(&self.slope),
                rise: simd.load(&self.rise),
                nearness: simd.load(&self.nearness),
            },
            crest: Crest::none(simd),
        }
    }
}

impl<'a, S: Simd> Tracer<'a, S> {
    pub(super) fn new(simd: S, scene: &'a Scene<'a>, fan: &'a Fan, block: &'a Block) -> Option<Self> {
        let sector = fan.sector.as_ref()?;
        Some(Self {
            simd,
            scene,
            fan,
            block,
            heights: Heights::new(scene),
            per_slope: sector.per_slope().map(|of| of as f32),
            focal_px: scene.view.focal_px(),
            sight_row: sector.sight_row() as f32,
            rows: block.rows,
            finds_edges: fan.finds_edges,
            samples: 0,
        })
    }

    /// Fills the rows of the planes' lines, which are the lines from `first` on of a strip.
    #[inline(always)]
    pub(super) fn trace(&mut self, strip: &mut Strip, first: usize) {
        let simd = self.simd;
        let mut horizon = self.block.lowest;
        for (horizon, has_ground) in horizon.iter_mut().zip(&self.block.has_ground) {
            if !has_ground {
                *horizon = f32::INFINITY;
            }
        }
        let zero = simd.floats(0.0);
        let mut state = State {
            horizon: simd.load(&horizon),
            next: simd.floats(self.rows[0]),
            last: Points { slope: simd.floats(NO_SLOPE), rise: zero, nearness: zero },
            crest: Crest::none(simd),
        };
        strip.begin(first);
        if let Some(begin) = self.fan.steps.first() {
            state.last = self.first_points(begin);
            state = self.begin(state, strip, first);
            self.sweep(&mut state, strip, first);
        }
        let skyline = self.skyline(&state);
        if self.finds_edges {
            let is_within =
                simd.less(simd.floats(self.rows[0]), state.next) & simd.less(state.next, simd.floats(self.rows[1]));
            strip.put_edges(simd, first, [skyline, state.next], is_within);
        }
        strip.put_sky(simd, first, [state.next, skyline], self.rows);
    }

    /// The rows of the planes' horizons, within the picture or a pixel beyond it.
    #[inline(always)]
    fn skyline(&self, state: &State<S>) -> S::Floats {
        let (simd, block) = (self.simd, self.block);
        let slope = simd.smaller(simd.larger(state.horizon, simd.load(&block.lowest)), simd.load(&block.highest));
        let row = self.place(&Points { slope, ..state.last }).row;
        // Planes without ground: as low as that.
        let has_ground = simd.less(state.horizon, simd.floats(f32::INFINITY));
        simd.select(has_ground, row, simd.floats(f32::MIN))
    }

    /// Points of the planes at a step: no nearer than where the ground begins, no further than its
    /// border. Levels are those of ground as far above the eye as `rise`, that of the step before.
    #[inline(always)]
    pub(super) fn points(&mut self, step: &Step, rise: S::Floats) -> Points<S> {
        let (simd, block) = (self.simd, self.block);
        let at_step = simd.floats(step.distance);
        let distance = simd.smaller(simd.larger(at_step, simd.load(&block.begin)), simd.load(&block.end));
        let mut nearness = simd.floats(step.nearness);
        let elsewhere = simd.less(distance, at_step) | simd.less(at_step, distance);
        if simd.any(elsewhere) {
            nearness = simd.select(elsewhere, simd.floats(1.0) / distance, nearness);
        }
        let place = Place {
            east: simd.load(&block.east) * distance,
            north: simd.load(&block.north) * distance,
            away2: distance * distance + rise * rise,
        };
        let above = self.heights.at(simd, &place) - simd.floats(self.scene.eye_height);
        self.samples = self.samples.wrapping_add(LANES as u64);
        let is_ground = simd.less(simd.floats(NO_SLOPE), above);
        Points { slope: above * nearness, rise: simd.select(is_ground, above, rise), nearness }
    }

    /// Points of a step that is the first one.
    #[inline(always)]
    pub(super) fn first_points(&mut self, step: &Step) -> Points<S> {
        // How high the ground is there, by which its level is chosen, is not known before.
        let points = self.points(step, self.simd.floats(0.0));
        self.points(step, points.rise)
    }

    /// What is seen before the first step.
    #[inline(always)]
    fn begin(&mut self, state: State<S>, strip: &mut Strip, first: usize) -> State<S> {
        let mut states = States::of(self.simd, &state);
        let mut under = [false; LANES];
        for (k, is_under) in under.iter_mut().enumerate() {
            let slope = states.slope[k];
            if !self.block.has_ground[k] || slope <= states.horizon[k] {
                continue;
            }
            let end = self.end_row(k, slope);
            if self.block.begin[k] > 0.0 && self.scene.has_undersides {
                *is_under = true;
            } else if end > self.rows[0] {
                self.fill_before(k, [slope, states.nearness[k], states.horizon[k]], end, strip, first);
            }
            states.horizon[k] = slope;
            states.next[k] = end.max(self.rows[0]);
        }
        let state = states.state(self.simd);
        if under.contains(&true) {
            self.look_under(&under, &state, strip, first);
        }
        state
    }

    /// Fills the rows below the first point of a plane. The ground goes on towards the eye as high
    /// as it is here; from where it begins down, it is a wall.
    fn fill_before(&self, k: usize, [slope, nearness, horizon]: [f32; 3], end: f32, strip: &mut Strip, first: usize) {
        let is_wall = self.block.begin[k] > 0.0;
        let before = if is_wall { [horizon, nearness] } else { [2.0 * slope, 2.0 * nearness] };
        let [row, seen] = self.seen(k, slope, nearness);
        let [row_before, seen_before] = self.seen(k, before[0], before[1]);
        let by = row - row_before;
        let per_row = if by.abs() > LEAST_ROWS { (seen - seen_before) / by } else { 0.0 };
        let within = [0.5 * seen.min(seen_before), 2.0 * seen.max(seen_before)];
        for number in self.rows[0] as usize..end as usize {
            let value = seen + (number as f32 + 0.5 - row) * per_row;
            strip.put(number, first + k, value.clamp(within[0], within[1]), per_row);
        }
    }

    /// The row of a point in plane `k`, and one over its depth. Slopes beyond the picture's edges
    /// are taken to them: what lies there may be behind the camera.
    #[inline(always)]
    pub(super) fn seen(&self, k: usize, slope: f32, nearness: f32) -> [f32; 2] {
        let block = self.block;
        let slope = slope.max(block.lowest[k]).min(block.highest[k]);
        let per_depth = 1.0 / (block.depth[k] + slope * self.per_slope[1]);
        let height = (block.rise[k] + slope * self.per_slope[0]) * per_depth;
        [height * self.focal_px + self.sight_row, nearness * per_depth]
    }

    /// The first row whose middle is above a slope.
    #[inline(always)]
    fn end_row(&self, k: usize, slope: f32) -> f32 {
        let [row, _] = self.seen(k, slope, 1.0);
        (row + 0.5).max(0.0).min(self.rows[1]).floor()
    }

    /// Goes outwards, as long as something may still be seen.
    #[inline(always)]
    fn sweep(&mut self, state: &mut State<S>, strip: &mut Strip, first: usize) {
        let count = self.fan.steps.len();
        let mut at = 1;
        // Whether the last point is that of the step before.
        let mut is_known = true;
        // Up to here it is known that many steps together rise.
        let mut many_rise_until = 0;
        while at < count {
            let lowest = self.lowest_open(state);
            if lowest == f32::INFINITY || self.is_all_below(at, lowest) {
                return;
            }
            if let Some(end) = self.end_of_hidden(at, lowest, &mut many_rise_until) {
                at = end;
                is_known = false;
                continue;
            }
            if !is_known {
                state.last = self.points(&self.fan.steps[at - 1], state.last.rise);
                is_known = true;
            }
            let end = count.min(at + GROUPS[1]);
            for step in &self.fan.steps[at..end] {
                let points = self.points(step, state.last.rise);
                self.advance::<true>(state, points, strip, first);
            }
            at = end;
        }
    }

    /// Where the next steps end that rise above no slope, if there are.
    #[inline(never)]
    pub(super) fn end_of_hidden(&self, at: usize, lowest: f32, many_rise_until: &mut usize) -> Option<usize> {
        let [many, few] = GROUPS.map(|group| self.fan.steps.len().min(at + group));
        if at >= *many_rise_until {
            if self.is_hidden(at, many, lowest) {
                return Some(many);
            }
            *many_rise_until = many;
        }
        self.is_hidden(at, few, lowest).then_some(few)
    }

    /// Takes the next points, and fills the rows that they come to. `IS_UP` false: upside down.
    #[inline(always)]
    fn advance<const IS_UP: bool>(&self, state: &mut State<S>, points: Points<S>, strip: &mut Strip, first: usize) {
        let simd = self.simd;
        let seen = if IS_UP {
            simd.less(state.horizon, points.slope)
        } else {
            simd.less(points.slope, state.horizon) & simd.less(simd.floats(NO_SLOPE), points.slope)
        };
        if simd.any(seen) {
            self.fill::<IS_UP>(state, &points, seen, strip, first);
        }
        state.last = points;
    }

    /// The smallest of the largest slopes so far, of planes that have rows left.
    #[inline(always)]
    fn lowest_open(&self, state: &State<S>) -> f32 {
        let simd = self.simd;
        let is_open = simd.less(state.next, simd.floats(self.rows[1]));
        simd.smallest(simd.select(is_open, state.horizon, simd.floats(f32::INFINITY)))
    }

    /// Whether no ground from a step on rises above a slope.
    #[inline(always)]
    pub(super) fn is_all_below(&self, at: usize, slope: f32) -> bool {
        let highest = self.scene.highest;
        let (nearest, furthest) = (&self.fan.steps[at - 1], &self.fan.steps[self.fan.steps.len() - 1]);
        highest * if highest > 0.0 { nearest.nearness } else { furthest.nearness } <= slope
    }

    /// Whether the steps from `at` to `end` and the way to them rise above no slope.
    fn is_hidden(&self, at: usize, end: usize, slope: f32) -> bool {
        let block = self.block;
        let (near, far) = (&self.fan.steps[at - 1], &self.fan.steps[end - 1]);
        let [a, b] = [0, LANES - 1].map(|k| Vec2::new(block.east[k], block.north[k]));
        // The planes between reach further than the line from the first to the last one.
        let margin = Vec2::splat(far.distance * (1.0 - a.dot(b)).max(1e-6));
        let corners = [a * near.distance, b * near.distance, a * far.distance, b * far.distance];
        let min = corners.into_iter().fold(Vec2::INFINITY, Vec2::min) - margin;
        let max = corners.into_iter().fold(Vec2::NEG_INFINITY, Vec2::max) + margin;
        // What is above the eye has the largest slope where it is nearest, what is below it where it
        // is furthest.
        let rise = slope * if slope > 0.0 { near.distance } else { far.distance };
        !self.scene.rises_above(rise, Bounds { min, max }, [near.distance, far.distance])
    }

    /// Fills the rows below the edge of the ground with what they see of it from below.
    #[inline(always)]
    fn look_under(&mut self, under: &[bool; LANES], above: &State<S>, strip: &mut Strip, first: usize) {
        let simd = self.simd;
        let mut states = States::of(simd, above);
        for (k, _) in under.iter().enumerate().filter(|(_, is_under)| !**is_under) {
            states.horizon[k] = NO_SLOPE;
            states.next[k] = self.rows[0];
        }
        let mut state = states.state(simd);
        let lowest = simd.load(&self.block.lowest);
        for at in 1..self.fan.steps.len() {
            let is_done = simd.at_most(state.next, simd.floats(self.rows[0])) | simd.at_most(state.horizon, lowest);
            if simd.bits(is_done) == ALL {
                break;
            }
            let points = self.points(&self.fan.steps[at], state.last.rise);
            self.advance::<false>(&mut state, points, strip, first);
        }
        // Rows that are left pass below all ground.
        let states = States::of(simd, &state);
        for k in (0..LANES).filter(|k| under[*k]) {
            for row in self.rows[0] as usize..states.next[k] as usize {
                strip.put(row, first + k, 0.0, 0.0);
            }
        }
    }
}
