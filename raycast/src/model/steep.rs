//! Which cells of the ground are steep: this decides how far one ray is a witness for another
//! ([`crate::proof::steepness`]).

use super::Ground;
use super::density::{BOX_HALF_WIDTH, Filter};
use super::maxima::larger;
use super::tile::Tile;

/// log2 of the cells along a side of a block, the unit that is steep or not. (Measured; see
/// `docs/techniques.md`, *Thresholds*.)
const LOG_STEEP: u32 = 2;
/// All ground outside of steep blocks has a lower slope than this, metres up per metre. (Measured;
/// see `docs/techniques.md`, *Thresholds*.)
pub(crate) const SLOPE_BOUND: f32 = 0.75;

/// A block of cells of a tile, some of which are steep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SteepBlock {
    /// South west and north east corner, lattice units.
    pub(crate) low: [u32; 2],
    pub(crate) high: [u32; 2],
    /// Slopes of its steepest cells.
    pub(crate) slopes: CellSlopes,
    /// Upper bound of the height of its steep cells, metres above the datum.
    pub(crate) top_m: f32,
}

/// Upper bounds of slopes, metres up per metre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct CellSlopes {
    /// Slope of the facets between heights.
    pub(crate) heights: f32,
    /// Slope of the surface of voxels, infinite where a cliff makes a wall.
    pub(crate) voxels: f32,
}

/// How steep a cell is, and how high.
#[derive(Debug, Clone, Copy)]
pub(super) struct Steep {
    pub(super) slopes: CellSlopes,
    pub(super) top_m: f32,
}

impl CellSlopes {
    /// A wall of voxels, where heights have no slope of their own.
    pub(super) const WALL: Self = Self { heights: 0.0, voxels: f32::INFINITY };

    /// Slopes of a cell of voxels. `corners`: heights of its corners in layers; `ups`: the smallest
    /// and the largest upward component of their normals.
    pub(super) fn of_voxels(corners: [f32; 4], ups: [f32; 2], is_accurate: bool, filter: Filter) -> Self {
        let voxels = match filter {
            _ if !is_accurate => bilinear_slope(corners),
            Filter::OrientedBox => voxel_slope(corners, ups),
            // Plateaus of density between a high and a low column become walls.
            Filter::Gaussian => f32::INFINITY,
        };
        Self { heights: facets_slope(corners), voxels }
    }
}

impl Ground {
    /// The steep blocks of a tile without voxels.
    pub(super) fn push_steep_heights(&mut self, index: usize) {
        const SIDE: usize = 1 << LOG_STEEP;
        let tile = self.tiles[index];
        let [columns, rows] = tile.cells.map(|n| n as usize);
        // A little less than the bound, so that rounding omits no block; `steepest_of_block`
        // decides which cells are steep.
        let limit = (0.9999 * SLOPE_BOUND * tile.spacing_m).powi(2);
        let mut scratch = std::mem::take(&mut self.scratch);
        for south in (0..rows).step_by(SIDE) {
            let row = |j: usize| &self.heights[tile.heights_at + j * (columns + 1)..][..columns + 1];
            let [steepest, _] = scratch.rows(columns, [0.0; 2]);
            for j in south..rows.min(south + SIDE) {
                steepen(row(j), row(j + 1), steepest);
            }
            for (block, cells) in steepest.chunks(SIDE).enumerate() {
                if cells.iter().all(|squared| *squared <= limit) {
                    continue;
                }
                let west = block * SIDE;
                let [slope, top_m] = self.steepest_of_block(&tile, [west, south], [cells.len(), SIDE]);
                if slope > SLOPE_BOUND {
                    let corner = |axis: usize, cell: usize| {
                        tile.origin[axis] + ((cell as u32).min(tile.cells[axis]) << tile.log_spacing)
                    };
                    let low = [corner(0, west), corner(1, south)];
                    let high = [corner(0, west + SIDE), corner(1, south + SIDE)];
                    let slopes = CellSlopes { heights: slope, voxels: f32::INFINITY };
                    self.steep.push(SteepBlock { low, high, slopes, top_m });
                }
            }
        }
        self.scratch = scratch;
    }

