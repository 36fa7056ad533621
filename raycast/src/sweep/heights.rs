//! Heights under sixteen points at once, out of the tiles that the points lie over.

use crate::model::{Source, Tile, TileSource};
use crate::scene::{Bounds, Scene};
use glam::{DVec2, Vec2};
use terravision_common::simd::{LANES, Simd, Sixteen};
use terravision_common::surface::facet::facet_linear_of_lanes;
use terravision_common::validity::{GROUND_PLANE, MEASURED_PLANE};

/// A point that is no further outside of a tile, cells, is taken for one on its border: rounding of
/// metres from the eye.
const NEAR_TILE: f32 = 0.01;
/// The height where there is no tile.
pub(super) const NOTHING: f32 = f32::NEG_INFINITY;

/// Bits of all lanes.
const ALL: u32 = (1 << LANES) - 1;
/// A number of each lane that is an integer.
type Integers = Sixteen<u32>;

/// Points, metres from the eye, and the squares of their distances from it.
#[derive(Clone, Copy)]
pub(super) struct Place<S: Simd> {
    pub(super) east: S::Floats,
    pub(super) north: S::Floats,
    pub(super) away2: S::Floats,
}

/// The same, point by point.
struct Places {
    east: Sixteen<f32>,
    north: Sixteen<f32>,
    away2: Sixteen<f32>,
}

impl Places {
    #[inline(always)]
    fn of<S: Simd>(simd: S, place: &Place<S>) -> Self {
        let mut of = Self { east: [0.0; LANES], north: [0.0; LANES], away2: [0.0; LANES] };
        simd.store(place.east, &mut of.east);
        simd.store(place.north, &mut of.north);
        simd.store(place.away2, &mut of.away2);
        of
    }
}

/// Which tile each lane is over: neighboring points mostly lie over one, and so do the next ones.
/// Where tiles have levels above them, a lane's tile is that of the level which its distance wants.
#[derive(Debug)]
pub(super) struct Heights<'a> {
    scene: &'a Scene<'a>,
    /// All heights of the ground, those of a tile from `first` on.
    all: &'a [f32],
    /// Factor on them.
    scale: f32,
    /// Where lanes without a tile read: in a tile of the frame, as all others do.
    nowhere: u32,
    /// South west corners, metres from the eye, and cells per metre.
    west: Sixteen<f32>,
    south: Sixteen<f32>,
    per_m: Sixteen<f32>,
    /// Cells east and north.
    columns: Sixteen<f32>,
    rows: Sixteen<f32>,
    first: Integers,
    /// Posts of a row.
    stride: Integers,
    /// What is added to heights: [`NOTHING`] where there is no tile.
    base: Sixteen<f32>,
    /// Squares of distances from the eye, from where and up to where the tile is the right one.
    from2: Sixteen<f32>,
    until2: Sixteen<f32>,
    /// From where on it is blended into the next level, and the share of that by metre².
    blend_from2: Sixteen<f32>,
    blend_per2: Sixteen<f32>,
    /// Where the next level's tile begins, and the tile's corner in it, cells.
    next_first: Integers,
    next_west: Sixteen<f32>,
    next_south: Sixteen<f32>,
    /// A bit of each lane whose tile has posts that are not ground, or were not measured.
    unmeasured: u32,
}

impl<'a> Heights<'a> {
    /// Over no tile yet.
    pub(super) fn new(scene: &'a Scene<'a>) -> Self {
        Self {
            scene,
            all: scene.heights,
            scale: scene.pyramid().map_or(1.0, |(pyramid, _)| pyramid.exaggeration()),
            nowhere: scene.pyramid().map_or(0, |(pyramid, _)| pyramid.first_of_root()),
            west: [0.0; LANES],
            south: [0.0; LANES],
            per_m: [1.0; LANES],
            columns: [-1.0; LANES],
            rows: [-1.0; LANES],
            first: [0; LANES],
            stride: [0; LANES],
            base: [NOTHING; LANES],
            from2: [f32::NEG_INFINITY; LANES],
            until2: [f32::INFINITY; LANES],
            blend_from2: [f32::MAX; LANES],
            blend_per2: [0.0; LANES],
            next_first: [0; LANES],
            next_west: [0.0; LANES],
            next_south: [0.0; LANES],
            unmeasured: 0,
        }
    }

    /// Heights of the ground at points; [`NOTHING`] where no tile is.
    #[inline(always)]
    pub(super) fn at<S: Simd>(&mut self, simd: S, place: &Place<S>) -> S::Floats {
        let cells = self.over(simd, place);
        let heights = self.blended(simd, place, cells, simd.words(0));
        heights * simd.floats(self.scale) + simd.load(&self.base)
    }

    /// Shares of ground and of measured ground at points ([`terravision_common::validity`]), 1 where
    /// no tile is; `None` where all ground was measured.
    #[inline(always)]
    pub(super) fn shares<S: Simd>(&mut self, simd: S, place: &Place<S>) -> Option<[S::Floats; 2]> {
        let cells = self.over(simd, place);
        if self.unmeasured == 0 {
            return None;
        }
        let stride = simd.load_words(&self.stride);
        let posts = stride * stride;
        let [ground, measured] = [GROUND_PLANE, MEASURED_PLANE];
        let ground = self.blended(simd, place, cells, posts * simd.words(ground as u32));
        let measured = self.blended(simd, place, cells, posts * simd.words(measured as u32));
        let is_tile = simd.less(simd.floats(NOTHING), simd.load(&self.base));
        let one = simd.floats(1.0);
        Some([simd.select(is_tile, ground, one), simd.select(is_tile, measured, one)])
    }

