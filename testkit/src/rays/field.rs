//! Grounds to cast rays on.

use glam::DVec2;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::surface::Plane;
use terravision_common::surface::facet::facet_linear;
use terravision_raycast::model::color::{ColorLayout, ColorPlace};
use terravision_raycast::model::{Filter, Ground, GroundShape, TileSpec};

/// Metres between posts.
pub const UNIT_M: f64 = 10.0;

/// Heights of `cells + 1` posts a side.
#[derive(Debug, Clone)]
pub struct Field {
    /// Cells along a side.
    pub cells: usize,
    /// Heights of posts, metres, rows from south to north.
    pub heights: Vec<f32>,
}

/// White noise from 0 to 1.
#[must_use]
pub fn noise(x: u64, y: u64, seed: u64) -> f64 {
    let mut h = x.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ y.wrapping_mul(0xC2B2_AE3D_27D4_EB4F) ^ (seed << 32 | seed);
    h = (h ^ (h >> 33)).wrapping_mul(0xFF51_AFD7_ED55_8CCD);
    h = (h ^ (h >> 33)).wrapping_mul(0xC4CE_B9FE_1A85_EC53);
    ((h ^ (h >> 33)) >> 11) as f64 / (1u64 << 53) as f64
}

impl Field {
    /// The heights that a function of column and row gives.
    #[must_use]
    pub fn of(cells: usize, height_m: impl Fn(usize, usize) -> f64) -> Self {
        let posts = cells + 1;
        Self { cells, heights: (0..posts * posts).map(|k| height_m(k % posts, k / posts) as f32).collect() }
    }

    /// Hills with detail down to the post: natural ground.
    #[must_use]
    pub fn hills(cells: usize, relief_m: f64, seed: u64) -> Self {
        let octave = |x: usize, y: usize, log: u32| {
            let (i, j) = (x >> log, y >> log);
            let period = (1usize << log) as f64;
            let ease = |at: usize, from: usize| {
                let t = (at - (from << log)) as f64 / period;
                t * t * (3.0 - 2.0 * t)
            };
            let (u, v) = (ease(x, i), ease(y, j));
            let at = |i: usize, j: usize| noise(i as u64, j as u64, seed + u64::from(log));
            let south = at(i, j) + (at(i + 1, j) - at(i, j)) * u;
            let north = at(i, j + 1) + (at(i + 1, j + 1) - at(i, j + 1)) * u;
            south + (north - south) * v
        };
        Self::of(cells, |x, y| (0..=6).map(|log| octave(x, y, log) * relief_m * 0.5f64.powi(7 - log as i32)).sum())
    }

    /// A plain with towers of one to four posts: cliffs on all sides.
    #[must_use]
    pub fn towers(cells: usize, height_m: f64, seed: u64) -> Self {
        Self::of(cells, |x, y| {
            let (i, j) = (x / 9, y / 9);
            let is_tower = noise(i as u64, j as u64, seed) > 0.7;
            let width = 1 + (noise(i as u64, j as u64, seed + 1) * 4.0) as usize;
            if is_tower && x % 9 < width && y % 9 < width {
                height_m
            } else {
                noise(x as u64, y as u64, seed + 2) * 3.0
            }
        })
    }

    /// The ground of this field in one tile, or in tiles of `side` cells; without a filter it has
    /// no voxels.
    #[must_use]
    pub fn ground(&self, side: usize, filter: impl Into<Option<Filter>>) -> Ground {
        let levels = (self.cells.div_ceil(side)).next_power_of_two().ilog2() as u8 + 1;
        let shape = GroundShape {
            surface: Plane::new(UNIT_M, [u32::MAX; 2], side as u32),
            levels,
            color: ColorLayout { side: self.cells as u32, mips: 1 },
            filter: filter.into(),
        };
        let mut ground = Ground::new(shape);
        self.fill(&mut ground, side);
        ground
    }

    /// Fills a ground of its shape.
    pub fn fill(&self, ground: &mut Ground, side: usize) {
        ground.clear(0.0);
        let posts = self.cells + 1;
        for south in (0..self.cells).step_by(side) {
            for west in (0..self.cells).step_by(side) {
                let cells = [west, south].map(|at| (self.cells - at).min(side) as u32);
                ground
                    .add(&TileSpec {
                        origin: [west as u32, south as u32],
                        level: 0,
                        log_spacing: 0,
                        cells,
                        heights: &self.heights[south * posts + west..],
                        shares: None,
                        stride: posts,
                        datum_m: 0.0,
                        color: self.color_place(),
                        is_accurate: true,
                    })
                    .unwrap();
            }
        }
        ground.finish();
    }

