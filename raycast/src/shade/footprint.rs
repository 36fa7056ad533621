//! Footprints: what a pixel covers on its facet, computed once for a run of neighbouring pixels
//! that see the same facet.
//!
//! A pixel covers a parallelogram of the facet's plane. Its longer axis is divided into taps, at
//! the mip whose texels are about as wide as the shorter one. Footprints are plain loops over
//! arrays, which compilers turn into vector instructions.

use super::strip::{Run, Runs};
use crate::model::Tile;
use crate::scene::Scene;
use crate::view::View;
use glam::{Vec2, Vec4};

/// log2 of the largest number of taps along a footprint; longer footprints use coarser mips.
/// (Measured, as is [`TEXELS_PER_TAP`]; see `docs/techniques.md`, *Thresholds*.)
const LOG_MOST_TAPS: u32 = 1;
/// A footprint gets another tap for every this many texels of length.
const TEXELS_PER_TAP: f32 = 2.0;
/// Footprints of surfaces that are seen edge on are infinite: they are cut to this share of the
/// distance, several pixels at any field of view.
const LONGEST_SHARE: f32 = 0.01;
/// Upper bound of the mips of a layer: those of the widest layer for which fixed point suffices.
const MOST_MIPS: usize = 16;
/// Lower bound of the cosine between a facet's normal and a ray, either way, for facets that are
/// seen edge on.
const LEAST_FACING: f32 = 1e-6;

/// The footprints of the runs of neighbouring lines. Memory is used again.
#[derive(Debug, Default)]
pub(crate) struct Footprints {
    of_runs: Vec<Footprint>,
    scratch: Scratch,
}

impl Footprints {
    /// Reserves memory for this many runs.
    pub(crate) fn reserve(&mut self, runs: usize) {
        self.of_runs.clear();
        self.of_runs.reserve(runs);
        self.scratch.reserve(runs);
    }

    /// Computes the footprints of runs.
    pub(crate) fn measure(&mut self, scene: &Scene<'_>, runs: &Runs) {
        gather(scene, runs.list(), &mut self.scratch);
        measure(&scene.view, runs.list().len(), &mut self.scratch);
        collect(scene, runs.list(), &self.scratch, &mut self.of_runs);
    }

    /// The footprint of a run; `None` for sky.
    #[inline(always)]
    pub(super) fn of(&self, run: u32) -> Option<&Footprint> {
        self.of_runs.get(run as usize)
    }
}

/// Intermediate values of footprints.
#[derive(Debug, Default)]
struct Scratch {
    /// For each run: column and row of the first pixel, one over its depth, slope east and north
    /// (metres up per metre), texels per metre.
    given: [Vec<f32>; 6],
    /// For each run: log2 of a texel's width in texels of the finest mip, log2 of the number of
    /// taps, and the offset from the first tap to the middle, in finest texels east and north.
    levels: Vec<i32>,
    log_taps: Vec<i32>,
    reach: [Vec<f32>; 2],
}

impl Scratch {
    fn reserve(&mut self, longest: usize) {
        self.given.iter_mut().chain(&mut self.reach).for_each(|values| values.resize(longest, 0.0));
        self.levels.resize(longest, 0);
        self.log_taps.resize(longest, 0);
    }
}

/// Where the colours of a run's pixels come from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    pub(super) layer: u32,
    /// First byte of the mip.
    start: u32,
    /// Texels along a side of the mip.
    side: u32,
    /// The last position between four texels, less than a texel from the mip's border.
    end: f32,
    /// One or two.
    taps: u32,
    /// Texels per metre.
    scale: f32,
    /// The taps at the point below the eye, texels east and south.
    origin: [f32; 4],
}

/// Four 8-bit channels in 16-bit lanes.
#[inline(always)]
fn lanes(texel: u64) -> u64 {
    texel & 0x00ff_00ff | (texel & 0xff00_ff00) << 24
}

