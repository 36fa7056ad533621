//! Colors of pixels that lie over one tile, out of its layer of the pool, in place.
//!
//! Whole numbers wrap around in kernels: a check for each would keep compilers from making vectors
//! of them.

use super::lanes::{index, larger, smaller};
use crate::model::color::ColorLayout;
use crate::shade::{Canvas, OPAQUE_BLACK};
use glam::Vec2;

/// Two channels of a texel.
const TWO: u32 = 0x00ff_00ff;
/// Taps are at most this many texels from the middle.
const FURTHEST_TAP: f32 = 4.0;

/// Pixels that are shaded together.
pub(super) const WIDE: usize = 64;
/// What a number that three divides is multiplied with to divide it by three, of 32 bits.
const THIRD: u32 = 0xaaaa_aaab;

/// Pixels beside each other: of each its place, metres from the eye, how wide its texels may be,
/// metres, and from its middle to its second tap, metres east and north; the first one is on the
/// other side.
pub(super) struct Slices<'a> {
    pub(super) east: &'a [f32],
    pub(super) north: &'a [f32],
    pub(super) size: &'a [f32],
    pub(super) reach_east: &'a [f32],
    pub(super) reach_north: &'a [f32],
}

/// A tile's colors, as pixels use them.
#[derive(Debug)]
pub(super) struct TilePaint<'a> {
    layer: &'a [u8],
    /// Texels along a side of the finest mip, and all of it.
    side: u32,
    texels: u32,
    /// The coarsest mip that is used.
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
        // A mip of one texel has no four to be between, and sides that are odd are not halved
        // exactly.
        let coarsest = (layout.mips.min(layout.side.max(2).ilog2()) - 1).min(layout.side.trailing_zeros());
        let min = placed.corner.truncate();
        Self {
            layer: canvas.layer(tile),
            side: layout.side,
            texels: layout.side.wrapping_mul(layout.side),
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

    /// Colors of pixels beside each other, as many as `out` has.
    #[inline(always)]
    pub(super) fn paint(&self, pixels: &Slices<'_>, has_two_taps: bool, out: &mut [u32]) {
        let count = out.len();
        let (mut level, mut scale) = ([0; WIDE], [0.0; WIDE]);
        let (mut u, mut v) = ([0.0; WIDE], [0.0; WIDE]);
        {
            let (level, scale, u, v) = (&mut level[..count], &mut scale[..count], &mut u[..count], &mut v[..count]);
            let (east, north, size) = (&pixels.east[..count], &pixels.north[..count], &pixels.size[..count]);
            for k in 0..count {
                // log2, rounded.
                let texels = larger(size[k] * self.per_m, 1.0) * std::f32::consts::SQRT_2;
                let rounded = ((texels.to_bits() >> 23) as i32).wrapping_sub(127);
                let rounded = if rounded < self.coarsest { rounded } else { self.coarsest };
                level[k] = rounded as u32;
                scale[k] = self.per_m * f32::from_bits((127i32.wrapping_sub(rounded) << 23) as u32);
                u[k] = (east[k] - self.corner.x) * scale[k] - 0.5;
                v[k] = (self.corner.y - north[k]) * scale[k] - 0.5;
            }
        }
        if !has_two_taps {
            return self.tap(&u[..count], &v[..count], &level[..count], out);
        }
        let (mut x, mut y) = ([0.0; WIDE], [0.0; WIDE]);
        let mut other = [0; WIDE];
        for (sign, is_first) in [(1.0f32, true), (-1.0, false)] {
            let (x, y, u, v) = (&mut x[..count], &mut y[..count], &u[..count], &v[..count]);
            let (east, north, scale) = (&pixels.reach_east[..count], &pixels.reach_north[..count], &scale[..count]);
            for k in 0..count {
                let within = |by: f32| smaller(larger(by * sign, -FURTHEST_TAP), FURTHEST_TAP);
                x[k] = u[k] + within(east[k] * scale[k]);
                y[k] = v[k] - within(north[k] * scale[k]);
            }
            let into = if is_first { &mut other[..count] } else { &mut *out };
            self.tap(x, y, &level[..count], into);
        }
        for (out, other) in out.iter_mut().zip(&other) {
            *out = (*out & other).wrapping_add(((*out ^ other) >> 1) & 0x7f7f_7f7f);
        }
    }

    /// Colors between four texels of mips.
    #[inline(always)]
    fn tap(&self, u: &[f32], v: &[f32], level: &[u32], out: &mut [u32]) {
        let count = out.len();
        let (mut east, mut south) = ([0; WIDE], [0; WIDE]);
        let (mut at, mut stride) = ([0; WIDE], [0; WIDE]);
        {
            let (u, v, level) = (&u[..count], &v[..count], &level[..count]);
            let (east, south) = (&mut east[..count], &mut south[..count]);
            let (at, stride) = (&mut at[..count], &mut stride[..count]);
            for k in 0..count {
                let side = self.side.wrapping_shr(level[k]);
                // Sides are halved exactly: texels of the finer mips are a geometric series.
                let before = self.texels.wrapping_sub(side.wrapping_mul(side)).wrapping_mul(4).wrapping_mul(THIRD);
                let end = side as i32 as f32 - (1.0 + 1.0 / 256.0);
                // Columns and rows in 256ths.
                let i = index(smaller(larger(u[k], 0.0), end) * 256.0);
                let j = index(smaller(larger(v[k], 0.0), end) * 256.0);
                east[k] = i & 0xff;
                south[k] = j & 0xff;
                at[k] = before.wrapping_add((j >> 8).wrapping_mul(side)).wrapping_add(i >> 8) << 2;
                stride[k] = side << 2;
            }
        }
        let mut texels = [[0; WIDE]; 4];
        for k in 0..count {
            let upper = at[k] as usize;
            let lower = upper + stride[k] as usize;
            let pair = |at: usize| match self.layer.get(at..at + 8) {
                Some(&[a, b, c, d, e, f, g, h]) => [u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h])],
                _ => [0; 2],
            };
            let ([nw, ne], [sw, se]) = (pair(upper), pair(lower));
            [texels[0][k], texels[1][k], texels[2][k], texels[3][k]] = [nw, ne, sw, se];
        }
        let [nw, ne, sw, se] = texels.each_ref().map(|texels| &texels[..count]);
        let (east, south) = (&east[..count], &south[..count]);
        for k in 0..count {
            let (east, south) = (east[k], south[k]);
            let (west, north) = (256u32.wrapping_sub(east), 256u32.wrapping_sub(south));
            let mix =
                |a: u32, b: u32, [first, second]: [u32; 2]| a.wrapping_mul(first).wrapping_add(b.wrapping_mul(second));
            let along = |a: u32, b: u32| (mix(a & TWO, b & TWO, [west, east]) >> 8) & TWO;
            let (upper, lower) = (along(nw[k], ne[k]), along(sw[k], se[k]));
            let (upper_green, lower_green) = (along(nw[k] >> 8, ne[k] >> 8), along(sw[k] >> 8, se[k] >> 8));
            let red_blue = (mix(upper, lower, [north, south]) >> 8) & TWO;
            let green = mix(upper_green, lower_green, [north, south]) & !TWO;
            out[k] = red_blue | green | OPAQUE_BLACK;
        }
    }
}
