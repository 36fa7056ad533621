//! Heights under sixteen points at once, out of the tiles that the points lie over.

use super::lanes::{Floats, LANES, floor, index, larger, smaller};
use crate::model::{Source, Tile, TileSource};
use crate::scene::{Bounds, Scene};
use glam::{DVec2, Vec2};
use terravision_common::surface::facet::facet_linear;

/// A point that is no further outside of a tile, cells, is taken for one on its border: rounding of
/// metres from the eye.
const NEAR_TILE: f32 = 0.01;
/// The height where there is no tile.
pub(super) const NOTHING: f32 = f32::NEG_INFINITY;

/// A number of each lane that is an integer.
type Integers = [u32; LANES];

/// Which tile each lane is over: neighboring points mostly lie over one, and so do the next ones.
/// Where tiles have levels above them, a lane's tile is that of the level which its distance wants.
#[derive(Debug)]
pub(super) struct Heights<'a> {
    scene: &'a Scene<'a>,
    /// All heights of the ground, those of a tile from `first` on.
    all: &'a [f32],
    /// Factor on them.
    scale: f32,
    /// South west corners, metres from the eye, and cells per metre.
    west: Floats,
    south: Floats,
    per_m: Floats,
    /// Cells east and north.
    columns: Floats,
    rows: Floats,
    first: Integers,
    /// Posts of a row, 0 where there is no tile.
    stride: Integers,
    /// Squares of distances from the eye, from where and up to where the tile is the right one.
    from2: Floats,
    until2: Floats,
    /// From where on it is blended into the next level, and the share of that by metre².
    blend_from2: Floats,
    blend_per2: Floats,
    /// Where the next level's tile begins, and the tile's corner in it, cells.
    next_first: Integers,
    next_west: Floats,
    next_south: Floats,
}

impl<'a> Heights<'a> {
    /// Over no tile yet.
    pub(super) fn new(scene: &'a Scene<'a>) -> Self {
        Self {
            scene,
            all: scene.heights,
            scale: scene.pyramid().map_or(1.0, |(pyramid, _)| pyramid.exaggeration()),
            west: [0.0; LANES],
            south: [0.0; LANES],
            per_m: [1.0; LANES],
            columns: [-1.0; LANES],
            rows: [-1.0; LANES],
            first: [0; LANES],
            stride: [0; LANES],
            from2: [f32::NEG_INFINITY; LANES],
            until2: [f32::INFINITY; LANES],
            blend_from2: [f32::MAX; LANES],
            blend_per2: [0.0; LANES],
            next_first: [0; LANES],
            next_west: [0.0; LANES],
            next_south: [0.0; LANES],
        }
    }

    /// Heights of the ground at points, metres from the eye, whose distances from it have these
    /// squares; [`NOTHING`] where no tile is.
    #[inline(always)]
    pub(super) fn at(&mut self, east: &Floats, north: &Floats, away2: &Floats) -> Floats {
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        if self.place(east, north, away2, &mut u, &mut v) {
            self.look_up(east, north, away2);
            self.place(east, north, away2, &mut u, &mut v);
        }
        let mut heights = self.sample(&u, &v, &self.first);
        let mut share = [0.0; LANES];
        let mut blended = 0u32;
        for k in 0..LANES {
            let by = (away2[k] - self.blend_from2[k]) * self.blend_per2[k];
            share[k] = smaller(larger(by, 0.0), 1.0);
            blended |= u32::from(share[k] > 0.0);
        }
        if blended != 0 {
            for k in 0..LANES {
                u[k] = u[k] * 0.5 + self.next_west[k];
                v[k] = v[k] * 0.5 + self.next_south[k];
            }
            let coarser = self.sample(&u, &v, &self.next_first);
            for k in 0..LANES {
                heights[k] += share[k] * (coarser[k] - heights[k]);
            }
        }
        for k in 0..LANES {
            let height = heights[k] * self.scale;
            heights[k] = if self.stride[k] == 0 { NOTHING } else { height };
        }
        heights
    }

