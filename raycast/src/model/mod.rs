//! The ground that rays are cast on: tiles of heights, side by side, of any mixture of levels, made into voxels.
//!
//! A tile of `n` x `n` cells has `(n + 1)²` columns of voxels, one per elevation post; a voxel is as high as it is wide,
//! and layers are counted from the same height for all tiles of a level, so that two tiles have equal columns on the edge
//! that they share. Per cell of four columns the *boundary array* has the lowest and the highest boundary cell: below them
//! is ground, above them air.

mod build;
pub mod color;
mod density;
mod tree;
pub mod world;

pub(crate) use build::{LOG_BLOCK, Span, SteepBlock};
pub use density::{BOX_HALF_WIDTH, Filter, SIGMA, THRESHOLD};
pub(crate) use tree::Found;
pub use tree::{Link, Node, Occupied, Tree};

use crate::model::color::{ColorLayout, ColorPlace};
use glam::DVec3;

/// Geometry that all tiles of a ground share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundShape {
    /// Side of a node of level 0, lattice units (elevation posts of level 0): a power of two.
    pub side: u32,
    /// Distance of two lattice points, metres.
    pub lattice_unit_m: f64,
    /// Levels of the quad tree.
    pub levels: u8,
    /// Where the ground ends east and north, lattice units; `u32::MAX` where tiles end it. Cells may reach beyond.
    pub extent: [u32; 2],
    /// Layers of colour.
    pub color: ColorLayout,
    /// How densities are made. `None`: no voxels are made at all, heights are for exact rays alone.
    pub filter: Option<Filter>,
}

/// A tile to be added to a ground.
#[derive(Debug, Clone, Copy)]
pub struct TileSpec<'a> {
    /// Lower left corner of its node, lattice units.
    pub origin: [u32; 2],
    /// Level of the node: its side is `side << level`.
    pub level: u8,
    /// log2 of the distance of its posts, lattice units.
    pub log_spacing: u8,
    /// Cells that it has east and north, at most those that fill its node.
    pub cells: [u32; 2],
    /// Heights of its posts, metres above `datum_m`, rows from south to north.
    pub heights: &'a [f32],
    /// Of its posts, in the same order, the share that is ground and the share that was measured
    /// (`terravision_common::validity`), where that is known of any.
    pub shares: Option<[&'a [f32]; 2]>,
    /// Heights from row to row, at least `cells[0] + 1`.
    pub stride: usize,
    /// What heights are above, metres in world coordinates (the eye's height for elevation arrays of the ring).
    pub datum_m: f64,
    /// Its colours.
    pub color: ColorPlace,
    /// Whether it may get voxels of its own. Without, the boundary array and its heights alone say where ground is.
    pub is_accurate: bool,
}

/// Why a tile is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum GroundError {
    /// Its place is not a node's.
    #[error("a tile of level {level} at {origin:?} is no node of the ground's {levels} levels")]
    Place {
        /// Lower left corner.
        origin: [u32; 2],
        /// Level.
        level: u8,
        /// How many there are.
        levels: u8,
    },
    /// It has no cells, or more than fill its node, or fewer heights than cells.
    #[error("a tile of {}x{} cells with {heights} heights does not fill its node", .cells[0], .cells[1])]
    Cells {
        /// Cells.
        cells: [u32; 2],
        /// Heights.
        heights: usize,
    },
    /// A height is not a number.
    #[error("height {index} of the tile at {origin:?} is no finite number")]
    Height {
        /// Lower left corner.
        origin: [u32; 2],
        /// Which.
        index: usize,
    },
    /// Another tile is there.
    #[error("the tile at {origin:?} covers another one")]
    Occupied {
        /// Lower left corner.
        origin: [u32; 2],
    },
}

/// Which tiles of a ground get voxels of those that may.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detail {
    /// The eye, world coordinates.
    pub eye_in_world: DVec3,
    /// Tiles that are more than this many times as far from the eye as the nearest one, and further than it is wide, get none.
    pub reach: f64,
    /// Bytes of all voxels at most: where they are spent, further tiles get none.
    pub most_bytes: usize,
}

