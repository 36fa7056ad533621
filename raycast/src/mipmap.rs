//! One exact ray per pixel: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel: "Maximum mipmaps for fast, accurate,
//! and scalable dynamic height field rendering", I3D 2008), then the facets of the cell, the same that the mesh draws, then
//! colour averaged over the pixel's footprint on the ground. No voxels.
//!
//! It takes no line of pixels for granted. Where the ray below proves that a stretch is in the air (see [`crate::cast`]; here for
//! every parameter, not for samples alone) it starts behind that stretch; and where it starts over the facet that the ray below
//! hit, and meets that facet, nothing else has to be looked at.

use crate::cast::{Coherence, Counts, LineOptions};
use crate::color::Mip;
use crate::facets::{Crossing, Entered, Facet, Hit};
use crate::frame::{Frame, Place, exit};
use crate::ground::Link;
use crate::view::Ray;
use glam::{Vec2, Vec3};

/// Most taps along a footprint; longer ones are averaged from coarser mips.
const MOST_TAPS: f32 = 8.0;
/// Rays below that may prove a start.
const MOST_KNOWN: usize = 4;

/// A ray that was cast: in the air from `entry` to `reach`.
#[derive(Debug, Clone, Copy)]
struct Known {
    ray: Ray,
    entry: f32,
    reach: f32,
}

