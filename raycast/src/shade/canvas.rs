//! The target of a frame, and the colours of the ground.

use super::mip::Mip;
use crate::model::Tile;
use crate::picture::Picture;
use crate::scene::{Placed, Scene};
use crate::view::Ray;
use glam::Vec2;

pub(crate) const OPAQUE_BLACK: u32 = 0xff00_0000;

/// A picture, and the colours of its ground.
#[derive(Debug)]
pub(crate) struct Canvas<'a> {
    pub(crate) scene: &'a Scene<'a>,
    /// Layers of colour.
    pub(crate) colors: &'a [&'a [u8]],
    pub(crate) picture: &'a Picture,
    pub(crate) sky: u32,
}

impl<'a> Canvas<'a> {
    /// Writes a pixel whose ray hits no ground.
    #[inline(always)]
    pub(crate) fn put_sky(&self, pixel: [u32; 2]) {
        self.picture.put(pixel, self.sky, f32::NAN);
    }

    /// Writes a pixel whose ray hits the ground of a tile at parameter `s`.
    #[inline(always)]
    pub(crate) fn put_ground(&self, pixel: [u32; 2], tile: u32, ray: &Ray, s: f32) {
        self.picture.put(pixel, self.shade(tile, ray, s), s * ray.depth);
    }

    /// Colour of a tile at parameter `s` of a ray: the mip whose texels are about as wide as the
    /// pixel, as if the ground faced the eye.
    #[inline(always)]
    pub(crate) fn shade(&self, tile: u32, ray: &Ray, s: f32) -> u32 {
        let scene = self.scene;
        let (placed, tile) = (&scene.placed[tile as usize], &scene.ground.tiles()[tile as usize]);
        let layout = scene.ground.shape().color;
        let footprint_m = s * ray.depth / scene.view.focal_px();
        let level = log2_rounded(footprint_m * placed.texels_per_m).min(layout.mips - 1);
        let at = texel(placed, ray.direction.truncate() * s);
        let layer = self.layer(tile);
        let scale = 1.0 / (1u32 << level) as f32;
        Mip::new(layer, layout, level).map_or(OPAQUE_BLACK, |mip| mip.bilinear(at * scale) | OPAQUE_BLACK)
    }

    /// The colours of a tile; empty if its layer is missing.
    #[inline(always)]
    pub(crate) fn layer(&self, tile: &Tile) -> &'a [u8] {
        self.colors.get(tile.color.layer as usize).copied().unwrap_or_default()
    }
}

/// Position of a point in a tile's finest colours, texels from their north west corner.
#[inline(always)]
fn texel(placed: &Placed, point: Vec2) -> Vec2 {
    let from_corner = (point - placed.color_corner) * placed.texels_per_m;
    Vec2::new(from_corner.x, -from_corner.y)
}

/// log2 of a number, rounded to a whole one; 0 for less than 1.
#[inline(always)]
fn log2_rounded(x: f32) -> u32 {
    let scaled = (x * std::f32::consts::SQRT_2).max(1.0);
    (scaled.to_bits() >> 23) - 127
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
