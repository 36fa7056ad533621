//! Rays of a line, from the bottom up (voxel-flythrough-1999 §4).
//!
//! A higher ray meets a height field further off, so a ray starts where the one below it hit. That holds when its samples
//! lie above those of the lower ray, and a little beside them no more than the ground can rise in between: sample `s` of
//! ray i is `eye + s·D_i`, so it is `s·(D_i − D_j)` from that of ray j, and
//!
//! ```text
//! D_i.z − D_j.z  >=  slope · |D_i.xy − D_j.xy|      ⇒      in the air at j  ⇒  in the air at i,  for every s
//! ```
//!
//! where no ground between the two is steeper than `slope`. Forward-only methods take this for granted, but planes of rays are
//! not vertical beside the middle of a pitched picture, and pixels of a rolled line are not above each other: then a ray may run
//! into a cliff that the one below it passed by. Here it is tested for each ray against the rays of its line
//! ([`Steepness`]); where the ground is steeper than the two rays allow, and there alone, the way is looked at, past blocks
//! that are below it as a whole. A start that lies in the ground all the same is stepped back from.

use crate::coherent::surface::Sample;
use crate::coherent::voxels::{Current, cell};
use crate::frame::{Frame, Place};
use crate::model::{LOG_BLOCK, THRESHOLD, Tile};
use crate::steepness::{Doubts, Steepness};
use crate::view::Ray;
use glam::Vec3;
use std::ops::Add;

/// How a ray's start is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Coherence {
    /// From the rays below it, when that is proven to miss nothing.
    #[default]
    Proven,
    /// From the ray below it, always: what forward-only methods do. Misses ground, for comparison only.
    ForwardOnly,
    /// Where the ray comes over the ground and below its top: plain ray casting.
    Plain,
    /// Where the ray comes over the ground, however high above it: what the paper compares with.
    FromEye,
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
    /// Rays that had to look at a part of the way that a ray below them had come.
    pub doubted: u64,
    /// Steps back out of the ground.
    pub steps_back: u64,
    /// Rays that met ground.
    pub hits: u64,
    /// How often rays came under the ground's edge.
    pub under: u64,
}

impl Add for Counts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            densities: self.densities + other.densities,
            unproven: self.unproven + other.unproven,
            doubted: self.doubted + other.doubted,
            steps_back: self.steps_back + other.steps_back,
            hits: self.hits + other.hits,
            under: self.under + other.under,
        }
    }
}

/// How rays of a line are cast.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LineOptions<'a> {
    pub(crate) coherence: Coherence,
    /// Of the surface that is looked at.
    pub(crate) steepness: &'a Steepness,
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
#[derive(Debug, Clone, Copy)]
enum End {
    /// A sample is in the ground.
    Hit(Sample),
    /// All samples before this plane are in the air, and none after it is over ground.
    Left(u32),
}

