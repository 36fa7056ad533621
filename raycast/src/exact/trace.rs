//! Following the ground along a plane of rays.
//!
//! Pixels above each other in a column (or beside each other in a row) have rays in one plane through the eye. Within it, at
//! one parameter `s`, rays lie on a line that leans as the plane does, always the same way. Where no ground is steeper than
//! that line ([`crate::steepness`]), the line enters the ground once, so that the plane's cut of the ground is the graph of a
//! function of `s`: one line, from facet to facet, without islands. Pixels are then found by following it:
//!
//! ```text
//!             ·b                 the first time that the cut rises to a pixel is what the pixel's ray meets first:
//!       a   · │·   ·c            up to a it is seen, from a to b hidden, from b on hidden until it is as high as b,
//!      ·  ·   │  ·               at c
//!    ·        │                  ·
//! ```
//!
//! Posts are projected into the picture once a frame ([`crate::exact::projected`]). A step from one facet to the next is then a
//! comparison: on which side of the plane is the next post? Where the plane cuts the edge between, pixel and one over depth are linear
//! along it, and so is one over depth from pixel to pixel within a facet.

use crate::exact::facets::{Entered, Hit};
use crate::exact::projected::Posts;
use crate::exact::strip::{Seen, Strip};
use crate::frame::Frame;
use crate::model::Found;
use crate::steepness::Steepness;
use crate::view::Ray;
use glam::{Vec2, Vec3};

/// Pixels for which the ground's steepness is looked up at once.
pub(crate) const CHUNK: usize = 16;
/// Hidden facets that are followed before it is cheaper to look for the next visible one through the pyramid.
const MOST_HIDDEN: u32 = 24;
/// The highest ground is looked up for so much more around, as a share of the distance: the lines beside are likely to ask for it.
const SEEN_AROUND: f32 = 1.0 / 16.0;
/// No line crosses more facets within tiles; a bound that no rounding can keep from being reached.
const MOST_FACETS: u32 = 1 << 16;

/// Pixels of a strip with rays in one plane, and what makes a post's place in it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column<'a> {
    steepness: &'a Steepness,
    /// The pixels.
    begin: usize,
    last: usize,
    /// Whether they are in one row, instead of one column.
    is_row: bool,
    /// Column (or row) of all of them, row (or column) of pixel number 0, and from number to number: 1 or -1.
    fixed: f32,
    first: f32,
    sign: f32,
    /// Place in the picture of pixel number 0, and from number to number.
    origin: Vec2,
    step: Vec2,
    /// s per depth at pixel number 0, and from number to number.
    guide: [f32; 2],
    chunk: Chunk,
}

/// Pixels for which ground is known to be gentle up to some distance.
#[derive(Debug, Clone, Copy)]
struct Chunk {
    /// Which; none at first.
    index: Option<usize>,
    /// Lowest pixel to which the cut may fall.
    lowest: f32,
    /// Distance, metres, divided by the most metres per s of a ray.
    gentle_until_s: f32,
}

/// Where following ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Traced {
    /// The first pixel that is not known yet.
    pub(crate) next: usize,
    /// The parameter up to which the one before it is in the air.
    pub(crate) reach: f32,
}

