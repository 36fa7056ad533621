//! What rays are drawn into: colour and depth, row by row from the top.

use std::sync::atomic::{AtomicU32, Ordering};

/// A picture that any number of threads draw disjoint pixels of. Plain stores: on every processor that Rust knows a
/// relaxed store is one, and whoever joins the threads sees what they wrote.
#[derive(Debug, Default)]
pub struct Picture {
    size: [u32; 2],
    rgba: Vec<AtomicU32>,
    depth_bits: Vec<AtomicU32>,
}

impl Picture {
    /// A black picture.
    #[must_use]
    pub fn new(size: [u32; 2]) -> Self {
        let pixels = size[0] as usize * size[1] as usize;
        let blank = || (0..pixels).map(|_| AtomicU32::new(0)).collect();
        Self { size, rgba: blank(), depth_bits: blank() }
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Colours, red in the lowest byte, rows from the top.
    pub fn rgba(&self) -> impl ExactSizeIterator<Item = u32> + '_ {
        self.rgba.iter().map(|pixel| pixel.load(Ordering::Relaxed))
    }

    /// Metres along the view axis, rows from the top; NaN for sky.
    pub fn depth(&self) -> impl ExactSizeIterator<Item = f32> + '_ {
        self.depth_bits.iter().map(|pixel| f32::from_bits(pixel.load(Ordering::Relaxed)))
    }

    #[inline(always)]
    pub(crate) fn put(&self, [x, y]: [u32; 2], rgba: u32, depth: f32) {
        let at = y as usize * self.size[0] as usize + x as usize;
        // Relaxed: every pixel has one writer a frame, and readers have joined the writers.
        self.rgba[at].store(rgba, Ordering::Relaxed);
        self.depth_bits[at].store(depth.to_bits(), Ordering::Relaxed);
    }
}