impl Frame<'_> {
    /// Casts the rays of a line's pixels, bottom up.
    pub(crate) fn cast_line<const APPROXIMATE: bool>(
        &self,
        options: &LineOptions<'_>,
        pixels: impl Iterator<Item = [u32; 2]>,
    ) -> Counts {
        let mut counts = Counts::default();
        let mut known: [Option<Known>; MOST_KNOWN] = [None; MOST_KNOWN];
        let mut next = 0;
        let Some(mut current) = self.current(0) else { return self.cast_nothing(pixels) };
        let planes = self.planes.s().len() as u32;
        let is_beside = self.is_eye_beside();
        for pixel in pixels {
            counts.rays += 1;
            let ray = self.view.ray(pixel);
            if self.has_undersides
                && let Some(seen) = self.seen_from_under(&ray, &mut counts)
            {
                counts.hits += u64::from(seen.is_some());
                let (color, depth) =
                    seen.map_or((self.sky, f32::NAN), |(tile, s)| (self.shade(tile, &ray, s), s * ray.depth));
                self.picture.put(pixel, color, depth);
                known[next] = None;
                next = (next + 1) % MOST_KNOWN;
                continue;
            }
            let entry = if is_beside { self.planes.at_or_after(self.entry(&ray)) } else { 0 };
            let below = self.ray_below(options, &ray, &known, next);
            let end = self.end_of(&ray);
            let result = match below {
                Some((below, doubts)) => {
                    // Where the lower ray was not over the ground yet it says nothing.
                    let before = below.entry.min(below.reach).min(end);
                    let gap = if entry < before { (before + 1).min(end) } else { before };
                    let start = below.reach.max(entry);
                    let mut found = End::Left(gap);
                    if entry < gap {
                        found = self.walk::<APPROXIMATE, false>(&ray, entry, gap, &mut current, &mut counts);
                    }
                    let mut is_doubted = false;
                    for [from, to] in doubts {
                        // It hit, or came past a corner of the ground.
                        if !matches!(found, End::Left(plane) if plane >= gap) {
                            break;
                        }
                        // A plane more on both sides: rounding.
                        let from = self.planes.at_or_after(from).saturating_sub(1).max(entry).max(gap);
                        let to = (self.planes.at_or_after(to) + 1).min(start + 1).min(end);
                        if from < to {
                            is_doubted = true;
                            let found_here = self.walk::<APPROXIMATE, true>(&ray, from, to, &mut current, &mut counts);
                            if matches!(found_here, End::Hit(_)) {
                                found = found_here;
                            }
                        }
                    }
                    counts.doubted += u64::from(is_doubted);
                    match found {
                        End::Left(plane) if plane >= gap => {
                            self.walk::<APPROXIMATE, false>(&ray, start, end, &mut current, &mut counts)
                        }
                        _ => found,
                    }
                }
                None => {
                    counts.unproven += 1;
                    let start = match options.coherence {
                        Coherence::FromEye => entry,
                        _ => entry.max(self.start_below_top(&ray)),
                    };
                    if matches!(options.coherence, Coherence::Plain | Coherence::FromEye) {
                        self.walk::<APPROXIMATE, false>(&ray, start, end, &mut current, &mut counts)
                    } else {
                        self.walk::<APPROXIMATE, true>(&ray, start, end, &mut current, &mut counts)
                    }
                }
            };
            let result = match result {
                End::Left(plane) => match self.at_border::<APPROXIMATE>(&ray, plane, &current, &mut counts) {
                    Some(sample) => End::Hit(sample),
                    None => result,
                },
                End::Hit(_) => result,
            };
            let reach = match result {
                End::Hit(sample) => {
                    let (reach, s) = self.refined::<APPROXIMATE>(&ray, sample, &current, &mut counts);
                    counts.hits += 1;
                    self.picture.put(pixel, self.shade(self.tile_at(&ray, s, &current), &ray, s), s * ray.depth);
                    reach
                }
                End::Left(plane) => {
                    self.picture.put(pixel, self.sky, f32::NAN);
                    // A ray that rose above everything is in the air for ever. Beyond the ground's border it says nothing.
                    if plane >= end && !self.ground.is_cut() {
                        planes
                    } else {
                        plane.min(self.planes.at_or_after(self.departure(&ray))).saturating_sub(1)
                    }
                }
            };
            known[next] = Some(Known { ray, entry, reach });
            next = (next + 1) % MOST_KNOWN;
        }
        counts
    }

    pub(crate) fn is_eye_beside(&self) -> bool {
        let (min, max) = (self.bounds.min, self.bounds.max);
        min.x > 0.0 || min.y > 0.0 || max.x < 0.0 || max.y < 0.0
    }

    /// The nearest ray below that proves where this one may start, and where on the way there it does not.
    #[inline(always)]
    fn ray_below(
        &self,
        options: &LineOptions<'_>,
        ray: &Ray,
        known: &[Option<Known>; MOST_KNOWN],
        next: usize,
    ) -> Option<(Known, Doubts)> {
        let back = |back: usize| known[(next + MOST_KNOWN - back) % MOST_KNOWN];
        match options.coherence {
            Coherence::Plain | Coherence::FromEye => None,
            Coherence::ForwardOnly => back(1).map(|below| (below, Doubts::NONE)),
            Coherence::Proven => options.steepness.nearest_proof(ray, (1..=MOST_KNOWN).filter_map(back), |below| {
                let s = self.planes.s();
                (&below.ray, s.get(below.reach as usize).copied().unwrap_or(f32::INFINITY))
            }),
        }
    }

    /// The plane after which a ray is above all ground, or over none.
    #[inline(always)]
    fn end_of(&self, ray: &Ray) -> u32 {
        let rising = self.end_of_rising(ray);
        // Cells may reach beyond the border.
        if self.ground.is_cut() { rising.min(self.planes.at_or_after(self.departure(ray))) } else { rising }
    }

    #[inline(always)]
    fn end_of_rising(&self, ray: &Ray) -> u32 {
        if ray.direction.z > 0.0 {
            // One more, for what lies before it.
            let after = self.planes.at_or_after(self.highest.max(0.0) / ray.direction.z) + 1;
            after.min(self.planes.s().len() as u32)
        } else if ray.direction.z == 0.0 && self.highest < 0.0 {
            0
        } else {
            self.planes.s().len() as u32
        }
    }

    /// The last plane at which a falling ray is above all ground.
    fn start_below_top(&self, ray: &Ray) -> u32 {
        if ray.direction.z < 0.0 && self.highest < 0.0 {
            self.planes.at_or_after(self.highest / ray.direction.z).saturating_sub(1)
        } else {
            0
        }
    }

    /// A tile, ready to be sampled.
    pub(crate) fn current(&self, index: u32) -> Option<Current<'_>> {
        let tile: &Tile = self.ground.tiles().get(index as usize)?;
        let placed = self.placed.get(index as usize)?;
        Some(Current {
            index,
            spans: self.ground.spans(tile),
            heights: self.ground.heights(tile),
            densities: self.ground.densities(tile),
            blocks: self.ground.blocks(tile),
            cells: tile.cells,
            layers: tile.layers as usize,
            is_accurate: tile.is_accurate,
            per_m: placed.per_m,
            at_0: -placed.corner * placed.per_m,
            datum: (self.datum - placed.corner.z) * placed.per_m,
        })
    }

    /// Sky, for a ground without tiles.
    pub(crate) fn cast_nothing(&self, pixels: impl Iterator<Item = [u32; 2]>) -> Counts {
        let mut counts = Counts::default();
        for pixel in pixels {
            counts.rays += 1;
            self.picture.put(pixel, self.sky, f32::NAN);
        }
        counts
    }

    /// Looks at the samples of a ray from plane `from` up to `end`. `current` is the tile to begin in, and where it ended.
    #[inline(always)]
    fn walk<'f, const APPROXIMATE: bool, const SKIPS: bool>(
        &'f self,
        ray: &Ray,
        from: u32,
        end: u32,
        current: &mut Current<'f>,
        counts: &mut Counts,
    ) -> End {
        let planes = &self.planes.s()[..(end as usize).min(self.planes.s().len())];
        let mut k = from as usize;
        let mut is_found = false;
        let mut outside = None;
        // None: no plane is before the first one.
        let mut looked_at = usize::MAX - 1;
        loop {
            // A copy, so that it stays in registers.
            let tile = *current;
            let per_s = ray.direction * tile.per_m;
            let [columns, rows] = tile.cells;
            let has_voxels = !APPROXIMATE && tile.is_accurate;
            let fall_per_s = self.fall * per_s.length();
            let mut looked_at_block = u32::MAX;
            loop {
                let Some(&s) = planes.get(k) else { return End::Left(end) };
                let mut at = tile.at(per_s, s);
                let ((mut i, mut low_u), (mut j, mut low_v)) = (cell(at.x), cell(at.y));
                if i >= columns || j >= rows {
                    if !is_found {
                        break;
                    }
                    // The tree says that it is here; the difference is rounding.
                    (at.x, at.y) = (at.x.clamp(0.0, columns as f32), at.y.clamp(0.0, rows as f32));
                    (i, j) = ((at.x as u32).min(columns - 1), (at.y as u32).min(rows - 1));
                    (low_u, low_v) = (i as f32, j as f32);
                }
                is_found = false;
                let span = tile.span(i, j);
                counts.samples += 1;
                let is_next = looked_at + 1 == k;
                looked_at = k;
                if at.z >= f32::from(span.highest) + 1.0 {
                    if let Some(before) = outside
                        && is_next
                        && let Some(sample) =
                            self.between::<APPROXIMATE>(ray, k, [Some(before), None], fall_per_s, current, counts)
                    {
                        return End::Hit(sample);
                    }
                    k += 1;
                    if SKIPS {
                        let block = (j >> LOG_BLOCK) * columns.div_ceil(1 << LOG_BLOCK) + (i >> LOG_BLOCK);
                        if block != looked_at_block {
                            looked_at_block = block;
                            k = self.skip(&tile, per_s, [i, j], at.z, block, k);
                        }
                    }
                    outside = None;
                    continue;
                }
                if at.z < f32::from(span.lowest) {
                    return End::Hit(Sample { plane: k as u32, inside: None, outside, crossing: None });
                }
                let density = if has_voxels {
                    counts.densities += 1;
                    tile.density([i, j], [low_u, low_v], at)
                } else {
                    tile.density_by_height([i, j], [low_u, low_v], at)
                };
                if density > THRESHOLD {
                    return End::Hit(Sample { plane: k as u32, inside: Some(density), outside, crossing: None });
                }
                if is_next
                    && let Some(sample) =
                        self.between::<APPROXIMATE>(ray, k, [outside, Some(density)], fall_per_s, current, counts)
                {
                    return End::Hit(sample);
                }
                outside = Some(density);
                k += 1;
            }
            loop {
                let Some(&s) = planes.get(k) else { return End::Left(end) };
                match self.find(ray, s) {
                    Place::Tile(tile) => {
                        if SKIPS && let Some(exit) = self.skip_nodes(ray, s) {
                            k = (k + 1).max(self.planes.at_or_after(exit) as usize);
                            outside = None;
                            continue;
                        }
                        let Some(next) = self.current(tile) else { return End::Left(k as u32) };
                        *current = next;
                        is_found = true;
                        break;
                    }
                    Place::HoleUntil(exit) => {
                        k = (k + 1).max(self.planes.at_or_after(exit) as usize);
                        outside = None;
                    }
                    Place::Left => return End::Left(k as u32),
                }
            }
        }
    }

    /// The first plane from `k` on at which a ray that is above all boundary cells of a block may not be any more.
    fn skip(&self, current: &Current<'_>, per_s: Vec3, cell: [u32; 2], height: f32, block: u32, k: usize) -> usize {
        let Some(highest) = current.blocks.get(block as usize) else { return k };
        let top = f32::from(*highest) + 1.0;
        if height < top {
            return k;
        }
        let mut s = f32::INFINITY;
        for (axis, cell) in cell.into_iter().enumerate() {
            let low = (cell >> LOG_BLOCK) << LOG_BLOCK;
            let high = (low + (1 << LOG_BLOCK)).min(current.cells[axis]);
            let (per_s, at_0) = (per_s[axis], current.at_0[axis]);
            if per_s > 0.0 {
                s = s.min((high as f32 - at_0) / per_s);
            } else if per_s < 0.0 {
                s = s.min((low as f32 - at_0) / per_s);
            }
        }
        if per_s.z < 0.0 {
            s = s.min((top - current.at_0.z) / per_s.z);
        }
        // One plane early: rounding.
        k.max(self.planes.at_or_after(s).saturating_sub(1) as usize)
    }
}