    /// The steepest slope of a block of cells, metres up per metre, and the highest post of cells
    /// that are steeper than the bound.
    fn steepest_of_block(&self, tile: &Tile, [west, south]: [usize; 2], [width, side]: [usize; 2]) -> [f32; 2] {
        let [columns, rows] = tile.cells.map(|n| n as usize);
        let per_m = 1.0 / tile.spacing_m;
        let row = |j: usize| &self.heights[tile.heights_at + j * (columns + 1)..][..columns + 1];
        let (mut slope, mut top_m) = (0.0, f32::NEG_INFINITY);
        for j in south..rows.min(south + side) {
            let (low, high) = (row(j), row(j + 1));
            for i in west..west + width {
                let corners = [low[i], low[i + 1], high[i], high[i + 1]];
                let own = facets_slope(corners) * per_m;
                if own > SLOPE_BOUND {
                    slope = larger(own, slope);
                    top_m = corners.into_iter().fold(top_m, larger);
                }
            }
        }
        [slope, top_m]
    }

    /// Adds a steep cell to its block, which is new or one of the tile's blocks, from `first` on.
    /// Cells come row by row.
    pub(super) fn note_steep(&mut self, tile: &Tile, first: usize, cell: [usize; 2], steep: Steep) {
        let Steep { slopes, top_m } = steep;
        let corner = |axis: usize, past: u32| {
            let block = (cell[axis] as u32 >> LOG_STEEP) + past;
            tile.origin[axis] + ((block << LOG_STEEP).min(tile.cells[axis]) << tile.log_spacing)
        };
        let low = [corner(0, 0), corner(1, 0)];
        let mut same_row = self.steep[first..].iter_mut().rev().take_while(|block| block.low[1] == low[1]);
        match same_row.find(|block| block.low == low) {
            Some(block) => {
                block.slopes.heights = block.slopes.heights.max(slopes.heights);
                block.slopes.voxels = block.slopes.voxels.max(slopes.voxels);
                block.top_m = block.top_m.max(top_m);
            }
            None => {
                let high = [corner(0, 1), corner(1, 1)];
                self.steep.push(SteepBlock { low, high, slopes, top_m });
            }
        }
    }
}

/// Raises squares of slopes, rise per cell, to those of the cells between two rows of posts.
fn steepen(south: &[f32], north: &[f32], squares: &mut [f32]) {
    let count = squares.len();
    let (south, north) = (&south[..count + 1], &north[..count + 1]);
    let corners = south[..count].iter().zip(&south[1..]).zip(north[..count].iter().zip(&north[1..]));
    for (square, ((sw, se), (nw, ne))) in squares.iter_mut().zip(corners) {
        let ([south, north], [west, east]) = ([se - sw, ne - nw], [nw - sw, ne - se]);
        *square = larger(larger(south * south + east * east, north * north + west * west), *square);
    }
}

/// The slope of the steeper of a cell's two facets (south eastern and north western), rise per
/// cell.
fn facets_slope([sw, se, nw, ne]: [f32; 4]) -> f32 {
    let [south, north] = [se - sw, ne - nw];
    let [west, east] = [nw - sw, ne - se];
    (south * south + east * east).max(north * north + west * west).sqrt()
}

/// Upper bound of the slope of the bilinear surface between a cell's posts, rise per cell.
fn bilinear_slope([sw, se, nw, ne]: [f32; 4]) -> f32 {
    let east = (se - sw).abs().max((ne - nw).abs());
    let north = (nw - sw).abs().max((ne - se).abs());
    (east * east + north * north).sqrt()
}

/// Upper bound of the slope of the trilinear surface of voxels in a cell, given the normals at its
/// corners.
fn voxel_slope(corners: [f32; 4], [least_up, most_up]: [f32; 2]) -> f32 {
    let slope = bilinear_slope(corners);
    let highest = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
    let lowest = corners.into_iter().fold(f32::INFINITY, f32::min);
    let range = highest - lowest;
    // Between columns whose densities fall at different rates the surface is a mean of heights
    // weighted by these rates.
    let graded = slope * most_up / least_up;
    if range * most_up <= BOX_HALF_WIDTH {
        graded
    } else if range * most_up <= 2.0 * BOX_HALF_WIDTH {
        // Where one column is all ground or all air, only the others determine heights, at half
        // their weight or more.
        graded.max(4.0 * BOX_HALF_WIDTH / least_up)
    } else {
        // Between two columns that do not overlap, density is the same at many heights: a wall.
        f32::INFINITY
    }
}
