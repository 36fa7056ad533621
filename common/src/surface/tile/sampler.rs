//! Samples the elevation of a tile at the columns of an array, row by row.
//!
//! Rows of the array within the same row of the tile's cells share the corners of these cells,
//! which are gathered once: one level up for every second row, at the smooth level for all rows or
//! nearly so. The rest of the work per row compiles to SIMD. The result has the bits of
//! [`facet_linear`], which is exact.

use super::{CellPosition, joined_elevation};
use crate::surface::PostLine;
use crate::surface::facet::facet_linear;

/// The positions of an array's columns in a tile; keeps its buffers.
#[derive(Debug)]
pub struct TileSampler {
    stride: usize,
    cells: Vec<u32>,
    /// Offsets within the cells.
    us: Vec<f64>,
    /// Whether columns are the tile's own posts.
    is_own: bool,
    /// The row of cells of `corners`.
    gathered: Option<u32>,
    /// South west, south east, north west, north east corner of each column's cell.
    corners: [Vec<f64>; 4],
}

impl TileSampler {
    /// Buffers for arrays with this many columns.
    #[must_use]
    pub fn new(columns: usize) -> Self {
        Self {
            stride: 0,
            cells: vec![0; columns],
            us: vec![0.0; columns],
            is_own: false,
            gathered: None,
            corners: [(); 4].map(|()| vec![0.0; columns]),
        }
    }

    /// Takes the columns, lattice coordinates, of an array in a tile whose posts have these, `posts` of
    /// them a side.
    pub fn enter(&mut self, columns: &[u64], line: &PostLine, posts: usize) {
        self.stride = posts;
        self.gathered = None;
        self.is_own = columns.len() == self.stride;
        for (((index, at), cell), u) in (0i64..).zip(columns).zip(&mut self.cells).zip(&mut self.us) {
            let position = line.position(*at);
            (*cell, *u) = (position.cell, position.offset);
            self.is_own &= at.cast_signed() == line.origin() + (index << line.log_step());
        }
    }

    /// Elevation along an edge of a tile on which every second post counts, at columns of an array.
    pub fn interpolate_joined(columns: &[u64], line: &PostLine, posts: &[f32], y: CellPosition, out: &mut [f64]) {
        let (line, cells) = (line.every_second(), line.cells());
        for (at, out) in columns.iter().zip(out) {
            *out = joined_elevation(posts, cells, line.position(*at), y);
        }
    }

    /// Elevation of the entered tile's `posts`, metres, in the row at `y`, at each column.
    pub fn interpolate(&mut self, posts: &[f32], y: CellPosition, out: &mut [f64]) {
        let v = y.offset;
        if self.is_own && (v == 0.0 || v == 1.0) {
            let row = y.cell as usize + usize::from(v == 1.0);
            for (out, z) in out.iter_mut().zip(&posts[row * self.stride..][..self.stride]) {
                *out = f64::from(*z);
            }
            return;
        }
        if self.gathered != Some(y.cell) {
            self.gathered = Some(y.cell);
            self.gather(posts, y.cell as usize);
        }
        let [z00, z10, z01, z11] = &self.corners;
        let corners = z00.iter().zip(z10).zip(z01.iter().zip(z11));
        for ((out, ((z00, z10), (z01, z11))), u) in out.iter_mut().zip(corners).zip(&self.us) {
            *out = facet_linear(*z00, *z10, *z01, *z11, *u, v);
        }
    }

    fn gather(&mut self, posts: &[f32], row: usize) {
        let (south, rest) = posts[row * self.stride..].split_at(self.stride);
        let north = &rest[..self.stride];
        let [z00, z10, z01, z11] = &mut self.corners;
        let corners = z00.iter_mut().zip(z10).zip(z01.iter_mut().zip(z11));
        for (((z00, z10), (z01, z11)), cell) in corners.zip(&self.cells) {
            let i = *cell as usize;
            (*z00, *z10) = (south[i].into(), south[i + 1].into());
            (*z01, *z11) = (north[i].into(), north[i + 1].into());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tile_elevation;
    use super::*;
    use proptest::prelude::*;

    const CELLS: u32 = 8;

    proptest! {
        /// Of arrays as fine as the tile and finer ones, whole and cut by the extent, wherever they
        /// lie in it.
        #[test]
        fn every_row_has_the_bits_of_the_single_point(
            posts in prop::collection::vec(-8_000_000i32..8_000_000, 81),
            (up, extent) in (0u8..4, 0u64..200),
            place in any::<u16>(),
        ) {
            let posts: Vec<f32> = posts.iter().map(|&p| p as f32 / 128.0).collect();
            let (level, origin) = (3 + up, 1000u64);
            let start = origin + (u64::from(place) % (1 << up)) * u64::from(CELLS << 3);
            let columns: Vec<u64> = (0..=u64::from(CELLS)).map(|i| (start + (i << 3)).min(origin + extent)).collect();
            let mut tile = TileSampler::new(columns.len());
            let line = PostLine::even(origin, level, CELLS);
            tile.enter(&columns, &line, CELLS as usize + 1);
            let mut row = vec![0.0; columns.len()];
            for y in &columns {
                let y = line.position(*y);
                tile.interpolate(&posts, y, &mut row);
                for (x, z) in columns.iter().zip(&row) {
                    let x = line.position(*x);
                    prop_assert_eq!(z.to_bits(), tile_elevation(&posts, CELLS, x, y).to_bits());
                }
            }
        }
    }
}