impl Detail {
    /// All tiles that may.
    pub const ALL: Self = Self { eye_in_world: DVec3::ZERO, reach: f64::INFINITY, most_bytes: usize::MAX };
}

/// Boundary cells reach no more voxels above the highest post.
const VOXELS_ABOVE: f32 = 3.0;

/// A tile as rays see it. Heights are metres above the ground's datum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tile {
    /// Lower left corner, lattice units.
    pub(crate) origin: [u32; 2],
    pub(crate) log_spacing: u8,
    pub(crate) spacing_m: f32,
    pub(crate) cells: [u32; 2],
    /// Where its arrays begin.
    pub(crate) heights_at: usize,
    pub(crate) spans_at: usize,
    pub(crate) densities_at: usize,
    pub(crate) maxima_at: usize,
    pub(crate) blocks_at: usize,
    /// Voxels of a column.
    pub(crate) layers: u32,
    /// Height of its lowest layer, voxels above height 0 in world coordinates.
    pub(crate) lowest_layer: i32,
    /// No ground of it is lower or higher, metres above the datum.
    pub(crate) lowest_m: f32,
    pub(crate) top_m: f32,
    pub(crate) is_accurate: bool,
    pub(crate) color: ColorPlace,
    /// Where the shares of its posts begin, if some of it is not measured ground.
    pub(crate) shares_at: Option<usize>,
}

impl Tile {
    #[inline]
    pub(crate) fn posts(&self) -> [usize; 2] {
        self.cells.map(|n| n as usize + 1)
    }
}

/// Tiles side by side. All memory is kept from frame to frame: a ground of the size of the last one allocates nothing.
#[derive(Debug)]
pub struct Ground {
    shape: GroundShape,
    datum_m: f64,
    tiles: Vec<Tile>,
    tree: Tree,
    heights: Vec<f32>,
    /// Shares of ground, and that were measured, of the tiles that need them.
    shares: Vec<[f32; 2]>,
    spans: Vec<Span>,
    densities: Vec<u8>,
    maxima: Vec<f32>,
    blocks: Vec<u16>,
    scratch: build::Scratch,
    /// Tiles by their distance from the eye, the nearest first.
    order: Vec<(f64, u32)>,
    most_voxel_bytes: usize,
    steep: Vec<SteepBlock>,
    lowest_m: f32,
    highest_m: f32,
    highest_voxel_m: f32,
    end: [u32; 2],
    is_cut: bool,
}

impl Ground {
    /// An empty ground.
    #[must_use]
    pub fn new(shape: GroundShape) -> Self {
        let mut ground = Self {
            shape,
            datum_m: 0.0,
            tiles: Vec::new(),
            tree: Tree::default(),
            heights: Vec::new(),
            shares: Vec::new(),
            spans: Vec::new(),
            densities: Vec::new(),
            maxima: Vec::new(),
            blocks: Vec::new(),
            scratch: build::Scratch::default(),
            order: Vec::new(),
            most_voxel_bytes: usize::MAX,
            steep: Vec::new(),
            lowest_m: 0.0,
            highest_m: 0.0,
            highest_voxel_m: 0.0,
            end: [0; 2],
            is_cut: false,
        };
        ground.clear(0.0);
        ground
    }

    /// Its geometry.
    #[must_use]
    #[inline]
    pub fn shape(&self) -> &GroundShape {
        &self.shape
    }

    /// Takes all tiles away. Those that come are kept as metres above `datum_m`, which is best near the eye's height.
    pub fn clear(&mut self, datum_m: f64) {
        self.datum_m = datum_m;
        self.tiles.clear();
        self.tree.clear(self.shape.side.ilog2(), u32::from(self.shape.levels.max(1)) - 1);
        self.heights.clear();
        self.shares.clear();
        self.spans.clear();
        self.densities.clear();
        self.maxima.clear();
        self.blocks.clear();
        self.steep.clear();
        self.lowest_m = f32::INFINITY;
        self.highest_m = f32::NEG_INFINITY;
        self.highest_voxel_m = f32::NEG_INFINITY;
        self.end = [0; 2];
        self.is_cut = false;
    }

