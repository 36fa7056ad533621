//! One exact ray per pixel: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel: "Maximum mipmaps for fast, accurate,
//! and scalable dynamic height field rendering", I3D 2008), then the root of the bilinear cell, then colour averaged over
//! the pixel's footprint on the ground. No voxels.
//!
//! It takes no line of pixels for granted. Where the ray below proves that a stretch is in the air (see [`crate::cast`]; here for
//! every parameter, not for samples alone) it starts behind that stretch.

use crate::cast::{Counts, LineOptions};
use crate::color::{ColorSource, Mip};
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

/// How a ray crossed a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Crossing {
    /// It met the ground at this parameter, in this cell.
    Hit(f32, [u32; 2]),
    /// It left at this one.
    Left(f32),
}

/// A tile along one ray: cells from its corner are `per_s·s + at_0`.
struct Entered<'a> {
    tile: &'a Tile,
    heights: &'a [f32],
    maxima: &'a [f32],
    per_s: Vec2,
    at_0: Vec2,
    /// Height above the datum of the ray, metres, in the same form.
    rise: f32,
    eye_height: f32,
}

impl Ground {
    /// Highest post of block `at` of `2^level` cells a side, `level >= 1`.
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
    fn at(&self, s: f32) -> Vec2 {
        self.per_s * s + self.at_0
    }

    fn height(&self, s: f32) -> f32 {
        self.rise * s + self.eye_height
    }

    /// Posts of a cell: south west, south east, north west, north east.
    fn corners(&self, [i, j]: [u32; 2]) -> [f32; 4] {
        let columns = self.tile.cells[0] as usize + 1;
        let south = j as usize * columns + i as usize;
        let north = south + columns;
        match (self.heights.get(south..south + 2), self.heights.get(north..north + 2)) {
            (Some(&[sw, se]), Some(&[nw, ne])) => [sw, se, nw, ne],
            _ => [f32::NEG_INFINITY; 4],
        }
    }

