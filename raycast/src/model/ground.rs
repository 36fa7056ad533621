//! The ground: tiles side by side, and data about all of them.

use super::maxima::{self, Scratch};
use super::pyramid::{PoolShape, PoolTile, Pyramid};
use super::spec::{Detail, GroundError, GroundShape, PatchSpec, TileSpec};
use super::steep::SteepBlock;
use super::tile::Tile;
use super::tree::Tree;
use super::voxels::{TileVoxels, Voxels};
use glam::{DVec2, DVec3};

/// Boundary cells reach at most this many voxels above the highest post: their upper faces lie
/// within a voxel of it, or within the radius of the Gaussian, two voxels; one more for rounding.
const VOXELS_ABOVE: f32 = 3.0;

/// Tiles side by side. All memory is reused from frame to frame: a ground no larger than the last
/// one allocates nothing.
#[derive(Debug)]
pub struct Ground {
    pub(super) shape: GroundShape,
    pub(super) datum_m: f64,
    pub(super) tiles: Vec<Tile>,
    pub(super) tree: Tree,
    pub(super) heights: Vec<f32>,
    /// Shares of ground and of measured ground, for the tiles that need them.
    pub(super) shares: Vec<[f32; 2]>,
    pub(super) maxima: Vec<f32>,
    pub(super) steep: Vec<SteepBlock>,
    /// Voxels of the tiles that have some.
    pub(super) voxels: Voxels,
    pub(super) scratch: Scratch,
    /// Tiles of the elevation pool, where heights may lie in place.
    pyramid: Option<Pyramid>,
    /// Whether they do.
    is_in_place: bool,
    /// Tiles by their distance from the eye, the nearest first.
    order: Vec<(f64, u32)>,
    lowest_m: f32,
    highest_m: f32,
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
            maxima: Vec::new(),
            steep: Vec::new(),
            voxels: Voxels::default(),
            scratch: Scratch::default(),
            pyramid: None,
            is_in_place: false,
            order: Vec::new(),
            lowest_m: 0.0,
            highest_m: 0.0,
            end: [0; 2],
            is_cut: false,
        };
        ground.clear(0.0);
        ground
    }

    /// The same, with an elevation pool in which heights may lie in place.
    #[must_use]
    pub fn with_pool(mut self, pool: PoolShape) -> Self {
        self.pyramid = Some(Pyramid::new(pool, self.shape.surface, self.shape.levels));
        self
    }

    /// Removes all tiles; heights of new ones lie in the elevation pool. Of those a sweep alone
    /// makes pictures.
    ///
    /// # Panics
    /// Without a pool ([`Ground::with_pool`]).
    pub fn clear_in_place(&mut self) {
        self.clear(0.0);
        self.is_in_place = true;
        self.pyramid.as_mut().expect("a ground in place has a pool").clear();
    }

    /// Adds a tile of the elevation pool, whose heights are `heights`, after the one above it.
    ///
    /// # Errors
    /// [`GroundError`]; the ground is unchanged.
    pub fn add_pool_tile(&mut self, tile: &PoolTile, heights: &[f32]) -> Result<(), GroundError> {
        let unattached = GroundError::Unattached { origin: tile.origin, level: tile.level };
        self.pyramid.as_mut().filter(|_| self.is_in_place).ok_or(unattached)?.add(tile, heights)
    }

    /// Adds a part of the ground over tiles of the elevation pool.
    ///
    /// # Errors
    /// [`GroundError`]; the ground is unchanged.
    pub fn add_patch(&mut self, spec: &PatchSpec) -> Result<(), GroundError> {
        let PatchSpec { origin, level, log_spacing, cells, color } = *spec;
        self.shape.check_place(origin, level, log_spacing, cells)?;
        let index = self.tiles.len() as u32;
        let inserted = self.tree.insert(origin, u32::from(level), index, f32::INFINITY);
        inserted.map_err(|_occupied| GroundError::Occupied { origin })?;
        self.push(Tile {
            origin,
            log_spacing,
            spacing_m: self.shape.surface.spacing_m(log_spacing) as f32,
            cells,
            heights_at: 0,
            maxima_at: 0,
            shares_at: None,
            voxels: TileVoxels::default(),
            lowest_m: 0.0,
            top_m: 0.0,
            color,
        });
        Ok(())
    }

    /// To be called when all parts and pool tiles have been added.
    pub fn finish_in_place(&mut self) {
        if let Some(pyramid) = self.pyramid.as_mut().filter(|_| self.is_in_place) {
            [self.lowest_m, self.highest_m] = pyramid.finish();
        }
    }

    /// The tiles of the elevation pool in which the heights of this ground lie; `None` where it has
    /// heights of its own.
    pub(crate) fn pyramid(&self) -> Option<&Pyramid> {
        self.pyramid.as_ref().filter(|_| self.is_in_place)
    }

    /// Removes all tiles. Heights of new ones are stored in metres above `datum_m`, which is best
    /// near the eye's height.
    pub fn clear(&mut self, datum_m: f64) {
        self.datum_m = datum_m;
        self.tiles.clear();
        self.tree.clear(self.shape.surface.cells().ilog2(), u32::from(self.shape.levels.max(1)) - 1);
        self.heights.clear();
        self.shares.clear();
        self.maxima.clear();
        self.steep.clear();
        self.voxels.clear();
        self.lowest_m = f32::INFINITY;
        self.highest_m = f32::NEG_INFINITY;
        self.end = [0; 2];
        self.is_cut = false;
        self.is_in_place = false;
    }

    /// Adds a tile. Rays see it after [`Ground::finish`].
    ///
    /// # Errors
    /// [`GroundError`]; the ground is unchanged.
    pub fn add(&mut self, spec: &TileSpec<'_>) -> Result<(), GroundError> {
        let TileSpec { origin, level, log_spacing, cells, .. } = *spec;
        self.shape.check(spec)?;
        let heights_at = self.heights.len();
        self.add_heights(spec);
        let added = &self.heights[heights_at..];
        let Some([lowest_m, highest_m]) = maxima::range(added, cells[0] as usize + 1, &mut self.scratch) else {
            let index = added.iter().position(|height| !height.is_finite()).unwrap_or_default();
            self.heights.truncate(heights_at);
            return Err(GroundError::Height { origin, index });
        };
        let spacing_m = self.shape.surface.spacing_m(log_spacing) as f32;
        let top_m = if self.has_voxels() { highest_m + VOXELS_ABOVE * spacing_m } else { highest_m };
        if self.tree.insert(origin, u32::from(level), self.tiles.len() as u32, top_m).is_err() {
            self.heights.truncate(heights_at);
            return Err(GroundError::Occupied { origin });
        }
        let shares_at = self.add_shares(spec);
        self.lowest_m = self.lowest_m.min(lowest_m);
        self.highest_m = self.highest_m.max(highest_m);
        self.push(Tile {
            origin,
            log_spacing,
            spacing_m,
            cells,
            heights_at,
            maxima_at: 0,
            shares_at,
            voxels: TileVoxels { is_accurate: spec.is_accurate, ..TileVoxels::default() },
            lowest_m,
            top_m,
            color: spec.color,
        });
        Ok(())
    }

    fn push(&mut self, tile: Tile) {
        for ((axis, end), extent) in self.end.iter_mut().enumerate().zip(self.shape.surface.extent()) {
            let reach = tile.origin[axis].saturating_add(tile.cells[axis] << tile.log_spacing);
            self.is_cut |= reach > extent;
            *end = (*end).max(reach.min(extent));
        }
        self.tiles.push(tile);
    }

    /// Appends the heights of a tile, row by row, above this ground's datum.
    fn add_heights(&mut self, spec: &TileSpec<'_>) {
        let offset = spec.datum_m - self.datum_m;
        for row in 0..=spec.cells[1] as usize {
            let row = &spec.heights[row * spec.stride..][..=spec.cells[0] as usize];
            if offset == 0.0 {
                self.heights.extend_from_slice(row);
            } else {
                self.heights.extend(row.iter().map(|height| (f64::from(*height) + offset) as f32));
            }
        }
    }

    /// Stores the shares of a tile, if some of it is not measured ground. Returns where they begin.
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

    /// Makes what a sweep needs of all tiles that were added: maxima alone.
    pub fn finish_for_sweep(&mut self) {
        for index in 0..self.tiles.len() {
            self.make_maxima(index);
        }
    }

    /// Builds the models of all added tiles: densities, boundary arrays, maxima.
    pub fn finish(&mut self) {
        self.finish_for(&Detail::ALL);
    }

    /// As [`Ground::finish`], with voxels only for the nearest tiles. Which tiles these are depends
    /// only on the tiles and on `detail`.
    pub fn finish_for(&mut self, detail: &Detail) {
        let Some(filter) = self.shape.filter else {
            for index in 0..self.tiles.len() {
                self.make_maxima(index);
                self.push_steep_heights(index);
            }
            return;
        };
        self.voxels.most_bytes = detail.most_bytes;
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
            let index = index as usize;
            // An infinite reach times a distance of 0 is NaN: then everything is within.
            self.tiles[index].voxels.is_accurate &= detail.reach.is_infinite() || distance <= limit;
            self.make_maxima(index);
            self.make_voxels(index, filter);
        }
    }

    /// Lower bound of the distance of a tile's ground from the eye, metres.
    fn distance_m(&self, tile: &Tile, eye: DVec3) -> f64 {
        let surface = &self.shape.surface;
        let low = surface.foot_of_lattice(tile.corner());
        let high = low + DVec2::from_array(tile.cells.map(f64::from)) * f64::from(tile.spacing_m);
        let foot = surface.foot(eye);
        let beside = (low - foot).max(foot - high).max(DVec2::ZERO);
        let above = (surface.height_above(eye, self.datum_m) - f64::from(tile.top_m)).max(0.0);
        surface.position(beside, above).length()
    }

    /// Its geometry.
    #[must_use]
    #[inline]
    pub fn shape(&self) -> &GroundShape {
        &self.shape
    }

    /// Whether it has voxels.
    #[must_use]
    pub fn has_voxels(&self) -> bool {
        self.shape.filter.is_some()
    }

    /// Number of tiles.
    #[must_use]
    pub fn tile_count(&self) -> usize {
        self.tiles.len()
    }

    /// Tiles that have voxels of their own.
    #[must_use]
    pub fn accurate_count(&self) -> usize {
        self.tiles.iter().filter(|tile| tile.voxels.is_accurate).count()
    }

    /// Bytes of all voxels.
    #[must_use]
    pub fn voxel_bytes(&self) -> usize {
        self.voxels.densities.len()
    }

    /// Bytes of all models.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.voxel_bytes() + size_of_val(&self.voxels.spans[..]) + 4 * (self.heights.len() + self.maxima.len())
    }

    /// The datum of heights, world coordinates.
    #[must_use]
    #[inline]
    pub fn datum_m(&self) -> f64 {
        self.datum_m
    }

    /// Lowest and highest post, metres above the datum. The lowest is above the highest when there
    /// are no tiles.
    #[must_use]
    pub fn range_m(&self) -> [f32; 2] {
        [self.lowest_m, self.highest_m]
    }

    /// The top of the highest boundary cell, or the highest post of a ground without voxels, metres
    /// above the datum.
    pub(crate) fn top_m(&self) -> f32 {
        if self.has_voxels() { self.voxels.highest_m } else { self.highest_m }
    }

    /// The end of the tiles east and north, exclusive, lattice units.
    pub(crate) fn end(&self) -> [u32; 2] {
        self.end
    }

    /// Whether cells reach beyond its end.
    pub(crate) fn is_cut(&self) -> bool {
        self.is_cut
    }

    /// Whether some of the added tiles are not wholly measured ground.
    pub(crate) fn is_partly_unmeasured(&self) -> bool {
        !self.shares.is_empty() || self.pyramid().is_some_and(Pyramid::has_unmeasured)
    }

    /// Blocks of cells that are steeper than [`super::SLOPE_BOUND`]; all other ground is less
    /// steep.
    pub(crate) fn steep_blocks(&self) -> &[SteepBlock] {
        &self.steep
    }

    #[inline]
    pub(crate) fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    #[inline]
    pub(crate) fn tree(&self) -> &Tree {
        &self.tree
    }
}
