//! A tile of ground as rays use it: where it lies, and where its arrays begin in those of the
//! ground.

use super::Ground;
use super::color::ColorPlace;
use super::voxels::{Span, TileVoxels};
use glam::DVec2;

/// A tile. Heights are metres above the ground's datum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tile {
    /// Lower left corner, lattice units.
    pub(crate) origin: [u32; 2],
    pub(crate) log_spacing: u8,
    pub(crate) spacing_m: f32,
    pub(crate) cells: [u32; 2],
    /// Where its arrays begin.
    pub(super) heights_at: usize,
    pub(super) maxima_at: usize,
    /// Where the shares of its posts begin, if some of it is not measured ground.
    pub(super) shares_at: Option<usize>,
    pub(crate) voxels: TileVoxels,
    /// Bounds of its ground, metres above the datum.
    pub(crate) lowest_m: f32,
    pub(crate) top_m: f32,
    pub(crate) color: ColorPlace,
}

impl Tile {
    #[inline]
    pub(crate) fn posts(&self) -> [usize; 2] {
        self.cells.map(|n| n as usize + 1)
    }

    /// Its lower left corner on the lattice.
    #[inline]
    pub(crate) fn corner(&self) -> DVec2 {
        DVec2::from_array(self.origin.map(f64::from))
    }

    /// Where its heights begin in [`Ground::all_heights`].
    #[inline]
    pub(crate) fn first_height(&self) -> usize {
        self.heights_at
    }

    /// Whether a point, lattice units, lies over its cells.
    #[inline]
    pub(crate) fn holds(&self, point: [f64; 2]) -> bool {
        (0..2).all(|axis| {
            let end = u64::from(self.origin[axis]) + (u64::from(self.cells[axis]) << self.log_spacing);
            point[axis] <= end as f64
        })
    }
}

impl Ground {
    /// The heights of all tiles, one behind the other.
    #[inline]
    pub(crate) fn all_heights(&self) -> &[f32] {
        &self.heights
    }

    #[inline]
    pub(crate) fn heights(&self, tile: &Tile) -> &[f32] {
        let [columns, rows] = tile.posts();
        &self.heights[tile.heights_at..][..columns * rows]
    }

    /// Highest posts of blocks of 2, 4, 8, … cells a side, from the finest to the coarsest.
    #[inline]
    pub(crate) fn maxima(&self, tile: &Tile) -> &[f32] {
        &self.maxima[tile.maxima_at..]
    }

    /// Shares of the posts of a cell: south west, south east, north west, north east. A tile
    /// without shares is wholly measured.
    pub(crate) fn shares_of_cell(&self, tile: &Tile, [i, j]: [u32; 2]) -> [[f32; 2]; 4] {
        let columns = tile.cells[0] as usize + 1;
        let south = tile.shares_at.map(|start| start + j as usize * columns + i as usize);
        let pair = |at: usize| self.shares.get(at..at + 2);
        match south.and_then(|south| pair(south).zip(pair(south + columns))) {
            Some((&[sw, se], &[nw, ne])) => [sw, se, nw, ne],
            _ => [[1.0; 2]; 4],
        }
    }

    #[inline]
    pub(crate) fn spans(&self, tile: &Tile) -> &[Span] {
        let cells = tile.cells[0] as usize * tile.cells[1] as usize;
        &self.voxels.spans[tile.voxels.spans_at..][..if self.has_voxels() { cells } else { 0 }]
    }

    #[inline]
    pub(crate) fn densities(&self, tile: &Tile) -> &[u8] {
        let [columns, rows] = tile.posts();
        let bytes = if tile.voxels.is_accurate { columns * rows * tile.voxels.layers as usize } else { 0 };
        &self.voxels.densities[tile.voxels.densities_at..][..bytes]
    }

    /// The highest boundary cell of each block of `1 << LOG_BLOCK` cells a side.
    #[inline]
    pub(crate) fn blocks(&self, tile: &Tile) -> &[u16] {
        &self.voxels.blocks[tile.voxels.blocks_at..]
    }
}
