//! The picture that rays draw: colour and, where somebody wants it, depth, row by row from the top.

use std::ops::Range;
use std::sync::atomic::{AtomicU32, Ordering};

/// A picture of which any number of threads draw disjoint pixels: a rectangle of planes that may be
/// larger. Stores are relaxed, which are plain stores on every processor that Rust supports; who
/// joins the threads sees what they wrote.
#[derive(Debug, Default)]
pub struct Picture {
    /// Width and height of the planes, and of the rectangle.
    planes: [u32; 2],
    size: [u32; 2],
    /// The rectangle's first pixel.
    first: usize,
    colors: Vec<AtomicU32>,
    /// The bits of depths; empty where nobody wants them.
    depths: Vec<AtomicU32>,
    has_depth: bool,
}

impl Picture {
    /// A black picture with depth.
    #[must_use]
    pub fn new(size: [u32; 2]) -> Self {
        let mut picture = Self::empty(true);
        picture.set_size(size);
        picture
    }

    /// A picture without pixels, whose pixels have depth or not.
    #[must_use]
    pub fn empty(has_depth: bool) -> Self {
        Self { has_depth, ..Self::default() }
    }

    /// Whether pixels have depth from the next [`Picture::set_size`] on.
    pub fn set_depth(&mut self, has_depth: bool) {
        self.has_depth = has_depth;
        if !has_depth {
            self.depths.clear();
        }
    }

    /// Makes planes of this size, black where they had another one before, and draws all of them.
    pub fn set_size(&mut self, size: [u32; 2]) {
        let count = size[0] as usize * size[1] as usize;
        let black = |plane: &mut Vec<AtomicU32>| {
            if plane.len() != count {
                *plane = (0..count).map(|_| AtomicU32::new(0)).collect();
            }
        };
        black(&mut self.colors);
        if self.has_depth {
            black(&mut self.depths);
        }
        self.planes = size;
        self.set_rectangle([0, 0], size);
    }

    /// Draws this rectangle of the planes, which it lies within, from now on.
    pub fn set_rectangle(&mut self, [x, y]: [u32; 2], size: [u32; 2]) {
        let end = [x + size[0], y + size[1]];
        assert!(end[0] <= self.planes[0] && end[1] <= self.planes[1], "a rectangle lies within its planes");
        self.size = size;
        self.first = y as usize * self.planes[0] as usize + x as usize;
    }

    /// Takes memory for colours, to draw into in place; [`Picture::set_size`] says of which size.
    pub fn take_colors(&mut self, colors: Vec<u32>) {
        // In place: a number and an atomic one are the same bytes.
        self.colors = colors.into_iter().map(AtomicU32::new).collect();
    }

    /// Gives the plane of colours away: RGBA, red in the lowest byte, rows from the top.
    #[must_use]
    pub fn give_colors(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.colors).into_iter().map(AtomicU32::into_inner).collect()
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Whether depth is drawn.
    #[must_use]
    pub fn has_depth(&self) -> bool {
        self.has_depth
    }

    /// Colours, red in the lowest byte, rows from the top.
    pub fn rgba(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.size[1] as usize).flat_map(|row| self.row(row)).map(|(color, _)| color)
    }

    /// Metres along the view axis, rows from the top; NaN for sky, and for all pixels without depth.
    pub fn depth(&self) -> impl Iterator<Item = f32> + '_ {
        (0..self.size[1] as usize).flat_map(|row| self.row(row)).map(|(_, depth)| depth)
    }

    /// Depths of a row; none without depth.
    pub fn depths(&self, row: usize) -> impl Iterator<Item = f32> + '_ {
        let places = self.depths.get(self.places(row)).unwrap_or_default();
        places.iter().map(|depth| f32::from_bits(depth.load(Ordering::Relaxed)))
    }

    /// Colours and depths of a row; without depth it is NaN.
    pub fn row(&self, row: usize) -> impl Iterator<Item = (u32, f32)> + '_ {
        let colors = self.colors.get(self.places(row)).unwrap_or_default();
        let depths = self.depths(row).chain(std::iter::repeat(f32::NAN));
        colors.iter().map(|color| color.load(Ordering::Relaxed)).zip(depths)
    }

    fn places(&self, row: usize) -> Range<usize> {
        let first = self.pixel([0, row as u32]);
        first..first + self.size[0] as usize
    }

    /// Where a pixel is in the planes.
    #[inline(always)]
    fn pixel(&self, [x, y]: [u32; 2]) -> usize {
        self.first + y as usize * self.planes[0] as usize + x as usize
    }

    /// Colour and depth of a pixel, in a picture that has depth.
    #[inline(always)]
    pub(crate) fn get(&self, pixel: [u32; 2]) -> (u32, f32) {
        let at = self.pixel(pixel);
        (self.colors[at].load(Ordering::Relaxed), f32::from_bits(self.depths[at].load(Ordering::Relaxed)))
    }

    #[inline(always)]
    pub(crate) fn put(&self, pixel: [u32; 2], rgba: u32, depth: f32) {
        self.put_row(pixel, &[(rgba, depth)]);
    }

    /// Puts pixels from this one on, each `step` columns and rows behind the one before.
    #[inline(always)]
    pub(crate) fn put_along(&self, pixel: [u32; 2], step: [i32; 2], colors: &[u32], depths: &[f32]) {
        let at = self.pixel(pixel);
        if step == [1, 0] {
            // Relaxed: as in `put_at`.
            for (place, color) in self.colors[at..at + colors.len()].iter().zip(colors) {
                place.store(*color, Ordering::Relaxed);
            }
            if self.has_depth {
                for (place, depth) in self.depths[at..at + depths.len()].iter().zip(depths) {
                    place.store(depth.to_bits(), Ordering::Relaxed);
                }
            }
            return;
        }
        let step = step[1] as isize * self.planes[0] as isize + step[0] as isize;
        let mut at = at;
        for (color, depth) in colors.iter().zip(depths) {
            self.put_at(at, *color, *depth);
            at = at.wrapping_add_signed(step);
        }
    }

    /// Writes pixels of a row, from this one to the right.
    #[inline(always)]
    pub(crate) fn put_row(&self, pixel: [u32; 2], row: &[(u32, f32)]) {
        for ((rgba, depth), at) in row.iter().zip(self.pixel(pixel)..) {
            self.put_at(at, *rgba, *depth);
        }
    }

    /// Relaxed: every pixel has one writer a frame, and readers have joined the writers.
    #[inline(always)]
    fn put_at(&self, at: usize, rgba: u32, depth: f32) {
        if let Some(color) = self.colors.get(at) {
            color.store(rgba, Ordering::Relaxed);
        }
        if let Some(place) = self.depths.get(at) {
            place.store(depth.to_bits(), Ordering::Relaxed);
        }
    }
}
