//! From sources to a block of the finest level.

pub mod color;
pub mod elevation;
pub mod mapper;
pub mod window;

use crate::IngestError;
use crate::source::open::Reader;
use crate::source::{Raster, TargetCrs};
use crate::store::Rect;
use mapper::{Lattice, Mapper};
use std::cell::RefCell;
use std::collections::VecDeque;
use window::Kernel;

/// The most source pixels that are in memory at a time, per thread.
const MAX_WINDOW_PIXELS: usize = 2 << 20;
/// The side of blocks of the finest level.
pub const BLOCK: usize = 256;

/// A source that is ready to be sampled by one thread.
#[derive(Debug)]
pub struct Sampler<R> {
    reader: R,
    mapper: Mapper,
    kernel: Kernel,
}

impl<R> Sampler<R> {
    /// A sampler for samples `step` apart, measured at a point of the database's CRS that is in the source.
    pub fn new(reader: R, mapper: Mapper, focus: [f64; 2], step: f64) -> Self {
        let scale = mapper.scale_at(focus, step);
        // A kernel may not need more than a window has.
        let most = (MAX_WINDOW_PIXELS as f64).sqrt() / 8.0;
        Self { reader, mapper, kernel: Kernel::new(scale.map(|s| s.min(most))) }
    }

    /// Calls `put` with the value at each sample of a block that lies in the source and has data, unless `is_done`
    /// says that the sample has been seen to.
    ///
    /// # Errors
    /// [`IngestError::Source`] when the source cannot be read.
    pub fn sample<const C: usize>(
        &mut self,
        lattice: &Lattice,
        block: Rect,
        is_done: &dyn Fn(usize) -> bool,
        put: &mut dyn FnMut(usize, [f32; C]),
    ) -> Result<(), IngestError>
    where
        R: Reader<C>,
    {
        let positions = self.mapper.map(lattice, block);
        self.sample_part(&positions, block.size[0], Rect::new([0, 0], block.size), is_done, put)
    }

    /// The same for a part of a block; parts that need too large a window are quartered.
    fn sample_part<const C: usize>(
        &mut self,
        positions: &[Option<[f64; 2]>],
        width: usize,
        part: Rect,
        is_done: &dyn Fn(usize) -> bool,
        put: &mut dyn FnMut(usize, [f32; C]),
    ) -> Result<(), IngestError>
    where
        R: Reader<C>,
    {
        let [x0, y0] = part.origin.map(|v| v as usize);
        let indices = || (0..part.area()).map(|k| (y0 + k / part.size[0]) * width + x0 + k % part.size[0]);
        let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
        for position in indices().filter(|&at| !is_done(at)).filter_map(|at| positions[at]) {
            for axis in 0..2 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
        }
        if low[0] > high[0] {
            return Ok(());
        }
        let (reach, size) = (self.kernel.reach(), self.reader.size());
        let first = [0, 1].map(|a| (low[a].floor() as i64 - reach[a] as i64).clamp(0, size[a] as i64 - 1) as usize);
        let last = [0, 1].map(|a| (high[a].ceil() as i64 + reach[a] as i64).clamp(0, size[a] as i64 - 1) as usize);
        let window_size = [last[0] - first[0] + 1, last[1] - first[1] + 1];
        if window_size[0] * window_size[1] > MAX_WINDOW_PIXELS && part.area() > 1 {
            let halves = |from: usize, length: usize| [(from, length / 2), (from + length / 2, length - length / 2)];
            for (y, h) in halves(y0, part.size[1]) {
                for (x, w) in halves(x0, part.size[0]) {
                    if w > 0 && h > 0 {
                        self.sample_part(positions, width, Rect::new([x as i64, y as i64], [w, h]), is_done, put)?;
                    }
                }
            }
            return Ok(());
        }
        let window = self.reader.read(first, window_size)?;
        for at in indices().filter(|&at| !is_done(at)) {
            if let Some(value) = positions[at].and_then(|position| self.kernel.sample(&window, position)) {
                put(at, value);
            }
        }
        Ok(())
    }
}

