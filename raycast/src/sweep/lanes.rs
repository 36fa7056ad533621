//! Sixteen neighboring planes, which are swept together: arrays that compilers make vectors of.

use terravision_common::simd::Sixteen;

/// A number of each.
pub(super) type Floats = Sixteen<f32>;

/// 2^23: floats from here to its double are whole, and their lower bits are that number.
const WHOLE: f32 = 8_388_608.0;

/// The whole part of a number from 0 to 2^22, as a float. Conversions that also take care of
/// numbers out of range are several instructions.
#[inline(always)]
pub(super) fn floor(x: f32) -> f32 {
    let nearest = (x + WHOLE) - WHOLE;
    if nearest > x { nearest - 1.0 } else { nearest }
}

/// The smaller of two numbers, neither NaN: one instruction.
#[inline(always)]
pub(super) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger one.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}
