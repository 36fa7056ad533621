//! Following the ground along a plane of rays.
//!
//! The rays of pixels above each other in a column (or beside each other in a row) lie in one plane
//! through the eye. At one parameter `s` these rays lie on a line whose inclination is the same for
//! all `s`. Where no ground is steeper than that line ([`crate::proof::steepness`]), the line
//! enters the ground once. The plane's section of the ground is then the graph of a function of
//! `s`: one polyline, from facet to facet, without islands. Pixels are found by following it:
//!
//! ```text
//!             ·b                 the first time that the cut rises to a pixel is what the pixel's ray meets
//!       a   · │·   ·c            first: up to a it is seen, from a to b hidden, from b on hidden until it is
//!      ·  ·   │  ·               as high as b, at c
//!    ·        │                  ·
//! ```
//!
//! Posts are projected into the picture once a frame ([`super::projected`]). A step from one facet
//! to the next is then a comparison: on which side of the plane is the next post? Pixel number and
//! one over depth are linear along the edge that the plane cuts, and one over depth is linear from
//! pixel to pixel within a facet.

use super::column::{CHUNK, Column, Target};
use super::entered::{Entered, Hit};
use super::projected::{Posts, Projected};
use crate::model::Found;
use crate::proof::Steepness;
use crate::scene::Scene;
use crate::shade::strip::Strip;

/// Hidden facets that are followed at most; then it is cheaper to find the next visible one through
/// the pyramid. (Measured; see `docs/techniques.md`, *Thresholds*.)
const MOST_HIDDEN: u32 = 24;
/// No line crosses more facets within tiles. A bound on the loop that holds whatever rounding does.
const MOST_FACETS: u32 = 1 << 16;

/// Inputs for following the ground.
#[derive(Debug)]
pub(crate) struct Follower<'a> {
    pub(crate) scene: &'a Scene<'a>,
    pub(crate) projected: &'a Projected,
    pub(crate) slopes: &'a Steepness,
}

/// Where following ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Traced {
    /// The first pixel that is not yet known.
    pub(crate) next: usize,
    /// The parameter up to which the one before it is in the air.
    pub(crate) reach: f32,
}

/// Posts of a facet: the two of the edge through which the cut leaves it upwards, the one with the
/// greater coordinate first, then the third.
#[derive(Debug, Clone, Copy)]
struct Step {
    before: usize,
    after: usize,
    third: usize,
}

/// The facet that the cut is in.
#[derive(Debug, Clone, Copy)]
struct Cut<'a> {
    tile: u32,
    posts: Posts<'a>,
    step: Step,
    /// Where it entered the facet: pixel number, and one over depth.
    from: [f32; 2],
}