/// Where a source's pixel centres lie in the database's CRS: least and greatest easting and northing, and its pixels' size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Least easting and northing.
    pub low: [f64; 2],
    /// Greatest.
    pub high: [f64; 2],
    /// About the side of a pixel, metres.
    pub pixel: f64,
    /// Where that was measured.
    pub focus: [f64; 2],
}

impl Bounds {
    /// Whether a block of a lattice may meet the source. (Bounds are of sampled points: a few pixels are allowed.)
    fn meets(&self, lattice: &Lattice, block: Rect) -> bool {
        (0..2).all(|axis| {
            let first = lattice.first[axis] + block.origin[axis] as f64 * lattice.step;
            let last = first + (block.size[axis] - 1) as f64 * lattice.step;
            let margin = 4.0 * self.pixel + 0.01 * (self.high[axis] - self.low[axis]);
            first <= self.high[axis] + margin && last >= self.low[axis] - margin
        })
    }
}

/// All sources of a layer, for one thread: opened when a block first meets them, closed when others are needed more.
/// (A world may have more files than a process may have open.)
pub struct SourceSet<'a, V, R> {
    sources: &'a [(Raster, V)],
    bounds: &'a [Bounds],
    target: &'a TargetCrs,
    lattice: Lattice,
    open: fn(&'a Raster, &'a V) -> Result<R, IngestError>,
    samplers: Vec<Option<Sampler<R>>>,
    /// Those that are open, the one opened longest ago first.
    is_open: VecDeque<usize>,
}

/// Files that a thread may have open.
const MAX_OPEN: usize = 24;

impl<'a, V, R> SourceSet<'a, V, R> {
    /// The sources, with their bounds, for samples on a lattice.
    pub fn new(
        sources: &'a [(Raster, V)],
        bounds: &'a [Bounds],
        target: &'a TargetCrs,
        lattice: Lattice,
        open: fn(&'a Raster, &'a V) -> Result<R, IngestError>,
    ) -> Self {
        let samplers = sources.iter().map(|_| None).collect();
        Self { sources, bounds, target, lattice, open, samplers, is_open: VecDeque::new() }
    }

    fn opened(&mut self, index: usize) -> Result<&mut Sampler<R>, IngestError> {
        if self.samplers[index].is_none() {
            if self.is_open.len() == MAX_OPEN {
                self.is_open.pop_front().into_iter().for_each(|oldest| self.samplers[oldest] = None);
            }
            let (raster, values) = &self.sources[index];
            let mapper = Mapper::new(self.target, raster)?;
            let focus = self.bounds[index].focus;
            let sampler = Sampler::new((self.open)(raster, values)?, mapper, focus, self.lattice.step);
            self.samplers[index] = Some(sampler);
            self.is_open.push_back(index);
        }
        // Just made, if it was not there.
        self.samplers[index].as_mut().ok_or_else(|| IngestError::usage("a source was not opened"))
    }

    /// Samples a block: the value of the first source that has data at each place, or `None`.
    ///
    /// # Errors
    /// [`IngestError::Source`] when a source cannot be read.
    pub fn sample<const C: usize>(&mut self, block: Rect) -> Result<Vec<Option<[f32; C]>>, IngestError>
    where
        R: Reader<C>,
    {
        let values = RefCell::new(vec![None; block.area()]);
        let lattice = self.lattice;
        for index in 0..self.sources.len() {
            if !self.bounds[index].meets(&lattice, block) {
                continue;
            }
            let is_done = |at: usize| values.borrow()[at].is_some();
            if (0..block.area()).all(is_done) {
                break;
            }
            let mut put = |at: usize, value| values.borrow_mut()[at] = Some(value);
            self.opened(index)?.sample::<C>(&lattice, block, &is_done, &mut put)?;
        }
        Ok(values.into_inner())
    }
}

impl<V, R> std::fmt::Debug for SourceSet<'_, V, R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SourceSet")
            .field("sources", &self.sources.len())
            .field("open", &self.is_open)
            .finish_non_exhaustive()
    }
}
