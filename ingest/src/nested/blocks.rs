//! Blocks of levels, which are made only where needed.

use crate::store::{Level, Rect};
use std::collections::BTreeSet;

/// The side of blocks, samples.
pub(super) const BLOCK: usize = 256;

/// The numbers of the blocks of a level of `[columns, rows]` samples that a rectangle touches.
pub(crate) fn meeting(size: [u64; 2], rect: Rect) -> Vec<usize> {
    let columns = size[0].div_ceil(BLOCK as u64) as usize;
    let range = |axis: usize| {
        let last = size[axis] as i64 - 1;
        let first = rect.origin[axis].clamp(0, last) as usize / BLOCK;
        first..=(rect.origin[axis] + rect.size[axis] as i64 - 1).clamp(0, last) as usize / BLOCK
    };
    let (x, y) = (range(0), range(1));
    y.flat_map(|row| x.clone().map(move |column| row * columns + column)).collect()
}

/// Repeats the border for samples of a coarse level beyond the world's extent, where there may be
/// no source: `last` is the last column and row inside.
pub(super) fn repeat_border<T: Copy>(samples: &mut [Option<T>], rect: Rect, last: [i64; 2]) {
    let [width, height] = rect.size;
    let inside = [0, 1].map(|axis| last[axis] - rect.origin[axis]);
    if let Ok(column) = usize::try_from(inside[0]) {
        for row in samples.chunks_exact_mut(width).filter(|_| column < width) {
            let border = row[column];
            row[column + 1..].iter_mut().filter(|sample| sample.is_none()).for_each(|sample| *sample = border);
        }
    }
    if let Ok(row) = usize::try_from(inside[1]) {
        for at in ((row + 1).min(height)..height).flat_map(|j| (0..width).map(move |i| (j, i))) {
            let border = samples[row * width + at.1];
            let sample = &mut samples[at.0 * width + at.1];
            *sample = sample.or(border);
        }
    }
}

/// Levels of a pyramid, the finest first, and which blocks of each have been made.
#[derive(Debug)]
pub(super) struct Pyramid<T> {
    pub(super) levels: Vec<Level<T>>,
    pub(super) made: Vec<BTreeSet<usize>>,
}

impl<T> Default for Pyramid<T> {
    fn default() -> Self {
        Self { levels: Vec::new(), made: Vec::new() }
    }
}

/// The rectangle of samples that a source may cover; `None` when it covers none.
pub(super) fn samples_of(bounds: &crate::plan::Bounds, lattice: &crate::plan::Lattice, size: [u64; 2]) -> Option<Rect> {
    let mut rect = Rect::new([0; 2], [0; 2]);
    for (axis, count) in size.into_iter().enumerate() {
        let margin = bounds.pixel + 0.01 * (bounds.high[axis] - bounds.low[axis]);
        let at = |v: f64| (v - lattice.first[axis]) / lattice.step;
        let first = at(bounds.low[axis] - margin).floor().max(0.0);
        let last = at(bounds.high[axis] + margin).ceil().min(count as f64 - 1.0);
        if last < first {
            return None;
        }
        rect.origin[axis] = first as i64;
        rect.size[axis] = (last - first) as usize + 1;
    }
    Some(rect)
}
