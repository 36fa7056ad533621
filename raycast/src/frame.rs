//! One frame's ground as seen from its eye: what all rays of the frame share.

use crate::exact::projected::Projected;
use crate::model::color::Mip;
use crate::model::{Found, Ground, Tile};
use crate::picture::Picture;
use crate::view::{Planes, Ray, View};
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

/// What a frame is drawn with.
#[derive(Debug)]
pub(crate) struct Frame<'a> {
    pub(crate) ground: &'a Ground,
    pub(crate) placed: &'a [Placed],
    /// Of exact rays that follow the ground; else empty.
    pub(crate) projected: &'a Projected,
    pub(crate) bounds: Bounds,
    pub(crate) view: View,
    pub(crate) planes: &'a Planes,
    /// Layers of colour.
    pub(crate) colors: &'a [&'a [u8]],
    pub(crate) picture: &'a Picture,
    pub(crate) sky: u32,
    /// Highest ground, metres from the eye.
    pub(crate) highest: f32,
    /// The ground's datum, metres above the eye.
    pub(crate) datum: f32,
    /// How fast densities fall along a ray that comes out of the ground, per voxel, as far as it is looked for.
    pub(crate) fall: f32,
    /// Whether facets are seen from below: an eye beside the world may look under its edge.
    pub(crate) has_undersides: bool,
}

/// Whether an eye is beside the world, not over it.
pub(crate) fn is_beside_world(ground: &Ground, view: &View) -> bool {
    let (eye, unit) = (view.eye_in_world(), ground.shape().lattice_unit_m);
    (0..2).any(|axis| !(0.0..=f64::from(ground.shape().extent[axis]) * unit).contains(&eye[axis]))
}

/// Places all tiles; returns their bounds.
pub(crate) fn place(ground: &Ground, view: &View, placed: &mut Vec<Placed>) -> Bounds {
    let eye = view.eye_in_world();
    let unit = ground.shape().lattice_unit_m;
    placed.clear();
    let mut bounds = Bounds { min: Vec2::INFINITY, max: Vec2::NEG_INFINITY };
    for tile in ground.tiles() {
        let corner = DVec2::new(f64::from(tile.origin[0]), f64::from(tile.origin[1])) * unit - eye.truncate();
        let spacing = f64::from(1u32 << tile.log_spacing) * unit;
        let height = f64::from(tile.lowest_layer) * spacing - eye.z;
        placed.push(Placed {
            corner: corner.extend(height).as_vec3(),
            per_m: (1.0 / spacing) as f32,
            color_corner: (tile.color.north_west_in_world - eye.truncate()).as_vec2(),
            texels_per_m: (1.0 / tile.color.texel_m) as f32,
        });
        let end = corner + DVec2::new(f64::from(tile.cells[0]), f64::from(tile.cells[1])) * spacing;
        let extent = DVec2::new(f64::from(ground.shape().extent[0]), f64::from(ground.shape().extent[1]));
        let end = end.min(extent * unit - eye.truncate());
        bounds.min = bounds.min.min(corner.as_vec2());
        bounds.max = bounds.max.max(end.as_vec2());
    }
    bounds
}

/// Where a point without a tile leads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Place {
    Tile(u32),
    /// Nothing here before this parameter of the ray.
    HoleUntil(f32),
    /// Nothing here or further on.
    Left,
}

