//! Holes, and ground that was filled, where a sweep has read heights in place: a pass over the
//! pixels after it, as [`crate::exact::holes`] is for tiles of the ground's own.
//!
//! The surface is that of the sweep: a function of the point and of its distance from the eye. A ray
//! that met a hole goes on from facet to facet of the level that is wanted where it is. The next
//! level's facets are made of whole ones of these, so that both are linear on each, and so is what
//! they are blended to, but for the way that the share of the next level goes with the distance.

use super::surface::Surface;
use crate::counts::Counts;
use crate::exact::holes::{MARK, MOST_HOLES, WITHIN};
use crate::exact::{LEAST_BELOW, LEAST_BELOW_M, Side, past};
use crate::model::{Source, TileSource};
use crate::scene::{Bounds, exit};
use crate::shade::Canvas;
use crate::view::Ray;
use crate::workers::Workers;
use std::sync::atomic::{AtomicUsize, Ordering};
use terravision_common::validity::{GROUND_PLANE, HALF, MEASURED_PLANE};

/// A ray crosses fewer tiles, and fewer facets of one. Bounds on loops that hold whatever rounding
/// does.
const MOST_TILES: u32 = 1 << 16;
const MOST_FACETS: u32 = 1 << 14;
/// From facet to facet a crossing is come closer to this many times: where the ground is blended,
/// it is not quite linear.
const TRIES: u32 = 3;
/// A point at which a ray has met the ground is followed this share of its way, to see on which
/// side the ray goes on.
const ONWARDS: f32 = 1e-4;

/// Where a ray has met the surface.
#[derive(Debug, Clone, Copy)]
struct Met {
    s: f32,
    is_hole: bool,
    is_filled: bool,
}

impl Met {
    /// What is put of the colour there: ground that was filled is marked.
    fn marked(&self, color: u32) -> u32 {
        if self.is_filled { color & !MARK } else { color }
    }
}

/// The tile that neighboring pixels see, metres from the eye.
struct Known {
    source: TileSource,
    bounds: Bounds,
    is_partly_unmeasured: bool,
}

impl Canvas<'_> {
    /// Continues the rays that hit a hole, and marks pixels whose ground was filled.
    pub(crate) fn look_at_shares_in_place(&self, workers: &Workers) {
        let Some(surface) = Surface::new(self.scene) else { return };
        let rows = self.picture.size()[1] as usize;
        let next = AtomicUsize::new(0);
        workers.run(|_| {
            let mut counts = Counts::default();
            // Relaxed: the result does not depend on which worker takes a row.
            while let Some(row) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|row| *row < rows) {
                surface.look_at_row(self, row, &mut counts);
            }
            counts
        });
    }
}