impl<'a> Column<'a> {
    /// The pixels from `k` on that are in one column or row; `None` when there are fewer than `fewest`.
    pub(crate) fn new(
        frame: &Frame<'_>,
        steepness: &'a Steepness,
        strip: &Strip<'_>,
        k: usize,
        fewest: usize,
    ) -> Option<Self> {
        let pixels = strip.pixels;
        let ([x, y], [next_x, next_y]) = (*pixels.get(k)?, *pixels.get(k + fewest - 1)?);
        let minor = match (x == next_x, y == next_y) {
            (true, false) => 0,
            (false, true) => 1,
            _ => return None,
        };
        let fixed = pixels[k][minor];
        let last = if pixels[pixels.len() - 1][minor] == fixed {
            pixels.len() - 1
        } else {
            k + pixels[k..].iter().take_while(|pixel| pixel[minor] == fixed).count() - 1
        };
        let major = 1 - minor;
        let sign = if pixels[k + 1][major] > pixels[k][major] { 1.0f32 } else { -1.0 };
        let first = f32::from(pixels[k][major]) - sign * k as f32;
        let (mut origin, mut step) = (Vec2::ZERO, Vec2::ZERO);
        (origin[major], origin[minor], step[major]) = (first, f32::from(fixed), sign);
        let guide = frame.view.guide();
        let at_0 = frame.view.direction_at(origin.x, origin.y).dot(guide);
        let [per_column, per_row] = frame.view.steps();
        let per_pixel = (per_column * step.x + per_row * step.y).dot(guide);
        Some(Self {
            steepness,
            begin: k,
            last,
            is_row: minor == 1,
            fixed: f32::from(fixed),
            first,
            sign,
            origin,
            step,
            guide: [at_0, per_pixel],
            chunk: Chunk { index: None, lowest: 0.0, gentle_until_s: 0.0 },
        })
    }

    /// Whether pixel `k` is in it.
    #[inline(always)]
    pub(crate) fn holds(&self, k: usize) -> bool {
        (self.begin..=self.last).contains(&k)
    }

    /// s per depth of a pixel.
    #[inline(always)]
    fn s_per_depth(&self, k: f32) -> f32 {
        self.guide[0] + self.guide[1] * k
    }

    /// Sees to it that the chunk of pixel `k` is known.
    #[inline(always)]
    fn enter_chunk(&mut self, frame: &Frame<'_>, k: usize, strip: &mut Strip<'_>) {
        if self.chunk.index != Some(k / CHUNK) {
            self.chunk = self.chunk_of(frame, k / CHUNK, strip);
        }
    }

    #[inline(never)]
    fn chunk_of(&self, frame: &Frame<'_>, index: usize, strip: &mut Strip<'_>) -> Chunk {
        let lowest = (index * CHUNK).saturating_sub(CHUNK) as f32;
        let highest = ((index + 1) * CHUNK).min(self.last + 1) as f32;
        let unknown = Chunk { index: Some(index), lowest, gentle_until_s: 0.0 };
        let ray = |k: f32| {
            let at = self.origin + self.step * k;
            frame.view.ray_along(at.x, at.y)
        };
        let (Some(low), Some(high)) = (ray(lowest), ray(highest)) else { return unknown };
        let by = high.direction - low.direction;
        if by.z <= 0.0 {
            return unknown;
        }
        let (a, b) = (low.direction.truncate(), high.direction.truncate());
        let limit = by.z * by.z / by.truncate().length_squared();
        if !frame.is_entered_above([&low, &high], &mut strip.seen[2 * index]) {
            return unknown;
        }
        let gentle_m = self.steepness.gentle_until(low.direction, high.direction, limit);
        // Rounding.
        Chunk { gentle_until_s: 0.999 * gentle_m / a.length().max(b.length()), ..unknown }
    }
}

