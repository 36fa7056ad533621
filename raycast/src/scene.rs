//! A frame's ground as seen from its eye: shared by the rays of all techniques.

use crate::model::facet::Facet;
use crate::model::{Found, Ground, LevelDistances, Pyramid, Source};
use crate::view::{Ray, View};
use glam::{DVec2, Vec2, Vec3};

/// A tile relative to the eye.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placed {
    /// South west corner of its first cell and height of its lowest layer, metres from the eye.
    pub(crate) corner: Vec3,
    /// Voxels per metre.
    pub(crate) per_m: f32,
    /// North west corner of its colours, metres from the eye.
    pub(crate) color_corner: Vec2,
    pub(crate) texels_per_m: f32,
}

/// A rectangle in the plane, metres from the eye.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Bounds {
    pub(crate) min: Vec2,
    pub(crate) max: Vec2,
}

/// The ground of a frame, relative to the eye.
#[derive(Debug)]
pub(crate) struct Scene<'a> {
    pub(crate) ground: &'a Ground,
    /// Heights of the ground's tiles, from where each of them begins: its own, or the whole elevation
    /// pool.
    pub(crate) heights: &'a [f32],
    /// From where on each level of the elevation pool's tiles is fine enough.
    distances: LevelDistances,
    /// Its tiles.
    pub(crate) placed: &'a [Placed],
    /// Bounds of all tiles.
    pub(crate) bounds: Bounds,
    pub(crate) view: View,
    /// The eye, metres above the ground's datum.
    pub(crate) eye_height: f32,
    /// Highest ground, metres above the eye; minus infinity without ground.
    pub(crate) highest: f32,
    /// Upper bound of the distance of ground, metres; 0 without ground.
    pub(crate) far: f32,
    /// Whether facets are seen from below: an eye beside the world may look below its edge.
    pub(crate) has_undersides: bool,
}

/// What is at a point of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    Tile(u32),
    /// No tile before this parameter of the ray.
    HoleUntil(f32),
    /// No tile here or farther on.
    Left,
}

/// A point outside of the ground's bounds by no more than this share of a lattice unit counts as on
/// them, for the rounding of metres from the eye: an eighth of a millimetre per kilometre.
const NEAR_BOUNDS: f32 = 0.01;
/// A point on the outer border belongs to the cell before it: this many lattice units are
/// subtracted, a difference that a double has room for at any lattice coordinate.
pub(crate) const JUST_INSIDE: f64 = 1e-3;

/// Computes the positions of all tiles; returns their bounds.
pub(crate) fn place(ground: &Ground, view: &View, placed: &mut Vec<Placed>) -> Bounds {
    let eye = view.eye_in_world();
    let surface = &ground.shape().surface;
    let extent = DVec2::from_array(surface.extent().map(f64::from));
    let ground_end = surface.lattice_from_eye(extent, eye);
    placed.clear();
    let mut bounds = Bounds { min: Vec2::INFINITY, max: Vec2::NEG_INFINITY };
    for tile in ground.tiles() {
        let corner = surface.lattice_from_eye(tile.corner(), eye);
        let spacing = surface.spacing_m(tile.log_spacing);
        let height = f64::from(tile.voxels.lowest_layer) * spacing - surface.height_m(eye);
        placed.push(Placed {
            corner: surface.position(corner, height).as_vec3(),
            per_m: (1.0 / spacing) as f32,
            color_corner: (tile.color.north_west_in_world - surface.foot(eye)).as_vec2(),
            texels_per_m: (1.0 / tile.color.texel_m) as f32,
        });
        let end = corner + DVec2::new(f64::from(tile.cells[0]), f64::from(tile.cells[1])) * spacing;
        let end = end.min(ground_end);
        bounds.min = bounds.min.min(corner.as_vec2());
        bounds.max = bounds.max.max(end.as_vec2());
    }
    bounds
}

