//! Colors of pixels that lie over one tile, out of its layer of the pool, in place.

use crate::model::color::ColorLayout;
use crate::shade::{Canvas, OPAQUE_BLACK};
use glam::Vec2;
use terravision_common::simd::{LANES, Simd, Sixteen, prefetch};

/// Two channels of a texel.
const TWO: u32 = 0x00ff_00ff;
/// Taps are at most this many texels from the middle.
const FURTHEST_TAP: f32 = 4.0;
/// Texels are prefetched for one of this number of pixels: neighbors mostly share its lines of
/// memory.
const PREFETCHED: usize = 2;
/// What a number that three divides is multiplied with to divide it by three, of 32 bits.
const THIRD: u32 = 0xaaaa_aaab;

/// Pixels beside each other: of each its place, metres from the eye, the square of how wide its
/// texels may be, metres, and from its middle to its second tap, metres east and north; the first
/// one is on the other side.
pub(super) struct Points<S: Simd> {
    pub(super) east: S::Floats,
    pub(super) north: S::Floats,
    pub(super) squared_m: S::Floats,
    pub(super) reach_east: S::Floats,
    pub(super) reach_north: S::Floats,
}

impl<S: Simd> Points<S> {
    /// The place of one.
    #[inline(always)]
    pub(super) fn point(&self, simd: S, lane: usize) -> Vec2 {
        let (mut east, mut north) = ([0.0; LANES], [0.0; LANES]);
        simd.store(self.east, &mut east);
        simd.store(self.north, &mut north);
        Vec2::new(east[lane % LANES], north[lane % LANES])
    }
}

/// A tile's colors, as pixels use them.
#[derive(Debug, Clone, Copy)]
pub(super) struct TilePaint<'a> {
    layer: &'a [u8],
    /// Texels along a side of the finest mip, and all of it.
    side: u32,
    texels: u32,
    /// The coarsest mip that is used.
    coarsest: u32,
    /// North west corner of the layer, metres from the eye.
    corner: Vec2,
    per_m: f32,
    /// The tile's rectangle, metres from the eye.
    min: Vec2,
    max: Vec2,
}

/// Texels of a mip for each pixel.
struct Mip<S: Simd> {
    /// Texels along a side, and those of all finer mips.
    side: S::Words,
    before: S::Words,
    /// The last place between texels.
    end: S::Floats,
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
            coarsest,
            corner: placed.color_corner,
            per_m: placed.texels_per_m,
            min,
            max: min + Vec2::new(tile.cells[0] as f32, tile.cells[1] as f32) * tile.spacing_m,
        }
    }

    /// Which pixels lie over the tile: a bit of each.
    #[inline(always)]
    pub(super) fn holds<S: Simd>(&self, simd: S, points: &Points<S>) -> u32 {
        let (east, north) = (points.east, points.north);
        let above = simd.at_most(simd.floats(self.min.x), east) & simd.at_most(simd.floats(self.min.y), north);
        let below = simd.at_most(east, simd.floats(self.max.x)) & simd.at_most(north, simd.floats(self.max.y));
        simd.bits(above & below)
    }

    /// Where the pixels of `mine`, a bit of each, take their colors from; texels are fetched from now
    /// on.
    #[inline(always)]
    pub(super) fn taps<S: Simd>(&self, simd: S, points: &Points<S>, mine: u32, has_two: bool, taps: &mut Taps<'a>) {
        let per_m = simd.floats(self.per_m);
        // log2 of the width, rounded: half of that of the square.
        let doubled = simd.larger(simd.floats(2.0) * points.squared_m * per_m * per_m, simd.floats(1.0));
        let octaves = simd.shift_right::<23>(simd.to_bits(doubled)) - simd.words(127);
        let level = simd.smaller_words(simd.shift_right::<1>(octaves), simd.words(self.coarsest));
        let share = simd.to_floats(simd.shift_left::<23>(simd.words(127) - level));
        let scale = per_m * share;
        let half = simd.floats(0.5);
        let u = (points.east - simd.floats(self.corner.x)) * scale - half;
        let v = (simd.floats(self.corner.y) - points.north) * scale - half;
        // Sides are halved exactly: texels of the finer mips are a geometric series.
        let side = simd.shift_right_by(simd.words(self.side), level);
        let mip = Mip {
            side,
            before: (simd.words(self.texels) - side * side) * simd.words(THIRD.wrapping_mul(4)),
            end: simd.floats(self.side as f32) * share - simd.floats(1.0 + 1.0 / 256.0),
        };
        taps.layer = self.layer;
        taps.has_two = has_two;
        if !has_two {
            mip.tap(simd, [u, v], &mut taps.of[0]);
            return taps.of[0].fetch(self.layer, mine);
        }
        let (near, furthest) = (simd.floats(-FURTHEST_TAP), simd.floats(FURTHEST_TAP));
        let x = simd.smaller(simd.larger(points.reach_east * scale, near), furthest);
        let y = simd.smaller(simd.larger(points.reach_north * scale, near), furthest);
        mip.tap(simd, [u + x, v - y], &mut taps.of[0]);
        mip.tap(simd, [u - x, v + y], &mut taps.of[1]);
        // The further one: the row below, which has been drawn before, has had the nearer one fetched.
        taps.of[1].fetch(self.layer, mine);
    }
}

