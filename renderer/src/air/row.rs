//! A row of pixels seen through the air, sixteen at a time.

use super::sky::Sky;
use crate::technique::NEAR_M;
use terravision_common::simd::{LANES, Simd, Sixteen, Work};

/// Columns of lanes.
const NUMBERS: Sixteen<f32> = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];
/// Floats from here on have whole numbers in their lower bits.
const WHOLE: f32 = 8_388_608.0;
/// Alpha from here on is all ground; 254 is ground that was made up.
const GROUND: u32 = 254;
/// Half of the sun's width in the sky, as the square of a chord: 0.27 degrees.
const SUN: f32 = 2.2e-5;
/// The exponential function is that of a part of its argument, taken to this power of two.
const DOUBLINGS: u32 = 8;
/// From here on nothing is left of what is seen.
const OPAQUE: f32 = 60.0;

/// What all rows have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Medium {
    pub(super) sky: Sky,
    /// Share of contrast that is lost, per metre, for small distances; 0: no haze.
    pub(super) per_m: f32,
}

/// A row to work on.
pub(super) struct Row<'a> {
    pub(super) medium: &'a Medium,
    /// Of depth 1: through the middle of the first pixel, and from pixel to pixel.
    pub(super) direction: [f32; 3],
    pub(super) step: [f32; 3],
    /// RGBA; alpha is the share of ground, which the colours were multiplied by.
    pub(super) texels: &'a mut [u8],
    /// Near plane over depth; empty without haze.
    pub(super) depth: &'a [f32],
}

impl Work for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { medium, direction, step, texels, depth } = self;
        let air = Kernel { simd, medium, direction, step };
        let mut words = [0; LANES];
        let mut nearness = [0.0; LANES];
        for (number, texels) in texels.chunks_mut(4 * LANES).enumerate() {
            let first = number * LANES;
            for (word, texel) in words.iter_mut().zip(texels.as_chunks::<4>().0) {
                *word = u32::from_le_bytes(*texel);
            }
            if let Some(depth) = depth.get(first..) {
                nearness.iter_mut().zip(depth).for_each(|(to, from)| *to = *from);
            }
            air.pixels(first as f32, &mut words, &nearness);
            for (word, texel) in words.iter().zip(texels.as_chunks_mut::<4>().0) {
                *texel = word.to_le_bytes();
            }
        }
    }
}

struct Kernel<'a, S> {
    simd: S,
    medium: &'a Medium,
    direction: [f32; 3],
    step: [f32; 3],
}

