//! Heights under sixteen points at once, out of the tiles that the points lie over.

use super::lanes::{Floats, floor, index, larger, smaller};
use crate::model::Tile;
use crate::scene::{Bounds, Scene};
use crate::simd::LANES;
use glam::Vec2;
use terravision_common::surface::facet::facet_linear;

/// A point that is no further outside of a tile, cells, is taken for one on its border: rounding of
/// metres from the eye.
const NEAR_TILE: f32 = 0.01;
/// The height where there is no tile.
pub(super) const NOTHING: f32 = f32::NEG_INFINITY;

/// Which tile each lane is over: neighboring points mostly lie over one, and so do the next ones.
#[derive(Debug)]
pub(super) struct Heights<'a> {
    scene: &'a Scene<'a>,
    /// All heights of the ground, those of a tile from `first` on.
    all: &'a [f32],
    /// South west corners, metres from the eye, and cells per metre.
    west: Floats,
    south: Floats,
    per_m: Floats,
    /// Cells east and north.
    columns: Floats,
    rows: Floats,
    first: [u32; LANES],
    /// Posts of a row, 0 where there is no tile.
    stride: [u32; LANES],
}

impl<'a> Heights<'a> {
    /// Over no tile yet.
    pub(super) fn new(scene: &'a Scene<'a>) -> Self {
        Self {
            scene,
            all: scene.ground.all_heights(),
            west: [0.0; LANES],
            south: [0.0; LANES],
            per_m: [1.0; LANES],
            columns: [-1.0; LANES],
            rows: [-1.0; LANES],
            first: [0; LANES],
            stride: [0; LANES],
        }
    }

    /// Heights of the ground at points, metres from the eye; [`NOTHING`] where no tile is.
    #[inline(always)]
    pub(super) fn at(&mut self, east: &Floats, north: &Floats) -> Floats {
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        if self.place(east, north, &mut u, &mut v) {
            self.look_up(east, north);
            self.place(east, north, &mut u, &mut v);
        }
        let (mut at, mut corners) = ([0; LANES], [[0.0; LANES]; 4]);
        for k in 0..LANES {
            let column = smaller(larger(u[k], 0.0), self.columns[k]);
            let row = smaller(larger(v[k], 0.0), self.rows[k]);
            let i = smaller(floor(column), self.columns[k] - 1.0);
            let j = smaller(floor(row), self.rows[k] - 1.0);
            u[k] = column - i;
            v[k] = row - j;
            at[k] = self.first[k].wrapping_add(index(j).wrapping_mul(self.stride[k])).wrapping_add(index(i));
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
            let height = facet_linear(sw, se, nw, ne, u[k], v[k]);
            heights[k] = if self.stride[k] == 0 { NOTHING } else { height };
        }
        heights
    }

    /// Where points lie in their lanes' tiles, cells; whether one lies outside.
    #[inline(always)]
    fn place(&self, east: &Floats, north: &Floats, u: &mut Floats, v: &mut Floats) -> bool {
        let mut outside = 0u32;
        for k in 0..LANES {
            u[k] = (east[k] - self.west[k]) * self.per_m[k];
            v[k] = (north[k] - self.south[k]) * self.per_m[k];
            let least = -NEAR_TILE;
            let is_inside = (u[k] >= least) & (u[k] - self.columns[k] <= NEAR_TILE);
            let is_within = (v[k] >= least) & (v[k] - self.rows[k] <= NEAR_TILE);
            outside |= u32::from(!(is_inside & is_within));
        }
        outside != 0
    }

    /// Finds the tiles of points that have left theirs.
    #[inline(never)]
    fn look_up(&mut self, east: &Floats, north: &Floats) {
        for k in 0..LANES {
            let point = Vec2::new(east[k], north[k]);
            if self.holds(k, point) {
                continue;
            }
            // Mostly the lane before has gone to the same tile.
            if k > 0 && self.holds(k - 1, point) {
                self.copy(k - 1, k);
                continue;
            }
            match self.scene.tile_or_hole_at(point) {
                Ok(tile) => self.set_tile(k, tile),
                Err(hole) => self.set_hole(k, hole),
            }
        }
    }

    fn holds(&self, k: usize, point: Vec2) -> bool {
        let [u, v] = [(point.x - self.west[k]) * self.per_m[k], (point.y - self.south[k]) * self.per_m[k]];
        let within = |at: f32, cells: f32| at >= -NEAR_TILE && at - cells <= NEAR_TILE;
        within(u, self.columns[k]) && within(v, self.rows[k])
    }

    fn copy(&mut self, from: usize, to: usize) {
        self.west[to] = self.west[from];
        self.south[to] = self.south[from];
        self.per_m[to] = self.per_m[from];
        self.columns[to] = self.columns[from];
        self.rows[to] = self.rows[from];
        self.first[to] = self.first[from];
        self.stride[to] = self.stride[from];
    }

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

    /// A rectangle without ground: one cell.
    fn set_hole(&mut self, k: usize, hole: Bounds) {
        let side = (hole.max - hole.min).max(Vec2::splat(f32::MIN_POSITIVE));
        self.west[k] = hole.min.x;
        self.south[k] = hole.min.y;
        self.per_m[k] = 1.0 / side.max_element();
        self.columns[k] = 1.0;
        self.rows[k] = 1.0;
        self.first[k] = 0;
        self.stride[k] = 0;
    }
}