impl Frame<'_> {
    /// Whether rays between two, in one plane, are above the ground where some of them have come over its bounds and others have
    /// not: there those that have not prove nothing.
    fn is_entered_above(&self, rays: [&Ray; 2], seen: &mut Seen) -> bool {
        if !self.is_eye_beside() {
            return true;
        }
        let (mut first, mut last) = (0.0f32, 0.0f32);
        for axis in 0..2 {
            let (min, max) = (self.bounds.min[axis], self.bounds.max[axis]);
            let border = if min > 0.0 {
                min
            } else if max < 0.0 {
                max
            } else {
                continue;
            };
            let entries = rays.map(|ray| border / ray.direction[axis]);
            // Some never come over it.
            if !entries.iter().all(|entry| *entry > 0.0 && entry.is_finite()) {
                return false;
            }
            first = first.max(entries[0].min(entries[1]));
            last = last.max(entries[0].max(entries[1]));
        }
        self.is_above(rays, [first, last], seen)
    }

    /// Whether rays between two, in one plane, are above the ground from one parameter to another.
    fn is_above(&self, rays: [&Ray; 2], [first, last]: [f32; 2], seen: &mut Seen) -> bool {
        let corners = rays.map(|ray| [ray.direction * first, ray.direction * last]);
        let corners = [corners[0][0], corners[0][1], corners[1][0], corners[1][1]];
        let low = corners.into_iter().fold(Vec3::INFINITY, Vec3::min);
        let high = corners.into_iter().fold(Vec3::NEG_INFINITY, Vec3::max);
        let furthest = high.abs().max(low.abs()).max_element();
        // A little more on all sides: rounding.
        let margin = 1e-5 * furthest + 0.01;
        if low.z - margin > self.highest {
            return true;
        }
        let (eye, unit) = (self.view.eye_in_world(), self.ground.shape().lattice_unit_m);
        let lattice = |at: Vec3, by: f32| [0, 1].map(|axis| (f64::from(at[axis] + by) + eye[axis]) / unit);
        let top = |tile: u32| self.ground.tiles()[tile as usize].top_m;
        let highest_in = |by: f32| {
            let (low, high) = (lattice(low, -by), lattice(high, by));
            Seen { low, high, highest: self.ground.tree().highest_in(low, high, &top) }
        };
        let is_below = |highest: f32| f64::from(low.z - margin) + eye.z - self.ground.datum_m() > f64::from(highest);
        if !seen.holds(lattice(low, -margin), lattice(high, margin)) {
            *seen = highest_in(margin + furthest * SEEN_AROUND);
        }
        is_below(seen.highest) || is_below(highest_in(margin).highest)
    }

    /// Of the pixels from `k` on, those that see sky because the ray below them met nothing up to `reach`, where it left the
    /// ground: chunk by chunk, as long as the ground is gentle that far and lies below all rays from there on.
    pub(crate) fn trace_sky(
        &self,
        column: &mut Column<'_>,
        k: usize,
        reach: f32,
        strip: &mut Strip<'_>,
    ) -> Option<Traced> {
        let mut traced = Traced { next: k, reach };
        while traced.next <= column.last {
            column.enter_chunk(self, traced.next, strip);
            if traced.reach >= column.chunk.gentle_until_s {
                break;
            }
            let next = ((traced.next / CHUNK + 1) * CHUNK).min(column.last + 1);
            let rays = [traced.next - 1, next - 1].map(|k| self.view.ray(strip.pixel(k)));
            // None of those between leaves the ground later.
            let last = self.last_exit(rays.each_ref());
            let is_left = last <= traced.reach
                || last.is_finite()
                    && self.is_above(rays.each_ref(), [traced.reach, last], &mut strip.seen[2 * (next / CHUNK) + 1]);
            if !is_left {
                break;
            }
            (traced.next..next).for_each(|k| strip.put_sky(k));
            traced = Traced { next, reach: self.departure(&rays[1]) };
        }
        (traced.next > k).then_some(traced)
    }

    /// Follows the ground from where pixel `k` meets it, as far as it is gentle, and puts what the next pixels see into the
    /// strip. `entered` is the tile of the hit, and then that of the last pixel. `None` when no pixel was found.
    pub(crate) fn trace<'f>(
        &'f self,
        column: &mut Column<'_>,
        entered: &mut Entered<'f>,
        hit: &Hit,
        k: usize,
        strip: &mut Strip<'_>,
        samples: &mut u64,
    ) -> Option<Traced> {
        if k >= column.last {
            return None;
        }
        column.enter_chunk(self, k + 1, strip);
        if hit.s >= column.chunk.gentle_until_s {
            return None;
        }
        let (next, tile) = if column.is_row {
            self.follow::<1>(column, entered.index, hit, k, strip, samples)?
        } else {
            self.follow::<0>(column, entered.index, hit, k, strip, samples)?
        };
        if tile != entered.index {
            *entered = self.enter_exact(tile)?;
        }
        Some(Traced { next, reach: column.s_per_depth((next - 1) as f32) / strip.nearness[next - 1] })
    }

    /// The same, from a tile: the first pixel that is not known yet, and the tile that the last one sees. `MINOR` is the axis of the
    /// picture that pixels have in common.
    #[inline(never)]
    fn follow<const MINOR: usize>(
        &self,
        column: &mut Column<'_>,
        tile: u32,
        hit: &Hit,
        k: usize,
        strip: &mut Strip<'_>,
        samples: &mut u64,
    ) -> Option<(usize, u32)> {
        let (mut here, mut seen) = (tile, tile);
        let mut posts = self.projected.of(here);
        let Step { mut before, mut after, mut third } = leaving::<MINOR>(&posts, column, hit)?;
        let fixed = column.fixed;
        let is_cut = self.ground.is_cut();
        let mut row = k + 1;
        // Where the cut enters the facet: pixel number, and one over depth.
        let mut from = [k as f32, column.s_per_depth(k as f32) / hit.s];
        let mut hidden = 0;
        for _ in 0..MOST_FACETS {
            let Some(to) = crossing::<MINOR>(&posts, column, [before, after]) else { break };
            if to[0] >= row as f32 {
                hidden = 0;
                seen = here;
                let last = (to[0] as usize).min(column.last);
                let per_pixel = (to[1] - from[1]) / (to[0] - from[0]);
                let facet = posts.facet([before, after, third]);
                let s_per_depth = column.s_per_depth(to[0]);
                loop {
                    column.enter_chunk(self, row, strip);
                    if s_per_depth >= column.chunk.gentle_until_s * to[1] {
                        break;
                    }
                    let end = last.min(row / CHUNK * CHUNK + CHUNK - 1);
                    let slope = || posts.slope(facet);
                    strip.put_run([row, end], from[0], [from[1], per_pixel], [here as usize, facet], slope);
                    if is_cut && self.is_past_border(column, end, strip) {
                        // The way to the ground grows from pixel to pixel.
                        row = (row..end).find(|k| self.is_past_border(column, *k, strip)).unwrap_or(end);
                        break;
                    }
                    row = end + 1;
                    if row > last {
                        break;
                    }
                }
                // All pixels are known, or the ground is not gentle.
                if row > column.last || row <= last {
                    break;
                }
            } else {
                hidden += 1;
                if hidden > MOST_HIDDEN || to[0] < column.chunk.lowest || to[0].is_nan() {
                    break;
                }
            }
            from = to;
            *samples += 1;
            // A facet and its neighbour are a parallelogram.
            let mut next = before.wrapping_add(after).wrapping_sub(third);
            let mut at = posts.place(next)[MINOR];
            if at.is_nan() {
                let Some((other, edge)) = self.neighbour(here, &posts, [before, after, third]) else { break };
                here = other;
                posts = self.projected.of(here);
                [before, after, next] = edge;
                at = posts.place(next)[MINOR];
                if at.is_nan() {
                    break;
                }
            }
            let is_before = at > fixed;
            third = if is_before { before } else { after };
            before = if is_before { next } else { before };
            after = if is_before { after } else { next };
        }
        (row > k + 1).then_some((row, seen))
    }

    /// Whether what a pixel was said to see lies beyond the ground's border, over which cells may reach.
    fn is_past_border(&self, column: &Column<'_>, k: usize, strip: &Strip<'_>) -> bool {
        let ray = self.view.ray(strip.pixel(k));
        column.s_per_depth(k as f32) / strip.nearness[k] > self.departure(&ray)
    }

    /// The tile beside, of the same level, that has the facet beyond an edge of a facet, whose third post is the last one; and there the
    /// edge, and the third post of that facet.
    #[inline(never)]
    fn neighbour(&self, index: u32, posts: &Posts<'_>, facet: [usize; 3]) -> Option<(u32, [usize; 3])> {
        let tile = &self.ground.tiles()[index as usize];
        let log = tile.log_spacing;
        let [p, n, third] = facet.map(|post| posts.cell(post));
        let next = [0, 1].map(|axis| p[axis] + n[axis] - third[axis]);
        let middle = [0, 1].map(|axis| {
            let low = p[axis].min(n[axis]).min(next[axis]);
            f64::from(tile.origin[axis]) + (f64::from(low) + 0.5) * f64::from(1u32 << log)
        });
        let Found::Tile(found) = self.ground.tree().find(middle) else { return None };
        let other = &self.ground.tiles()[found as usize];
        if other.log_spacing != log || found == index {
            return None;
        }
        let beyond = self.projected.of(found);
        let move_by = |cell: [i32; 2], axis: usize| {
            cell[axis] + ((i64::from(tile.origin[axis]) - i64::from(other.origin[axis])) >> log) as i32
        };
        let moved = |cell: [i32; 2]| beyond.index([0, 1].map(|axis| move_by(cell, axis)));
        let edge = [moved(p)?, moved(n)?, moved(next)?];
        let is_same = |n: usize| posts.height(facet[n]) == beyond.height(edge[n]);
        (is_same(0) && is_same(1)).then_some((found, edge))
    }
}