    /// Heights at places in tiles that begin there, cells.
    #[inline(always)]
    fn sample(&self, u: &Floats, v: &Floats, first: &Integers) -> Floats {
        let (mut at, mut corners) = ([0; LANES], [[0.0; LANES]; 4]);
        let (mut east, mut north) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            let column = smaller(larger(u[k], 0.0), self.columns[k]);
            let row = smaller(larger(v[k], 0.0), self.rows[k]);
            let i = smaller(floor(column), self.columns[k] - 1.0);
            let j = smaller(floor(row), self.rows[k] - 1.0);
            east[k] = column - i;
            north[k] = row - j;
            at[k] = first[k].wrapping_add(index(j).wrapping_mul(self.stride[k])).wrapping_add(index(i));
        }
        for k in 0..LANES {
            let (south, north) = (at[k] as usize, at[k].wrapping_add(self.stride[k]) as usize);
            if let (Some(&[sw, se]), Some(&[nw, ne])) =
                (self.all.get(south..south.wrapping_add(2)), self.all.get(north..north.wrapping_add(2)))
            {
                [corners[0][k], corners[1][k], corners[2][k], corners[3][k]] = [sw, se, nw, ne];
            }
        }
        let mut heights = [0.0; LANES];
        for k in 0..LANES {
            let [sw, se, nw, ne] = [corners[0][k], corners[1][k], corners[2][k], corners[3][k]];
            heights[k] = facet_linear(sw, se, nw, ne, east[k], north[k]);
        }
        heights
    }

    /// Where points lie in their lanes' tiles, cells; whether one lies outside, or another level is
    /// wanted there.
    #[inline(always)]
    fn place(&self, east: &Floats, north: &Floats, away2: &Floats, u: &mut Floats, v: &mut Floats) -> bool {
        let mut outside = 0u32;
        for k in 0..LANES {
            u[k] = (east[k] - self.west[k]) * self.per_m[k];
            v[k] = (north[k] - self.south[k]) * self.per_m[k];
            let least = -NEAR_TILE;
            let is_inside = (u[k] >= least) & (u[k] - self.columns[k] <= NEAR_TILE);
            let is_within = (v[k] >= least) & (v[k] - self.rows[k] <= NEAR_TILE);
            let is_level = (away2[k] >= self.from2[k]) & (away2[k] < self.until2[k]);
            outside |= u32::from(!(is_inside & is_within & is_level));
        }
        outside != 0
    }

    /// Finds the tiles of points that have left theirs.
    #[inline(never)]
    fn look_up(&mut self, east: &Floats, north: &Floats, away2: &Floats) {
        for k in 0..LANES {
            let (point, away2) = (Vec2::new(east[k], north[k]), away2[k]);
            if self.holds(k, point, away2) {
                continue;
            }
            // Mostly the lane before has gone to the same tile.
            if k > 0 && self.holds(k - 1, point, away2) {
                self.copy(k - 1, k);
                continue;
            }
            match self.scene.source_at(point, away2) {
                Some(Source::Tile(source)) => self.set_source(k, &source),
                Some(Source::Hole { corner, log, until2 }) => {
                    self.set_hole(k, self.scene.square(corner, log), until2);
                }
                None => match self.scene.tile_or_hole_at(point) {
                    Ok(tile) => self.set_tile(k, tile),
                    Err(hole) => self.set_hole(k, hole, f32::INFINITY),
                },
            }
        }
    }

    fn holds(&self, k: usize, point: Vec2, away2: f32) -> bool {
        let [u, v] = [(point.x - self.west[k]) * self.per_m[k], (point.y - self.south[k]) * self.per_m[k]];
        let within = |at: f32, cells: f32| at >= -NEAR_TILE && at - cells <= NEAR_TILE;
        within(u, self.columns[k]) && within(v, self.rows[k]) && away2 >= self.from2[k] && away2 < self.until2[k]
    }

    fn copy(&mut self, from: usize, to: usize) {
        self.west[to] = self.west[from];
        self.south[to] = self.south[from];
        self.per_m[to] = self.per_m[from];
        self.columns[to] = self.columns[from];
        self.rows[to] = self.rows[from];
        self.first[to] = self.first[from];
        self.stride[to] = self.stride[from];
        self.from2[to] = self.from2[from];
        self.until2[to] = self.until2[from];
        self.blend_from2[to] = self.blend_from2[from];
        self.blend_per2[to] = self.blend_per2[from];
        self.next_first[to] = self.next_first[from];
        self.next_west[to] = self.next_west[from];
        self.next_south[to] = self.next_south[from];
    }

    /// A tile of the elevation pool.
    fn set_source(&mut self, k: usize, source: &TileSource) {
        let surface = &self.scene.ground.shape().surface;
        let eye = self.scene.view.eye_in_world();
        let corner = surface.lattice_from_eye(DVec2::from_array(source.origin.map(f64::from)), eye);
        let cells = surface.cells();
        [self.west[k], self.south[k]] = corner.as_vec2().to_array();
        self.per_m[k] = (1.0 / surface.spacing_m(source.level)) as f32;
        self.columns[k] = cells as f32;
        self.rows[k] = cells as f32;
        self.first[k] = source.first;
        self.stride[k] = cells + 1;
        self.from2[k] = source.from2;
        self.until2[k] = source.until2;
        self.blend_from2[k] = source.blend_from2;
        let over = source.until2 - source.blend_from2;
        self.blend_per2[k] = if over.is_finite() && over > 0.0 { 1.0 / over } else { 0.0 };
        self.next_first[k] = source.next_first;
        [self.next_west[k], self.next_south[k]] = source.next_corner;
    }

    /// A tile of the ground, which has no levels above it.
    fn set_tile(&mut self, k: usize, index: u32) {
        let (placed, tile): (_, &Tile) =
            (&self.scene.placed[index as usize], &self.scene.ground.tiles()[index as usize]);
        self.west[k] = placed.corner.x;
        self.south[k] = placed.corner.y;
        self.per_m[k] = placed.per_m;
        self.columns[k] = tile.cells[0] as f32;
        self.rows[k] = tile.cells[1] as f32;
        self.first[k] = tile.first_height() as u32;
        self.stride[k] = tile.cells[0] + 1;
    }

    /// A rectangle without ground, for points nearer than this: one cell.
    fn set_hole(&mut self, k: usize, hole: Bounds, until2: f32) {
        let side = (hole.max - hole.min).max(Vec2::splat(f32::MIN_POSITIVE));
        self.west[k] = hole.min.x;
        self.south[k] = hole.min.y;
        self.per_m[k] = 1.0 / side.max_element();
        self.columns[k] = 1.0;
        self.rows[k] = 1.0;
        self.first[k] = 0;
        self.stride[k] = 0;
        self.from2[k] = f32::NEG_INFINITY;
        self.until2[k] = until2;
        self.blend_per2[k] = 0.0;
    }
}