impl Surface<'_> {
    fn look_at_row(&self, canvas: &Canvas<'_>, row: usize, counts: &mut Counts) {
        let (scene, picture) = (self.scene, canvas.picture);
        let mut known: Option<Known> = None;
        for ((color, depth), x) in picture.row(row).zip(0u32..) {
            if !depth.is_finite() {
                continue;
            }
            let pixel = [x, row as u32];
            let ray = scene.view.ray(pixel);
            // Between two planes a point may lie a little beyond the border: what is there is what
            // is at the border.
            let s = (depth / ray.depth).min(scene.departure(&ray) * WITHIN);
            if !known.as_ref().is_some_and(|known| known.holds(&ray, s)) {
                known = self.known(&ray, s);
            }
            let Some(Known { source, is_partly_unmeasured: true, .. }) = &known else { continue };
            let met = self.met(&ray, s, source);
            if !met.is_hole {
                if met.is_filled {
                    picture.put(pixel, met.marked(color), depth);
                }
                continue;
            }
            let beyond = self.beyond_hole(&ray, s, self.side_beyond(&ray, s, source), counts);
            let tile = beyond.as_ref().and_then(|met| scene.tile_at_point((ray.direction * met.s).truncate()));
            match (beyond, tile) {
                (Some(met), Some(tile)) => {
                    picture.put(pixel, met.marked(canvas.shade(tile, &ray, met.s)), met.s * ray.depth);
                }
                _ => canvas.put_sky(pixel),
            }
        }
    }

    /// The tile that a ray is over, and where it is the right one.
    fn known(&self, ray: &Ray, s: f32) -> Option<Known> {
        let Source::Tile(source) = self.source(ray, s) else { return None };
        let log = self.scene.ground.shape().surface.cells().ilog2() + u32::from(source.level);
        let bounds = self.scene.square(source.origin, log);
        Some(Known { source, bounds, is_partly_unmeasured: self.pyramid.is_partly_unmeasured(&source) })
    }

    /// The surface where a ray has met it.
    fn met(&self, ray: &Ray, s: f32, source: &TileSource) -> Met {
        let share = |plane| self.plane(ray, f64::from(s), source, plane);
        Met { s, is_hole: share(GROUND_PLANE) < HALF, is_filled: share(MEASURED_PLANE) < HALF }
    }

    /// On which side of the surface a ray goes on that has met it. Between two planes of a sweep a
    /// pixel is beside the surface.
    fn side_beyond(&self, ray: &Ray, s: f32, source: &TileSource) -> Side {
        let above = |s: f32| self.above(ray, f64::from(s), source);
        let here = above(s);
        let is_above = if here.abs() > least_below(s) { here > 0.0 } else { above(s + s * ONWARDS) > here };
        if is_above { Side::Above } else { Side::Below }
    }

    /// Where a ray that passes through a hole, to this side of the surface, hits ground, if it does.
    fn beyond_hole(&self, ray: &Ray, mut s: f32, mut side: Side, counts: &mut Counts) -> Option<Met> {
        let border = self.scene.departure(ray);
        for _ in 0..MOST_HOLES {
            let met = self.next_met(ray, &mut side, [past(s), border], counts)?;
            if !met.is_hole {
                return Some(met);
            }
            s = met.s;
        }
        None
    }

    /// Where a ray next meets the side of the surface that is drawn, before `border`.
    fn next_met(&self, ray: &Ray, side: &mut Side, [from, border]: [f32; 2], counts: &mut Counts) -> Option<Met> {
        let [lowest, highest] = self.scene.ground.range_m().map(|height| height - self.scene.eye_height);
        let (mut s, rise) = (from, ray.direction.z);
        for _ in 0..MOST_TILES {
            let is_out = (rise >= 0.0 && rise * s > highest) || (rise <= 0.0 && rise * s < lowest);
            if !s.is_finite() || s >= border || is_out {
                return None;
            }
            let source = match self.source(ray, s) {
                Source::Tile(source) => source,
                Source::Hole { corner, log, .. } => {
                    let Bounds { min, max } = self.scene.square(corner, log);
                    s = past(exit(ray.direction.truncate(), min, max).max(s));
                    *side = Side::Outside;
                    continue;
                }
            };
            let end = self.end_of(ray, s, &source, border);
            if !self.is_clear(ray, [s, end], *side, &source)
                && let Some(met) = self.cross(ray, side, [s, end], &source, counts)
            {
                return Some(met);
            }
            s = past(end);
        }
        None
    }

    /// Where a ray leaves a tile, or the distances that it is right for.
    fn end_of(&self, ray: &Ray, s: f32, source: &TileSource, border: f32) -> f32 {
        let log = self.scene.ground.shape().surface.cells().ilog2() + u32::from(source.level);
        let Bounds { min, max } = self.scene.square(source.origin, log);
        let by_distance = (source.until2 / ray.direction.length_squared()).sqrt();
        exit(ray.direction.truncate(), min, max).min(by_distance).min(border).max(s)
    }

    /// Whether a ray stays on its side of all of a tile.
    fn is_clear(&self, ray: &Ray, [from, to]: [f32; 2], side: Side, source: &TileSource) -> bool {
        let [low, high] = self.pyramid.range_of(source).map(|height| height - self.scene.eye_height);
        let [begin, end] = [ray.direction.z * from, ray.direction.z * to];
        match side {
            Side::Above => begin.min(end) > high,
            Side::Below => begin.max(end) < low,
            Side::Outside => false,
        }
    }

    /// Goes from facet to facet of a tile, up to where a ray meets the side of one that is drawn.
    fn cross(
        &self,
        ray: &Ray,
        side: &mut Side,
        [from, to]: [f32; 2],
        source: &TileSource,
        counts: &mut Counts,
    ) -> Option<Met> {
        let (mut s, end) = (f64::from(from), f64::from(to));
        let mut above = self.above(ray, s, source);
        if *side == Side::Outside {
            *side = if above < 0.0 { Side::Below } else { Side::Above };
        }
        for _ in 0..MOST_FACETS {
            counts.samples += 1;
            let next = self.next_edge(ray, s, source).min(end).max(s);
            let above_next = self.above(ray, next, source);
            let is_through = match *side {
                Side::Below => above_next > least_below(next as f32),
                Side::Above | Side::Outside => above_next < -least_below(next as f32),
            };
            if is_through {
                let is_from_above = *side != Side::Below;
                let at = self.crossing(ray, [s, next], [above, above_next], source);
                *side = if is_from_above { Side::Below } else { Side::Above };
                if is_from_above || self.scene.has_undersides {
                    return Some(self.met(ray, at as f32, source));
                }
            }
            if next >= end {
                return None;
            }
            (s, above) = (next, above_next);
        }
        None
    }

    /// Where a ray crosses the surface, which is above it at one end and below it at the other.
    fn crossing(&self, ray: &Ray, ends: [f64; 2], above: [f64; 2], source: &TileSource) -> f64 {
        let ([mut near, mut far], [mut before, mut behind]) = (ends, above);
        // The beginning may be on the wrong side by rounding.
        if (before > 0.0) == (behind > 0.0) {
            return near;
        }
        let mut at = near;
        for _ in 0..TRIES {
            at = near + (far - near) * (before / (before - behind)).clamp(0.0, 1.0);
            let above = self.above(ray, at, source);
            if (above > 0.0) == (before > 0.0) {
                (near, before) = (at, above);
            } else {
                (far, behind) = (at, above);
            }
        }
        at
    }
}

impl Known {
    /// Whether a ray is over its tile, at distances that it is right for.
    fn holds(&self, ray: &Ray, s: f32) -> bool {
        let at = ray.direction * s;
        let (point, away2) = (at.truncate(), at.length_squared());
        let Bounds { min, max } = self.bounds;
        let is_over = point.cmpge(min).all() && point.cmple(max).all();
        is_over && away2 >= self.source.from2 && away2 < self.source.until2
    }
}

/// How far below the surface a point is below it, for rounding.
fn least_below(s: f32) -> f64 {
    f64::from(LEAST_BELOW * s + LEAST_BELOW_M)
}
