//! A ground whose heights lie in an elevation pool: levels of tiles, of which a frame has those that
//! its eye wants.

use super::{Field, UNIT_M};
use glam::{DVec2, DVec3};
use terravision_common::camera::Camera;
use terravision_common::surface::Plane;
use terravision_common::surface::facet::facet_linear;
use terravision_common::validity::{GROUND_PLANE, MEASURED_PLANE, PLANES};
use terravision_raycast::model::color::{ColorLayout, ColorPlace};
use terravision_raycast::model::{Ground, GroundShape, PatchSpec, PoolShape, PoolTile};

/// Cells along a side of a tile.
const SIDE: usize = 16;
/// Posts of a tile.
const POSTS: usize = (SIDE + 1) * (SIDE + 1);

/// All levels of a square field, in a pool.
#[derive(Debug)]
pub struct PooledField {
    /// From the finest to the coarsest, which is one tile.
    levels: Vec<Field>,
    /// The whole pool.
    pub heights: Vec<f32>,
    /// Factor on all heights.
    exaggeration: f64,
    /// Planes of numbers that a tile has, and numbers from slot to slot: more than that.
    planes: usize,
    stride: usize,
}

impl PooledField {
    /// The levels of a field of `16 << (levels - 1)` cells a side, each filtered from the finer one.
    #[must_use]
    pub fn new(field: Field, exaggeration: f64) -> Self {
        Self::with_planes(field, exaggeration, 1)
    }

    /// The same with shares of ground and of measured ground: 1 at posts for which these hold, else 0.
    #[must_use]
    pub fn with_holes(field: Field, exaggeration: f64, are: [&dyn Fn(DVec2) -> bool; 2]) -> Self {
        let mut pooled = Self::with_planes(field, exaggeration, PLANES);
        for (plane, is) in [GROUND_PLANE, MEASURED_PLANE].into_iter().zip(are) {
            pooled.fill_plane(plane, |level, [i, j]| {
                let post = DVec2::new(i as f64, j as f64) * UNIT_M * f64::from(1u32 << level);
                if is(post) { 1.0 } else { 0.0 }
            });
        }
        pooled
    }

    fn with_planes(field: Field, exaggeration: f64, planes: usize) -> Self {
        let mut levels = vec![field];
        while let Some(finer) = levels.last().filter(|field| field.cells > SIDE) {
            levels.push(halved(finer));
        }
        let stride = planes * POSTS + 15;
        let mut pooled = Self { levels, heights: Vec::new(), exaggeration, planes, stride };
        pooled.heights = vec![f32::NAN; pooled.slots() * stride];
        let levels = pooled.levels.clone();
        pooled.fill_plane(0, |level, [i, j]| levels[level].heights[j * (levels[level].cells + 1) + i]);
        pooled
    }

    /// Fills a plane of all tiles: `number` of a level's posts.
    fn fill_plane(&mut self, plane: usize, number: impl Fn(usize, [usize; 2]) -> f32) {
        for level in 0..self.levels.len() {
            let tiles = self.levels[level].cells / SIDE;
            for [m, n] in (0..tiles * tiles).map(|k| [k % tiles, k / tiles]) {
                let first = self.slot(level, [m, n]) * self.stride + plane * POSTS;
                for (k, of) in self.heights[first..][..POSTS].iter_mut().enumerate() {
                    *of = number(level, [m * SIDE + k % (SIDE + 1), n * SIDE + k / (SIDE + 1)]);
                }
            }
        }
    }

    /// Slots before those of a level, the coarsest level first; none is the first.
    fn slot(&self, level: usize, [m, n]: [usize; 2]) -> usize {
        let before: usize = self.levels[level + 1..].iter().map(|field| (field.cells / SIDE).pow(2)).sum();
        before + n * (self.levels[level].cells / SIDE) + m
    }

    fn slots(&self) -> usize {
        self.levels.iter().map(|field| (field.cells / SIDE).pow(2)).sum()
    }

    /// The finest level.
    #[must_use]
    pub fn finest(&self) -> &Field {
        &self.levels[0]
    }

    /// An empty ground of its shape.
    #[must_use]
    pub fn ground(&self) -> Ground {
        let shape = GroundShape {
            surface: Plane::new(UNIT_M, [u32::MAX; 2], SIDE as u32),
            levels: self.levels.len() as u8,
            color: ColorLayout { side: self.levels[0].cells as u32, mips: 1 },
            filter: None,
        };
        let pool = PoolShape {
            slots: self.slots() as u32,
            stride: self.stride as u32,
            exaggeration: self.exaggeration as f32,
            has_validity: self.planes == PLANES,
        };
        Ground::new(shape).with_pool(pool)
    }

