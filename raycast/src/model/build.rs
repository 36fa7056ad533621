//! What is made of a tile's heights: voxel densities, the boundary array, and maxima.

use super::density::{BOX_HALF_WIDTH, Column, Filter, THRESHOLD};
use super::{Found, Ground, Tile};

/// The boundary cells of a column of cells, in layers of its tile: the whole lower face of the lowest one is ground, the
/// whole upper face of the highest one air.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Span {
    /// Lowest boundary cell.
    pub(crate) lowest: u16,
    /// Highest boundary cell.
    pub(crate) highest: u16,
}

/// Layers below and above what a tile's surface needs, so that samples an interval away from it are still graded.
const MARGIN: i32 = 3;
/// A tile with more layers (a cliff of a hundred times its own width) gets no voxels.
const MOST_LAYERS: usize = 4096;
/// log2 of the cells along a side of a block of the skipping array.
pub(crate) const LOG_BLOCK: u32 = 4;

/// log2 of the cells along a side of a block that is steep or not.
const LOG_STEEP: u32 = 2;
/// A step between two tiles that counts as a wall, in the finer one's voxels. Nearly every edge of two levels has a step; taking all of
/// them for walls doubles what rays cost, for what less than a pixel of a line would see.
const LEAST_WALL: f32 = 0.5;
/// A slope up to which ground is not worth telling apart, metres up per metre.
pub(super) const GENTLE: f32 = 0.75;

/// Cells of a tile, some of which are steep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SteepBlock {
    /// South west and north east corner, lattice units.
    pub(crate) low: [u32; 2],
    pub(crate) high: [u32; 2],
    /// The steepest slope of heights, metres up per metre: an upper bound.
    pub(crate) slope: f32,
    /// That of the surface of voxels, infinite where a cliff makes a wall.
    pub(crate) voxel_slope: f32,
    /// No ground of its steep cells is higher, metres above the datum.
    pub(crate) top_m: f32,
}

/// How steep a cell is, and how high.
#[derive(Debug, Clone, Copy)]
struct Steep {
    slope: f32,
    voxel_slope: f32,
    top_m: f32,
}

/// One tile's intermediate values, in memory that is used again.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Heights of the tile and around it, layers of the tile.
    around: Vec<f32>,
    /// Of each column the highest voxel that is ground.
    tops: Vec<u16>,
    /// Of each column the upward part of the normal.
    ups: Vec<f32>,
    /// Of each post of a row, or each cell: two values.
    rows: [Vec<f32>; 2],
}

impl Scratch {
    /// Two rows of `count` values, the first all the one and the second all the other.
    fn rows(&mut self, count: usize, values: [f32; 2]) -> [&mut [f32]; 2] {
        let mut values = values.into_iter();
        self.rows.each_mut().map(|row| {
            row.clear();
            row.resize(count, values.next().unwrap_or_default());
            &mut row[..]
        })
    }
}