impl Frame<'_> {
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
        let unit = self.ground.shape().lattice_unit_m;
        let inside = at.clamp(min, max);
        if (inside - at).abs().max_element() > 0.01 * unit as f32 {
            return Place::HoleUntil(s);
        }
        let eye = self.view.eye_in_world().truncate();
        // Rounding takes a sample on the outer border out of it.
        let end = self.ground.end().map(|end| f64::from(end) - 1e-3);
        let from_eye = |lattice: u64, axis: usize| (lattice as f64 * unit - eye[axis]) as f32;
        let inside = inside.as_dvec2();
        let point = [0, 1].map(|axis| ((inside[axis] + eye[axis]) / unit).clamp(0.0, end[axis]));
        match self.ground.tree().find(point) {
            Found::Tile(tile) if self.ground.tiles()[tile as usize].holds(point) => Place::Tile(tile),
            Found::Hole(corner, log) => {
                let low = [0, 1].map(|axis| from_eye(u64::from(corner[axis]), axis));
                let high = [0, 1].map(|axis| from_eye(u64::from(corner[axis]) + (1 << log), axis));
                Place::HoleUntil(exit(direction, Vec2::from_array(low), Vec2::from_array(high)).max(s))
            }
            Found::Tile(_) | Found::Outside => Place::HoleUntil(s),
        }
    }

    /// The parameter at which a ray comes over the ground's bounds.
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

    /// The parameter at which a ray leaves the ground's bounds, 0 when it never comes over them.
    #[inline]
    pub(crate) fn departure(&self, ray: &Ray) -> f32 {
        exit(ray.direction.truncate(), self.bounds.min, self.bounds.max).max(0.0)
    }

    /// A parameter at which no ray between two is over the ground's bounds any more.
    #[inline]
    pub(crate) fn last_exit(&self, rays: [&Ray; 2]) -> f32 {
        let of = |axis: usize| {
            let exits = rays.map(|ray| match ray.direction[axis] {
                d if d > 0.0 => [self.bounds.max[axis] / d, 1.0],
                d if d < 0.0 => [self.bounds.min[axis] / d, -1.0],
                _ => [f32::INFINITY, 0.0],
            });
            // Between east and west there is a ray that goes neither way.
            if exits[0][1] == exits[1][1] { exits[0][0].max(exits[1][0]) } else { f32::INFINITY }
        };
        of(0).min(of(1))
    }

    /// Colour of a tile at parameter `s` of a ray.
    #[inline(always)]
    pub(crate) fn shade(&self, tile: u32, ray: &Ray, s: f32) -> u32 {
        let (placed, tile) = (&self.placed[tile as usize], &self.ground.tiles()[tile as usize]);
        let layout = self.ground.shape().color;
        let footprint_m = s * ray.depth / self.view.focal_px();
        let level = log2_rounded(footprint_m * placed.texels_per_m).min(layout.mips - 1);
        let at = self.texel(placed, ray.direction.truncate() * s);
        let layer = self.layer(tile);
        let scale = 1.0 / (1u32 << level) as f32;
        Mip::new(layer, layout, level).map_or(OPAQUE_BLACK, |mip| mip.bilinear(at * scale) | OPAQUE_BLACK)
    }

    /// The colours of a tile; none where there are none.
    #[inline(always)]
    pub(crate) fn layer(&self, tile: &Tile) -> &[u8] {
        self.colors.get(tile.color.layer as usize).copied().unwrap_or_default()
    }

    /// Place of a point in a tile's finest colours, texels from their north west corner.
    #[inline(always)]
    pub(crate) fn texel(&self, placed: &Placed, point: Vec2) -> Vec2 {
        let from_corner = (point - placed.color_corner) * placed.texels_per_m;
        Vec2::new(from_corner.x, -from_corner.y)
    }
}

const OPAQUE_BLACK: u32 = 0xff00_0000;

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

/// log2 of a number, rounded to a whole one; 0 for less than 1.
#[inline(always)]
pub(crate) fn log2_rounded(x: f32) -> u32 {
    let scaled = (x * std::f32::consts::SQRT_2).max(1.0);
    (scaled.to_bits() >> 23) - 127
}

impl Tile {
    /// Whether a point, lattice units, lies over its cells.
    #[inline]
    pub(crate) fn holds(&self, point: [f64; 2]) -> bool {
        (0..2).all(|axis| {
            let end = u64::from(self.origin[axis]) + (u64::from(self.cells[axis]) << self.log_spacing);
            point[axis] <= end as f64
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithms_round_to_the_nearest_level() {
        let found = [0.0, 0.3, 1.0, 1.41, 1.42, 2.0, 2.82, 2.84, 64.0].map(log2_rounded);
        assert_eq!(found, [0, 0, 0, 0, 1, 1, 1, 2, 6]);
    }
}