impl<S: Simd> Kernel<'_, S> {
    #[inline(always)]
    fn pixels(&self, first: f32, words: &mut Sixteen<u32>, nearness: &Sixteen<f32>) {
        let simd = self.simd;
        let seen = simd.load_words(words);
        let alpha = simd.shift_right::<24>(seen);
        let is_ground = simd.less(simd.floats(GROUND as f32 - 0.5), self.number(alpha));
        let share = simd.select(is_ground, simd.floats(1.0), self.number(alpha) * simd.floats(1.0 / 255.0));
        let (toward, length) = self.directions(first);
        let left = self.left(simd.load(nearness), length);
        let glow = self.glow(toward);
        let (sky, disc) = (self.sky(toward[2]), self.disc(toward));
        let air = share - share * left;
        let above = simd.floats(1.0) - share;
        let channel = |number: usize, of: S::Words| {
            let aglow = |plain: S::Floats| plain + glow * (simd.floats(self.medium.sky.glow[number]) - plain);
            let haze = aglow(simd.floats(self.medium.sky.horizon[number]));
            let beyond = aglow(sky[number]);
            let beyond = beyond + disc * (simd.floats(255.0) - beyond);
            let value = left * self.number(of & simd.words(0xff)) + air * haze + above * beyond;
            // Rounded to nearest.
            simd.index(simd.smaller(simd.larger(value, simd.floats(0.0)), simd.floats(255.0)))
        };
        let red = channel(0, seen);
        let green = simd.shift_left::<8>(channel(1, simd.shift_right::<8>(seen)));
        let blue = simd.shift_left::<16>(channel(2, simd.shift_right::<16>(seen)));
        let alpha = simd.shift_left::<24>(simd.select_words(is_ground, alpha, simd.words(255)));
        simd.store_words(red | green | blue | alpha, words);
    }

    /// Small whole numbers as floats.
    #[inline(always)]
    fn number(&self, of: S::Words) -> S::Floats {
        self.simd.to_floats(of | self.simd.words(WHOLE.to_bits())) - self.simd.floats(WHOLE)
    }

    /// Directions of length 1 through sixteen pixels, and how long they are of depth 1.
    #[inline(always)]
    fn directions(&self, first: f32) -> ([S::Floats; 3], S::Floats) {
        let simd = self.simd;
        let at = simd.load(&NUMBERS) + simd.floats(first);
        let of = |axis: usize| simd.floats(self.direction[axis]) + simd.floats(self.step[axis]) * at;
        let [x, y, z] = [of(0), of(1), of(2)];
        let squared = x * x + y * y + z * z;
        // One over the square root, by Newton from a famous guess.
        let mut inverse = simd.to_floats(simd.words(0x5f37_59df) - simd.shift_right::<1>(simd.to_bits(squared)));
        for _ in 0..3 {
            inverse = inverse * (simd.floats(1.5) - simd.floats(0.5) * squared * inverse * inverse);
        }
        ([x * inverse, y * inverse, z * inverse], squared * inverse)
    }

    /// How much is left of what is seen: exp(-distance per_m).
    #[inline(always)]
    fn left(&self, nearness: S::Floats, length: S::Floats) -> S::Floats {
        let simd = self.simd;
        if self.medium.per_m == 0.0 {
            return simd.floats(1.0);
        }
        let near = simd.floats(NEAR_M as f32 * self.medium.per_m) * length;
        let thick = simd.smaller(near / simd.larger(nearness, simd.floats(f32::MIN_POSITIVE)), simd.floats(OPAQUE));
        let part = thick * simd.floats(1.0 / (1u32 << DOUBLINGS) as f32);
        let series = [1.0 / 24.0, -1.0 / 6.0, 0.5, -1.0, 1.0].map(|factor| simd.floats(factor));
        let mut left = series[0];
        for factor in &series[1..] {
            left = left * part + *factor;
        }
        for _ in 0..DOUBLINGS {
            left = left * left;
        }
        left
    }

    /// How much of the light around the sun is seen: wide and faint, and narrow.
    #[inline(always)]
    fn glow(&self, toward: [S::Floats; 3]) -> S::Floats {
        let simd = self.simd;
        let Some(sun) = self.medium.sky.sun else { return simd.floats(0.0) };
        let [x, y, z] = sun.map(|v| simd.floats(v));
        let along = simd.larger(x * toward[0] + y * toward[1] + z * toward[2], simd.floats(0.0));
        let power = |of: S::Floats| of * of;
        let eight = power(power(power(along)));
        let narrow = power(power(power(power(eight))));
        simd.floats(self.medium.sky.glow_share) * (simd.floats(0.5) * eight + simd.floats(0.5) * narrow)
    }

    /// How much of a pixel is the sun itself.
    #[inline(always)]
    fn disc(&self, toward: [S::Floats; 3]) -> S::Floats {
        let simd = self.simd;
        let Some(sun) = self.medium.sky.sun else { return simd.floats(0.0) };
        let by = [0, 1, 2].map(|axis| toward[axis] - simd.floats(sun[axis]));
        let squared = by[0] * by[0] + by[1] * by[1] + by[2] * by[2];
        let inside = simd.floats(1.5) - squared * simd.floats(1.0 / SUN);
        simd.smaller(simd.larger(inside, simd.floats(0.0)), simd.floats(1.0))
    }

    /// The sky without the light around the sun.
    #[inline(always)]
    fn sky(&self, up: S::Floats) -> [S::Floats; 3] {
        let simd = self.simd;
        let low = simd.floats(1.0) - simd.smaller(simd.larger(up, simd.floats(0.0)), simd.floats(1.0));
        let two = low * low;
        let four = two * two;
        let Sky { zenith, horizon, .. } = &self.medium.sky;
        [0, 1, 2].map(|channel| simd.floats(zenith[channel]) + simd.floats(horizon[channel] - zenith[channel]) * four)
    }
}