/// The larger one of two numbers that are no NaN: one instruction, in loops too.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller one.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The lowest and the highest of heights in rows of `columns`; `None` when one is no finite number.
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
    /// Makes the model of a tile; the heights of all tiles are there.
    pub(super) fn make_model(&mut self, index: usize) {
        let maxima_at = self.push_maxima(index);
        self.tiles[index].maxima_at = maxima_at;
        match self.shape.filter {
            Some(filter) => self.make_voxels(index, filter),
            None => self.push_steep_heights(index),
        }
    }

    fn make_voxels(&mut self, index: usize, filter: Filter) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let tile = self.tiles[index];
        let [columns, rows] = tile.posts();
        let radius = filter.radius();
        let stride = columns + 2 * radius;
        self.gather(&tile, radius, &mut scratch.around);
        // In double precision: layers of neighbouring tiles have to lie at the same heights.
        let scale = 1.0 / f64::from(tile.spacing_m);
        let in_voxels = |height: f32| (f64::from(height) + self.datum_m) * scale;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &height in &scratch.around {
            low = low.min(in_voxels(height));
            high = high.max(in_voxels(height));
        }
        let lowest_layer = low.floor() as i32 - MARGIN;
        let layers = (high.ceil() - f64::from(lowest_layer)) as usize + MARGIN as usize + 1;
        for height in &mut scratch.around {
            *height = (in_voxels(*height) - f64::from(lowest_layer)) as f32;
        }
        let (spans_at, blocks_at) = (self.spans.len(), self.blocks.len());
        let densities_at = self.densities.len();
        let bytes = columns * rows * layers;
        let has_room = bytes <= self.most_voxel_bytes.saturating_sub(densities_at);
        let is_accurate = tile.is_accurate && layers <= MOST_LAYERS && has_room;
        let model =
            Tile { lowest_layer, is_accurate, layers: layers as u32, spans_at, blocks_at, densities_at, ..tile };
        if is_accurate {
            self.densities.resize(densities_at + bytes, 0);
        }
        scratch.tops.clear();
        scratch.ups.clear();
        for j in 0..rows {
            for i in 0..columns {
                let at = (j + radius) * stride + i + radius;
                let column = Column { heights: &scratch.around, stride, at };
                scratch.ups.push(column.normal_up());
                if is_accurate {
                    let at = densities_at + (j * columns + i) * layers;
                    let voxels = &mut self.densities[at..at + layers];
                    column.fill(filter, voxels);
                    scratch.tops.push(top(voxels));
                } else {
                    // Heights themselves are the surface.
                    scratch.tops.push(scratch.around[at].max(0.0) as u16);
                }
            }
        }
        self.push_spans(&model, &scratch, filter);
        self.push_blocks(&model);
        self.push_border_walls(&model);
        self.tiles[index] = model;
        self.scratch = scratch;
    }

    /// Heights of a tile's posts and of `radius` more on each side, metres above the datum: those of its neighbours, so that
    /// two tiles of a level make the same of an edge that they share. Where no neighbour is, the border goes on.
    fn gather(&self, tile: &Tile, radius: usize, out: &mut Vec<f32>) {
        out.clear();
        let [columns, rows] = tile.posts();
        let heights = self.heights(tile);
        let radius = radius as i64;
        for j in -radius..rows as i64 + radius {
            for i in -radius..columns as i64 + radius {
                let inside = |at: i64, count: usize| at.clamp(0, count as i64 - 1);
                let (x, y) = (inside(i, columns), inside(j, rows));
                let own = heights[y as usize * columns + x as usize];
                let neighbour = |post| self.neighbour_height(tile, post);
                out.push(match (x, y) == (i, j) {
                    true => own,
                    // Past the corner of two tiles at the border of all ground, the border goes on as well.
                    false => {
                        neighbour([i, j]).or_else(|| neighbour([i, y])).or_else(|| neighbour([x, j])).unwrap_or(own)
                    }
                });
            }
        }
    }

    /// Height of a post outside of a tile, given by its column and row in it.
    fn neighbour_height(&self, tile: &Tile, post: [i64; 2]) -> Option<f32> {
        let unit = 1i64 << tile.log_spacing;
        let point = [0, 1].map(|axis| (i64::from(tile.origin[axis]) + post[axis] * unit) as f64);
        // A post on the border of two tiles belongs to both; the one that is nearer to this tile surely has it.
        let nudge = [0, 1].map(|axis| if post[axis] > 0 { point[axis] - 0.5 } else { point[axis] });
        match self.tree.find(nudge) {
            Found::Tile(neighbour) => {
                let neighbour = &self.tiles[neighbour as usize];
                let end = |axis: usize| {
                    f64::from(neighbour.origin[axis])
                        + f64::from(neighbour.cells[axis]) * f64::from(1u32 << neighbour.log_spacing)
                };
                (point[0] <= end(0) && point[1] <= end(1)).then(|| self.height_in(neighbour, point))
            }
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// The boundary array of a tile, and the slopes of its cells.
    fn push_spans(&mut self, tile: &Tile, scratch: &Scratch, filter: Filter) {
        let [columns, rows] = tile.posts();
        let radius = filter.radius();
        let stride = columns + 2 * radius;
        let first = self.steep.len();
        for j in 0..rows - 1 {
            for i in 0..columns - 1 {
                let at = j * columns + i;
                let corners = [at, at + 1, at + columns, at + columns + 1];
                let (mut lowest, mut highest) = (u16::MAX, 0);
                let (mut least_up, mut most_up) = (1.0f32, 0.0f32);
                for corner in corners {
                    lowest = lowest.min(scratch.tops[corner]);
                    highest = highest.max(scratch.tops[corner]);
                    least_up = least_up.min(scratch.ups[corner]);
                    most_up = most_up.max(scratch.ups[corner]);
                }
                self.spans.push(Span { lowest, highest });
                let at = (j + radius) * stride + i + radius;
                let corners = [at, at + 1, at + stride, at + stride + 1].map(|at| scratch.around[at]);
                let slope = facets_slope(corners);
                let voxel_slope = match filter {
                    _ if !tile.is_accurate => bilinear_slope(corners),
                    Filter::OrientedBox => voxel_slope(corners, [least_up, most_up]),
                    // Plateaus of density between a high and a low column become walls.
                    Filter::Gaussian => f32::INFINITY,
                };
                if slope.max(voxel_slope) > GENTLE {
                    // What lies above a boundary cell is air, and so is what lies above the highest post.
                    let top = f64::from(tile.lowest_layer) + f64::from(highest) + 1.0;
                    let top_m = (top * f64::from(tile.spacing_m) - self.datum_m) as f32;
                    let post_m = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
                    let post_m = ((f64::from(tile.lowest_layer) + f64::from(post_m)) * f64::from(tile.spacing_m)
                        - self.datum_m) as f32;
                    self.note_steep(tile, first, [i, j], Steep { slope, voxel_slope, top_m: top_m.max(post_m) });
                }
            }
        }
    }

    /// Where a tile's border does not lie on that of a neighbour with fewer posts there is a wall between the two.
    fn push_border_walls(&mut self, tile: &Tile) {
        let first = self.steep.len();
        let [columns, rows] = tile.cells;
        // Of each side its first post, the step to the next one, how many there are, and which way is out.
        let sides = [
            ([0, 0], 0, columns, [0.0, -0.5]),
            ([0, rows], 0, columns, [0.0, 0.5]),
            ([0, 0], 1, rows, [-0.5, 0.0]),
            ([columns, 0], 1, rows, [0.5, 0.0]),
        ];
        for (start, axis, count, out) in sides {
            for step in 0..=count {
                let mut post: [u32; 2] = start;
                post[axis] += step;
                let Some([own, other]) = self.heights_at_border(tile, post, out) else { continue };
                if (own - other).abs() <= LEAST_WALL * tile.spacing_m {
                    continue;
                }
                let top_m = own.max(other) + tile.spacing_m;
                // Exact rays are cast on grounds without voxels.
                let steep = Steep { slope: 0.0, voxel_slope: f32::INFINITY, top_m };
                // The cells on both sides of the post.
                for before in [1, 0] {
                    let mut cell = post;
                    cell[axis] = cell[axis].saturating_sub(before);
                    let cell = [cell[0].min(columns - 1), cell[1].min(rows - 1)];
                    self.note_steep(tile, first, cell.map(|n| n as usize), steep);
                }
            }
        }
    }

    /// Heights of a post on a tile's border: its own, and that of the coarser tile that lies half a lattice unit further out.
    fn heights_at_border(&self, tile: &Tile, post: [u32; 2], out: [f64; 2]) -> Option<[f32; 2]> {
        let point = [0, 1].map(|axis| f64::from(tile.origin[axis] + (post[axis] << tile.log_spacing)));
        // A post at the end of the side belongs to the tile beside this one.
        let inward = [0, 1].map(|axis| if post[axis] == tile.cells[axis] { -0.5 } else { 0.5 });
        let outside = [0, 1].map(|axis| point[axis] + if out[axis] == 0.0 { inward[axis] } else { out[axis] });
        let Found::Tile(other) = self.tree.find(outside) else { return None };
        let other = &self.tiles[other as usize];
        if other.log_spacing <= tile.log_spacing {
            return None;
        }
        let own = self.heights(tile)[post[1] as usize * tile.posts()[0] + post[0] as usize];
        Some([own, self.height_in(other, point)])
    }

    /// The slopes of a tile without voxels.
    fn push_steep_heights(&mut self, index: usize) {
        const SIDE: usize = 1 << LOG_STEEP;
        let tile = self.tiles[index];
        let [columns, rows] = tile.cells.map(|n| n as usize);
        let per_m = 1.0 / tile.spacing_m;
        // A little less than gentle, so that rounding leaves out no block; which cells are steep is told below.
        let limit = (0.9999 * GENTLE * tile.spacing_m).powi(2);
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
                let (mut slope, mut top_m) = (0.0, f32::NEG_INFINITY);
                for j in south..rows.min(south + SIDE) {
                    let (low, high) = (row(j), row(j + 1));
                    for i in block * SIDE..block * SIDE + cells.len() {
                        let corners = [low[i], low[i + 1], high[i], high[i + 1]];
                        let own = facets_slope(corners) * per_m;
                        if own > GENTLE {
                            slope = larger(own, slope);
                            top_m = corners.into_iter().fold(top_m, larger);
                        }
                    }
                }
                if slope > GENTLE {
                    let corner = |axis: usize, cell: usize| {
                        tile.origin[axis] + ((cell as u32).min(tile.cells[axis]) << tile.log_spacing)
                    };
                    let low = [corner(0, block * SIDE), corner(1, south)];
                    let high = [corner(0, (block + 1) * SIDE), corner(1, south + SIDE)];
                    self.steep.push(SteepBlock { low, high, slope, voxel_slope: f32::INFINITY, top_m });
                }
            }
        }
        self.scratch = scratch;
    }

    /// A cell is steep: into its block, which is new or among those of its tile, from `first` on. Cells come row by row.
    fn note_steep(&mut self, tile: &Tile, first: usize, cell: [usize; 2], steep: Steep) {
        let Steep { slope, voxel_slope, top_m } = steep;
        let corner = |axis: usize, past: u32| {
            let block = (cell[axis] as u32 >> LOG_STEEP) + past;
            tile.origin[axis] + ((block << LOG_STEEP).min(tile.cells[axis]) << tile.log_spacing)
        };
        let low = [corner(0, 0), corner(1, 0)];
        let mut same_row = self.steep[first..].iter_mut().rev().take_while(|block| block.low[1] == low[1]);
        match same_row.find(|block| block.low == low) {
            Some(block) => {
                block.slope = block.slope.max(slope);
                block.voxel_slope = block.voxel_slope.max(voxel_slope);
                block.top_m = block.top_m.max(top_m);
            }
            None => {
                let high = [corner(0, 1), corner(1, 1)];
                self.steep.push(SteepBlock { low, high, slope, voxel_slope, top_m });
            }
        }
    }

    /// The highest boundary cell of blocks of cells.
    fn push_blocks(&mut self, tile: &Tile) {
        let [columns, rows] = tile.cells.map(|n| n as usize);
        let side = 1usize << LOG_BLOCK;
        for south in (0..rows).step_by(side) {
            for west in (0..columns).step_by(side) {
                let mut highest = 0;
                for j in south..rows.min(south + side) {
                    let row = &self.spans[tile.spans_at + j * columns..];
                    highest = row[west..columns.min(west + side)].iter().fold(highest, |h, span| h.max(span.highest));
                }
                self.blocks.push(highest);
                let top = f64::from(tile.lowest_layer) + f64::from(highest) + 1.0;
                let top_m = (top * f64::from(tile.spacing_m) - self.datum_m) as f32;
                self.highest_voxel_m = self.highest_voxel_m.max(top_m);
            }
        }
    }

    /// The highest post of blocks of 2, 4, 8, … cells a side, their borders included, until one block is all.
    fn push_maxima(&mut self, index: usize) -> usize {
        let tile = self.tiles[index];
        let start = self.maxima.len();
        let mut cells = tile.cells.map(|n| n as usize);
        if cells.into_iter().max() <= Some(1) {
            return start;
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
            let coarser = cells.map(|n| n.div_ceil(2));
            let end = self.maxima.len();
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
            finer = end;
            cells = coarser;
        }
        start
    }
}