impl<'a> Scene<'a> {
    /// A ground relative to the eye of a view. `placed`: memory for its tiles.
    pub(crate) fn new(ground: &'a Ground, view: View, placed: &'a mut Vec<Placed>, has_undersides: bool) -> Self {
        let bounds = place(ground, &view, placed);
        let eye_height = ground.shape().surface.height_above(view.eye_in_world(), ground.datum_m()) as f32;
        // The farthest ground is at most as far as the farthest corner of its bounds, at the lowest
        // or highest height.
        let [lowest, highest] = ground.range_m().map(|height| (height - eye_height).abs());
        let far = bounds.min.abs().max(bounds.max.abs()).length().hypot(lowest.max(highest));
        let has_ground = ground.tile_count() > 0 && far.is_finite();
        let mut scene = Self {
            ground,
            heights: ground.all_heights(),
            distances: LevelDistances::new(&ground.shape().surface, view.focal_px(), 1.0),
            placed,
            bounds,
            view,
            eye_height,
            highest: if has_ground { ground.top_m() - eye_height } else { f32::NEG_INFINITY },
            far: if has_ground { far } else { 0.0 },
            has_undersides,
        };
        scene.has_undersides |= scene.is_eye_beside_world();
        scene
    }

    /// The same ground, its heights in place in the elevation pool, of which these are all numbers:
    /// posts are at most `post_px` pixels apart.
    pub(crate) fn in_place(self, heights: &'a [f32], post_px: f32) -> Self {
        let Some(pyramid) = self.ground.pyramid() else { return self };
        let surface = &self.ground.shape().surface;
        let distances = LevelDistances::new(surface, self.view.focal_px(), post_px);
        let eye = self.view.eye_in_world();
        let [_, most_rise2] = self.rises2();
        let farthest2 = |corner: [u32; 2], side: u64| {
            let low = DVec2::from_array(corner.map(f64::from));
            let [low, high] = [low, low + side as f64].map(|corner| surface.lattice_from_eye(corner, eye).as_vec2());
            low.abs().max(high.abs()).length_squared() + most_rise2
        };
        let highest =
            if self.far > 0.0 { pyramid.highest(&distances, farthest2) - self.eye_height } else { self.highest };
        Self { heights, distances, highest, ..self }
    }

    /// Squares of how far the ground is above or below the eye, at least and at most.
    fn rises2(&self) -> [f32; 2] {
        let [lowest, highest] = self.ground.range_m().map(|height| height - self.eye_height);
        let least = lowest.max(-highest).max(0.0);
        [least * least, lowest.abs().max(highest.abs()).powi(2)]
    }

    /// The elevation pool's tiles, where heights lie in them, and from where on each level of theirs
    /// is fine enough.
    pub(crate) fn pyramid(&self) -> Option<(&'a Pyramid, &LevelDistances)> {
        Some((self.ground.pyramid()?, &self.distances))
    }

    /// Where the ground of a point, metres from the eye, is taken from in the elevation pool, whose
    /// distance from the eye has this square. A point outside is moved to the border.
    pub(crate) fn source_at(&self, point: Vec2, away2: f32) -> Option<Source> {
        Some(self.ground.pyramid()?.find(self.lattice_point(point), away2, &self.distances))
    }

    /// Whether ground that is read in place may be a hole, or may have been filled.
    pub(crate) fn has_holes_in_place(&self) -> bool {
        self.ground.pyramid().is_some() && self.ground.is_partly_unmeasured()
    }

    /// The square of `1 << log` lattice units at a lattice point.
    pub(crate) fn square(&self, corner: [u32; 2], log: u32) -> Bounds {
        let surface = &self.ground.shape().surface;
        let corner = DVec2::from_array(corner.map(f64::from));
        let [min, max] = [corner, corner + (1u64 << log) as f64]
            .map(|corner| surface.lattice_from_eye(corner, self.view.eye_in_world()).as_vec2());
        Bounds { min, max }
    }