    /// Adds a tile. [`Ground::finish`] makes rays see it.
    ///
    /// # Errors
    /// [`GroundError`]; the ground is as before.
    pub fn add(&mut self, spec: &TileSpec<'_>) -> Result<(), GroundError> {
        let TileSpec { origin, level, cells, stride, .. } = *spec;
        let levels = self.shape.levels;
        let log_node = self.shape.side.ilog2() + u32::from(level);
        let log_root = self.shape.side.ilog2() + u32::from(levels) - 1;
        let is_place = level < levels
            && log_root < 32
            && origin.iter().all(|v| v % (1 << log_node) == 0)
            && origin.iter().all(|v| u64::from(*v) < 1 << log_root);
        if !is_place {
            return Err(GroundError::Place { origin, level, levels });
        }
        let is_filled = |n: u32| n > 0 && u64::from(n) << spec.log_spacing <= 1 << log_node;
        let needed = cells[1] as usize * stride + cells[0] as usize + 1;
        let is_short = |plane: &[f32]| plane.len() < needed;
        let are_short = is_short(spec.heights) || spec.shares.is_some_and(|planes| planes.into_iter().any(is_short));
        if !cells.iter().all(|n| is_filled(*n)) || stride <= cells[0] as usize || are_short {
            return Err(GroundError::Cells { cells, heights: spec.heights.len() });
        }
        let heights_at = self.heights.len();
        let offset = spec.datum_m - self.datum_m;
        for row in 0..=cells[1] as usize {
            let row = &spec.heights[row * stride..][..=cells[0] as usize];
            if offset == 0.0 {
                self.heights.extend_from_slice(row);
            } else {
                self.heights.extend(row.iter().map(|height| (f64::from(*height) + offset) as f32));
            }
        }
        let added = &self.heights[heights_at..];
        let Some([lowest_m, highest_m]) = build::range(added, cells[0] as usize + 1, &mut self.scratch) else {
            let index = added.iter().position(|height| !height.is_finite()).unwrap_or_default();
            self.heights.truncate(heights_at);
            return Err(GroundError::Height { origin, index });
        };
        let spacing_m = (self.shape.lattice_unit_m * f64::from(1u32 << spec.log_spacing)) as f32;
        let top_m = if self.has_voxels() { highest_m + VOXELS_ABOVE * spacing_m } else { highest_m };
        if self.tree.insert(origin, u32::from(level), self.tiles.len() as u32, top_m).is_err() {
            self.heights.truncate(heights_at);
            return Err(GroundError::Occupied { origin });
        }
        let shares_at = self.add_shares(spec);
        self.lowest_m = self.lowest_m.min(lowest_m);
        self.highest_m = self.highest_m.max(highest_m);
        for (axis, end) in self.end.iter_mut().enumerate() {
            let reach = origin[axis].saturating_add(cells[axis] << spec.log_spacing);
            self.is_cut |= reach > self.shape.extent[axis];
            *end = (*end).max(reach.min(self.shape.extent[axis]));
        }
        self.tiles.push(Tile {
            origin,
            log_spacing: spec.log_spacing,
            spacing_m,
            cells,
            heights_at,
            spans_at: 0,
            densities_at: 0,
            maxima_at: 0,
            blocks_at: 0,
            layers: 0,
            lowest_layer: 0,
            lowest_m,
            top_m,
            is_accurate: spec.is_accurate,
            color: spec.color,
            shares_at,
        });
        Ok(())
    }