/// Posts of a facet: those of the edge by which the cut leaves it upwards, the one with the greater coordinate first, and the third one.
#[derive(Debug, Clone, Copy)]
struct Step {
    before: usize,
    after: usize,
    third: usize,
}

/// Where a plane cuts an edge: pixel number, and one over depth.
#[inline(always)]
fn crossing<const MINOR: usize>(posts: &Posts<'_>, column: &Column<'_>, edge: [usize; 2]) -> Option<[f32; 2]> {
    let [p, n] = [posts.get(edge[0])?, posts.get(edge[1])?];
    let share = (column.fixed - p[MINOR]) / (n[MINOR] - p[MINOR]);
    let at = p[1 - MINOR] + (n[1 - MINOR] - p[1 - MINOR]) * share;
    Some([(at - column.first) * column.sign, p[2] + (n[2] - p[2]) * share])
}

/// How the cut leaves the facet of a hit.
#[inline(always)]
fn leaving<const MINOR: usize>(posts: &Posts<'_>, column: &Column<'_>, hit: &Hit) -> Option<Step> {
    let [i, j] = [hit.facet.corner.x as i32, hit.facet.corner.y as i32];
    let middle = if hit.facet.is_south_east { [i + 1, j] } else { [i, j + 1] };
    let all = [posts.index([i, j])?, posts.index(middle)?, posts.index([i + 1, j + 1])?];
    let places = all.map(|post| posts.place(post)[MINOR]);
    if places.iter().any(|at| at.is_nan()) {
        return None;
    }
    let is_before = places.map(|at| at > column.fixed);
    // The post that is alone on its side of the plane.
    let alone = match is_before {
        [a, b, c] if b == c && a != b => 0,
        [a, b, c] if a == c && a != b => 1,
        [a, b, c] if a == b && a != c => 2,
        _ => return None,
    };
    let others = [all[(alone + 1) % 3], all[(alone + 2) % 3]];
    let edges = others.map(|other| if is_before[alone] { [all[alone], other] } else { [other, all[alone]] });
    let mut heights = [0.0; 2];
    for (height, edge) in heights.iter_mut().zip(edges) {
        *height = crossing::<MINOR>(posts, column, edge)?[0];
    }
    let upper = usize::from(heights[1] > heights[0]);
    let [before, after] = edges[upper];
    Some(Step { before, after, third: others[1 - upper] })
}
