//! One exact ray per pixel: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel: "Maximum mipmaps for fast, accurate,
//! and scalable dynamic height field rendering", I3D 2008), then the facets of the cell, the same that the mesh draws. No
//! voxels. Colours follow line by line ([`crate::shade::paint`]).
//!
//! It takes no line of pixels for granted. Where the ground is gentle enough, pixels above one that hit are found by following
//! the ground ([`crate::exact::trace`]). Elsewhere, where the ray below proves that a stretch is in the air (see [`crate::coherent::cast`]; here for
//! every parameter, not for samples alone) a ray starts behind that stretch; and where it starts over the facet that the ray
//! below hit, and meets that facet, nothing else has to be looked at.
//!
//! The ground is a surface: it has no sides where tiles end. A ray that comes over it lower than its edge is under it, and meets
//! facets from below, or none, as the mesh draws them (`docs/rendering.md`, culling). It proves nothing for others.

use crate::coherent::cast::{Coherence, Counts, LineOptions};
use crate::exact::facets::{Crossing, Entered, Facet, Hit};
use crate::exact::strip::Strip;
use crate::exact::trace::Column;
use crate::frame::{Frame, Place, exit};
use crate::model::Link;
use crate::view::Ray;
use glam::Vec2;

/// Rays below that may prove a start.
const MOST_KNOWN: usize = 4;
/// Pixels above each other, from which on the ground is followed.
const FEWEST_FOLLOWED: usize = 3;

/// A ray that was cast: in the air from `entry` to `reach`.
#[derive(Debug, Clone, Copy)]
struct Known {
    ray: Ray,
    entry: f32,
    reach: f32,
}

/// Where a ray is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Side {
    /// Over no tile: nothing is known.
    Outside,
    Above,
    Below,
}