    /// Fills a ground with the tiles that a camera wants, posts at most `post_px` pixels apart, and
    /// those above them. Nodes that `is_missing` names (level and place) are drawn by the one above.
    pub fn fill(
        &self,
        ground: &mut Ground,
        camera: &Camera,
        post_px: f64,
        is_missing: impl Fn(usize, [usize; 2]) -> bool,
    ) {
        ground.clear_in_place();
        let mut open = vec![(self.levels.len() - 1, [0; 2])];
        while let Some((level, place)) = open.pop() {
            let origin = place.map(|at| ((at * SIDE) << level) as u32);
            let slot = self.slot(level, place) as u32;
            let tile = PoolTile { origin, level: level as u8, slot, generation: 1 };
            ground.add_pool_tile(&tile, &self.heights).unwrap();
            let [low, high] = [0, SIDE << level]
                .map(|by| DVec2::new(f64::from(origin[0]), f64::from(origin[1])) * UNIT_M + by as f64 * UNIT_M);
            let eye = camera.eye();
            let beside = (low - eye.truncate()).max(eye.truncate() - high).max(DVec2::ZERO);
            let range = self.range();
            let above = (range[0] - eye.z).max(eye.z - range[1]).max(0.0);
            let is_wanted = beside.length_squared() + above * above < square_of(camera, post_px, level);
            let children = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|by| [2 * place[0] + by[0], 2 * place[1] + by[1]]);
            if level > 0 && is_wanted && !children.iter().any(|child| is_missing(level - 1, *child)) {
                open.extend(children.map(|child| (level - 1, child)));
                continue;
            }
            let side = self.levels[0].cells as f64 * UNIT_M;
            ground
                .add_patch(&PatchSpec {
                    origin,
                    level: level as u8,
                    log_spacing: level as u8,
                    cells: [SIDE as u32; 2],
                    color: ColorPlace::new(0, DVec2::new(0.0, side), UNIT_M),
                })
                .unwrap();
        }
        ground.finish_in_place();
    }

    /// Lowest and highest post of all levels, metres.
    fn range(&self) -> [f64; 2] {
        let all =
            self.levels.iter().flat_map(|field| &field.heights).map(|height| f64::from(*height) * self.exaggeration);
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], height| [low.min(height), high.max(height)])
    }

    /// Height of the ground that an eye sees at a place, all tiles being there, metres.
    #[must_use]
    pub fn at(&self, camera: &Camera, post_px: f64, place: DVec2) -> Option<f64> {
        let eye: DVec3 = camera.eye();
        let mut height = self.of_level(0, place)?;
        // The level depends on the distance, and the distance on the height.
        for _ in 0..4 {
            let away2 = (place - eye.truncate()).length_squared() + (height - eye.z).powi(2);
            let last = self.levels.len() - 1;
            let level = (0..last).find(|level| away2 < square_of(camera, post_px, level + 1)).unwrap_or(last);
            height = self.of_level(level, place)?;
            if level < last {
                let [from, to] = [0.6, 1.0].map(|by: f64| square_of(camera, post_px, level) * (2.0 * by).exp2());
                let share = ((away2 - from) / (to - from)).clamp(0.0, 1.0);
                height += share * (self.of_level(level + 1, place)? - height);
            }
        }
        Some(height)
    }

    fn of_level(&self, level: usize, place: DVec2) -> Option<f64> {
        let field = &self.levels[level];
        let at = place / (UNIT_M * f64::from(1u32 << level));
        let end = field.cells as f64;
        if at.min_element() < 0.0 || at.max_element() > end {
            return None;
        }
        let [i, j] = [at.x, at.y].map(|at| (at as usize).min(field.cells - 1));
        let z = |i: usize, j: usize| f64::from(field.heights[j * (field.cells + 1) + i]);
        let height = facet_linear(z(i, j), z(i + 1, j), z(i, j + 1), z(i + 1, j + 1), at.x - i as f64, at.y - j as f64);
        Some(height * self.exaggeration)
    }
}

/// The square of the distance from which on a level is fine enough, metres².
fn square_of(camera: &Camera, post_px: f64, level: usize) -> f64 {
    (UNIT_M * camera.focal_px() / post_px * f64::from(1u32 << level)).powi(2)
}

/// Every second post of a field, filtered.
fn halved(field: &Field) -> Field {
    let last = field.cells as i64;
    Field::of(field.cells / 2, |x, y| {
        let at = |i: i64, j: i64| {
            let [i, j] = [2 * x as i64 + i, 2 * y as i64 + j].map(|at| at.clamp(0, last) as usize);
            f64::from(field.heights[j * (field.cells + 1) + i])
        };
        let row = |j: i64| 0.25 * (at(-1, j) + at(1, j)) + 0.5 * at(0, j);
        0.25 * (row(-1) + row(1)) + 0.5 * row(0)
    })
}
