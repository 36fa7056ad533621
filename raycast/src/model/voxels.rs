//! The voxels of a tile: densities, the boundary array, and the blocks with which rays skip it.

use super::Ground;
use super::density::{Filter, HeightColumn, THRESHOLD};
use super::maxima::Scratch;
use super::steep::{CellSlopes, SLOPE_BOUND, Steep};
use super::tile::Tile;

/// The boundary cells of a column of cells, in layers of its tile: the whole lower face of the
/// lowest one is ground, the whole upper face of the highest one air.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Span {
    /// Lowest boundary cell.
    pub(crate) lowest: u16,
    /// Highest boundary cell.
    pub(crate) highest: u16,
}

/// Where the voxels of a tile are in the arrays of its ground.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct TileVoxels {
    pub(super) spans_at: usize,
    pub(super) densities_at: usize,
    pub(super) blocks_at: usize,
    /// Voxels per column.
    pub(crate) layers: u32,
    /// Height of its lowest layer, voxels above height 0 in world coordinates.
    pub(crate) lowest_layer: i32,
    /// Whether there are densities; otherwise the boundary array and heights say where ground is.
    pub(crate) is_accurate: bool,
}

/// The voxels of all tiles.
#[derive(Debug, Default)]
pub(super) struct Voxels {
    pub(super) spans: Vec<Span>,
    pub(super) densities: Vec<u8>,
    pub(super) blocks: Vec<u16>,
    /// The top of the highest boundary cell, metres above the datum.
    pub(super) highest_m: f32,
    /// Upper bound of the bytes of densities.
    pub(super) most_bytes: usize,
}

/// Extra layers below and above a tile's surface, so that samples one interval away from it still
/// have graded densities: half the width of the filter (1.5 voxels) and a sampling interval (0.6),
/// rounded up.
const MARGIN: i32 = 3;
/// A tile with more layers gets no voxels: a leaf of 16 x 16 cells would take more than a megabyte,
/// as much as two hundred leaves of mountains. It takes a cliff a hundred times as high as the tile
/// is wide to have this many.
const MOST_LAYERS: usize = 4096;
/// log2 of the cells along a side of a block of the skipping array: a leaf is 16 cells wide, and is
/// skipped as a whole. (Measured; see `docs/techniques.md`, *Thresholds*.)
pub(crate) const LOG_BLOCK: u32 = 4;

impl Voxels {
    /// Removes all tiles, keeps the memory.
    pub(super) fn clear(&mut self) {
        self.spans.clear();
        self.densities.clear();
        self.blocks.clear();
        self.highest_m = f32::NEG_INFINITY;
    }
}

