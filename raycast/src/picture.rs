//! The picture that rays draw: colour and depth, row by row from the top.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// A picture of which any number of threads draw disjoint pixels. Stores are relaxed, which are
/// plain stores on every processor that Rust supports; who joins the threads sees what they wrote.
#[derive(Debug, Default)]
pub struct Picture {
    size: [u32; 2],
    /// Colour in the lower half, the bits of depth in the upper half: a single store per pixel,
    /// because lines cross rows, so that each store is in another page than the one before.
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

    /// Colours and depths of some rows.
    pub fn rows(&self, rows: Range<usize>) -> impl ExactSizeIterator<Item = (u32, f32)> + '_ {
        let width = self.size[0] as usize;
        self.pixels[rows.start * width..rows.end * width].iter().map(|pixel| {
            let bits = pixel.load(Ordering::Relaxed);
            (bits as u32, f32::from_bits((bits >> 32) as u32))
        })
    }

    /// Color and depth of a pixel.
    #[inline(always)]
    pub(crate) fn get(&self, [x, y]: [u32; 2]) -> (u32, f32) {
        let bits = self.pixels[y as usize * self.size[0] as usize + x as usize].load(Ordering::Relaxed);
        (bits as u32, f32::from_bits((bits >> 32) as u32))
    }

    #[inline(always)]
    pub(crate) fn put(&self, pixel: [u32; 2], rgba: u32, depth: f32) {
        self.put_row(pixel, &[(rgba, depth)]);
    }

    /// Puts pixels from this one on, each `step` columns and rows behind the one before: color in
    /// the lower half, the bits of depth in the upper half.
    #[inline(always)]
    pub(crate) fn put_along(&self, [x, y]: [u32; 2], step: [i32; 2], pixels: &[u64]) {
        let at = y as usize * self.size[0] as usize + x as usize;
        if step == [1, 0] {
            for (pixel, value) in self.pixels[at..at + pixels.len()].iter().zip(pixels) {
                // Relaxed: as below.
                pixel.store(*value, Ordering::Relaxed);
            }
            return;
        }
        let step = step[1] as isize * self.size[0] as isize + step[0] as isize;
        let mut at = at;
        for value in pixels {
            if let Some(pixel) = self.pixels.get(at) {
                pixel.store(*value, Ordering::Relaxed);
            }
            at = at.wrapping_add_signed(step);
        }
    }

    /// Writes pixels of a row, from this one to the right.
    #[inline(always)]
    pub(crate) fn put_row(&self, [x, y]: [u32; 2], row: &[(u32, f32)]) {
        let at = y as usize * self.size[0] as usize + x as usize;
        for (pixel, (rgba, depth)) in self.pixels[at..at + row.len()].iter().zip(row) {
            // Relaxed: every pixel has one writer a frame, and readers have joined the writers.
            pixel.store(u64::from(depth.to_bits()) << 32 | u64::from(*rgba), Ordering::Relaxed);
        }
    }
}