    /// Metres up per metre east and north on the facet of a tile at a point, metres from the eye.
    pub(crate) fn slope_at(&self, tile: u32, point: Vec2) -> Vec2 {
        let (placed, tile) = (&self.placed[tile as usize], &self.ground.tiles()[tile as usize]);
        let (corners, by, per_m) = if let Some(pyramid) = self.ground.pyramid() {
            let found = pyramid.corners_at(self.lattice_point(point), self.heights);
            let Some((corners, by, level)) = found else { return Vec2::ZERO };
            (corners, by, 1.0 / self.ground.shape().surface.spacing_m(level) as f32)
        } else {
            let at = (point - placed.corner.truncate()) * placed.per_m;
            let [i, j] = [0, 1].map(|axis| (at[axis].max(0.0) as u32).min(tile.cells[axis] - 1) as usize);
            let (stride, heights) = (tile.posts()[0], self.ground.heights(tile));
            let south = j * stride + i;
            let corners = [south, south + 1, south + stride, south + stride + 1].map(|post| heights[post]);
            (corners, [at.x - i as f32, at.y - j as f32], placed.per_m)
        };
        let is_north_west = by[0] < by[1];
        Facet::of_cell(Vec2::ZERO, corners)[usize::from(is_north_west)].slope * per_m
    }

    /// Whether the eye is beside the world, not over it.
    fn is_eye_beside_world(&self) -> bool {
        !self.ground.shape().surface.is_over(self.view.eye_in_world())
    }

    /// Whether the eye is beside the tiles that are drawn.
    pub(crate) fn is_eye_beside_tiles(&self) -> bool {
        let (min, max) = (self.bounds.min, self.bounds.max);
        min.x > 0.0 || min.y > 0.0 || max.x < 0.0 || max.y < 0.0
    }

    /// What is at parameter `s` of a ray.
    #[inline]
    pub(crate) fn find(&self, ray: &Ray, s: f32) -> Place {
        let at = (ray.direction * s).truncate();
        let direction = ray.direction.truncate();
        let (min, max) = (self.bounds.min, self.bounds.max);
        let is_past = |at: f32, direction: f32, min: f32, max: f32| {
            (at < min && direction <= 0.0) || (at > max && direction >= 0.0)
        };
        if is_past(at.x, direction.x, min.x, max.x) || is_past(at.y, direction.y, min.y, max.y) {
            return Place::Left;
        }
        let surface = &self.ground.shape().surface;
        let inside = at.clamp(min, max);
        if (inside - at).abs().max_element() > NEAR_BOUNDS * surface.unit_m() as f32 {
            return Place::HoleUntil(s);
        }
        let from_eye = |lattice: DVec2| surface.lattice_from_eye(lattice, self.view.eye_in_world()).as_vec2();
        let point = self.lattice_point(inside);
        match self.ground.tree().find(point) {
            Found::Tile(tile) if self.ground.tiles()[tile as usize].holds(point) => Place::Tile(tile),
            Found::Hole(corner, log) => {
                let corner = DVec2::from_array(corner.map(f64::from));
                let [low, high] = [corner, corner + (1u64 << log) as f64].map(from_eye);
                Place::HoleUntil(exit(direction, low, high).max(s))
            }
            Found::Tile(_) | Found::Outside => Place::HoleUntil(s),
        }
    }

    /// The tile at a point of the ground, metres from the eye; a point outside is moved to the
    /// border.
    pub(crate) fn tile_at_point(&self, point: Vec2) -> Option<u32> {
        match self.ground.tree().find(self.lattice_point(point)) {
            Found::Tile(tile) => Some(tile),
            Found::Hole(..) | Found::Outside => None,
        }
    }

    /// The tile at a point of the ground, metres from the eye, or the rectangle around it that has
    /// none. A point outside is taken to the border.
    pub(crate) fn tile_or_hole_at(&self, point: Vec2) -> Result<u32, Bounds> {
        let at = self.lattice_point(point);
        match self.ground.tree().find(at) {
            Found::Tile(tile) if self.ground.tiles()[tile as usize].holds(at) => Ok(tile),
            Found::Hole(corner, log) => Err(self.square(corner, log)),
            Found::Tile(_) | Found::Outside => Err(Bounds { min: point, max: point + 1.0 }),
        }
    }

