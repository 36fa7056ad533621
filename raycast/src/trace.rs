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
//! A post's distance from the plane, its pixel and its depth are linear in its place, so that each step from one facet to the
//! next costs one post and one division, and pixels within a facet one multiplication each: one over depth is linear in the
//! picture.

use crate::facets::{Entered, Hit};
use crate::frame::Frame;
use crate::ground::Found;
use crate::steepness::Steepness;
use crate::strip::Strip;
use crate::view::Ray;
use glam::{Vec2, Vec3, Vec4};

/// Pixels for which the ground's steepness is looked up at once.
const CHUNK: usize = 16;
/// Hidden facets that are followed before it is cheaper to look for the next visible one through the pyramid.
const MOST_HIDDEN: u32 = 24;
/// No line crosses more facets within tiles; a bound that no rounding can keep from being reached.
const MOST_FACETS: u32 = 1 << 16;

/// Pixels of a strip with rays in one plane, and what makes a post's place in it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column<'a> {
    steepness: &'a Steepness,
    /// The pixels.
    begin: usize,
    last: usize,
    /// A point relative to the eye times these: distance from the plane, pixel number times depth, depth.
    across: Vec3,
    along: Vec3,
    depth: Vec3,
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

/// A post, and its place as a column sees it: distance from the plane, pixel number times depth, depth, 1.
#[derive(Debug, Clone, Copy)]
struct Post {
    cell: [i32; 2],
    height: f32,
    at: Vec4,
}

/// What makes a tile's posts.
struct Posts<'a> {
    heights: &'a [f32],
    stride: i32,
    /// Cells that may be entered.
    cells: [i32; 2],
    corner: Vec4,
    east: Vec4,
    north: Vec4,
    up: Vec4,
}

impl Posts<'_> {
    #[inline(always)]
    fn holds(&self, [i, j]: [i32; 2]) -> bool {
        i as u32 <= self.cells[0] as u32 && j as u32 <= self.cells[1] as u32
    }

    #[inline(always)]
    fn get(&self, cell: [i32; 2]) -> Option<Post> {
        let height = *self.heights.get((cell[1] * self.stride + cell[0]) as usize)?;
        let at = self.corner + self.east * cell[0] as f32 + self.north * cell[1] as f32 + self.up * height;
        Some(Post { cell, height, at })
    }
}

