//! One exact ray per pixel of a line, bottom up.
//!
//! Coherence is never assumed. Where the ground's slope allows it, pixels above one that hit are
//! found by following the ground ([`super::follow`]). Elsewhere, a witness below may prove that an
//! interval is in the air ([`crate::proof`]; here for every parameter, not only for samples). The
//! ray then starts behind that interval; and if it starts over the facet that the ray below hit,
//! and hits that facet too, nothing else has to be tested.
//!
//! The ground is a surface: it has no side walls where tiles end. A ray that enters its bounds
//! lower than its edge is below it, and hits facets from below, or none, as the mesh draws them
//! (`docs/rendering.md`, culling). Such a ray proves nothing about others.

use super::column::{Column, Target};
use super::entered::{Entered, Hit};
use super::follow::Follower;
use crate::counts::Counts;
use crate::model::facet::Facet;
use crate::proof::{Recent, StartRule};
use crate::scene::Scene;
use crate::view::Ray;

/// A ray that has been cast: in the air from `entry` to `reach`.
#[derive(Debug, Clone, Copy)]
struct Known {
    ray: Ray,
    entry: f32,
    reach: f32,
}

/// The exact rays of a frame.
#[derive(Debug)]
pub(crate) struct ExactRays<'a, R> {
    pub(crate) scene: &'a Scene<'a>,
    pub(crate) rule: &'a R,
    /// `Some` if the start rule knows slopes.
    pub(crate) follower: Option<Follower<'a>>,
}

/// State while the rays of a line are cast.
#[derive(Debug)]
struct LineState<'f> {
    /// The tile in which rays are likely to be.
    current: Entered<'f>,
    /// The facet that the ray below hit, and its tile.
    facet: Option<(u32, Facet)>,
    recent: Recent<Known>,
    /// How many rays below are tried.
    tried: usize,
    counts: Counts,
}

/// The result of a ray.
#[derive(Debug, Clone, Copy)]
struct Outcome {
    hit: Option<Hit>,
    /// The parameter up to which it is in the air.
    reach: f32,
    /// Whether it was never below the ground.
    was_above: bool,
}

impl<R: StartRule> ExactRays<'_, R> {
    /// Finds what the pixels of a line see, bottom up.
    pub(crate) fn find_line(&self, target: &mut Target<'_>) -> Counts {
        let count = target.strip.pixels.len();
        let counts = Counts { rays: count as u64, ..Counts::default() };
        let Some(current) = self.scene.enter(0) else {
            (0..count).for_each(|k| target.strip.put_sky(k));
            return counts;
        };
        let tried = match R::RELIES {
            // In one column the rays below prove the same, and the nearest one proves the longest
            // interval.
            true if target.strip.is_straight() => 1,
            true => usize::MAX,
            false => 0,
        };
        let mut line = LineState { current, facet: None, recent: Recent::new(), tried, counts };
        let mut column: Option<Column<'_>> = None;
        let mut k = 0;
        while k < count {
            let ray = self.scene.view.ray(target.strip.pixel(k));
            let found = self.find(&mut line, &ray);
            match &found.hit {
                Some(hit) => {
                    line.counts.hits += 1;
                    let facet = line.current.facet_number(&hit.facet);
                    target.strip.put(k, hit.s * ray.depth, line.current.index, facet, hit.facet.slope);
                }
                None => target.strip.put_sky(k),
            }
            k += 1;
            let Some(follower) = self.follower.as_ref().filter(|_| found.was_above) else { continue };
            if !column.is_some_and(|column| column.holds(k - 1)) {
                column = Column::new(self.scene, follower.slopes, &target.strip, k - 1);
            }
            let Some(column) = &mut column else { continue };
            let traced = match &found.hit {
                Some(hit) => follower.trace(column, &mut line.current, hit, k - 1, target, &mut line.counts.samples),
                None => follower.trace_sky(column, k, found.reach, target),
            };
            if let Some(traced) = traced {
                line.counts.hits += if found.hit.is_some() { (traced.next - k) as u64 } else { 0 };
                k = traced.next;
                line.facet = None;
                let ray = self.scene.view.ray(target.strip.pixel(k - 1));
                line.recent.push(Some(Known { ray, entry: self.scene.entry(&ray), reach: traced.reach }));
            }
        }
        line.counts
    }

    /// Casts a ray.
    #[inline(always)]
    fn find<'f>(&'f self, line: &mut LineState<'f>, ray: &Ray) -> Outcome {
        let scene = self.scene;
        let entry = scene.entry(ray);
        let were_under = line.counts.under;
        // Cells may reach beyond the border; without such cells the walk ends by itself.
        let border = if scene.ground.is_cut() { scene.departure(ray) } else { f32::INFINITY };
        let (mut hit, start) = self.start(line, ray, entry, border);
        if hit.is_none() {
            // Below the ground nothing is proven.
            let start = if line.counts.under == were_under { start } else { entry };
            let same = line.facet.filter(|(tile, _)| *tile == line.current.index && line.tried > 0 && start > entry);
            let again = same.and_then(|(_, facet)| {
                line.counts.samples += 1;
                let s = line.current.meets(&line.current.along(ray), &facet, start).filter(|s| *s <= border)?;
                Some(Hit { s, facet })
            });
            let LineState { current, counts, .. } = line;
            hit = again.or_else(|| scene.first_hit(ray, entry, [start, border], current, counts));
        }
        // Beyond the ground's border a ray that hit nothing proves nothing.
        let reach = hit.map_or_else(|| scene.departure(ray), |hit| hit.s);
        let was_above = line.counts.under == were_under;
        line.facet = hit.filter(|_| was_above).map(|hit| (line.current.index, hit.facet));
        line.recent.push(was_above.then_some(Known { ray: *ray, entry, reach }));
        Outcome { hit, reach, was_above }
    }

    /// Where a ray starts, and the hit before that, if there is one in an interval that its witness
    /// does not prove.
    #[inline(always)]
    fn start<'f>(&'f self, line: &mut LineState<'f>, ray: &Ray, entry: f32, border: f32) -> (Option<Hit>, f32) {
        let scene = self.scene;
        let LineState { current, recent, tried, counts, .. } = line;
        let below = recent.nearest_first(*tried);
        let Some((below, unproven)) = self.rule.find_witness(ray, below, |below| (&below.ray, below.reach)) else {
            counts.without_witness += 1;
            let is_above = ray.direction.z < 0.0 && scene.highest < 0.0;
            return (None, entry.max(if is_above { scene.highest / ray.direction.z } else { 0.0 }));
        };
        let start = below.reach.max(entry);
        // Before the witness entered the ground's bounds, it proves nothing.
        let gap = below.entry.min(start).min(border);
        let mut hit = None;
        if entry < gap {
            hit = scene.first_hit(ray, entry, [entry, gap], current, counts);
        }
        let mut is_looked_at = false;
        for [from, to] in unproven {
            let (from, to) = (from.max(entry.max(gap)), to.min(start).min(border));
            if from < to && hit.is_none() {
                is_looked_at = true;
                hit = scene.first_hit(ray, entry, [from, to], current, counts);
            }
        }
        counts.partly_proven += u64::from(is_looked_at);
        (hit, start)
    }
}
