//! Rays of a line, from the bottom up (voxel-flythrough-1999 §4).
//!
//! A higher ray meets a height field further off, so a ray starts where the one below it hit. That holds when its samples
//! lie above those of the lower ray, and a little beside them no more than the ground can rise in between: sample `s` of
//! ray i is `eye + s·D_i`, so it is `s·(D_i − D_j)` from that of ray j, and
//!
//! ```text
//! D_i.z − D_j.z  >=  steepest · |D_i.xy − D_j.xy|      ⇒      in the air at j  ⇒  in the air at i,  for every s
//! ```
//!
//! where no ground is steeper than `steepest`. Forward-only methods take this for granted, but planes of rays are not vertical
//! beside the middle of a pitched picture, and pixels of a rolled line are not above each other: then a ray may run into
//! a cliff that the one below it passed by. Here it is tested for each ray against the rays of its line, nearest
//! first; a ray for which none will do goes back to where it is in the air for sure, by the highest cells of blocks.
//! A start that lies in the ground all the same is stepped back from.

use crate::color::ColorSource;
use crate::frame::{Frame, Place};
use crate::ground::{LOG_BLOCK, Span, THRESHOLD, Tile};
use crate::view::Ray;
use std::ops::Add;

/// How a ray's start is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coherence {
    /// From the rays below it, when that is proven to miss nothing.
    #[default]
    Proven,
    /// From the ray below it, always: what forward-only methods do. Misses ground, for comparison only.
    ForwardOnly,
    /// At the eye, or where the ray comes over the ground: plain ray casting.
    Plain,
}

/// What was done for a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Rays.
    pub rays: u64,
    /// Points of rays that were looked at.
    pub samples: u64,
    /// Those of them whose density was interpolated.
    pub densities: u64,
    /// Rays whose start no ray below them proved.
    pub unproven: u64,
    /// Steps back out of the ground.
    pub steps_back: u64,
    /// Rays that met ground.
    pub hits: u64,
}

impl Add for Counts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            densities: self.densities + other.densities,
            unproven: self.unproven + other.unproven,
            steps_back: self.steps_back + other.steps_back,
            hits: self.hits + other.hits,
        }
    }
}

/// How rays of a line are cast.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LineOptions {
    pub(crate) coherence: Coherence,
    /// Slope that no ground exceeds, with room for rounding, squared.
    pub(crate) steepest_squared: f32,
}

/// A ray that was cast: in the air at all planes from `entry` up to `reach`.
#[derive(Debug, Clone, Copy)]
struct Known {
    ray: Ray,
    entry: u32,
    reach: u32,
}

/// Rays below that are tried. Two pixels of a scan-converted line, a few apart, lie more nearly above each other the
/// further apart they are.
const MOST_KNOWN: usize = 4;

/// How a walk along a ray ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The sample at this plane is in the ground.
    Hit(u32),
    /// All samples before this plane are in the air, and none after it is over ground.
    Left(u32),
}

/// A tile, ready to be sampled along one ray.
struct Entered<'a> {
    tile: &'a Tile,
    spans: &'a [Span],
    densities: &'a [u8],
    blocks: &'a [u16],
    /// Cells and layers per parameter, and at parameter 0.
    per_s: [f32; 3],
    at_0: [f32; 3],
}

/// Whole part of a number from 0 to 2^22, and past any cell count for a negative one. A whole number may give the cell
/// below it, of which it is the end.
#[inline(always)]
fn cell(at: f32) -> u32 {
    // Adding 2^23 leaves no bits for fractions. A conversion would have to check for numbers that do not fit.
    ((at - 0.5) + 8_388_608.0).to_bits().wrapping_sub(0x4b00_0000)
}

