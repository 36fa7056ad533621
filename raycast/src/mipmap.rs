//! One exact ray per pixel: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel: "Maximum mipmaps for fast, accurate,
//! and scalable dynamic height field rendering", I3D 2008), then the facets of the cell, the same that the mesh draws, then
//! colour averaged over the pixel's footprint on the ground. No voxels.
//!
//! It takes no line of pixels for granted. Where the ray below proves that a stretch is in the air (see [`crate::cast`]; here for
//! every parameter, not for samples alone) it starts behind that stretch; and where it starts over the facet that the ray below
//! hit, and meets that facet, nothing else has to be looked at.

use crate::cast::{Counts, LineOptions};
use crate::color::Mip;
use crate::frame::{Frame, Place, exit};
use crate::ground::{Ground, Link, Tile};
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

/// Half of a cell, cut from south west to north east, and the plane through it. Heights are from the eye.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Facet {
    /// South west corner of its cell, from the tile's corner, cells.
    corner: Vec2,
    is_south_east: bool,
    /// Metres up per cell east and north.
    slope: Vec2,
    /// Height of its plane above the tile's corner.
    height: f32,
}

/// Where a ray meets the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Hit {
    s: f32,
    facet: Facet,
}

/// How a ray crossed a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Crossing {
    /// It met the ground.
    Hit(Hit),
    /// It left, or reached its limit, at this parameter.
    Left(f32),
}

/// A tile that rays are in.
#[derive(Debug, Clone, Copy)]
struct Entered<'a> {
    index: u32,
    tile: &'a Tile,
    heights: &'a [f32],
    maxima: &'a [f32],
    /// Cells per metre.
    per_m: f32,
    /// The eye's place, cells from the tile's corner.
    at_0: Vec2,
    /// The eye, metres above the datum.
    eye_height: f32,
}

/// A ray along a tile.
#[derive(Debug, Clone, Copy)]
struct Along {
    /// Cells per unit of s.
    per_s: Vec2,
    /// Metres up per unit of s.
    rise: f32,
}

impl Facet {
    /// Those of a cell, south eastern half first; heights of its corners from the eye.
    #[inline(always)]
    fn of_cell(corner: Vec2, [sw, se, nw, ne]: [f32; 4]) -> [Self; 2] {
        [(true, Vec2::new(se - sw, ne - se)), (false, Vec2::new(ne - nw, nw - sw))].map(|(is_south_east, slope)| Self {
            corner,
            is_south_east,
            slope,
            height: sw - slope.dot(corner),
        })
    }

    /// Height of a ray over the plane: `s` times the first, plus the second.
    #[inline(always)]
    fn above(&self, along: &Along, at_0: Vec2) -> [f32; 2] {
        [along.rise - self.slope.dot(along.per_s), -(self.height + self.slope.dot(at_0))]
    }

    /// Whether a point, cells from the tile's corner, lies over it.
    #[inline(always)]
    fn holds(&self, at: Vec2) -> bool {
        let by = at - self.corner;
        let [first, second] = if self.is_south_east { [by.y, by.x] } else { [by.x, by.y] };
        0.0 <= first && first <= second && second <= 1.0
    }
}

impl Ground {
    /// Highest post of block `at` of `2^level` cells a side, `level >= 1`.
    #[inline(always)]
    fn block_maximum(tile: &Tile, maxima: &[f32], level: u32, at: [u32; 2]) -> f32 {
        let mut start = 0;
        for finer in 1..level {
            let [columns, rows] = tile.cells.map(|n| n.div_ceil(1 << finer) as usize);
            start += columns * rows;
        }
        let columns = tile.cells[0].div_ceil(1 << level) as usize;
        maxima.get(start + at[1] as usize * columns + at[0] as usize).copied().unwrap_or(f32::INFINITY)
    }
}

