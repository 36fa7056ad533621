//! Colors of pixels that lie over one tile, out of its layer of the pool, in place.

use super::lanes::{Floats, LANES, index, larger, smaller};
use crate::model::color::ColorLayout;
use crate::shade::{Canvas, OPAQUE_BLACK};
use glam::Vec2;

/// Mips that are used of a layer: those of layers as wide as fixed point reaches.
const MOST_MIPS: usize = 16;
/// Two channels of a texel.
const TWO: u32 = 0x00ff_00ff;
/// Taps are at most so many texels from the middle.
const FURTHEST_TAP: f32 = 4.0;

/// What pixels want of a tile.
pub(super) struct Wanted {
    /// Metres that a texel may be wide.
    pub(super) size: Floats,
    /// From a pixel's middle to its second tap, metres east and north; the first one is on the other side.
    pub(super) reach: [Floats; 2],
}

/// A tile's colors, as pixels use them.
#[derive(Debug)]
pub(super) struct TilePaint<'a> {
    layer: &'a [u8],
    /// First texel, texels along a side, and the last place between four texels, of each mip.
    starts: [u32; MOST_MIPS],
    sides: [u32; MOST_MIPS],
    ends: Floats,
    coarsest: i32,
    /// North west corner of the layer, metres from the eye.
    corner: Vec2,
    per_m: f32,
    /// The tile's rectangle, metres from the eye.
    min: Vec2,
    max: Vec2,
}

impl<'a> TilePaint<'a> {
    /// The colors of a tile.
    pub(super) fn new(canvas: &Canvas<'a>, index: u32, layout: ColorLayout) -> Self {
        let scene = canvas.scene;
        let (placed, tile) = (&scene.placed[index as usize], &scene.ground.tiles()[index as usize]);
        // A mip of one texel has no four to be between.
        let coarsest = (layout.mips.min(layout.side.max(2).ilog2()) - 1).min(MOST_MIPS as u32 - 1);
        let (mut starts, mut sides, mut ends) = ([0; MOST_MIPS], [0; MOST_MIPS], [0.0; MOST_MIPS]);
        let (mut start, mut side) = (0, layout.side);
        for level in 0..=coarsest as usize {
            starts[level] = start;
            sides[level] = side;
            // Fixed point ends at 16384.
            ends[level] = (side.min(16384) - 1) as f32 - 1.0 / 256.0;
            start += side * side;
            side >>= 1;
        }
        let min = placed.corner.truncate();
        Self {
            layer: canvas.layer(tile),
            starts,
            sides,
            ends,
            coarsest: coarsest as i32,
            corner: placed.color_corner,
            per_m: placed.texels_per_m,
            min,
            max: min + Vec2::new(tile.cells[0] as f32, tile.cells[1] as f32) * tile.spacing_m,
        }
    }

    /// Whether a point, metres from the eye, lies over the tile.
    #[inline(always)]
    pub(super) fn holds(&self, point: Vec2) -> bool {
        (point.x >= self.min.x) & (point.x <= self.max.x) & (point.y >= self.min.y) & (point.y <= self.max.y)
    }

    /// Colors at points, metres from the eye.
    #[inline(always)]
    pub(super) fn colors(&self, east: &Floats, north: &Floats, wanted: &Wanted, has_two_taps: bool) -> [u32; LANES] {
        let (mut level, mut scale) = ([0; LANES], [0.0; LANES]);
        let (mut u, mut v) = ([0.0; LANES], [0.0; LANES]);
        for k in 0..LANES {
            // log2, rounded.
            let texels = larger(wanted.size[k] * self.per_m, 1.0) * std::f32::consts::SQRT_2;
            let rounded = (texels.to_bits() >> 23) as i32 - 127;
            let rounded = if rounded < self.coarsest { rounded } else { self.coarsest };
            level[k] = rounded as u32;
            scale[k] = self.per_m * f32::from_bits(((127 - rounded) << 23) as u32);
            u[k] = (east[k] - self.corner.x) * scale[k] - 0.5;
            v[k] = (self.corner.y - north[k]) * scale[k] - 0.5;
        }
        if !has_two_taps {
            return self.tap(&u, &v, &level);
        }
        let taps = [1.0, -1.0].map(|sign: f32| {
            let (mut x, mut y) = ([0.0; LANES], [0.0; LANES]);
            for k in 0..LANES {
                let within = |by: f32| smaller(larger(by * sign, -FURTHEST_TAP), FURTHEST_TAP);
                x[k] = u[k] + within(wanted.reach[0][k] * scale[k]);
                y[k] = v[k] - within(wanted.reach[1][k] * scale[k]);
            }
            self.tap(&x, &y, &level)
        });
        let mut mean = [0; LANES];
        for k in 0..LANES {
            let (a, b) = (taps[0][k], taps[1][k]);
            mean[k] = (a & b) + (((a ^ b) >> 1) & 0x7f7f_7f7f);
        }
        mean
    }

    /// Colors between four texels of mips.
    #[inline(always)]
    fn tap(&self, u: &Floats, v: &Floats, level: &[u32; LANES]) -> [u32; LANES] {
        let (mut shares, mut at, mut side) = ([[0; LANES]; 2], [0; LANES], [0; LANES]);
        let (mut end, mut start) = ([0.0; LANES], [0; LANES]);
        for k in 0..LANES {
            let level = level[k] as usize % MOST_MIPS;
            end[k] = self.ends[level];
            start[k] = self.starts[level];
            side[k] = self.sides[level];
        }
        for k in 0..LANES {
            // Columns and rows in 256ths.
            let [i, j] = [u[k], v[k]].map(|at| index(smaller(larger(at, 0.0), end[k]) * 256.0));
            shares[0][k] = i & 0xff;
            shares[1][k] = j & 0xff;
            at[k] = 4 * (start[k] + (j >> 8) * side[k] + (i >> 8));
        }
        let mut texels = [[0; LANES]; 4];
        for k in 0..LANES {
            let upper = at[k] as usize;
            let lower = upper + 4 * side[k] as usize;
            let pair = |at: usize| match self.layer.get(at..at + 8) {
                Some(&[a, b, c, d, e, f, g, h]) => [u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h])],
                _ => [0; 2],
            };
            let ([nw, ne], [sw, se]) = (pair(upper), pair(lower));
            [texels[0][k], texels[1][k], texels[2][k], texels[3][k]] = [nw, ne, sw, se];
        }
        let mut colors = [0; LANES];
        for k in 0..LANES {
            let [nw, ne, sw, se] = [texels[0][k], texels[1][k], texels[2][k], texels[3][k]];
            let (east, south) = (shares[0][k], shares[1][k]);
            let (west, north) = (256 - east, 256 - south);
            let along = |a: u32, b: u32| (((a & TWO) * west + (b & TWO) * east) >> 8) & TWO;
            let (upper, lower) = (along(nw, ne), along(sw, se));
            let (upper_green, lower_green) = (along(nw >> 8, ne >> 8), along(sw >> 8, se >> 8));
            let red_blue = ((upper * north + lower * south) >> 8) & TWO;
            let green = (upper_green * north + lower_green * south) & !TWO;
            colors[k] = red_blue | green | OPAQUE_BLACK;
        }
        colors
    }
}
