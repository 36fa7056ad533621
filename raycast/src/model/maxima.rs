//! Extremes of a tile's heights: their range, and the pyramid of maxima with which exact rays skip
//! ground.

use super::Ground;
use super::tile::Tile;

/// Intermediate values of one tile, in reused memory.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Heights of the tile and around it, layers of the tile.
    pub(super) around: Vec<f32>,
    /// For each column the highest voxel that is ground.
    pub(super) tops: Vec<u16>,
    /// For each column the upward component of the normal.
    pub(super) ups: Vec<f32>,
    /// Two values for each post or cell of a row.
    rows: [Vec<f32>; 2],
}

impl Scratch {
    /// Two rows of `count` values: the first row filled with the first value, the second with the
    /// other.
    pub(super) fn rows(&mut self, count: usize, values: [f32; 2]) -> [&mut [f32]; 2] {
        let mut values = values.into_iter();
        self.rows.each_mut().map(|row| {
            row.clear();
            row.resize(count, values.next().unwrap_or_default());
            &mut row[..]
        })
    }
}

/// The larger of two numbers, neither of them NaN: one instruction, also in loops.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers, neither of them NaN.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The lowest and the highest of heights in rows of `columns`; `None` when one is NaN or infinite.
pub(super) fn range(heights: &[f32], columns: usize, scratch: &mut Scratch) -> Option<[f32; 2]> {
    const EXPONENT: u32 = 0x7f80_0000;
    let [lowest, highest] = scratch.rows(columns, [f32::INFINITY, f32::NEG_INFINITY]);
    let mut is_finite = true;
    for row in heights.chunks_exact(columns) {
        let mut other = 0;
        for ((height, lowest), highest) in row.iter().zip(&mut *lowest).zip(&mut *highest) {
            *lowest = smaller(*height, *lowest);
            *highest = larger(*height, *highest);
            other |= u32::from(height.to_bits() & EXPONENT == EXPONENT);
        }
        is_finite &= other == 0;
    }
    let [lowest, highest] = [&*lowest, &*highest];
    is_finite.then(|| {
        [
            lowest.iter().copied().fold(f32::INFINITY, f32::min),
            highest.iter().copied().fold(f32::NEG_INFINITY, f32::max),
        ]
    })
}

impl Ground {
    /// Computes the highest post of a tile's blocks of 2, 4, 8, … cells a side, borders included,
    /// up to a single block.
    pub(super) fn make_maxima(&mut self, index: usize) {
        let tile = self.tiles[index];
        let start = self.maxima.len();
        self.tiles[index].maxima_at = start;
        let mut cells = tile.cells.map(|n| n as usize);
        if cells.into_iter().max() <= Some(1) {
            return;
        }
        let columns = cells[0] + 1;
        let rows = &self.heights[tile.heights_at..][..columns * (cells[1] + 1)];
        for three in (0..cells[1]).step_by(2).map(|j| &rows[j * columns..rows.len().min((j + 3) * columns)]) {
            let [highest, _] = self.scratch.rows(columns, [f32::NEG_INFINITY; 2]);
            for row in three.chunks_exact(columns) {
                highest.iter_mut().zip(row).for_each(|(highest, height)| *highest = larger(*height, *highest));
            }
            self.maxima.extend((0..cells[0]).step_by(2).map(|i| {
                let pair = larger(highest[i], highest[i + 1]);
                highest.get(i + 2).map_or(pair, |last| larger(pair, *last))
            }));
        }
        let mut finer = start;
        cells = cells.map(|n| n.div_ceil(2));
        while cells.into_iter().max() > Some(1) {
            let end = self.maxima.len();
            cells = self.push_coarser_maxima(finer, cells);
            finer = end;
        }
    }

    /// Halves a level of maxima that begins at `finer`. Returns the size of the coarser level.
    fn push_coarser_maxima(&mut self, finer: usize, cells: [usize; 2]) -> [usize; 2] {
        let coarser = cells.map(|n| n.div_ceil(2));
        for j in 0..coarser[1] {
            for i in 0..coarser[0] {
                let mut highest = f32::NEG_INFINITY;
                for row in 2 * j..(2 * j + 2).min(cells[1]) {
                    for column in 2 * i..(2 * i + 2).min(cells[0]) {
                        highest = larger(self.maxima[finer + row * cells[0] + column], highest);
                    }
                }
                self.maxima.push(highest);
            }
        }
        coarser
    }

    /// Highest post of block `at` of `2^level` cells a side, `level >= 1`, given the maxima of its
    /// tile.
    #[inline(always)]
    pub(crate) fn block_maximum(tile: &Tile, maxima: &[f32], level: u32, at: [u32; 2]) -> f32 {
        let mut start = 0;
        for finer in 1..level {
            let [columns, rows] = tile.cells.map(|n| n.div_ceil(1 << finer) as usize);
            start += columns * rows;
        }
        let columns = tile.cells[0].div_ceil(1 << level) as usize;
        maxima.get(start + at[1] as usize * columns + at[0] as usize).copied().unwrap_or(f32::INFINITY)
    }

    /// A height that no post of a tile's cells over a rectangle exceeds, lattice units.
    fn highest_of_tile(&self, tile: &Tile, low: [f64; 2], high: [f64; 2]) -> f32 {
        let scale = 1.0 / f64::from(1u32 << tile.log_spacing);
        let cells = |axis: usize| {
            let cell = |at: f64| ((at - f64::from(tile.origin[axis])) * scale).max(0.0) as u32;
            [low, high].map(|corner| cell(corner[axis]).min(tile.cells[axis] - 1))
        };
        let [columns, rows] = [cells(0), cells(1)];
        let widest = (columns[1] - columns[0]).max(rows[1] - rows[0]) + 1;
        // Blocks of that many cells: at most two a side lie over the rectangle.
        let level = widest.next_power_of_two().ilog2().max(1);
        if tile.cells.iter().all(|n| n.div_ceil(1 << level) <= 1) {
            return tile.top_m;
        }
        let maxima = self.maxima(tile);
        let mut highest = f32::NEG_INFINITY;
        for row in rows[0] >> level..=rows[1] >> level {
            for column in columns[0] >> level..=columns[1] >> level {
                highest = larger(Self::block_maximum(tile, maxima, level, [column, row]), highest);
            }
        }
        highest
    }

    /// A height that no ground of a rectangle exceeds, lattice units; metres above the datum. For a
    /// ground without voxels.
    pub(crate) fn highest_in(&self, low: [f64; 2], high: [f64; 2]) -> f32 {
        let top = |tile: u32| self.highest_of_tile(&self.tiles[tile as usize], low, high);
        self.tree.highest_in(low, high, &top)
    }
}