impl Entered<'_> {
    #[inline(always)]
    fn along(&self, ray: &Ray) -> Along {
        Along { per_s: ray.direction.truncate() * self.per_m, rise: ray.direction.z }
    }

    #[inline(always)]
    fn at(&self, along: &Along, s: f32) -> Vec2 {
        along.per_s * s + self.at_0
    }

    /// Posts of a cell: south west, south east, north west, north east.
    #[inline(always)]
    fn corners(&self, [i, j]: [u32; 2]) -> [f32; 4] {
        let columns = self.tile.cells[0] as usize + 1;
        let south = j as usize * columns + i as usize;
        let north = south + columns;
        match (self.heights.get(south..south + 2), self.heights.get(north..north + 2)) {
            (Some(&[sw, se]), Some(&[nw, ne])) => [sw, se, nw, ne],
            _ => [f32::NEG_INFINITY; 4],
        }
    }

    /// Whether a ray is over the tile at a parameter.
    #[inline(always)]
    fn is_under(&self, along: &Along, s: f32) -> bool {
        let at = self.at(along, s);
        let [columns, rows] = self.tile.cells;
        at.x >= 0.0 && at.y >= 0.0 && at.x < columns as f32 && at.y < rows as f32
    }

    /// Where a ray that is in the air up to `from` meets a facet, when it is over that facet from there on.
    #[inline(always)]
    fn meets(&self, along: &Along, facet: &Facet, from: f32) -> Option<f32> {
        let [per_s, at_eye] = facet.above(along, self.at_0);
        let s = -at_eye / per_s;
        (per_s < 0.0 && s >= from && facet.holds(self.at(along, s)) && facet.holds(self.at(along, from))).then_some(s)
    }

    /// Follows the ray from `from` until it hits, leaves, or is past `until`.
    fn cross(&self, along: &Along, from: f32, until: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(along.per_s, -self.at_0, size - self.at_0).min(until).max(from);
        let most = cells[0].max(cells[1]).next_power_of_two().ilog2();
        let start = self.at(along, from).clamp(Vec2::ZERO, size);
        let per_s_reciprocal = along.per_s.recip();
        let is_east = along.per_s.x > 0.0;
        let is_north = along.per_s.y > 0.0;
        let height = |s: f32| along.rise * s + self.eye_height;
        let mut level = 0;
        let mut at = [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)];
        let mut s = from;
        loop {
            *samples += 1;
            let side = (1u32 << level) as f32;
            let low = Vec2::new(at[0] as f32, at[1] as f32) * side;
            let leave = |axis: usize, is_up: bool| {
                let border = if is_up { low[axis] + side } else { low[axis] };
                if along.per_s[axis] == 0.0 {
                    f32::INFINITY
                } else {
                    (border - self.at_0[axis]) * per_s_reciprocal[axis]
                }
            };
            let leaves = [leave(0, is_east), leave(1, is_north)];
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let lowest = height(s).min(height(out));
            if level == 0 {
                let corners = self.corners(at);
                let highest = corners[0].max(corners[1]).max(corners[2].max(corners[3]));
                if lowest <= highest
                    && let Some(hit) = self.root(along, corners, low, s, out)
                {
                    return Crossing::Hit(hit);
                }
            } else if lowest <= Ground::block_maximum(self.tile, self.maxima, level, at) {
                level -= 1;
                let middle = self.at(along, s);
                let half = 0.5 * side;
                for axis in 0..2 {
                    let last = (cells[axis] - 1) >> level;
                    at[axis] = (2 * at[axis] + u32::from(middle[axis] >= low[axis] + half)).min(last);
                }
                continue;
            }
            s = out;
            if s >= end {
                return Crossing::Left(end);
            }
            let axis = usize::from(leaves[1] < leaves[0]);
            let before = at[axis] >> 1;
            if along.per_s[axis] > 0.0 {
                at[axis] += 1;
                if at[axis] > (cells[axis] - 1) >> level {
                    return Crossing::Left(end);
                }
            } else if at[axis] == 0 {
                return Crossing::Left(end);
            } else {
                at[axis] -= 1;
            }
            if at[axis] >> 1 != before && level < most {
                level += 1;
                at = [at[0] >> 1, at[1] >> 1];
            }
        }
    }

    /// The first parameter from `from` to `to` at which the ray is not above the facets of the cell whose corner is `low`.
    #[inline(always)]
    fn root(&self, along: &Along, corners: [f32; 4], low: Vec2, from: f32, to: f32) -> Option<Hit> {
        let facets = Facet::of_cell(low, corners.map(|height| height - self.eye_height));
        let place = self.at(along, from) - low;
        let (across, per_s) = (place.x - place.y, along.per_s.x - along.per_s.y);
        // Where it changes from one half to the other, if it does.
        let change = if across * per_s < 0.0 { from - across / per_s } else { f32::INFINITY };
        let is_south_east_first = across > 0.0 || (across == 0.0 && per_s >= 0.0);
        let order = if is_south_east_first { [0, 1] } else { [1, 0] };
        let mut begin = from;
        for facet in order.map(|n| facets[n]) {
            let end = if begin < change { to.min(change) } else { to };
            let [per_s, at_eye] = facet.above(along, self.at_0);
            if per_s * begin + at_eye <= 0.0 {
                return Some(Hit { s: begin, facet });
            }
            if per_s * end + at_eye <= 0.0 {
                return Some(Hit { s: (-at_eye / per_s).clamp(begin, end), facet });
            }
            if change >= to {
                return None;
            }
            begin = change;
        }
        None
    }
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
        for pixel in pixels {
            counts.rays += 1;
            let ray = self.view.ray(pixel);
            let entry = self.entry(&ray);
            let below = (1..=MOST_KNOWN).filter_map(|back| known[(next + MOST_KNOWN - back) % MOST_KNOWN]);
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
                let again = facet.filter(|(tile, _)| *tile == current.index).and_then(|(_, facet)| {
                    counts.samples += 1;
                    current.meets(&current.along(&ray), &facet, start).map(|s| Hit { s, facet })
                });
                hit = again.or_else(|| self.first_hit(&ray, start, f32::INFINITY, &mut current, &mut counts));
            }
            let reach = match hit {
                Some(hit) => {
                    counts.hits += 1;
                    self.picture.put(pixel, self.shade_footprint(&current, &ray, &hit), hit.s * ray.depth);
                    hit.s
                }
                None => {
                    self.picture.put(pixel, self.sky, f32::NAN);
                    f32::INFINITY
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
    fn skip_nodes(&self, ray: &Ray, s: f32) -> Option<f32> {
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
                Link::Tile(tile) => self.ground.tiles()[tile as usize].highest_m,
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
        let taps = (long / short).ceil().clamp(1.0, MOST_TAPS);
        let lod = short.log2().clamp(0.0, (layout.mips - 1) as f32);
        let level = lod as u32;
        let share = lod - level as f32;
        let mips = [level, (level + 1).min(layout.mips - 1)].map(|level| Mip::new(layer, layout, level));
        let [Some(fine), Some(coarse)] = mips else { return [0; 3] };
        let scales = [level, (level + 1).min(layout.mips - 1)].map(|level| 1.0 / (1u32 << level) as f32);
        let mut sum = [0.0f32; 3];
        for tap in 0..taps as u32 {
            // The axis is that of texels from the north: `texel` turned y over, and so did nobody for footprints yet.
            let offset = ((tap as f32 + 0.5) / taps - 0.5) * (long - short).max(0.0);
            let at = center + Vec2::new(axis.x, -axis.y) * offset;
            let color = fine.bilinear_rgb(at * scales[0]);
            let color = if share < 0.02 {
                color
            } else {
                let other = coarse.bilinear_rgb(at * scales[1]);
                std::array::from_fn(|c| color[c] + (other[c] - color[c]) * share)
            };
            for (sum, value) in sum.iter_mut().zip(color) {
                *sum += value;
            }
        }
        sum.map(|v| (v / taps + 0.5) as u8)
    }
}

/// A little further: a point on a border belongs to what lies behind it.
#[inline(always)]
fn past(s: f32) -> f32 {
    s + s.abs() * 2e-6 + 1e-6
}