    /// Where points lie in their lanes' tiles, cells, once those are found.
    #[inline(always)]
    fn over<S: Simd>(&mut self, simd: S, place: &Place<S>) -> [S::Floats; 2] {
        let cells = self.cells(simd, place);
        if self.is_over(simd, place, cells) {
            return cells;
        }
        self.look_up(&Places::of(simd, place));
        self.cells(simd, place)
    }

    /// Numbers of a plane that begins this many posts behind each tile's begin, blended into the next
    /// level's.
    #[inline(always)]
    fn blended<S: Simd>(&self, simd: S, place: &Place<S>, [u, v]: [S::Floats; 2], posts_before: S::Words) -> S::Floats {
        let own = self.sample(simd, [u, v], simd.load_words(&self.first) + posts_before);
        let by = (place.away2 - simd.load(&self.blend_from2)) * simd.load(&self.blend_per2);
        let (zero, one) = (simd.floats(0.0), simd.floats(1.0));
        let share = simd.smaller(simd.larger(by, zero), one);
        if !simd.any(simd.less(zero, share)) {
            return own;
        }
        let half = simd.floats(0.5);
        let next = [u * half + simd.load(&self.next_west), v * half + simd.load(&self.next_south)];
        let coarser = self.sample(simd, next, simd.load_words(&self.next_first) + posts_before);
        own + share * (coarser - own)
    }

    /// Heights at places in tiles that begin there, cells.
    #[inline(always)]
    fn sample<S: Simd>(&self, simd: S, [u, v]: [S::Floats; 2], first: S::Words) -> S::Floats {
        let (zero, one) = (simd.floats(0.0), simd.floats(1.0));
        let (columns, rows) = (simd.load(&self.columns), simd.load(&self.rows));
        let column = simd.smaller(simd.larger(u, zero), columns);
        let row = simd.smaller(simd.larger(v, zero), rows);
        let i = simd.smaller(simd.floor(column), columns - one);
        let j = simd.smaller(simd.floor(row), rows - one);
        let stride = simd.load_words(&self.stride);
        let at = first + simd.index(j) * stride + simd.index(i);
        let [sw, se] = simd.pairs(self.all, at);
        let [nw, ne] = simd.pairs(self.all, at + stride);
        facet_linear_of_lanes(simd, [sw, se, nw, ne], [column - i, row - j])
    }

    /// Where points lie in their lanes' tiles, cells.
    #[inline(always)]
    fn cells<S: Simd>(&self, simd: S, place: &Place<S>) -> [S::Floats; 2] {
        let per_m = simd.load(&self.per_m);
        [(place.east - simd.load(&self.west)) * per_m, (place.north - simd.load(&self.south)) * per_m]
    }

    /// Whether all points lie over their lanes' tiles, and these levels are wanted there.
    #[inline(always)]
    fn is_over<S: Simd>(&self, simd: S, place: &Place<S>, [u, v]: [S::Floats; 2]) -> bool {
        let (least, most) = (simd.floats(-NEAR_TILE), simd.floats(NEAR_TILE));
        let is_inside = simd.at_most(least, u) & simd.at_most(u - simd.load(&self.columns), most);
        let is_within = simd.at_most(least, v) & simd.at_most(v - simd.load(&self.rows), most);
        let is_level =
            simd.at_most(simd.load(&self.from2), place.away2) & simd.less(place.away2, simd.load(&self.until2));
        simd.bits(is_inside & is_within & is_level) == ALL
    }

    /// Finds the tiles of points that have left theirs.
    #[inline(never)]
    fn look_up(&mut self, places: &Places) {
        for k in 0..LANES {
            let (point, away2) = (Vec2::new(places.east[k], places.north[k]), places.away2[k]);
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
        self.base[to] = self.base[from];
        self.from2[to] = self.from2[from];
        self.until2[to] = self.until2[from];
        self.blend_from2[to] = self.blend_from2[from];
        self.blend_per2[to] = self.blend_per2[from];
        self.next_first[to] = self.next_first[from];
        self.next_west[to] = self.next_west[from];
        self.next_south[to] = self.next_south[from];
        self.set_unmeasured(to, self.unmeasured >> from & 1 == 1);
    }

    fn set_unmeasured(&mut self, k: usize, is_unmeasured: bool) {
        self.unmeasured = self.unmeasured & !(1 << k) | u32::from(is_unmeasured) << k;
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
        self.base[k] = 0.0;
        self.from2[k] = source.from2;
        self.until2[k] = source.until2;
        self.blend_from2[k] = source.blend_from2;
        let over = source.until2 - source.blend_from2;
        self.blend_per2[k] = if over.is_finite() && over > 0.0 { 1.0 / over } else { 0.0 };
        self.next_first[k] = source.next_first;
        [self.next_west[k], self.next_south[k]] = source.next_corner;
        let pyramid = self.scene.pyramid().map(|(pyramid, _)| pyramid).filter(|pyramid| pyramid.has_validity());
        self.set_unmeasured(k, pyramid.is_some_and(|pyramid| pyramid.is_partly_unmeasured(source)));
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
        self.base[k] = 0.0;
    }

    /// A rectangle without ground, for points nearer than this: one cell.
    fn set_hole(&mut self, k: usize, hole: Bounds, until2: f32) {
        let side = (hole.max - hole.min).max(Vec2::splat(f32::MIN_POSITIVE));
        self.west[k] = hole.min.x;
        self.south[k] = hole.min.y;
        self.per_m[k] = 1.0 / side.max_element();
        self.columns[k] = 1.0;
        self.rows[k] = 1.0;
        self.first[k] = self.nowhere;
        self.stride[k] = 0;
        self.base[k] = NOTHING;
        self.from2[k] = f32::NEG_INFINITY;
        self.until2[k] = until2;
        self.blend_per2[k] = 0.0;
        self.set_unmeasured(k, false);
    }
}
