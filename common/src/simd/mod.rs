//! Vectors of sixteen numbers, which kernels are written in: by AVX-512, by AVX2, or by arrays on
//! any processor.
//!
//! A kernel is [`Work`], generic over [`Simd`], and inlined as a whole into a function for
//! processors with those instructions. All sets give the same bits: they add, subtract, multiply, divide and
//! compare, which are exact to the bit everywhere, and nothing is fused.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod instructions;
mod portable;
mod prefetch;
#[cfg(test)]
mod tests;

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub use avx512::Avx512;
pub use instructions::{Instructions, Work};
pub use portable::Portable;
pub use prefetch::prefetch;

use std::fmt::Debug;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Numbers of a vector.
pub const LANES: usize = 16;

/// A number of each lane.
pub type Sixteen<T> = [T; LANES];

/// 2^23: floats from here to its double are whole, and their lower bits are that number.
const WHOLE: f32 = 8_388_608.0;

/// The last place of a table of `count` numbers that has a number behind it, at most `i32::MAX`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn last_pair(count: usize) -> Option<u32> {
    let last = count.checked_sub(2)?;
    Some(last.min(i32::MAX as usize) as u32)
}

/// A set of instructions that this processor has: who holds one may use them.
pub trait Simd: Copy + Debug {
    /// 32-bit floats.
    type Floats: Copy
        + Add<Output = Self::Floats>
        + Sub<Output = Self::Floats>
        + Mul<Output = Self::Floats>
        + Div<Output = Self::Floats>;
    /// 32-bit words, which wrap around.
    type Words: Copy
        + Add<Output = Self::Words>
        + Sub<Output = Self::Words>
        + Mul<Output = Self::Words>
        + BitAnd<Output = Self::Words>
        + BitOr<Output = Self::Words>;
    /// A yes or no of each lane.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask>;

    /// The same number in all lanes.
    fn floats(self, x: f32) -> Self::Floats;
    /// The same word in all lanes.
    fn words(self, x: u32) -> Self::Words;
    /// Sixteen floats from memory.
    fn load(self, from: &Sixteen<f32>) -> Self::Floats;
    /// Sixteen words from memory.
    fn load_words(self, from: &Sixteen<u32>) -> Self::Words;
    /// Stores sixteen words.
    fn store_words(self, of: Self::Words, to: &mut Sixteen<u32>);
    /// Stores sixteen floats.
    fn store(self, of: Self::Floats, to: &mut Sixteen<f32>);
    /// Stores the lanes of a mask, and leaves others.
    fn store_where(self, mask: Self::Mask, of: Self::Floats, to: &mut Sixteen<f32>);

    /// `a` where it is smaller, else `b`.
    fn smaller(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// `a` where it is larger, else `b`.
    fn larger(self, a: Self::Floats, b: Self::Floats) -> Self::Floats;
    /// Whether `a < b`; never with NaN.
    fn less(self, a: Self::Floats, b: Self::Floats) -> Self::Mask;
    /// Whether `a ≤ b`; never with NaN.
    fn at_most(self, a: Self::Floats, b: Self::Floats) -> Self::Mask;
    /// `yes` where the mask is, else `no`.
    fn select(self, mask: Self::Mask, yes: Self::Floats, no: Self::Floats) -> Self::Floats;
    /// `yes` where the mask is, else `no`.
    fn select_words(self, mask: Self::Mask, yes: Self::Words, no: Self::Words) -> Self::Words;
    /// Products of the halves of words, 16 bits each, which wrap around.
    fn multiply_halves(self, a: Self::Words, b: Self::Words) -> Self::Words;
    /// The smaller of two words without signs.
    fn smaller_words(self, a: Self::Words, b: Self::Words) -> Self::Words;
    /// Words shifted to the right; bits are lost.
    fn shift_right<const BITS: u32>(self, of: Self::Words) -> Self::Words;
    /// Words shifted to the left.
    fn shift_left<const BITS: u32>(self, of: Self::Words) -> Self::Words;
    /// Words shifted to the right, each by bits of its own, less than 32.
    fn shift_right_by(self, of: Self::Words, bits: Self::Words) -> Self::Words;
    /// The bits of floats.
    fn to_bits(self, of: Self::Floats) -> Self::Words;
    /// The floats of bits.
    fn to_floats(self, of: Self::Words) -> Self::Floats;
    /// A bit for each lane, the first lane's lowest.
    fn bits(self, mask: Self::Mask) -> u32;
    /// The mask of these bits.
    fn mask(self, bits: u32) -> Self::Mask;

    /// The number at each place of a short table, less than 16, and the one behind it.
    fn near_pairs(self, table: &[f32; LANES + 1], at: Self::Words) -> [Self::Floats; 2];
    /// The number at each place of a table and the one behind it. Places beyond its end are the
    /// last one that has one behind it; 0 in a table without such a place.
    fn pairs(self, table: &[f32], at: Self::Words) -> [Self::Floats; 2];
    /// The same of words of four bytes, the lowest byte first.
    fn texel_pairs(self, table: &[u8], at: Self::Words) -> [Self::Words; 2];

    /// Whether any lane is yes.
    #[inline(always)]
    fn any(self, mask: Self::Mask) -> bool {
        self.bits(mask) != 0
    }

    /// The whole part of numbers from 0 to 2^22.
    #[inline(always)]
    fn floor(self, x: Self::Floats) -> Self::Floats {
        let whole = self.floats(WHOLE);
        let nearest = (x + whole) - whole;
        self.select(self.less(x, nearest), nearest - self.floats(1.0), nearest)
    }

    /// Whole numbers from 0 to 2^22 as words.
    #[inline(always)]
    fn index(self, x: Self::Floats) -> Self::Words {
        self.to_bits(x + self.floats(WHOLE)) & self.words(0x007f_ffff)
    }

    /// Numbers without their signs.
    #[inline(always)]
    fn magnitude(self, x: Self::Floats) -> Self::Floats {
        self.to_floats(self.to_bits(x) & self.words(0x7fff_ffff))
    }

    /// The smallest number.
    #[inline(always)]
    fn smallest(self, of: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(of, &mut lanes);
        lanes.into_iter().fold(f32::INFINITY, |a, b| if b < a { b } else { a })
    }

    /// The largest number.
    #[inline(always)]
    fn largest(self, of: Self::Floats) -> f32 {
        let mut lanes = [0.0; LANES];
        self.store(of, &mut lanes);
        lanes.into_iter().fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a })
    }
}