impl Frame<'_> {
    /// Casts the rays of a line's pixels, bottom up.
    pub(crate) fn cast_exact(&self, options: &LineOptions<'_>, pixels: impl Iterator<Item = [u32; 2]>) -> Counts {
        let mut counts = Counts::default();
        let mut known: [Option<Known>; MOST_KNOWN] = [None; MOST_KNOWN];
        let mut next = 0;
        let Some(mut current) = self.enter_exact(0) else { return self.cast_nothing(pixels) };
        // The facet that the ray below hit, and its tile.
        let mut facet: Option<(u32, Facet)> = None;
        let is_cut = self.ground.is_cut();
        for pixel in pixels {
            counts.rays += 1;
            let ray = self.view.ray(pixel);
            let entry = self.entry(&ray);
            let tried = if options.coherence == Coherence::Proven { MOST_KNOWN } else { 0 };
            let below = (1..=tried).filter_map(|back| known[(next + MOST_KNOWN - back) % MOST_KNOWN]);
            // Cells may reach beyond the border; without such cells it ends by itself.
            let border = if is_cut { self.departure(&ray) } else { f32::INFINITY };
            let mut hit = None;
            let start = match options.steepness.nearest_proof(&ray, below, |below| (&below.ray, below.reach)) {
                Some((below, doubts)) => {
                    let start = below.reach.max(entry);
                    // Where the lower ray was not over the ground yet it says nothing.
                    let gap = below.entry.min(start);
                    if entry < gap {
                        hit = self.first_hit(&ray, entry, gap, &mut current, &mut counts);
                    }
                    let mut is_doubted = false;
                    for [from, to] in doubts {
                        let (from, to) = (from.max(entry.max(gap)), to.min(start));
                        if from < to && hit.is_none() {
                            is_doubted = true;
                            hit = self.first_hit(&ray, from, to, &mut current, &mut counts);
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
                let same = facet.filter(|(tile, _)| *tile == current.index && tried > 0);
                let again = same.and_then(|(_, facet)| {
                    counts.samples += 1;
                    let s = current.meets(&current.along(&ray), &facet, start).filter(|s| *s <= border)?;
                    Some(Hit { s, facet })
                });
                hit = again.or_else(|| self.first_hit(&ray, start, border, &mut current, &mut counts));
            }
            let reach = match hit {
                Some(hit) => {
                    counts.hits += 1;
                    self.picture.put(pixel, self.shade_footprint(&current, &ray, &hit), hit.s * ray.depth);
                    hit.s
                }
                None => {
                    self.picture.put(pixel, self.sky, f32::NAN);
                    // Beyond the ground's border it says nothing.
                    self.departure(&ray)
                }
            };
            facet = hit.map(|hit| (current.index, hit.facet));
            known[next] = Some(Known { ray, entry, reach });
            next = (next + 1) % MOST_KNOWN;
        }
        counts
    }

    /// Where, from `from` on and before `until`, a ray meets the ground. `current` is the tile that it is likely in, and that it
    /// hit.
    fn first_hit<'f>(
        &'f self,
        ray: &Ray,
        from: f32,
        until: f32,
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
                        continue;
                    }
                    Place::Left => return None,
                }
                if let Some(skip) = self.skip_nodes(ray, s) {
                    s = past(skip);
                    continue;
                }
            }
            is_here = false;
            match current.cross(&current.along(ray), s, until, &mut counts.samples) {
                Crossing::Hit(hit) => return Some(hit),
                Crossing::Left(out) => s = past(out.max(s)),
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
    fn enter_exact(&self, index: u32) -> Option<Entered<'_>> {
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

    /// Colour averaged over the part of the facet's plane that a pixel covers.
    fn shade_footprint(&self, entered: &Entered<'_>, ray: &Ray, hit: &Hit) -> u32 {
        let (placed, tile, s) = (&self.placed[entered.index as usize], entered.tile, hit.s);
        let slope = hit.facet.slope * placed.per_m;
        let normal = Vec3::new(-slope.x, -slope.y, 1.0);
        let depth = s * ray.depth;
        let direction = ray.direction / ray.depth;
        let facing = normal.dot(direction);
        let limit = 0.01 * depth;
        let axis = |step: Vec3| {
            // Surfaces that are seen edge on have no end in this direction: cut to a hundredth of the distance.
            let across = (step - direction * (normal.dot(step) / facing)) * depth;
            let across = across.truncate();
            let length = across.length();
            let across = if length > limit { across * (limit / length) } else { across };
            if across.is_finite() { across } else { direction.truncate().normalize_or_zero() * limit }
        };
        let [column, row] = self.view.steps();
        let scale = self.texels_per_m(placed);
        let (across, along) = (axis(column) * scale, axis(row) * scale);
        let center = self.texel(placed, ray.direction.truncate() * s);
        let [r, g, b] = self.average(self.layer(tile), center, across, along);
        u32::from_le_bytes([r, g, b, 255])
    }

    /// Mean colour of a parallelogram, texels: taps along the long axis of its ellipse, at the mips whose texels are as wide
    /// as the short one.
    fn average(&self, layer: &[u8], center: Vec2, a: Vec2, b: Vec2) -> [u8; 3] {
        let layout = self.ground.shape().color;
        let (xx, yy, xy) = (a.x * a.x + b.x * b.x, a.y * a.y + b.y * b.y, a.x * a.y + b.x * b.y);
        let mean = 0.5 * (xx + yy);
        let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let long = (mean + spread).sqrt();
        let short = (mean - spread).max(0.0).sqrt().max(1.0).max(long / MOST_TAPS);
        // The eigenvector of the larger eigenvalue, from whichever row of the matrix is longer.
        let axis = if xx >= yy { Vec2::new(mean + spread - yy, xy) } else { Vec2::new(xy, mean + spread - xx) };
        let axis = axis.normalize_or(Vec2::X);
        let ratio = (long / short).clamp(1.0, MOST_TAPS);
        // Rounded up.
        let count = ratio as u32 + u32::from(ratio > (ratio as u32) as f32);
        let taps = count as f32;
        let lod = log2(short).clamp(0.0, (layout.mips - 1) as f32);
        let level = lod as u32;
        let share = lod - level as f32;
        let mips = [level, (level + 1).min(layout.mips - 1)].map(|level| Mip::new(layer, layout, level));
        let [Some(fine), Some(coarse)] = mips else { return [0; 3] };
        let scales = [level, (level + 1).min(layout.mips - 1)].map(|level| 1.0 / (1u32 << level) as f32);
        let mut sum = Vec3::ZERO;
        for tap in 0..count {
            // The axis is that of texels from the north: `texel` turned y over, and so did nobody for footprints yet.
            let offset = ((tap as f32 + 0.5) / taps - 0.5) * (long - short).max(0.0);
            let at = center + Vec2::new(axis.x, -axis.y) * offset;
            let color = fine.bilinear_rgb(at * scales[0]);
            let color = Vec3::from_array(color);
            sum += if share < 0.02 {
                color
            } else {
                color + (Vec3::from_array(coarse.bilinear_rgb(at * scales[1])) - color) * share
            };
        }
        let mean = sum / taps + 0.5;
        [mean.x as u8, mean.y as u8, mean.z as u8]
    }
}

/// log2 of a number from 1 on, within a hundredth and without a jump: a parabola between powers of two.
#[inline(always)]
fn log2(x: f32) -> f32 {
    let exponent = (x.to_bits() >> 23) as f32 - 127.0;
    let mantissa = f32::from_bits(x.to_bits() & 0x007f_ffff | 0x3f80_0000);
    exponent + (2.0 - mantissa * (1.0 / 3.0)) * mantissa - 5.0 / 3.0
}

/// A little further: a point on a border belongs to what lies behind it.
#[inline(always)]
fn past(s: f32) -> f32 {
    s + s.abs() * 2e-6 + 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithms_are_right_to_a_hundredth() {
        for n in 0..4000 {
            let x = 1.0 + 0.017 * n as f32;
            assert!((log2(x) - x.log2()).abs() < 0.011, "{x}");
        }
    }
}