    /// The ground of this field in tiles of 16 cells of several levels, some of them thinned, drawn
    /// with voxels where `is_accurate` says so of a tile's origin.
    #[must_use]
    pub fn mixed(&self, seed: u64, filter: Filter, is_accurate: impl Fn([u32; 2]) -> bool) -> Ground {
        const SIDE: usize = 16;
        let shape = GroundShape {
            surface: Plane::new(UNIT_M, [u32::MAX; 2], SIDE as u32),
            levels: (self.cells.div_ceil(SIDE)).next_power_of_two().ilog2() as u8 + 1,
            color: ColorLayout { side: self.cells as u32, mips: 1 },
            filter: Some(filter),
        };
        let mut ground = Ground::new(shape);
        let posts = self.cells + 1;
        let mut add = |[west, south]: [usize; 2], level: u8, log_spacing: u8| {
            let cells = [west, south].map(|at| (self.cells - at).min(SIDE << level) >> log_spacing);
            let rows = (0..=cells[1]).map(|j| (south + (j << log_spacing)) * posts + west);
            let heights: Vec<f32> =
                rows.flat_map(|row| (0..=cells[0]).map(move |i| self.heights[row + (i << log_spacing)])).collect();
            let origin = [west as u32, south as u32];
            ground
                .add(&TileSpec {
                    origin,
                    level,
                    log_spacing,
                    cells: cells.map(|n| n as u32),
                    heights: &heights,
                    shares: None,
                    stride: cells[0] + 1,
                    datum_m: 0.0,
                    color: self.color_place(),
                    is_accurate: is_accurate(origin),
                })
                .unwrap();
        };
        for south in (0..self.cells).step_by(2 * SIDE) {
            for west in (0..self.cells).step_by(2 * SIDE) {
                if noise(west as u64, south as u64, seed) < 0.5 {
                    add([west, south], 1, if noise(west as u64, south as u64, seed + 1) < 0.5 { 1 } else { 2 });
                    continue;
                }
                for [east, north] in [[0, 0], [SIDE, 0], [0, SIDE], [SIDE, SIDE]] {
                    let origin = [west + east, south + north];
                    if origin.into_iter().all(|at| at < self.cells) {
                        let is_thin = noise(origin[0] as u64, origin[1] as u64, seed + 2) < 0.3;
                        add(origin, 0, u8::from(is_thin));
                    }
                }
            }
        }
        ground.finish();
        ground
    }

    fn color_place(&self) -> ColorPlace {
        ColorPlace::new(0, DVec2::new(0.0, self.cells as f64 * UNIT_M), UNIT_M)
    }

    /// One layer of colour, a texel per cell: every one of its own.
    #[must_use]
    pub fn colors(&self) -> Vec<u8> {
        let texel = |k: usize| [(k % self.cells) as u8, (k / self.cells) as u8, (k % 7 * 30) as u8, 255];
        (0..self.cells * self.cells).flat_map(texel).collect()
    }

    /// Height at a point, linear on facets, metres.
    #[must_use]
    pub fn at(&self, x: f64, y: f64) -> Option<f64> {
        let (u, v) = (x / UNIT_M, y / UNIT_M);
        let end = self.cells as f64;
        if !(0.0..=end).contains(&u) || !(0.0..=end).contains(&v) {
            return None;
        }
        let (i, j) = ((u as usize).min(self.cells - 1), (v as usize).min(self.cells - 1));
        let (u, v) = (u - i as f64, v - j as f64);
        let z = |i: usize, j: usize| f64::from(self.heights[j * (self.cells + 1) + i]);
        Some(facet_linear(z(i, j), z(i + 1, j), z(i, j + 1), z(i + 1, j + 1), u, v))
    }
}

/// A camera, angles in degrees.
#[must_use]
pub fn camera(eye: [f64; 3], [heading, pitch, roll]: [f64; 3], vfov_deg: f64, [width, height]: [u32; 2]) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: eye,
        heading_rad: heading.to_radians(),
        pitch_rad: pitch.to_radians(),
        roll_rad: roll.to_radians(),
        vfov_rad: vfov_deg.to_radians(),
        width,
        height,
        timestamp_nanos: 0,
    })
    .expect("valid")
}