    /// Whether ground of a rectangle, between these distances along the ground, may rise above this
    /// height, metres above the eye.
    pub(crate) fn rises_above(&self, rise: f32, within: Bounds, along: [f32; 2]) -> bool {
        let surface = &self.ground.shape().surface;
        let [low, high] = [within.min, within.max]
            .map(|corner| surface.lattice_of_way(corner.as_dvec2(), self.view.eye_in_world()).to_array());
        let height = rise + self.eye_height;
        if let Some((pyramid, distances)) = self.pyramid() {
            let rises2 = self.rises2();
            let away2 = [0, 1].map(|n| along[n] * along[n] + rises2[n]);
            pyramid.rises_above(height, [low, high], away2, distances)
        } else {
            self.ground.highest_in(low, high) > height
        }
    }

    /// Converts a point from metres from the eye to lattice units, clamped to the ground's end.
    #[inline]
    fn lattice_point(&self, point: Vec2) -> [f64; 2] {
        // Rounding may move a point on the outer border out of the bounds.
        let end = self.ground.end().map(|end| f64::from(end) - JUST_INSIDE);
        let at = self.ground.shape().surface.lattice_of_way(point.as_dvec2(), self.view.eye_in_world());
        [0, 1].map(|axis| at[axis].clamp(0.0, end[axis]))
    }

    /// Where a way from the eye's foot comes over the ground's bounds, and where it leaves them,
    /// metres: a direction of length 1. Where it misses them the end is not behind the beginning.
    pub(crate) fn ground_along(&self, direction: Vec2) -> [f32; 2] {
        let (mut begin, mut end) = (0.0f32, f32::INFINITY);
        for axis in 0..2 {
            let (direction, min, max) = (direction[axis], self.bounds.min[axis], self.bounds.max[axis]);
            let [near, far] = match direction {
                d if d > 0.0 => [min / d, max / d],
                d if d < 0.0 => [max / d, min / d],
                _ if min <= 0.0 && max >= 0.0 => [0.0, f32::INFINITY],
                _ => [f32::INFINITY, 0.0],
            };
            begin = begin.max(near);
            end = end.min(far);
        }
        if end.is_finite() { [begin, end] } else { [0.0, 0.0] }
    }

    /// The parameter at which a ray enters the ground's bounds.
    #[inline]
    pub(crate) fn entry(&self, ray: &Ray) -> f32 {
        let mut entry = 0.0f32;
        for axis in 0..2 {
            let (direction, min, max) = (ray.direction[axis], self.bounds.min[axis], self.bounds.max[axis]);
            if min > 0.0 && direction > 0.0 {
                entry = entry.max(min / direction);
            } else if max < 0.0 && direction < 0.0 {
                entry = entry.max(max / direction);
            }
        }
        entry
    }

    /// The parameter at which a ray leaves the ground's bounds; 0 when it never enters them.
    #[inline]
    pub(crate) fn departure(&self, ray: &Ray) -> f32 {
        exit(ray.direction.truncate(), self.bounds.min, self.bounds.max).max(0.0)
    }

    /// A parameter at which all rays between two have left the ground's bounds.
    #[inline]
    pub(crate) fn last_departure(&self, rays: [&Ray; 2]) -> f32 {
        let of = |axis: usize| {
            let exits = rays.map(|ray| match ray.direction[axis] {
                d if d > 0.0 => [self.bounds.max[axis] / d, 1.0],
                d if d < 0.0 => [self.bounds.min[axis] / d, -1.0],
                _ => [f32::INFINITY, 0.0],
            });
            // Between a ray to the east and one to the west there is a ray that goes neither way.
            if exits[0][1] == exits[1][1] { exits[0][0].max(exits[1][0]) } else { f32::INFINITY }
        };
        of(0).min(of(1))
    }
}

/// Parameter at which a ray from the origin leaves a rectangle that it is in.
#[inline(always)]
pub(crate) fn exit(direction: Vec2, low: Vec2, high: Vec2) -> f32 {
    let of = |direction: f32, low: f32, high: f32| match direction {
        d if d > 0.0 => high / d,
        d if d < 0.0 => low / d,
        _ => f32::INFINITY,
    };
    of(direction.x, low.x, high.x).min(of(direction.y, low.y, high.y))
}
