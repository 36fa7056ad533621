//! From sources to a block of the finest level.

pub mod color;
pub(crate) mod corners;
pub mod elevation;
pub mod kernel;
pub mod mapper;
pub mod neighbors;
mod sharp;
mod source_set;

use crate::IngestError;
use crate::plan::Lattice;
use crate::source::window::Window;
use crate::store::Rect;
use kernel::Kernel;
use mapper::Mapper;
use neighbors::Neighbor;
pub use source_set::SourceSet;

/// Maximum number of source pixels in memory at a time, per thread.
const MAX_WINDOW_PIXELS: usize = 2 << 20;
/// The side of blocks of the finest level.
pub const BLOCK: usize = 256;

/// The result of sampling a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sampled<const C: usize> {
    /// It lies in none of the sources.
    Outside,
    /// It lies in a source, but no source has data there.
    Void,
    /// The number of the first source that has data there, and its value.
    Value(u32, [f32; C]),
}

impl<const C: usize> Sampled<C> {
    /// The number of the source and its value, where one has data.
    #[must_use]
    pub fn known(self) -> Option<(u32, [f32; C])> {
        match self {
            Self::Value(source, value) => Some((source, value)),
            Self::Outside | Self::Void => None,
        }
    }
}

/// How one source is sampled, by one thread.
#[derive(Debug)]
pub struct Sampler {
    mapper: Mapper,
    kernel: Kernel,
    neighbors: Vec<Neighbor>,
    /// First and last column and row that any of the neighbours has.
    limits: [[i64; 2]; 2],
}

/// Reads a rectangle of a source's grid, from the source and its neighbours.
type ReadWindow<'r, const C: usize> = dyn FnMut(&[Neighbor], Rect) -> Result<Window<C>, IngestError> + 'r;

impl Sampler {
    /// A sampler of a source that has these neighbours, itself among them.
    #[must_use]
    pub fn new(mapper: Mapper, kernel: Kernel, neighbors: Vec<Neighbor>) -> Self {
        let first = |axis: usize| neighbors.iter().map(|n| n.place.origin[axis]).min().unwrap_or(0);
        let end = |n: &Neighbor, axis: usize| n.place.origin[axis] + n.place.size[axis] as i64;
        let last = |axis: usize| neighbors.iter().map(|n| end(n, axis) - 1).max().unwrap_or(0);
        let limits = [[0, 1].map(first), [0, 1].map(last)];
        Self { mapper, kernel, neighbors, limits }
    }

    /// Smallest and largest sample so far.
    #[must_use]
    pub fn range(&self) -> [f32; 2] {
        self.kernel.range()
    }

    /// Positions in the source of the samples of a block, row by row; `None` outside of it.
    #[must_use]
    pub fn positions(&self, lattice: &Lattice, block: Rect) -> Vec<Option<[f64; 2]>> {
        self.mapper.map(lattice, block)
    }

    /// Calls `put` with the value at each of the positions, `width` a row, that has data.
    ///
    /// # Errors
    /// [`IngestError::Source`] when the source cannot be read.
    pub fn sample<const C: usize>(
        &mut self,
        positions: &[Option<[f64; 2]>],
        width: usize,
        put: &mut impl FnMut(usize, [f32; C]),
        read: &mut ReadWindow<'_, C>,
    ) -> Result<(), IngestError> {
        let all = Rect::new([0, 0], [width, positions.len() / width]);
        self.sample_part(positions, width, all, put, read)
    }

    /// The same for a part of a block; parts that need too large a window are split into quarters.
    fn sample_part<const C: usize>(
        &mut self,
        positions: &[Option<[f64; 2]>],
        width: usize,
        part: Rect,
        put: &mut impl FnMut(usize, [f32; C]),
        read: &mut ReadWindow<'_, C>,
    ) -> Result<(), IngestError> {
        let [x0, y0] = part.origin.map(|v| v as usize);
        let row = |j: usize| (y0 + j) * width + x0..(y0 + j) * width + x0 + part.size[0];
        let indices = || (0..part.size[1]).flat_map(row);
        let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
        for position in indices().filter_map(|at| positions[at]) {
            for axis in 0..2 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
        }
        if low[0] > high[0] {
            return Ok(());
        }
        let (reach, [least, most]) = (self.kernel.reach(), self.limits);
        let first = [0, 1].map(|a| (low[a].floor() as i64 - reach[a] as i64).clamp(least[a], most[a]));
        let last = [0, 1].map(|a| (high[a].ceil() as i64 + reach[a] as i64).clamp(least[a], most[a]));
        let window_size = [0, 1].map(|a| (last[a] - first[a] + 1) as usize);
        if window_size[0] * window_size[1] > MAX_WINDOW_PIXELS && part.area() > 1 {
            let halves = |from: usize, length: usize| [(from, length / 2), (from + length / 2, length - length / 2)];
            for (y, h) in halves(y0, part.size[1]) {
                for (x, w) in halves(x0, part.size[0]) {
                    if w > 0 && h > 0 {
                        let quarter = Rect::new([x as i64, y as i64], [w, h]);
                        self.sample_part(positions, width, quarter, put, read)?;
                    }
                }
            }
            return Ok(());
        }
        let window = read(&self.neighbors, Rect::new(first, window_size))?;
        for at in indices() {
            if let Some(value) = positions[at].and_then(|position| self.kernel.sample(&window, position)) {
                put(at, value);
            }
        }
        Ok(())
    }
}