    /// Keeps the shares of a tile, if some of it is not measured ground; where they begin.
    fn add_shares(&mut self, spec: &TileSpec<'_>) -> Option<usize> {
        let planes = spec.shares?;
        let (columns, rows) = (spec.cells[0] as usize + 1, spec.cells[1] as usize + 1);
        let posts = (0..rows).flat_map(|row| row * spec.stride..row * spec.stride + columns);
        let start = self.shares.len();
        self.shares.extend(posts.map(|at| planes.map(|plane| plane[at])));
        let is_needed = self.shares[start..].iter().flatten().any(|share| *share < 1.0);
        if !is_needed {
            self.shares.truncate(start);
        }
        is_needed.then_some(start)
    }

    /// Whether some of what was added is not measured ground.
    pub(crate) fn is_partly_unmeasured(&self) -> bool {
        !self.shares.is_empty()
    }

    /// Shares of the posts of a cell: south west, south east, north west, north east. All is measured where nothing else is known.
    pub(crate) fn shares_of_cell(&self, tile: &Tile, [i, j]: [u32; 2]) -> [[f32; 2]; 4] {
        let columns = tile.cells[0] as usize + 1;
        let south = tile.shares_at.map(|start| start + j as usize * columns + i as usize);
        let pair = |at: usize| self.shares.get(at..at + 2);
        match south.and_then(|south| pair(south).zip(pair(south + columns))) {
            Some((&[sw, se], &[nw, ne])) => [sw, se, nw, ne],
            _ => [[1.0; 2]; 4],
        }
    }

    /// Makes the models of all tiles that were added: densities, boundary arrays, maxima.
    pub fn finish(&mut self) {
        self.finish_for(&Detail::ALL);
    }

    /// As [`Ground::finish`], with voxels for the nearest tiles alone. Which those are depends on the tiles and `detail` alone.
    pub fn finish_for(&mut self, detail: &Detail) {
        if !self.has_voxels() {
            (0..self.tiles.len()).for_each(|index| self.make_model(index));
            return;
        }
        self.most_voxel_bytes = detail.most_bytes;
        self.order.clear();
        for (tile, index) in self.tiles.iter().zip(0..) {
            self.order.push((self.distance_m(tile, detail.eye_in_world), index));
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let limit = self.order.first().map_or(0.0, |(nearest, index)| {
            let tile = &self.tiles[*index as usize];
            let side = f64::from(tile.cells[0].max(tile.cells[1])) * f64::from(tile.spacing_m);
            (detail.reach * nearest).max(side)
        });
        for at in 0..self.order.len() {
            let (distance, index) = self.order[at];
            // Not a number where an endless reach meets no distance: everything is within.
            self.tiles[index as usize].is_accurate &= detail.reach.is_infinite() || distance <= limit;
            self.make_model(index as usize);
        }
    }

    /// How far a tile's ground is from the eye at least, metres.
    fn distance_m(&self, tile: &Tile, eye: DVec3) -> f64 {
        let unit = self.shape.lattice_unit_m;
        let beside = |axis: usize| {
            let low = f64::from(tile.origin[axis]) * unit;
            let high = low + f64::from(tile.cells[axis]) * f64::from(tile.spacing_m);
            (low - eye[axis]).max(eye[axis] - high).max(0.0)
        };
        let above = (eye.z - self.datum_m - f64::from(tile.top_m)).max(0.0);
        DVec3::new(beside(0), beside(1), above).length()
    }

    /// Tiles that have voxels.
    #[must_use]
    pub fn accurate_count(&self) -> usize {
        self.tiles.iter().filter(|tile| tile.is_accurate).count()
    }

    /// Bytes of all voxels.
    #[must_use]
    pub fn voxel_bytes(&self) -> usize {
        self.densities.len()
    }

    /// Number of tiles.
    #[must_use]
    pub fn tile_count(&self) -> usize {
        self.tiles.len()
    }

    /// Bytes of all models.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.densities.len() + size_of_val(&self.spans[..]) + 4 * (self.heights.len() + self.maxima.len())
    }

    /// A slope that no ground exceeds outside of [`Ground::steep_blocks`], metres up per metre.
    pub(crate) fn gentle(&self) -> f32 {
        build::GENTLE
    }