impl Frame<'_> {
    /// What the pixels of a line see, bottom up.
    pub(crate) fn find_exact(&self, options: &LineOptions<'_>, strip: &mut Strip<'_>) -> Counts {
        let mut counts = Counts { rays: strip.pixels.len() as u64, ..Counts::default() };
        let mut known: [Option<Known>; MOST_KNOWN] = [None; MOST_KNOWN];
        let mut next = 0;
        let Some(mut current) = self.enter_exact(0) else {
            (0..strip.pixels.len()).for_each(|k| strip.put_sky(k));
            return counts;
        };
        // The facet that the ray below hit, and its tile.
        let mut facet: Option<(u32, Facet)> = None;
        let is_cut = self.ground.is_cut();
        let is_followed = options.coherence == Coherence::Proven;
        // In one column the rays below prove the same, the nearest one for the longest way.
        let tried = match options.coherence {
            Coherence::Proven if strip.is_straight() => 1,
            Coherence::Proven => MOST_KNOWN,
            _ => 0,
        };
        let mut column: Option<Column<'_>> = None;
        let mut k = 0;
        while k < strip.pixels.len() {
            let ray = self.view.ray(strip.pixel(k));
            let entry = self.entry(&ray);
            let were_under = counts.under;
            let below = (1..=tried).filter_map(|back| known[(next + MOST_KNOWN - back) % MOST_KNOWN]);
            // Cells may reach beyond the border; without such cells it ends by itself.
            let border = if is_cut { self.departure(&ray) } else { f32::INFINITY };
            let mut hit = None;
            let start = match options.steepness.nearest_proof(&ray, below, |below| (&below.ray, below.reach)) {
                Some((below, doubts)) => {
                    let start = below.reach.max(entry);
                    // Where the lower ray was not over the ground yet it says nothing.
                    let gap = below.entry.min(start).min(border);
                    if entry < gap {
                        hit = self.first_hit(&ray, entry, [entry, gap], &mut current, &mut counts);
                    }
                    let mut is_doubted = false;
                    for [from, to] in doubts {
                        let (from, to) = (from.max(entry.max(gap)), to.min(start).min(border));
                        if from < to && hit.is_none() {
                            is_doubted = true;
                            hit = self.first_hit(&ray, entry, [from, to], &mut current, &mut counts);
                        }
                    }
                    counts.doubted += u64::from(is_doubted);
                    start
                }
                None => {
                    counts.unproven += 1;
                    let is_above = ray.direction.z < 0.0 && self.highest < 0.0;
                    entry.max(if is_above { self.highest / ray.direction.z } else { 0.0 })
                }
            };
            if hit.is_none() {
                // Under the ground nothing is proven.
                let start = if counts.under == were_under { start } else { entry };
                let same = facet.filter(|(tile, _)| *tile == current.index && tried > 0 && start > entry);
                let again = same.and_then(|(_, facet)| {
                    counts.samples += 1;
                    let s = current.meets(&current.along(&ray), &facet, start).filter(|s| *s <= border)?;
                    Some(Hit { s, facet })
                });
                hit = again.or_else(|| self.first_hit(&ray, entry, [start, border], &mut current, &mut counts));
            }
            let reach = match hit {
                Some(hit) => {
                    counts.hits += 1;
                    let facet = current.facet_number(&hit.facet);
                    strip.put(k, hit.s * ray.depth, current.index, facet, hit.facet.slope);
                    hit.s
                }
                None => {
                    strip.put_sky(k);
                    // Beyond the ground's border it says nothing.
                    self.departure(&ray)
                }
            };
            let was_above = counts.under == were_under;
            facet = hit.filter(|_| was_above).map(|hit| (current.index, hit.facet));
            known[next] = was_above.then_some(Known { ray, entry, reach });
            next = (next + 1) % MOST_KNOWN;
            k += 1;
            if !is_followed || !was_above {
                continue;
            }
            if !column.is_some_and(|column| column.holds(k - 1)) {
                column = Column::new(self, options.steepness, strip, k - 1, FEWEST_FOLLOWED);
            }
            let Some(column) = &mut column else { continue };
            let last = match hit {
                Some(hit) => self.trace(column, &mut current, &hit, k - 1, strip, &mut counts.samples),
                None => self.trace_sky(column, k, reach, strip),
            };
            if let Some(traced) = last {
                counts.hits += if hit.is_some() { (traced.next - k) as u64 } else { 0 };
                k = traced.next;
                facet = None;
                let ray = self.view.ray(strip.pixel(k - 1));
                known[next] = Some(Known { ray, entry: self.entry(&ray), reach: traced.reach });
                next = (next + 1) % MOST_KNOWN;
            }
        }
        counts
    }

    /// Where, from `from` on and before `until`, a ray meets the ground. Up to `from` it is in the air, but for what is before its
    /// `entry` into the ground's bounds. `current` is the tile that it is likely in, and that it hit.
    fn first_hit<'f>(
        &'f self,
        ray: &Ray,
        entry: f32,
        [from, until]: [f32; 2],
        current: &mut Entered<'f>,
        counts: &mut Counts,
    ) -> Option<Hit> {
        let side = if from <= entry { Side::Outside } else { Side::Above };
        self.next_hit(ray, side, [from, until], current, counts)
    }

    /// The same from where a ray is known to be.
    pub(crate) fn next_hit<'f>(
        &'f self,
        ray: &Ray,
        mut side: Side,
        [from, until]: [f32; 2],
        current: &mut Entered<'f>,
        counts: &mut Counts,
    ) -> Option<Hit> {
        let mut s = from;
        let mut is_here = current.is_under(&current.along(ray), s);
        // A ray crosses fewer tiles than this; a bound that no rounding can keep from being reached.
        for _ in 0..1 << 16 {
            if !s.is_finite() || s >= until || ray.direction.z >= 0.0 && ray.direction.z * s > self.highest {
                return None;
            }
            if !is_here {
                match self.find(ray, s) {
                    Place::Tile(tile) if tile == current.index => {}
                    Place::Tile(tile) => *current = self.enter_exact(tile)?,
                    Place::HoleUntil(until) => {
                        s = past(until.max(s));
                        side = Side::Outside;
                        continue;
                    }
                    Place::Left => return None,
                }
                if let Some(skip) = self.skip_nodes(ray, s) {
                    side = Side::Above;
                    s = past(skip);
                    continue;
                }
            }
            is_here = false;
            let along = current.along(ray);
            if side == Side::Outside {
                side = if current.is_below(&along, s) { Side::Below } else { Side::Above };
                counts.under += u64::from(side == Side::Below);
            }
            if side == Side::Below {
                match current.emerge(&along, s, until, &mut counts.samples) {
                    Crossing::Hit(hit) if self.has_undersides => return Some(hit),
                    Crossing::Hit(hit) => {
                        side = Side::Above;
                        s = past(hit.s);
                    }
                    Crossing::Left(out) => s = past(out.max(s)),
                }
                continue;
            }
            match current.cross(&along, s, until, &mut counts.samples) {
                Crossing::Hit(hit) => return Some(hit),
                Crossing::Left(out) => s = past(out.max(s)),
            }
        }
        None
    }

    /// What a ray sees that comes over the ground lower than its edge, if it does: a tile and a parameter, or sky.
    pub(crate) fn seen_from_under(&self, ray: &Ray, counts: &mut Counts) -> Option<Option<(u32, f32)>> {
        let (entry, border) = (self.entry(ray), self.departure(ray));
        let mut s = entry;
        for _ in 0..1 << 16 {
            match self.find(ray, s) {
                Place::Tile(tile) => {
                    let mut current = self.enter_exact(tile)?;
                    if !current.is_below(&current.along(ray), s) {
                        return None;
                    }
                    let hit = self.first_hit(ray, s, [s, border], &mut current, counts);
                    return Some(hit.map(|hit| (current.index, hit.s)));
                }
                Place::HoleUntil(until) if until < border => s = past(until.max(s)),
                Place::HoleUntil(_) | Place::Left => return None,
            }
        }
        None
    }

    /// Descends the tree at a point of a ray; where the ray leaves the largest node that it passes above, if there is one.
    #[inline]
    pub(crate) fn skip_nodes(&self, ray: &Ray, s: f32) -> Option<f32> {
        let tree = self.ground.tree();
        let unit = self.ground.shape().lattice_unit_m;
        let eye = self.view.eye_in_world();
        let at = (ray.direction * s).as_dvec3() + eye;
        let size = (1u64 << (tree.log_side() + tree.root_level())) as f64;
        let point = [at.x, at.y].map(|v| (v / unit).clamp(0.0, size - 1.0) as u32);
        let eye_height = (eye.z - self.ground.datum_m()) as f32;
        let direction = ray.direction.truncate();
        let mut log = tree.log_side() + tree.root_level();
        let mut link = tree.root();
        loop {
            let highest = match link {
                Link::Empty => return None,
                Link::Tile(tile) => self.ground.tiles()[tile as usize].top_m,
                Link::Node(node) => tree.node(node).highest_m,
            };
            let low = [0, 1].map(|axis| (f64::from((point[axis] >> log) << log) * unit - eye[axis]) as f32);
            let side = ((1u64 << log) as f64 * unit) as f32;
            let low = Vec2::from_array(low);
            let out = exit(direction, low, low + Vec2::splat(side)).max(s);
            let lowest = eye_height + (ray.direction.z * s).min(ray.direction.z * out);
            if lowest > highest {
                return Some(out);
            }
            let Link::Node(node) = link else { return None };
            log -= 1;
            link = tree.child(node, point, log);
        }
    }

    #[inline]
    pub(crate) fn enter_exact(&self, index: u32) -> Option<Entered<'_>> {
        let tile = self.ground.tiles().get(index as usize)?;
        let placed = self.placed.get(index as usize)?;
        Some(Entered {
            index,
            tile,
            heights: self.ground.heights(tile),
            maxima: self.ground.maxima(tile),
            per_m: placed.per_m,
            at_0: -placed.corner.truncate() * placed.per_m,
            eye_height: (self.view.eye_in_world().z - self.ground.datum_m()) as f32,
        })
    }
}

/// A little further: a point on a border belongs to what lies behind it.
#[inline(always)]
pub(crate) fn past(s: f32) -> f32 {
    s + s.abs() * 2e-6 + 1e-6
}