impl Ground {
    /// Builds the voxels of a tile. The heights of all tiles must have been added.
    pub(super) fn make_voxels(&mut self, index: usize, filter: Filter) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let tile = self.tiles[index];
        let [columns, rows] = tile.posts();
        self.gather(&tile, filter.radius(), &mut scratch.around);
        let [lowest_layer, layers] = self.to_layers(&tile, &mut scratch.around);
        let densities_at = self.voxels.densities.len();
        let bytes = columns * rows * layers as usize;
        let has_room = bytes <= self.voxels.most_bytes.saturating_sub(densities_at);
        let is_accurate = tile.voxels.is_accurate && layers as usize <= MOST_LAYERS && has_room;
        let voxels = TileVoxels {
            spans_at: self.voxels.spans.len(),
            densities_at,
            blocks_at: self.voxels.blocks.len(),
            layers: layers as u32,
            lowest_layer,
            is_accurate,
        };
        let tile = Tile { voxels, ..tile };
        if is_accurate {
            self.voxels.densities.resize(densities_at + bytes, 0);
        }
        self.fill_columns(&tile, filter, &mut scratch);
        self.push_spans(&tile, &scratch, filter);
        self.push_blocks(&tile);
        self.push_border_walls(&tile);
        self.tiles[index] = tile;
        self.scratch = scratch;
    }

    /// Converts heights around a tile, metres above the datum, into layers above its lowest one.
    /// Returns that layer and the number of layers. In double precision, because layers of
    /// neighbouring tiles have to lie at the same heights.
    fn to_layers(&self, tile: &Tile, heights: &mut [f32]) -> [i32; 2] {
        let scale = 1.0 / f64::from(tile.spacing_m);
        let in_voxels = |height: f32| (f64::from(height) + self.datum_m) * scale;
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &mut height in &mut *heights {
            low = low.min(in_voxels(height));
            high = high.max(in_voxels(height));
        }
        let lowest_layer = low.floor() as i32 - MARGIN;
        let layers = (high.ceil() - f64::from(lowest_layer)) as i32 + MARGIN + 1;
        for height in heights {
            *height = (in_voxels(*height) - f64::from(lowest_layer)) as f32;
        }
        [lowest_layer, layers]
    }

    /// Fills a tile's columns with densities, if it has some, and stores where the surface of each
    /// column is.
    fn fill_columns(&mut self, tile: &Tile, filter: Filter, scratch: &mut Scratch) {
        let [columns, rows] = tile.posts();
        let layers = tile.voxels.layers as usize;
        let radius = filter.radius();
        let stride = columns + 2 * radius;
        scratch.tops.clear();
        scratch.ups.clear();
        for j in 0..rows {
            for i in 0..columns {
                let at = (j + radius) * stride + i + radius;
                let column = HeightColumn { heights: &scratch.around, stride, at };
                scratch.ups.push(column.normal_up());
                if tile.voxels.is_accurate {
                    let at = tile.voxels.densities_at + (j * columns + i) * layers;
                    let voxels = &mut self.voxels.densities[at..at + layers];
                    column.fill(filter, voxels);
                    scratch.tops.push(top(voxels));
                } else {
                    // The heights themselves are the surface.
                    scratch.tops.push(scratch.around[at].max(0.0) as u16);
                }
            }
        }
    }

    /// Builds the boundary array of a tile, and the slopes of its cells.
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
                self.voxels.spans.push(Span { lowest, highest });
                let at = (j + radius) * stride + i + radius;
                let corners = [at, at + 1, at + stride, at + stride + 1].map(|at| scratch.around[at]);
                let slopes = CellSlopes::of_voxels(corners, [least_up, most_up], tile.voxels.is_accurate, filter);
                if slopes.heights.max(slopes.voxels) > SLOPE_BOUND {
                    let highest_post = corners.into_iter().fold(f32::NEG_INFINITY, f32::max);
                    // What lies above a boundary cell is air, and so is what lies above the highest
                    // post.
                    let top_m = self.layer_m(tile, f64::from(highest) + 1.0);
                    let post_m = self.layer_m(tile, f64::from(highest_post));
                    self.note_steep(tile, first, [i, j], Steep { slopes, top_m: top_m.max(post_m) });
                }
            }
        }
    }

    /// Builds the array of the highest boundary cell of each block of cells.
    fn push_blocks(&mut self, tile: &Tile) {
        let [columns, rows] = tile.cells.map(|n| n as usize);
        let side = 1usize << LOG_BLOCK;
        for south in (0..rows).step_by(side) {
            for west in (0..columns).step_by(side) {
                let mut highest = 0;
                for j in south..rows.min(south + side) {
                    let row = &self.voxels.spans[tile.voxels.spans_at + j * columns..];
                    highest = row[west..columns.min(west + side)].iter().fold(highest, |h, span| h.max(span.highest));
                }
                self.voxels.blocks.push(highest);
                let top_m = self.layer_m(tile, f64::from(highest) + 1.0);
                self.voxels.highest_m = self.voxels.highest_m.max(top_m);
            }
        }
    }

    /// Height of a fractional layer of a tile, metres above the datum.
    fn layer_m(&self, tile: &Tile, layer: f64) -> f32 {
        let in_voxels = f64::from(tile.voxels.lowest_layer) + layer;
        (in_voxels * f64::from(tile.spacing_m) - self.datum_m) as f32
    }
}

/// The highest voxel of a column that is ground; 0 for a column of air, which does not occur:
/// layers begin below the lowest post.
fn top(voxels: &[u8]) -> u16 {
    let top = voxels.iter().rposition(|&density| f32::from(density) > THRESHOLD);
    top.unwrap_or(0).min(usize::from(u16::MAX)) as u16
}