impl Entered<'_> {
    #[inline(always)]
    fn along(&self, axis: usize, s: f32) -> f32 {
        self.per_s[axis] * s + self.at_0[axis]
    }

    /// Trilinear density at a place in cell `(i, j)`, at a height in layers.
    #[inline(always)]
    fn density(&self, [i, j]: [u32; 2], u: f32, v: f32, height: f32) -> f32 {
        let layers = self.tile.layers as usize;
        let height = height.clamp(0.0, (layers - 2) as f32 + 0.999);
        let k = (height as usize).min(layers - 2);
        let (fu, fv, fk) = (u - i as f32, v - j as f32, height - k as f32);
        let columns = self.tile.cells[0] as usize + 1;
        let south = (j as usize * columns + i as usize) * layers + k;
        let north = south + columns * layers;
        let pair = |at: usize| match self.densities.get(at..at + 2) {
            Some(&[low, high]) => [f32::from(low), f32::from(high)],
            _ => [0.0; 2],
        };
        let (sw, se, nw, ne) = (pair(south), pair(south + layers), pair(north), pair(north + layers));
        let level = |k: usize| {
            let s = sw[k] + (se[k] - sw[k]) * fu;
            let n = nw[k] + (ne[k] - nw[k]) * fu;
            s + (n - s) * fv
        };
        let (low, high) = (level(0), level(1));
        low + (high - low) * fk
    }
}