/// Where pixels beside each other take their colors from: one place between four texels, or two.
///
/// Places are worked out some pixels ahead of the colors, so that texels of many pixels are fetched
/// from memory at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Taps<'a> {
    layer: &'a [u8],
    has_two: bool,
    of: [Tap; 2],
}

/// A place: the north western and the south western texel of four, and the shares of the eastern and
/// southern ones, in 256ths for each of two channels.
#[derive(Debug, Clone, Copy)]
struct Tap {
    rows: [Sixteen<u32>; 2],
    east: Sixteen<u32>,
    south: Sixteen<u32>,
}

impl Tap {
    const NONE: Self = Self { rows: [[0; LANES]; 2], east: [0; LANES], south: [0; LANES] };

    /// Has texels of the pixels of `mine` fetched from memory.
    #[inline(always)]
    fn fetch(&self, layer: &[u8], mine: u32) {
        for k in (PREFETCHED / 2..LANES).step_by(PREFETCHED) {
            if mine >> k & 1 != 0 {
                prefetch(layer, 4 * self.rows[0][k] as usize);
                prefetch(layer, 4 * self.rows[1][k] as usize);
            }
        }
    }
}

impl<S: Simd> Mip<S> {
    #[inline(always)]
    fn tap(&self, simd: S, [u, v]: [S::Floats; 2], tap: &mut Tap) {
        let (zero, parts) = (simd.floats(0.0), simd.floats(256.0));
        // Columns and rows in 256ths.
        let i = simd.index(simd.smaller(simd.larger(u, zero), self.end) * parts);
        let j = simd.index(simd.smaller(simd.larger(v, zero), self.end) * parts);
        let at = self.before + simd.shift_right::<8>(j) * self.side + simd.shift_right::<8>(i);
        let (part, twice) = (simd.words(0xff), simd.words(0x0001_0001));
        simd.store_words(at, &mut tap.rows[0]);
        simd.store_words(at + self.side, &mut tap.rows[1]);
        simd.store_words((i & part) * twice, &mut tap.east);
        simd.store_words((j & part) * twice, &mut tap.south);
    }
}

impl Taps<'_> {
    /// Of no pixel.
    pub(super) const NONE: Self = Self { layer: &[], has_two: false, of: [Tap::NONE; 2] };

    /// The colors.
    #[inline(always)]
    pub(super) fn colors<S: Simd>(&self, simd: S) -> S::Words {
        let a = self.color(simd, &self.of[0]);
        if !self.has_two {
            return a;
        }
        let b = self.color(simd, &self.of[1]);
        // The mean of each channel, rounded down.
        let differ = (a | b) - (a & b);
        (a & b) + (simd.shift_right::<1>(differ) & simd.words(0x7f7f_7f7f))
    }

    /// Colors between four texels.
    #[inline(always)]
    fn color<S: Simd>(&self, simd: S, tap: &Tap) -> S::Words {
        let [nw, ne] = simd.texel_pairs(self.layer, simd.load_words(&tap.rows[0]));
        let [sw, se] = simd.texel_pairs(self.layer, simd.load_words(&tap.rows[1]));
        let (east, south) = (simd.load_words(&tap.east), simd.load_words(&tap.south));
        let upper = mix_channels(simd, [nw, ne], east);
        let lower = mix_channels(simd, [sw, se], east);
        let red_blue = simd.shift_right::<8>(mix(simd, [upper[0], lower[0]], south)) & simd.words(TWO);
        let green = mix(simd, [upper[1], lower[1]], south) & simd.words(!TWO);
        red_blue | green | simd.words(OPAQUE_BLACK)
    }
}

/// Between two words of two channels, times 256. `share`: of the second, in 256ths, for each
/// channel.
#[inline(always)]
fn mix<S: Simd>(simd: S, [a, b]: [S::Words; 2], share: S::Words) -> S::Words {
    let other = simd.words(0x0100_0100) - share;
    simd.multiply_halves(a, other) + simd.multiply_halves(b, share)
}

/// Between two texels: red and blue, green and alpha.
#[inline(always)]
fn mix_channels<S: Simd>(simd: S, [a, b]: [S::Words; 2], share: S::Words) -> [S::Words; 2] {
    let two = simd.words(TWO);
    let red_blue = mix(simd, [a & two, b & two], share);
    let green = mix(simd, [simd.shift_right::<8>(a) & two, simd.shift_right::<8>(b) & two], share);
    [simd.shift_right::<8>(red_blue) & two, simd.shift_right::<8>(green) & two]
}