    /// Follows the ray from `from` until it hits or leaves.
    fn cross(&self, from: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(self.per_s, -self.at_0, size - self.at_0).max(from);
        let most = cells[0].max(cells[1]).next_power_of_two().ilog2();
        let start = self.at(from).clamp(Vec2::ZERO, size);
        let mut level = 0;
        let mut at = [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)];
        let mut s = from;
        loop {
            *samples += 1;
            let side = (1u32 << level) as f32;
            let low = Vec2::new(at[0] as f32, at[1] as f32) * side;
            let leave = |axis: usize| {
                let per_s = self.per_s[axis];
                match per_s {
                    d if d > 0.0 => (low[axis] + side - self.at_0[axis]) / d,
                    d if d < 0.0 => (low[axis] - self.at_0[axis]) / d,
                    _ => f32::INFINITY,
                }
            };
            let leaves = [leave(0), leave(1)];
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let lowest = self.height(s).min(self.height(out));
            if level == 0 {
                let corners = self.corners(at);
                let highest = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
                if lowest <= highest
                    && let Some(hit) = self.root(corners, low, s, out)
                {
                    return Crossing::Hit(hit, at);
                }
            } else if lowest <= Ground::block_maximum(self.tile, self.maxima, level, at) {
                level -= 1;
                let middle = self.at(s);
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
            if self.per_s[axis] > 0.0 {
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

    /// The first parameter from `from` to `to` at which the ray is not above the bilinear cell whose corner is `low`.
    fn root(&self, corners: [f32; 4], low: Vec2, from: f32, to: f32) -> Option<f32> {
        let [a, b, c, d] = coefficients(corners);
        let place = self.at(from) - low;
        let (u, v) = (place.x, place.y);
        // Height of the ray over the cell, `from + r`: q2·r² + q1·r + q0.
        let q0 = self.height(from) - (a + b * u + c * v + d * u * v);
        if q0 <= 0.0 {
            return Some(from);
        }
        let q1 = self.rise - (b * self.per_s.x + c * self.per_s.y + d * (u * self.per_s.y + v * self.per_s.x));
        let q2 = -d * self.per_s.x * self.per_s.y;
        let span = to - from;
        let within = |r: f32| (r >= 0.0 && r <= span).then_some(from + r);
        let discriminant = q1 * q1 - 4.0 * q2 * q0;
        if discriminant < 0.0 {
            return None;
        }
        // Of the two roots the one that stays when q2 vanishes; both forms that do not cancel.
        let q = -0.5 * (q1 + discriminant.sqrt().copysign(q1));
        let (near, far) = (q0 / q, q / q2);
        let ordered = if far >= 0.0 && far < near || near < 0.0 { (far, near) } else { (near, far) };
        within(ordered.0).or_else(|| within(ordered.1))
    }
}

/// Height in a cell: a + b·u + c·v + d·u·v, u and v from its south west corner.
fn coefficients([sw, se, nw, ne]: [f32; 4]) -> [f32; 4] {
    [sw, se - sw, nw - sw, sw - se - nw + ne]
}

impl<C: ColorSource + ?Sized> Frame<'_, C> {
    /// Casts the rays of a line's pixels, bottom up.
    pub(crate) fn cast_exact(&self, options: &LineOptions, pixels: impl Iterator<Item = [u32; 2]>) -> Counts {
        let mut counts = Counts::default();
        let mut known: [Option<Known>; MOST_KNOWN] = [None; MOST_KNOWN];
        let mut next = 0;
        let mut place = 0;
        for pixel in pixels {
            counts.rays += 1;
            let ray = self.view.ray(pixel);
            let entry = self.entry(&ray);
            let below = (1..=MOST_KNOWN).find_map(|back| {
                let below = known[(next + MOST_KNOWN - back) % MOST_KNOWN]?;
                (below.entry <= entry && ray.is_above(&below.ray, options.steepest_squared)).then_some(below)
            });
            let start = match below {
                Some(below) => below.reach.max(entry),
                None => {
                    counts.unproven += 1;
                    let is_above = ray.direction.z < 0.0 && self.highest < 0.0;
                    entry.max(if is_above { self.highest / ray.direction.z } else { 0.0 })
                }
            };
            let reach = match self.first_hit(&ray, start, below.is_some(), &mut place, &mut counts) {
                Some((s, cell)) => {
                    counts.hits += 1;
                    self.picture.put(pixel, self.shade_footprint(place, &ray, s, cell), s * ray.depth);
                    s
                }
                None => {
                    self.picture.put(pixel, self.sky, f32::NAN);
                    f32::INFINITY
                }
            };
            known[next] = Some(Known { ray, entry, reach });
            next = (next + 1) % MOST_KNOWN;
        }
        counts
    }

    /// The first parameter from `from` on at which a ray meets the ground, and the cell. `place` is the tile that it is
    /// likely in, and where it hit.
    fn first_hit(
        &self,
        ray: &Ray,
        from: f32,
        is_near: bool,
        place: &mut u32,
        counts: &mut Counts,
    ) -> Option<(f32, [u32; 2])> {
        let mut s = from;
        let mut is_here = is_near && self.is_over(*place, ray, s);
        // A ray crosses fewer tiles than this; a bound that no rounding can keep from being reached.
        for _ in 0..1 << 16 {
            if !s.is_finite() || ray.direction.z >= 0.0 && ray.direction.z * s > self.highest {
                return None;
            }
            if !is_here {
                match self.find(ray, s) {
                    Place::Tile(tile) => *place = tile,
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
            let entered = self.enter_exact(ray, *place)?;
            match entered.cross(s, &mut counts.samples) {
                Crossing::Hit(s, cell) => return Some((s, cell)),
                Crossing::Left(out) => s = past(out.max(s)),
            }
        }
        None
    }

    /// Whether a ray is over a tile at a parameter.
    fn is_over(&self, place: u32, ray: &Ray, s: f32) -> bool {
        self.enter_exact(ray, place).is_some_and(|entered| {
            let at = entered.at(s);
            let [columns, rows] = entered.tile.cells;
            at.x >= 0.0 && at.y >= 0.0 && at.x < columns as f32 && at.y < rows as f32
        })
    }

    /// Descends the tree at a point of a ray; where the ray leaves the largest node that it passes above, if there is one.
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

    fn enter_exact(&self, ray: &Ray, place: u32) -> Option<Entered<'_>> {
        let tile = self.ground.tiles().get(place as usize)?;
        let placed = &self.placed[place as usize];
        Some(Entered {
            tile,
            heights: self.ground.heights(tile),
            maxima: self.ground.maxima(tile),
            per_s: ray.direction.truncate() * placed.per_m,
            at_0: -placed.corner.truncate() * placed.per_m,
            rise: ray.direction.z,
            eye_height: (self.view.eye_in_world().z - self.ground.datum_m()) as f32,
        })
    }

    /// Colour averaged over the part of the tangent plane that a pixel covers.
    fn shade_footprint(&self, place: u32, ray: &Ray, s: f32, cell: [u32; 2]) -> u32 {
        let Some(entered) = self.enter_exact(ray, place) else { return self.sky };
        let placed = &self.placed[place as usize];
        let [_, b, c, d] = coefficients(entered.corners(cell));
        let in_cell = entered.at(s) - Vec2::new(cell[0] as f32, cell[1] as f32);
        let slope = Vec2::new(b + d * in_cell.y, c + d * in_cell.x) * placed.per_m;
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
        let tile = &self.ground.tiles()[place as usize];
        let [r, g, b] = self.average(self.colors.layer(tile.color.layer), center, across, along);
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
fn past(s: f32) -> f32 {
    s + s.abs() * 2e-6 + 1e-6
}
