//! From sources to a block of the finest level.

pub mod color;
pub mod elevation;
pub mod mapper;
pub mod window;

use crate::IngestError;
use crate::error::gdal_message;
use crate::source::open::Reader;
use crate::source::{Raster, TargetCrs};
use crate::store::Rect;
use gdal::spatial_ref::CoordTransform;
use mapper::{Lattice, Mapper};
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
    /// A sampler for samples `step` apart, measured at `middle` of the source in the database's CRS.
    pub fn new(reader: R, mapper: Mapper, middle: [f64; 2], step: f64) -> Self {
        let scale = mapper.scale_at(middle, step);
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

/// The middle of a source in the database's CRS.
pub(crate) fn middle_of(raster: &Raster, target: &TargetCrs) -> Result<[f64; 2], IngestError> {
    let [x, y] = raster.affine.apply(0.5 * raster.size[0] as f64, 0.5 * raster.size[1] as f64);
    if target.is_of(raster) {
        return Ok([x, y]);
    }
    let transform = CoordTransform::new(&raster.srs()?, &target.srs()?)
        .map_err(|e| IngestError::source(&raster.path, format!("cannot be transformed: {}", gdal_message(&e))))?;
    let (mut xs, mut ys) = ([x], [y]);
    // A middle that cannot be transformed comes back infinite: the scale is then taken as 1.
    transform.transform_coords(&mut xs, &mut ys, &mut []).ok();
    Ok([xs[0], ys[0]])
}