impl<C: ColorSource + ?Sized> Frame<'_, C> {
    /// Casts the rays of a line's pixels, bottom up.
    pub(crate) fn cast_line<const APPROXIMATE: bool>(
        &self,
        options: &LineOptions,
        pixels: impl Iterator<Item = [u32; 2]>,
    ) -> Counts {
        let mut counts = Counts::default();
        let mut known: [Option<Known>; MOST_KNOWN] = [None; MOST_KNOWN];
        let mut next = 0;
        let mut place = 0;
        let planes = self.planes.s().len() as u32;
        let is_beside = self.is_eye_beside();
        for pixel in pixels {
            counts.rays += 1;
            let ray = self.view.ray(pixel);
            let entry = if is_beside { self.planes.at_or_after(self.entry(&ray)) } else { 0 };
            let below = self.ray_below(options, &ray, &known, next);
            let end = self.end_of(&ray);
            let result = match below {
                Some(below) => {
                    // Where the lower ray was not over the ground yet it says nothing.
                    let gap = below.entry.min(below.reach).min(end);
                    let in_gap = if entry < gap {
                        self.walk::<APPROXIMATE, false>(&ray, entry, gap, &mut place, &mut counts)
                    } else {
                        End::Left(gap)
                    };
                    match in_gap {
                        End::Left(plane) if plane >= gap => {
                            let start = below.reach.max(entry);
                            self.walk::<APPROXIMATE, false>(&ray, start, end, &mut place, &mut counts)
                        }
                        // It hit, or came past a corner of the ground.
                        _ => in_gap,
                    }
                }
                None => {
                    counts.unproven += 1;
                    let start = entry.max(self.start_below_top(&ray));
                    if options.coherence == Coherence::Plain {
                        self.walk::<APPROXIMATE, false>(&ray, start, end, &mut place, &mut counts)
                    } else {
                        self.walk::<APPROXIMATE, true>(&ray, start, end, &mut place, &mut counts)
                    }
                }
            };
            let reach = match result {
                End::Hit(plane) => {
                    let (plane, s) = self.refined::<APPROXIMATE>(&ray, plane, place, &mut counts);
                    counts.hits += 1;
                    self.picture.put(pixel, self.shade(place, &ray, s), s * ray.depth);
                    plane
                }
                End::Left(plane) => {
                    self.picture.put(pixel, self.sky, f32::NAN);
                    // A ray that rose above everything is in the air for ever. Beyond the ground's border it says nothing.
                    if plane >= end { planes } else { plane.min(self.planes.at_or_after(self.departure(&ray))) }
                }
            };
            known[next] = Some(Known { ray, entry, reach });
            next = (next + 1) % MOST_KNOWN;
        }
        counts
    }

    fn is_eye_beside(&self) -> bool {
        let (min, max) = (self.bounds.min, self.bounds.max);
        min.x > 0.0 || min.y > 0.0 || max.x < 0.0 || max.y < 0.0
    }

    /// The nearest ray below that proves where this one may start.
    #[inline(always)]
    fn ray_below(
        &self,
        options: &LineOptions,
        ray: &Ray,
        known: &[Option<Known>; MOST_KNOWN],
        next: usize,
    ) -> Option<Known> {
        match options.coherence {
            Coherence::Plain => None,
            Coherence::ForwardOnly => known[(next + MOST_KNOWN - 1) % MOST_KNOWN],
            Coherence::Proven => (1..=MOST_KNOWN).find_map(|back| {
                let below = known[(next + MOST_KNOWN - back) % MOST_KNOWN]?;
                ray.is_above(&below.ray, options.steepest_squared).then_some(below)
            }),
        }
    }

    /// The plane after which a rising ray is above all ground.
    #[inline(always)]
    fn end_of(&self, ray: &Ray) -> u32 {
        if ray.direction.z > 0.0 {
            self.planes.at_or_after(self.highest.max(0.0) / ray.direction.z)
        } else if ray.direction.z == 0.0 && self.highest < 0.0 {
            0
        } else {
            self.planes.s().len() as u32
        }
    }

    /// The first plane at which a falling ray is not above all ground.
    fn start_below_top(&self, ray: &Ray) -> u32 {
        if ray.direction.z < 0.0 && self.highest < 0.0 {
            self.planes.at_or_after(self.highest / ray.direction.z)
        } else {
            0
        }
    }

    /// Makes a tile ready for a ray.
    #[inline(always)]
    fn enter(&self, ray: &Ray, place: u32) -> Option<Entered<'_>> {
        let tile = self.ground.tiles().get(place as usize)?;
        let placed = self.placed[place as usize];
        let (per_s, at_0) = (ray.direction * placed.per_m, -placed.corner * placed.per_m);
        Some(Entered {
            tile,
            spans: self.ground.spans(tile),
            densities: self.ground.densities(tile),
            blocks: self.ground.blocks(tile),
            per_s: per_s.to_array(),
            at_0: at_0.to_array(),
        })
    }

    /// Looks at the samples of a ray from plane `from` up to `end`. `place` is the tile to begin in, and where it ended.
    #[inline(always)]
    fn walk<const APPROXIMATE: bool, const SKIPS: bool>(
        &self,
        ray: &Ray,
        from: u32,
        end: u32,
        place: &mut u32,
        counts: &mut Counts,
    ) -> End {
        let planes = &self.planes.s()[..(end as usize).min(self.planes.s().len())];
        let mut k = from as usize;
        let mut is_found = false;
        while k < planes.len() {
            let Some(entered) = self.enter(ray, *place) else { return End::Left(k as u32) };
            let [columns, rows] = entered.tile.cells;
            let is_graded = !APPROXIMATE && entered.tile.is_accurate;
            let mut looked_at_block = u32::MAX;
            while let Some(&s) = planes.get(k) {
                let (mut u, mut v) = (entered.along(0, s), entered.along(1, s));
                let (mut i, mut j) = (cell(u), cell(v));
                if i >= columns || j >= rows {
                    if !is_found {
                        break;
                    }
                    // The tree says that it is here; the difference is rounding.
                    (u, v) = (u.clamp(0.0, columns as f32), v.clamp(0.0, rows as f32));
                    (i, j) = ((u as u32).min(columns - 1), (v as u32).min(rows - 1));
                }
                is_found = false;
                let height = entered.along(2, s);
                let span = entered.spans[j as usize * columns as usize + i as usize];
                counts.samples += 1;
                if height >= f32::from(span.highest) + 1.0 {
                    k += 1;
                    if SKIPS {
                        let blocks = columns.div_ceil(1 << LOG_BLOCK);
                        let block = (j >> LOG_BLOCK) * blocks + (i >> LOG_BLOCK);
                        if block != looked_at_block {
                            looked_at_block = block;
                            k = self.skip(&entered, [i, j], height, block, k);
                        }
                    }
                    continue;
                }
                if !is_graded || height < f32::from(span.lowest) {
                    return End::Hit(k as u32);
                }
                counts.densities += 1;
                if entered.density([i, j], u, v, height) > THRESHOLD {
                    return End::Hit(k as u32);
                }
                k += 1;
            }
            let Some(&s) = planes.get(k) else { break };
            match self.find(ray, s) {
                Place::Tile(tile) => {
                    *place = tile;
                    is_found = true;
                }
                Place::HoleUntil(exit) => k = (k + 1).max(self.planes.at_or_after(exit) as usize),
                Place::Left => return End::Left(k as u32),
            }
        }
        End::Left(end)
    }

    /// The first plane from `k` on at which a ray that is above all boundary cells of a block may not be any more.
    fn skip(&self, entered: &Entered<'_>, cell: [u32; 2], height: f32, block: u32, k: usize) -> usize {
        let top = f32::from(entered.blocks[block as usize]) + 1.0;
        if height < top {
            return k;
        }
        let mut s = f32::INFINITY;
        for (axis, cell) in cell.into_iter().enumerate() {
            let low = (cell >> LOG_BLOCK) << LOG_BLOCK;
            let high = (low + (1 << LOG_BLOCK)).min(entered.tile.cells[axis]);
            let (per_s, at_0) = (entered.per_s[axis], entered.at_0[axis]);
            if per_s > 0.0 {
                s = s.min((high as f32 - at_0) / per_s);
            } else if per_s < 0.0 {
                s = s.min((low as f32 - at_0) / per_s);
            }
        }
        if entered.per_s[2] < 0.0 {
            s = s.min((top - entered.at_0[2]) / entered.per_s[2]);
        }
        // One plane early: rounding.
        k.max(self.planes.at_or_after(s).saturating_sub(1) as usize)
    }

    /// Where a ray passes the surface before a plane at which it is in the ground: the first such plane, and the parameter
    /// between it and the one before, by the two densities.
    #[inline(always)]
    fn refined<const APPROXIMATE: bool>(&self, ray: &Ray, plane: u32, place: u32, counts: &mut Counts) -> (u32, f32) {
        let planes = self.planes.s();
        let mut plane = plane;
        let mut here = self.density_at::<APPROXIMATE>(ray, planes[plane as usize], place);
        while plane > 0 {
            let before = self.density_at::<APPROXIMATE>(ray, planes[plane as usize - 1], place);
            let [from, to] = [planes[plane as usize - 1], planes[plane as usize]];
            let (Some(inside), Some(outside)) = (here, before) else { return (plane, to) };
            if outside <= THRESHOLD {
                let share = (THRESHOLD - outside) / (inside - outside).max(1e-3);
                return (plane, if APPROXIMATE { to } else { from + (to - from) * share.clamp(0.0, 1.0) });
            }
            counts.steps_back += 1;
            plane -= 1;
            here = before;
        }
        (plane, planes[plane as usize])
    }

    /// Density at a parameter of a ray that is in a tile or near it; 0 and 255 where the boundary array alone decides, `None`
    /// where no ground is.
    fn density_at<const APPROXIMATE: bool>(&self, ray: &Ray, s: f32, place: u32) -> Option<f32> {
        let mut entered = self.enter(ray, place)?;
        let is_inside = |entered: &Entered<'_>| {
            cell(entered.along(0, s)) < entered.tile.cells[0] && cell(entered.along(1, s)) < entered.tile.cells[1]
        };
        if !is_inside(&entered) {
            let Place::Tile(tile) = self.find(ray, s) else { return None };
            entered = self.enter(ray, tile)?;
        }
        let [columns, rows] = entered.tile.cells;
        let u = entered.along(0, s).clamp(0.0, columns as f32);
        let v = entered.along(1, s).clamp(0.0, rows as f32);
        let (i, j) = ((u as u32).min(columns - 1), (v as u32).min(rows - 1));
        let height = entered.along(2, s);
        if APPROXIMATE || !entered.tile.is_accurate {
            let span = entered.spans[j as usize * columns as usize + i as usize];
            return Some(if height >= f32::from(span.highest) + 1.0 { 0.0 } else { 255.0 });
        }
        Some(entered.density([i, j], u, v, height))
    }
}
