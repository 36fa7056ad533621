//! Holes, and ground that was filled, where a sweep has read heights in place: pixel by pixel, as
//! [`crate::exact::holes`] is for tiles of the ground's own. Most pixels are looked at sixteen at a
//! time ([`super::through`]); here are those whose neighbors see something else.
//!
//! The surface is that of the sweep: a function of the point and of its distance from the eye. A ray
//! that met a hole goes on from facet to facet of the level that is wanted where it is. The next
//! level's facets are made of whole ones of these, so that both are linear on each, and so is what
//! they are blended to, but for the way that the share of the next level goes with the distance.

use super::surface::Plane;
use crate::exact::holes::{MARK, MOST_HOLES, WITHIN};
use crate::exact::{LEAST_BELOW, LEAST_BELOW_M, Side, past};
use crate::model::{Source, TileSource};
use crate::scene::{Bounds, exit};
use crate::shade::Canvas;
use crate::view::Ray;
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

impl Plane<'_> {
    /// Looks at a pixel that sees ground: its ray goes on if that is a hole, and it is marked if the
    /// ground was filled.
    pub(super) fn look_at(&self, canvas: &Canvas<'_>, pixel: [u32; 2]) {
        let (scene, picture) = (self.scene, canvas.picture);
        let (color, depth) = picture.get(pixel);
        if !depth.is_finite() {
            return;
        }
        let ray = scene.view.ray(pixel);
        let s = self.within(&ray, depth / ray.depth);
        let Some(source) = self.partly_unmeasured(&ray, s) else { return };
        let met = self.met(&ray, s, &source);
        if !met.is_hole {
            if met.is_filled {
                picture.put(pixel, met.marked(color), depth);
            }
            return;
        }
        let beyond = self.beyond_hole(&ray, s, self.side_beyond(&ray, s, &source));
        let tile = beyond.as_ref().and_then(|met| scene.tile_at_point((ray.direction * met.s).truncate()));
        match (beyond, tile) {
            (Some(met), Some(tile)) => {
                picture.put(pixel, met.marked(canvas.shade(tile, &ray, met.s)), met.s * ray.depth);
            }
            _ => canvas.put_sky(pixel),
        }
    }

    /// Whether what a pixel sees at this depth is a hole.
    pub(super) fn is_hole(&self, pixel: [u32; 2], depth: f32) -> bool {
        let ray = self.scene.view.ray(pixel);
        let s = self.within(&ray, depth / ray.depth);
        self.partly_unmeasured(&ray, s).is_some_and(|source| self.met(&ray, s, &source).is_hole)
    }

    /// Between two planes a point may lie a little beyond the border: what is there is what is at the
    /// border.
    fn within(&self, ray: &Ray, s: f32) -> f32 {
        s.min(self.scene.departure(ray) * WITHIN)
    }

    /// The tile that a ray is over, if some of its ground may be a hole, or may have been filled.
    fn partly_unmeasured(&self, ray: &Ray, s: f32) -> Option<TileSource> {
        match self.source(ray, s) {
            Source::Tile(source) => Some(source).filter(|source| self.pyramid.is_partly_unmeasured(source)),
            Source::Hole { .. } => None,
        }
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
    fn beyond_hole(&self, ray: &Ray, mut s: f32, mut side: Side) -> Option<Met> {
        let border = self.scene.departure(ray);
        for _ in 0..MOST_HOLES {
            let met = self.next_met(ray, &mut side, [past(s), border])?;
            if !met.is_hole {
                return Some(met);
            }
            s = met.s;
        }
        None
    }

    /// Where a ray next meets the side of the surface that is drawn, before `border`.
    fn next_met(&self, ray: &Ray, side: &mut Side, [from, border]: [f32; 2]) -> Option<Met> {
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
                && let Some(met) = self.cross(ray, side, [s, end], &source)
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
    fn cross(&self, ray: &Ray, side: &mut Side, [from, to]: [f32; 2], source: &TileSource) -> Option<Met> {
        let (mut s, end) = (f64::from(from), f64::from(to));
        let mut above = self.above(ray, s, source);
        if *side == Side::Outside {
            *side = if above < 0.0 { Side::Below } else { Side::Above };
        }
        for _ in 0..MOST_FACETS {
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

/// How far below the surface a point is below it, for rounding.
fn least_below(s: f32) -> f64 {
    f64::from(LEAST_BELOW * s + LEAST_BELOW_M)
}