    /// Blocks of cells that are steeper.
    pub(crate) fn steep_blocks(&self) -> &[SteepBlock] {
        &self.steep
    }

    /// Whether it has voxels.
    #[must_use]
    pub fn has_voxels(&self) -> bool {
        self.shape.filter.is_some()
    }

    /// What heights are above, world coordinates.
    #[must_use]
    #[inline]
    pub fn datum_m(&self) -> f64 {
        self.datum_m
    }

    /// Lowest and highest post, metres above the datum. The lowest is above the highest when there are no tiles.
    #[must_use]
    pub fn range_m(&self) -> [f32; 2] {
        [self.lowest_m, self.highest_m]
    }

    /// The top of the highest boundary cell, or the highest post of a ground without voxels, metres above the datum.
    pub(crate) fn top_m(&self) -> f32 {
        if self.has_voxels() { self.highest_voxel_m } else { self.highest_m }
    }

    /// One past the tiles, east and north, lattice units.
    pub(crate) fn end(&self) -> [u32; 2] {
        self.end
    }

    /// Whether cells reach beyond its end.
    pub(crate) fn is_cut(&self) -> bool {
        self.is_cut
    }

    #[inline]
    pub(crate) fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    #[inline]
    pub(crate) fn tree(&self) -> &Tree {
        &self.tree
    }

    #[inline]
    pub(crate) fn heights(&self, tile: &Tile) -> &[f32] {
        let [columns, rows] = tile.posts();
        &self.heights[tile.heights_at..][..columns * rows]
    }

    #[inline]
    pub(crate) fn spans(&self, tile: &Tile) -> &[Span] {
        let cells = tile.cells[0] as usize * tile.cells[1] as usize;
        &self.spans[tile.spans_at..][..if self.has_voxels() { cells } else { 0 }]
    }

    #[inline]
    pub(crate) fn densities(&self, tile: &Tile) -> &[u8] {
        let [columns, rows] = tile.posts();
        let bytes = if tile.is_accurate { columns * rows * tile.layers as usize } else { 0 };
        &self.densities[tile.densities_at..][..bytes]
    }

    /// The highest boundary cell of blocks of `1 << LOG_BLOCK` cells a side.
    #[inline]
    pub(crate) fn blocks(&self, tile: &Tile) -> &[u16] {
        &self.blocks[tile.blocks_at..]
    }

    #[inline]
    pub(crate) fn maxima(&self, tile: &Tile) -> &[f32] {
        &self.maxima[tile.maxima_at..]
    }

    /// Height of the surface at a point, linear on facets, metres above the datum; `None` where no tile is. Lattice units.
    #[must_use]
    pub fn height_at(&self, point: [f64; 2]) -> Option<f32> {
        match self.tree.find(point) {
            Found::Tile(tile) => Some(self.height_in(&self.tiles[tile as usize], point)),
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// Height in a tile, linear on facets as everywhere (`terravision_common::surface::facet`); a point outside of its cells is taken to their border.
    fn height_in(&self, tile: &Tile, point: [f64; 2]) -> f32 {
        let unit = f64::from(1u32 << tile.log_spacing);
        let place = |axis: usize| {
            let at = (point[axis] - f64::from(tile.origin[axis])) / unit;
            let at = at.clamp(0.0, f64::from(tile.cells[axis]));
            let cell = (at as usize).min(tile.cells[axis] as usize - 1);
            (cell, (at - cell as f64) as f32)
        };
        let ((i, u), (j, v)) = (place(0), place(1));
        let stride = tile.posts()[0];
        let heights = self.heights(tile);
        let z = |i: usize, j: usize| heights[j * stride + i];
        let (sw, ne) = (z(i, j), z(i + 1, j + 1));
        if u >= v {
            let se = z(i + 1, j);
            sw + (se - sw) * u + (ne - se) * v
        } else {
            let nw = z(i, j + 1);
            sw + (nw - sw) * v + (ne - nw) * u
        }
    }
}

#[cfg(test)]
mod tests;