/// Raises squares of slopes, up per cell, to those of the cells between two rows of posts.
fn steepen(south: &[f32], north: &[f32], squares: &mut [f32]) {
    let count = squares.len();
    let (south, north) = (&south[..count + 1], &north[..count + 1]);
    let corners = south[..count].iter().zip(&south[1..]).zip(north[..count].iter().zip(&north[1..]));
    for (square, ((sw, se), (nw, ne))) in squares.iter_mut().zip(corners) {
        let ([south, north], [west, east]) = ([se - sw, ne - nw], [nw - sw, ne - se]);
        *square = larger(larger(south * south + east * east, north * north + west * west), *square);
    }
}

/// The steeper one of a cell's two facets, up per cell: the south eastern and the north western one.
fn facets_slope([sw, se, nw, ne]: [f32; 4]) -> f32 {
    let [south, north] = [se - sw, ne - nw];
    let [west, east] = [nw - sw, ne - se];
    (south * south + east * east).max(north * north + west * west).sqrt()
}

/// A slope that the surface that is bilinear between a cell's posts does not exceed, up per cell.
fn bilinear_slope([sw, se, nw, ne]: [f32; 4]) -> f32 {
    let east = (se - sw).abs().max((ne - nw).abs());
    let north = (nw - sw).abs().max((ne - se).abs());
    (east * east + north * north).sqrt()
}

/// A slope that the surface of voxels, which is trilinear, does not exceed in a cell, given the normals at its corners.
fn voxel_slope(corners: [f32; 4], [least_up, most_up]: [f32; 2]) -> f32 {
    let slope = bilinear_slope(corners);
    let highest = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
    let lowest = corners.into_iter().fold(f32::INFINITY, f32::min);
    let range = highest - lowest;
    // Between columns whose densities fall at different rates the surface is a mean of heights weighted by these rates.
    let graded = slope * most_up / least_up;
    if range * most_up <= BOX_HALF_WIDTH {
        graded
    } else if range * most_up <= 2.0 * BOX_HALF_WIDTH {
        // Where one column is all ground or all air, the others alone tell heights, at half their weight or more.
        graded.max(4.0 * BOX_HALF_WIDTH / least_up)
    } else {
        // Between two columns that do not overlap density is the same at many heights: a wall.
        f32::INFINITY
    }
}

/// The highest voxel of a column that is ground; 0 for a column of air, which there is none of.
fn top(voxels: &[u8]) -> u16 {
    let top = voxels.iter().rposition(|&density| f32::from(density) > THRESHOLD);
    top.unwrap_or(0).min(usize::from(u16::MAX)) as u16
}