impl Footprint {
    /// Mean colour around a point, metres east and south of the eye.
    #[inline(always)]
    pub(super) fn color(&self, layer: &[u8], [east, south]: [f32; 2]) -> u32 {
        // When a smaller number is added, the sum's lower bits are that number, rounded to a whole
        // one.
        const WHOLE: f32 = 8_388_608.0;
        let Some(texels) = layer.get(self.start as usize..) else { return 0 };
        // Columns and rows of both taps: the nearest from 0 to the end, in 256ths.
        let at = Vec4::new(east, south, east, south) * self.scale + Vec4::from_array(self.origin);
        let at = at.max(Vec4::ZERO).min(Vec4::splat(self.end)) * 256.0 + Vec4::splat(WHOLE);
        let [i, j, k, l] = at.to_array().map(|at| at.to_bits() & 0x007f_ffff);
        let mut sum = 0x0080_0080_0080_0080;
        if self.taps == 1 {
            sum += self.tap(texels, [i, j], 256);
        } else {
            sum += self.tap(texels, [i, j], 128) + self.tap(texels, [k, l], 128);
        }
        (sum >> 8) as u32 & 0x00ff_00ff | (sum >> 32) as u32 & 0xff00_ff00
    }

    /// Colour between four texels, in 256ths of one, times a weight. All weights are 256 together,
    /// so that lanes never overflow.
    #[inline(always)]
    fn tap(&self, texels: &[u8], [i, j]: [u32; 2], weight: u32) -> u64 {
        let stride = 4 * self.side as usize;
        let (u, v) = (i & 0xff, ((j & 0xff) * weight) >> 8);
        let south = weight - v;
        let (ne, se) = ((u * south) >> 8, (u * v) >> 8);
        let (nw, sw) = (south - ne, v - se);
        let first = (j >> 8) as usize * stride + 4 * (i >> 8) as usize;
        let pair = |at: usize| match texels.get(at..at + 8) {
            Some(&[a, b, c, d, e, f, g, h]) => u64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => 0,
        };
        let (upper, lower) = (pair(first), pair(first + stride));
        lanes(upper & 0xffff_ffff) * u64::from(nw)
            + lanes(upper >> 32) * u64::from(ne)
            + lanes(lower & 0xffff_ffff) * u64::from(sw)
            + lanes(lower >> 32) * u64::from(se)
    }
}

/// Collects the inputs of the footprints of runs.
fn gather(scene: &Scene<'_>, runs: &[Run], scratch: &mut Scratch) {
    let [columns, rows, nearness, east, north, texels] = &mut scratch.given;
    for (n, run) in runs.iter().enumerate() {
        let placed = &scene.placed[run.tile as usize];
        columns[n] = f32::from(run.pixel[0]);
        rows[n] = f32::from(run.pixel[1]);
        nearness[n] = run.nearness;
        east[n] = run.slope.x * placed.per_m;
        north[n] = run.slope.y * placed.per_m;
        texels[n] = placed.texels_per_m;
    }
}

/// Converts footprints to the form in which pixels use them.
fn collect(scene: &Scene<'_>, runs: &[Run], scratch: &Scratch, footprints: &mut Vec<Footprint>) {
    let layout = scene.ground.shape().color;
    // A mip of one texel has no position between four texels.
    let coarsest = (layout.mips.min(layout.side.max(2).ilog2()) - 1).min(MOST_MIPS as u32 - 1);
    let mut mips = [(0, layout.side); MOST_MIPS];
    for level in 1..=coarsest as usize {
        let (start, side) = mips[level - 1];
        mips[level] = (start + 4 * side * side, side >> 1);
    }
    let [east, north] = &scratch.reach;
    footprints.clear();
    for (n, run) in runs.iter().enumerate() {
        let (placed, tile): (_, &Tile) = (&scene.placed[run.tile as usize], &scene.ground.tiles()[run.tile as usize]);
        let level = scratch.levels[n].clamp(0, coarsest as i32);
        let (start, side) = mips[level as usize % MOST_MIPS];
        let finer = power_of_2(-level);
        let scale = placed.texels_per_m * finer;
        let log_taps = scratch.log_taps[n].clamp(0, LOG_MOST_TAPS as i32) as u32;
        let reach = Vec2::new(east[n], -north[n]) * finer;
        let corner = placed.color_corner * scale;
        let step = reach * power_of_2(1 - log_taps as i32);
        let first = Vec2::new(-corner.x, corner.y) - reach + 0.5 * step - 0.5;
        let second = first + step;
        footprints.push(Footprint {
            layer: tile.color.layer,
            start,
            side,
            // Fixed point ends at 32768.
            end: (side.min(32768) - 1) as f32 - 1.0 / 256.0,
            taps: 1 << log_taps,
            scale,
            origin: [first.x, first.y, second.x, second.y],
        });
    }
}

