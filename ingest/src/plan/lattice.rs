//! The lattice of samples in the world's CRS, and the bounds of sources.

use crate::store::Rect;

/// A lattice of target samples in the database's CRS: sample `(i, j)` is at `first + step·(i, j)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Easting and northing of sample (0, 0).
    pub first: [f64; 2],
    /// Distance of samples, metres.
    pub step: f64,
}

impl Lattice {
    /// Easting and northing of a sample.
    #[must_use]
    pub fn at(&self, i: f64, j: f64) -> [f64; 2] {
        [self.first[0] + i * self.step, self.first[1] + j * self.step]
    }
}

/// Where a source's pixel centres lie in the database's CRS: least and greatest easting and
/// northing, and its pixels' size.
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
    /// Whether a block of a lattice may meet the source. (Bounds are of sampled points: a few
    /// pixels are allowed.)
    #[must_use]
    pub fn meets(&self, lattice: &Lattice, block: Rect) -> bool {
        (0..2).all(|axis| {
            let first = lattice.first[axis] + block.origin[axis] as f64 * lattice.step;
            let last = first + (block.size[axis] - 1) as f64 * lattice.step;
            let margin = 4.0 * self.pixel + 0.01 * (self.high[axis] - self.low[axis]);
            first <= self.high[axis] + margin && last >= self.low[axis] - margin
        })
    }
}
