//! What rays are drawn into: colour and depth, row by row from the top.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// A picture that any number of threads draw disjoint pixels of. Plain stores: on every processor that Rust knows a
/// relaxed store is one, and whoever joins the threads sees what they wrote.
#[derive(Debug, Default)]
pub struct Picture {
    size: [u32; 2],
    /// Colour in the lower half, the bits of depth in the upper one: one store a pixel, since lines cross rows, and each store is
    /// in another page than the last.
    pixels: Vec<AtomicU64>,
}

impl Picture {
    /// A black picture.
    #[must_use]
    pub fn new(size: [u32; 2]) -> Self {
        let count = size[0] as usize * size[1] as usize;
        Self { size, pixels: (0..count).map(|_| AtomicU64::new(0)).collect() }
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Colours, red in the lowest byte, rows from the top.
    pub fn rgba(&self) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.pixels.iter().map(|pixel| pixel.load(Ordering::Relaxed) as u32)
    }

    /// Metres along the view axis, rows from the top; NaN for sky.
    pub fn depth(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.pixels.iter().map(|pixel| f32::from_bits((pixel.load(Ordering::Relaxed) >> 32) as u32))
    }

    /// Both, of some rows.
    pub fn rows(&self, rows: Range<usize>) -> impl ExactSizeIterator<Item = (u32, f32)> + '_ {
        let width = self.size[0] as usize;
        self.pixels[rows.start * width..rows.end * width].iter().map(|pixel| {
            let bits = pixel.load(Ordering::Relaxed);
            (bits as u32, f32::from_bits((bits >> 32) as u32))
        })
    }

    #[inline(always)]
    pub(crate) fn put(&self, pixel: [u32; 2], rgba: u32, depth: f32) {
        self.put_row(pixel, &[(rgba, depth)]);
    }

    /// Puts pixels beside each other, from this one to the right: their colors, and as many depths.
    #[inline(always)]
    pub(crate) fn put_pairs(&self, [x, y]: [u32; 2], colors: &[u32], depths: &[f32]) {
        let at = y as usize * self.size[0] as usize + x as usize;
        for ((pixel, rgba), depth) in self.pixels[at..at + colors.len()].iter().zip(colors).zip(depths) {
            // Relaxed: as below.
            pixel.store(u64::from(depth.to_bits()) << 32 | u64::from(*rgba), Ordering::Relaxed);
        }
    }

    /// Puts pixels beside each other, from this one to the right.
    #[inline(always)]
    pub(crate) fn put_row(&self, [x, y]: [u32; 2], row: &[(u32, f32)]) {
        let at = y as usize * self.size[0] as usize + x as usize;
        for (pixel, (rgba, depth)) in self.pixels[at..at + row.len()].iter().zip(row) {
            // Relaxed: every pixel has one writer a frame, and readers have joined the writers.
            pixel.store(u64::from(depth.to_bits()) << 32 | u64::from(*rgba), Ordering::Relaxed);
        }
    }
}
