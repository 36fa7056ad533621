//! Lines of pixels before they are coloured: what each pixel sees. Each worker reuses its own.

use crate::lines::Lines;
use glam::Vec2;

/// log2 of the pixels of a line for which the footprint of a facet is computed once: within 32 x 16
/// pixels footprints are nearly equal.
const LOG_LONGEST_RUN: u32 = 4;
/// log2 of the entries of the hash table of runs: 64 KiB, to stay in a core's L2 cache.
const LOG_ENTRIES: u32 = 12;

/// Neighbouring lines, which are painted together: pixels that are adjacent in the picture are
/// adjacent in colour tiles too, see the same facets, and share cache lines of the picture.
#[derive(Debug, Default)]
pub(crate) struct Strips {
    pub(crate) lines: Vec<Line>,
    pub(crate) runs: Runs,
}

/// Pixels of a line, bottom up.
#[derive(Debug, Default)]
pub(crate) struct Line {
    /// Columns and rows.
    pub(crate) pixels: Vec<[u16; 2]>,
    /// One over depth; undefined for sky.
    pub(crate) nearness: Vec<f32>,
    /// The run that a pixel belongs to; [`Line::SKY`] if it sees sky.
    pub(crate) run_of: Vec<u32>,
}

/// A part of a facet with a common footprint: that of the first pixel that saw it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Run {
    pub(crate) pixel: [u16; 2],
    pub(crate) nearness: f32,
    pub(crate) tile: u32,
    /// Metres up per cell east and north.
    pub(crate) slope: Vec2,
}

/// The runs of neighbouring lines.
#[derive(Debug, Default)]
pub(crate) struct Runs {
    list: Vec<Run>,
    /// Hash table: a facet and the part of it, and the index of the run. Of two with the same entry
    /// the later one stays.
    found: Vec<(u64, u32)>,
}

/// A line to be filled.
#[derive(Debug)]
pub(crate) struct Strip<'a> {
    pub(crate) pixels: &'a [[u16; 2]],
    pub(crate) nearness: &'a mut [f32],
    run_of: &'a mut [u32],
    runs: &'a mut Runs,
}

impl Strips {
    /// Most lines.
    pub(crate) const MOST: usize = 32;

    /// Removes all lines, and reserves memory for lines of this many pixels.
    pub(crate) fn begin(&mut self, longest: usize) {
        self.lines.resize_with(Self::MOST, Line::default);
        for line in &mut self.lines {
            line.pixels.clear();
            line.pixels.reserve(longest);
            line.nearness.resize(longest, 0.0);
            line.run_of.resize(longest, Line::SKY);
        }
        self.runs.list.clear();
        self.runs.list.reserve(Self::MOST * longest);
        self.runs.found.clear();
        self.runs.found.resize(1 << LOG_ENTRIES, (u64::MAX, 0));
    }

    /// Begins line `n` of a picture, as line number `at` of the strip.
    pub(crate) fn strip(&mut self, at: usize, lines: &Lines, n: usize) -> Strip<'_> {
        let Line { pixels, nearness, run_of } = &mut self.lines[at];
        lines.fill(n, pixels);
        Strip { pixels, nearness, run_of, runs: &mut self.runs }
    }
}

impl Line {
    /// The run of pixels that see no ground.
    pub(crate) const SKY: u32 = u32::MAX;

    /// Most pixels.
    pub(crate) const LONGEST: u32 = u16::MAX as u32;

    #[inline(always)]
    pub(crate) fn pixel(&self, k: usize) -> [u32; 2] {
        self.pixels[k].map(u32::from)
    }
}

impl Runs {
    pub(crate) fn list(&self) -> &[Run] {
        &self.list
    }

    /// The run of a facet's pixels around pixel `k`; `run` creates it if it does not exist.
    #[inline(always)]
    fn find(&mut self, k: usize, tile: u32, facet: usize, run: impl FnOnce() -> Run) -> u32 {
        let key = u64::from(tile) << 44 | (facet as u64) << 16 | (k >> LOG_LONGEST_RUN) as u64;
        let entry = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - LOG_ENTRIES)) as usize;
        let Some((found, number)) = self.found.get_mut(entry) else { return Line::SKY };
        if *found != key {
            (*found, *number) = (key, self.list.len() as u32);
            self.list.push(run());
        }
        *number
    }
}

impl Strip<'_> {
    #[inline(always)]
    pub(crate) fn pixel(&self, k: usize) -> [u32; 2] {
        self.pixels[k].map(u32::from)
    }

    /// Whether all pixels are in one column or row.
    pub(crate) fn is_straight(&self) -> bool {
        match (self.pixels.first(), self.pixels.last()) {
            (Some(a), Some(b)) => a[0] == b[0] || a[1] == b[1],
            _ => true,
        }
    }

    /// Writes that pixel `k` sees sky.
    #[inline]
    pub(crate) fn put_sky(&mut self, k: usize) {
        self.run_of[k] = Line::SKY;
    }

    /// Writes that pixel `k` sees a facet of a tile at a depth. `facet`: its number within the
    /// tile.
    #[inline]
    pub(crate) fn put(&mut self, k: usize, depth: f32, tile: u32, facet: usize, slope: Vec2) {
        let nearness = 1.0 / depth;
        let pixel = self.pixels[k];
        self.nearness[k] = nearness;
        self.run_of[k] = self.runs.find(k, tile, facet, || Run { pixel, nearness, tile, slope });
    }

    /// Writes that the pixels from `first` to `last`, all within the same sixteen, see a facet.
    /// `nearness` is linear: its value at pixel `at`, and its change from pixel to pixel.
    #[inline(always)]
    pub(crate) fn put_run(
        &mut self,
        [first, last]: [usize; 2],
        at: f32,
        [nearness, per_pixel]: [f32; 2],
        [tile, facet]: [usize; 2],
        slope: impl FnOnce() -> Vec2,
    ) {
        let mut by = first as f32 - at;
        let (pixel, nearest) = (self.pixels[first], nearness + by * per_pixel);
        let tile = tile as u32;
        let run = self.runs.find(first, tile, facet, || Run { pixel, nearness: nearest, tile, slope: slope() });
        for (value, run_of) in self.nearness[first..last + 1].iter_mut().zip(&mut self.run_of[first..last + 1]) {
            *value = nearness + by * per_pixel;
            *run_of = run;
            by += 1.0;
        }
    }
}