impl Follower<'_> {
    /// Marks the pixels from `k` on that see sky because the ray below them hit nothing up to
    /// `reach`, where it left the ground. Works chunk by chunk, as long as the ground may be
    /// followed that far and lies below all rays from there on.
    pub(crate) fn trace_sky(
        &self,
        column: &mut Column<'_>,
        k: usize,
        reach: f32,
        target: &mut Target<'_>,
    ) -> Option<Traced> {
        let scene = self.scene;
        let Target { strip, seen } = target;
        let mut traced = Traced { next: k, reach };
        while traced.next <= column.last {
            column.enter_chunk(scene, traced.next, seen);
            if traced.reach >= column.chunk.followed_until_s {
                break;
            }
            let next = ((traced.next / CHUNK + 1) * CHUNK).min(column.last + 1);
            let rays = [traced.next - 1, next - 1].map(|k| scene.view.ray(strip.pixel(k)));
            // No ray between these two leaves the ground later.
            let last = scene.last_departure(rays.each_ref());
            let is_left = last <= traced.reach
                || last.is_finite()
                    && scene.is_above(rays.each_ref(), [traced.reach, last], &mut seen[2 * (next / CHUNK) + 1]);
            if !is_left {
                break;
            }
            (traced.next..next).for_each(|k| strip.put_sky(k));
            traced = Traced { next, reach: scene.departure(&rays[1]) };
        }
        (traced.next > k).then_some(traced)
    }

    /// Follows the ground from where pixel `k` hits it, as far as slopes allow, and writes what the
    /// next pixels see into the strip. `entered` is the tile of the hit, and afterwards the tile of
    /// the last pixel. `None` when no pixel was found.
    pub(crate) fn trace<'f>(
        &'f self,
        column: &mut Column<'_>,
        entered: &mut Entered<'f>,
        hit: &Hit,
        k: usize,
        target: &mut Target<'_>,
        samples: &mut u64,
    ) -> Option<Traced> {
        if k >= column.last {
            return None;
        }
        column.enter_chunk(self.scene, k + 1, target.seen);
        if hit.s >= column.chunk.followed_until_s {
            return None;
        }
        let (next, tile) = if column.is_row {
            self.follow::<1>(column, entered.index, hit, k, target, samples)?
        } else {
            self.follow::<0>(column, entered.index, hit, k, target, samples)?
        };
        if tile != entered.index {
            *entered = self.scene.enter(tile)?;
        }
        Some(Traced { next, reach: column.s_per_depth((next - 1) as f32) / target.strip.nearness[next - 1] })
    }

    /// The same from a given tile. Returns the first pixel that is not yet known, and the tile that
    /// the last one sees. `MINOR` is the axis along which all pixels have the same coordinate.
    #[inline(never)]
    fn follow<const MINOR: usize>(
        &self,
        column: &mut Column<'_>,
        tile: u32,
        hit: &Hit,
        k: usize,
        target: &mut Target<'_>,
        samples: &mut u64,
    ) -> Option<(usize, u32)> {
        let posts = self.projected.of(tile);
        let step = leaving::<MINOR>(&posts, column, hit)?;
        let mut cut = Cut { tile, posts, step, from: [k as f32, column.s_per_depth(k as f32) / hit.s] };
        let mut seen = tile;
        let mut row = k + 1;
        let mut hidden = 0;
        for _ in 0..MOST_FACETS {
            let Some(to) = crossing::<MINOR>(&cut.posts, column, [cut.step.before, cut.step.after]) else { break };
            if to[0] >= row as f32 {
                hidden = 0;
                seen = cut.tile;
                let last = (to[0] as usize).min(column.last);
                row = self.put_facet(column, &cut, to, [row, last], target);
                // All pixels are known, or the ground is too steep.
                if row > column.last || row <= last {
                    break;
                }
            } else {
                hidden += 1;
                if hidden > MOST_HIDDEN || to[0] < column.chunk.lowest || to[0].is_nan() {
                    break;
                }
            }
            cut.from = to;
            *samples += 1;
            if !self.step_over::<MINOR>(&mut cut, column.fixed) {
                break;
            }
        }
        (row > k + 1).then_some((row, seen))
    }

    /// Writes the pixels from `row` to `last` that see the facet of a cut, which leaves the facet
    /// at `to`. Returns the first pixel that does not see it, or the one after the last.
    #[inline(always)]
    fn put_facet(
        &self,
        column: &mut Column<'_>,
        cut: &Cut<'_>,
        to: [f32; 2],
        [mut row, last]: [usize; 2],
        target: &mut Target<'_>,
    ) -> usize {
        let Target { strip, seen } = target;
        let Step { before, after, third } = cut.step;
        let per_pixel = (to[1] - cut.from[1]) / (to[0] - cut.from[0]);
        let facet = cut.posts.facet([before, after, third]);
        let s_per_depth = column.s_per_depth(to[0]);
        loop {
            column.enter_chunk(self.scene, row, seen);
            if s_per_depth >= column.chunk.followed_until_s * to[1] {
                return row;
            }
            let end = last.min(row / CHUNK * CHUNK + CHUNK - 1);
            let slope = || cut.posts.slope(facet);
            strip.put_run([row, end], cut.from[0], [cut.from[1], per_pixel], [cut.tile as usize, facet], slope);
            if self.scene.ground.is_cut() && self.is_past_border(column, end, strip) {
                // The distance to the ground grows from pixel to pixel.
                return (row..end).find(|k| self.is_past_border(column, *k, strip)).unwrap_or(end);
            }
            row = end + 1;
            if row > last {
                return row;
            }
        }
    }

    /// Moves to the facet behind the edge through which the cut leaves. Returns whether there is
    /// one.
    #[inline(always)]
    fn step_over<'f, const MINOR: usize>(&'f self, cut: &mut Cut<'f>, fixed: f32) -> bool {
        let Step { mut before, mut after, third } = cut.step;
        // A facet and its neighbour form a parallelogram.
        let mut next = before.wrapping_add(after).wrapping_sub(third);
        let mut at = cut.posts.place(next)[MINOR];
        if at.is_nan() {
            let Some((other, edge)) = self.neighbor(cut.tile, &cut.posts, [before, after, third]) else { return false };
            cut.tile = other;
            cut.posts = self.projected.of(other);
            [before, after, next] = edge;
            at = cut.posts.place(next)[MINOR];
            if at.is_nan() {
                return false;
            }
        }
        let is_before = at > fixed;
        cut.step = Step {
            third: if is_before { before } else { after },
            before: if is_before { next } else { before },
            after: if is_before { after } else { next },
        };
        true
    }

    /// Whether the hit of a pixel lies beyond the ground's border, which cells may overlap.
    fn is_past_border(&self, column: &Column<'_>, k: usize, strip: &Strip<'_>) -> bool {
        let ray = self.scene.view.ray(strip.pixel(k));
        column.s_per_depth(k as f32) / strip.nearness[k] > self.scene.departure(&ray)
    }

    /// The neighbouring tile of the same level that has the facet behind an edge; and, in that
    /// tile, the edge and the third post of that facet. `facet`: the posts of the edge, then the
    /// third post.
    #[inline(never)]
    fn neighbor(&self, index: u32, posts: &Posts<'_>, facet: [usize; 3]) -> Option<(u32, [usize; 3])> {
        let ground = self.scene.ground;
        let tile = &ground.tiles()[index as usize];
        let log = tile.log_spacing;
        let [p, n, third] = facet.map(|post| posts.cell(post));
        let next = [0, 1].map(|axis| p[axis] + n[axis] - third[axis]);
        let middle = [0, 1].map(|axis| {
            let low = p[axis].min(n[axis]).min(next[axis]);
            f64::from(tile.origin[axis]) + (f64::from(low) + 0.5) * f64::from(1u32 << log)
        });
        let Found::Tile(found) = ground.tree().find(middle) else { return None };
        let other = &ground.tiles()[found as usize];
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
    // The post that is on the other side of the plane than the other two.
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