/// Computes the ellipses and taps of the footprints of runs.
fn measure(view: &View, count: usize, scratch: &mut Scratch) {
    let Scratch { given, levels, log_taps, reach: [out_east, out_north], .. } = scratch;
    let [columns, rows, nearness, slopes_east, slopes_north, texels] = given;
    let (columns, rows, nearness) = (&columns[..count], &rows[..count], &nearness[..count]);
    let (slopes_east, slopes_north, texels) = (&slopes_east[..count], &slopes_north[..count], &texels[..count]);
    let (levels, log_taps) = (&mut levels[..count], &mut log_taps[..count]);
    let (out_east, out_north) = (&mut out_east[..count], &mut out_north[..count]);
    let [column, row] = view.steps();
    for n in 0..count {
        let (east, north) = (slopes_east[n], slopes_north[n]);
        let d = view.direction_at(columns[n], rows[n]);
        // The facet's normal is (-east, -north, 1). Rays come from above, or, beside the world,
        // from below.
        let facing = d.z - east * d.x - north * d.y;
        let facing = facing.abs().max(LEAST_FACING).copysign(facing);
        let scale = texels[n] / nearness[n];
        let limit = LONGEST_SHARE * scale;
        let across = |x: f32, y: f32, z: f32| {
            let by = (z - east * x - north * y) / facing;
            let (x, y) = ((x - d.x * by) * scale, (y - d.y * by) * scale);
            let squared = x * x + y * y;
            let shorter = if squared > limit * limit { limit / squared.sqrt() } else { 1.0 };
            (x * shorter, y * shorter)
        };
        let (ax, ay) = across(column.x, column.y, column.z);
        let (bx, by) = across(row.x, row.y, row.z);
        // Axes of the ellipse, from the matrix of second moments.
        let (xx, yy, xy) = (ax * ax + bx * bx, ay * ay + by * by, ax * ay + bx * by);
        let mean = 0.5 * (xx + yy);
        let half = 0.5 * (xx - yy);
        let spread = (half * half + xy * xy).sqrt();
        let long = (mean + spread).sqrt();
        let short = (mean - spread).max(1.0).sqrt().max(long * (1.0 / (1 << LOG_MOST_TAPS) as f32));
        let level = rounded_log2(short);
        let width = power_of_2(level);
        let taps = long / (width * TEXELS_PER_TAP);
        // The next power of two.
        log_taps[n] = ((taps.max(1.0).to_bits() as i32 - 1) >> 23) - 126;
        levels[n] = level;
        // The eigenvector of the larger eigenvalue, from the longer row of the matrix.
        let (x, y) = if half >= 0.0 { (half + spread, xy) } else { (xy, spread - half) };
        let reach = 0.5 * (long - short).max(0.0) / (x * x + y * y).max(f32::MIN_POSITIVE).sqrt();
        out_east[n] = x * reach;
        out_north[n] = y * reach;
    }
}

/// 2 to the power of `exponent`, for normal numbers.
#[inline(always)]
fn power_of_2(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127) << 23) as u32)
}

/// log2 of a number of 1 or more, rounded.
#[inline(always)]
fn rounded_log2(x: f32) -> i32 {
    ((x * std::f32::consts::SQRT_2).to_bits() >> 23) as i32 - 127
}
