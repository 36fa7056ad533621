//! Lines of pixels on their way to the picture: what each pixel sees, before it has a colour. Some per worker, used again.

use crate::facets::Facet;
use crate::lines::Lines;
use crate::paint::{Footprint, Scratch};
use glam::Vec2;

/// A run of pixels that see one facet has its footprint worked out once, for its first pixel. No run is longer than this.
const LONGEST_RUN: usize = 16;

/// Pixels of a line, bottom up, and runs of them that see the same facet.
#[derive(Debug, Default)]
pub(crate) struct Strip {
    /// Columns and rows.
    pub(crate) pixels: Vec<[u16; 2]>,
    /// One over depth; anything for sky.
    pub(crate) nearness: Vec<f32>,
    /// Which run a pixel is in; [`Strip::SKY`] for none.
    pub(crate) run_of: Vec<u16>,
    pub(crate) runs: Vec<Run>,
    /// Of each run, where its pixels have their colours from.
    pub(crate) footprints: Vec<Footprint>,
}

/// Neighbouring lines, which are painted together: what is beside each other in the picture is so in colour tiles as well, and is
/// written at once.
#[derive(Debug, Default)]
pub(crate) struct Strips {
    pub(crate) strips: Vec<Strip>,
    pub(crate) scratch: Scratch,
}

impl Strips {
    /// Most lines.
    pub(crate) const MOST: usize = 16;

    /// Takes memory for the lines of pictures of a size, if it is not there.
    pub(crate) fn reserve(&mut self, size: [u32; 2]) {
        self.strips.resize_with(Self::MOST, Strip::default);
        self.strips.iter_mut().for_each(|strip| strip.reserve(size));
        self.scratch.reserve(size[0].max(size[1]) as usize);
    }
}

/// Pixels that see one facet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Run {
    /// The first one.
    pub(crate) first: u16,
    pub(crate) tile: u32,
    /// Metres up per cell east and north.
    pub(crate) slope: Vec2,
}

impl Strip {
    /// The run of pixels that see no ground.
    pub(crate) const SKY: u16 = u16::MAX;

    /// Most pixels: their numbers, and those of runs, are below that of the sky.
    pub(crate) const LONGEST: u32 = Self::SKY as u32;

    /// Takes memory for the lines of pictures of a size, if it is not there.
    pub(crate) fn reserve(&mut self, size: [u32; 2]) {
        let longest = size[0].max(size[1]) as usize;
        self.pixels.clear();
        self.pixels.reserve(longest);
        self.nearness.resize(longest, 0.0);
        self.run_of.resize(longest, Self::SKY);
        self.runs.clear();
        self.runs.reserve(longest);
        self.footprints.clear();
        self.footprints.reserve(longest);
    }

    /// Begins line `n`.
    pub(crate) fn begin(&mut self, lines: &Lines, n: usize) {
        lines.fill(n, &mut self.pixels);
        self.runs.clear();
    }

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

    /// Pixel `k` sees sky.
    #[inline]
    pub(crate) fn put_sky(&mut self, k: usize) {
        self.run_of[k] = Self::SKY;
    }

    /// Pixel `k` sees a facet of a tile at a depth.
    #[inline]
    pub(crate) fn put(&mut self, k: usize, depth: f32, tile: u32, facet: &Facet) {
        self.nearness[k] = 1.0 / depth;
        let run = Run { first: k as u16, tile, slope: facet.slope };
        let is_same = |last: &Run| Run { first: run.first, ..*last } == run && k - (last.first as usize) < LONGEST_RUN;
        if !(k > 0 && self.run_of[k - 1] != Self::SKY && self.runs.last().is_some_and(is_same)) {
            self.runs.push(run);
        }
        self.run_of[k] = (self.runs.len() - 1) as u16;
    }

    /// Pixels from `first` to `last` see a facet, `nearness` of a pixel being linear: its value at pixel `at`, and from pixel
    /// to pixel.
    #[inline(always)]
    pub(crate) fn put_run(
        &mut self,
        [first, last]: [usize; 2],
        at: f32,
        [nearness, per_pixel]: [f32; 2],
        tile: u32,
        slope: Vec2,
    ) {
        let mut next = first;
        while next <= last {
            let end = last.min(next + LONGEST_RUN - 1);
            let run = self.runs.len() as u16;
            self.runs.push(Run { first: next as u16, tile, slope });
            let mut by = next as f32 - at;
            for (value, run_of) in self.nearness[next..end + 1].iter_mut().zip(&mut self.run_of[next..end + 1]) {
                *value = nearness + by * per_pixel;
                *run_of = run;
                by += 1.0;
            }
            next = end + 1;
        }
    }
}