impl<'a> Column<'a> {
    /// The pixels from `k` on that are in one column or row; `None` when there are fewer than `fewest`.
    pub(crate) fn new(
        frame: &Frame<'_>,
        steepness: &'a Steepness,
        strip: &Strip,
        k: usize,
        fewest: usize,
    ) -> Option<Self> {
        let pixels = &strip.pixels;
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
        let [column, row, depth] = frame.view.inverse();
        let [of_minor, of_major] = if minor == 0 { [column, row] } else { [row, column] };
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
            across: of_minor - depth * f32::from(fixed),
            along: (of_major - depth * first) * sign,
            depth,
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
    fn enter_chunk(&mut self, frame: &Frame<'_>, k: usize) {
        if self.chunk.index != Some(k / CHUNK) {
            self.chunk = self.chunk_of(frame, k / CHUNK);
        }
    }

    #[inline(never)]
    fn chunk_of(&self, frame: &Frame<'_>, index: usize) -> Chunk {
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
        if !frame.is_entered_above([&low, &high]) {
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
    fn is_entered_above(&self, rays: [&Ray; 2]) -> bool {
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
        let corners = rays.map(|ray| [ray.direction * first, ray.direction * last]);
        let corners = [corners[0][0], corners[0][1], corners[1][0], corners[1][1]];
        let low = corners.into_iter().fold(Vec3::INFINITY, Vec3::min);
        let high = corners.into_iter().fold(Vec3::NEG_INFINITY, Vec3::max);
        // A little more on all sides: rounding.
        let margin = 1e-5 * high.abs().max(low.abs()).max_element() + 0.01;
        if low.z - margin > self.highest {
            return true;
        }
        let (eye, unit) = (self.view.eye_in_world(), self.ground.shape().lattice_unit_m);
        let lattice = |at: Vec3, by: f32| [0, 1].map(|axis| (f64::from(at[axis] + by) + eye[axis]) / unit);
        let top = |tile: u32| self.ground.tiles()[tile as usize].top_m;
        let highest = self.ground.tree().highest_in(lattice(low, -margin), lattice(high, margin), &top);
        f64::from(low.z - margin) + eye.z - self.ground.datum_m() > f64::from(highest)
    }

    /// Of the pixels from `k` on, those that see sky because the ray below them met nothing up to `reach`, where it left the
    /// ground: all of a chunk that pass above the highest ground from there on.
    pub(crate) fn trace_sky(&self, column: &mut Column<'_>, k: usize, reach: f32, strip: &mut Strip) -> Option<Traced> {
        if k > column.last {
            return None;
        }
        column.enter_chunk(self, k);
        let lowest = self.view.ray(strip.pixel(k)).direction.z;
        if reach < column.chunk.gentle_until_s && lowest >= 0.0 && lowest * reach > self.highest {
            let next = ((k / CHUNK + 1) * CHUNK).min(column.last + 1);
            (k..next).for_each(|k| strip.put_sky(k));
            let ray = self.view.ray(strip.pixel(next - 1));
            Some(Traced { next, reach: self.departure(&ray) })
        } else {
            None
        }
    }

    /// The posts of a tile as a column sees them.
    #[inline(always)]
    fn posts(&self, column: &Column<'_>, entered: &Entered<'_>) -> Posts<'_> {
        let tile = &self.ground.tiles()[entered.index as usize];
        let spacing = tile.spacing_m;
        let corner = self.placed[entered.index as usize].corner.truncate().extend(-entered.eye_height);
        let of = |axis: usize| Vec4::new(column.across[axis], column.along[axis], column.depth[axis], 0.0);
        let (east, north, up) = (of(0), of(1), of(2));
        let extent = self.ground.shape().extent;
        // No cell that reaches beyond the border.
        let cells = [0, 1].map(|axis| {
            let inside = extent[axis].saturating_sub(tile.origin[axis]) >> tile.log_spacing;
            tile.cells[axis].min(inside) as i32
        });
        Posts {
            heights: self.ground.heights(tile),
            stride: tile.cells[0] as i32 + 1,
            cells,
            corner: east * corner.x + north * corner.y + up * corner.z + Vec4::W,
            east: east * spacing,
            north: north * spacing,
            up,
        }
    }

    /// Follows the ground from where pixel `k` meets it, as far as it is gentle, and puts what the next pixels see into the
    /// strip. `entered` is the tile of the hit, and then that of the last pixel. `None` when no pixel was found.
    #[inline(never)]
    pub(crate) fn trace<'f>(
        &'f self,
        column: &mut Column<'_>,
        entered: &mut Entered<'f>,
        hit: &Hit,
        k: usize,
        strip: &mut Strip,
        samples: &mut u64,
    ) -> Option<Traced> {
        let mut row = k + 1;
        column.enter_chunk(self, row);
        if hit.s >= column.chunk.gentle_until_s {
            return None;
        }
        let mut here = *entered;
        let mut posts = self.posts(column, &here);
        let (mut edge, mut third) = leaving(&posts, hit)?;
        // Where the cut enters the facet: pixel number, and one over depth.
        let mut from = [k as f32, column.s_per_depth(k as f32) / hit.s];
        let mut hidden = 0;
        for _ in 0..MOST_FACETS {
            let [p, n] = &edge;
            let way = p.at * n.at.x - n.at * p.at.x;
            // The crossing lies behind the eye.
            if way.z >= 0.0 || way.z.is_nan() {
                break;
            }
            let reciprocal = 1.0 / way.z;
            let to = [way.y * reciprocal, way.w * reciprocal];
            if to[0] >= row as f32 {
                hidden = 0;
                let last = (to[0] as usize).min(column.last);
                let per_pixel = (to[1] - from[1]) / (to[0] - from[0]);
                let slope = slope_of([p, n, &third]);
                let s_per_depth = column.s_per_depth(to[0]);
                let mut is_gentle = true;
                while row <= last && is_gentle {
                    column.enter_chunk(self, row);
                    is_gentle = s_per_depth < column.chunk.gentle_until_s * to[1];
                    if is_gentle {
                        let end = last.min(row / CHUNK * CHUNK + CHUNK - 1);
                        strip.put_run([row, end], from[0], [from[1], per_pixel], here.index, slope);
                        row = end + 1;
                        *entered = here;
                    }
                }
                if row > column.last || !is_gentle {
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
            let mut next = [0, 1].map(|axis| p.cell[axis] + n.cell[axis] - third.cell[axis]);
            if !posts.holds(next) {
                let Some(shift) = self.neighbour(&mut here, [p, n], next) else { break };
                posts = self.posts(column, &here);
                let move_by = |cell: &mut [i32; 2]| (cell[0], cell[1]) = (cell[0] + shift[0], cell[1] + shift[1]);
                edge.iter_mut().for_each(|post| move_by(&mut post.cell));
                move_by(&mut next);
                let is_same = |post: &Post| {
                    posts.holds(post.cell) && posts.get(post.cell).is_some_and(|own| own.height == post.height)
                };
                if !posts.holds(next) || !edge.iter().all(is_same) {
                    break;
                }
            }
            let Some(next) = posts.get(next) else { break };
            third = std::mem::replace(&mut edge[usize::from(next.at.x <= 0.0)], next);
        }
        if row == k + 1 {
            return None;
        }
        let last = row - 1;
        Some(Traced { next: row, reach: column.s_per_depth(last as f32) / strip.nearness[last] })
    }

    /// Enters the tile beside, of the same level, that has the facet beyond an edge; by how much cells are counted otherwise
    /// there.
    #[inline(never)]
    fn neighbour<'f>(&'f self, entered: &mut Entered<'f>, edge: [&Post; 2], next: [i32; 2]) -> Option<[i32; 2]> {
        let tile = entered.tile;
        let log = tile.log_spacing;
        let middle = [0, 1].map(|axis| {
            let low = edge[0].cell[axis].min(edge[1].cell[axis]).min(next[axis]);
            f64::from(tile.origin[axis]) + (f64::from(low) + 0.5) * f64::from(1u32 << log)
        });
        let Found::Tile(index) = self.ground.tree().find(middle) else { return None };
        let other = &self.ground.tiles()[index as usize];
        if other.log_spacing != log || index == entered.index {
            return None;
        }
        *entered = self.enter_exact(index)?;
        Some([0, 1].map(|axis| ((i64::from(tile.origin[axis]) - i64::from(other.origin[axis])) >> log) as i32))
    }
}

/// The edge by which the cut leaves a facet upwards, its post before the plane first, and the third post.
#[inline(always)]
fn leaving(posts: &Posts<'_>, hit: &Hit) -> Option<([Post; 2], Post)> {
    let [i, j] = [hit.facet.corner.x as i32, hit.facet.corner.y as i32];
    let middle = if hit.facet.is_south_east { [i + 1, j] } else { [i, j + 1] };
    if !posts.holds([i + 1, j + 1]) {
        return None;
    }
    let all = [posts.get([i, j])?, posts.get(middle)?, posts.get([i + 1, j + 1])?];
    let is_before = all.map(|post| post.at.x > 0.0);
    // The post that is alone on its side of the plane.
    let alone = match is_before {
        [a, b, c] if b == c && a != b => 0,
        [a, b, c] if a == c && a != b => 1,
        [a, b, c] if a == b && a != c => 2,
        _ => return None,
    };
    let others = [all[(alone + 1) % 3], all[(alone + 2) % 3]];
    let edge = |other: Post| if is_before[alone] { [all[alone], other] } else { [other, all[alone]] };
    let height = |[p, n]: [Post; 2]| {
        let way = p.at * n.at.x - n.at * p.at.x;
        if way.z < 0.0 { way.y / way.z } else { f32::NEG_INFINITY }
    };
    let edges = others.map(edge);
    let heights = edges.map(height);
    let upper = usize::from(heights[1] > heights[0]);
    (heights[upper] > f32::NEG_INFINITY).then_some((edges[upper], others[1 - upper]))
}

/// Metres up per cell east and north on the facet of three posts.
#[inline(always)]
fn slope_of([a, b, c]: [&Post; 3]) -> Vec2 {
    let by = |post: &Post| {
        let [east, north] = [0, 1].map(|axis| (post.cell[axis] - a.cell[axis]) as f32);
        (Vec2::new(east, north), post.height - a.height)
    };
    let ((to_b, up_b), (to_c, up_c)) = (by(b), by(c));
    // 1 or -1: its own reciprocal.
    let area = to_b.perp_dot(to_c);
    Vec2::new(up_b * to_c.y - up_c * to_b.y, up_c * to_b.x - up_b * to_c.x) * area
}
