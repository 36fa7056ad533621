//! Vectors as arrays, on any processor.

use super::{LANES, Simd, Sixteen};
use std::array::from_fn;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// What every processor has.
#[derive(Debug, Clone, Copy)]
pub struct Portable;

#[derive(Debug, Clone, Copy)]
pub struct Floats(Sixteen<f32>);

#[derive(Debug, Clone, Copy)]
pub struct Words(Sixteen<u32>);

/// All bits of a lane, or none.
#[derive(Debug, Clone, Copy)]
pub struct Mask(Sixteen<u32>);

macro_rules! lane_by_lane {
    ($($of:ident: $trait:ident :: $name:ident by $by:expr),* $(,)?) => {$(
        impl $trait for $of {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                let by = $by;
                Self(from_fn(|k| by(self.0[k], other.0[k])))
            }
        }
    )*};
}

lane_by_lane! {
    Floats: Add::add by |a: f32, b: f32| a + b,
    Floats: Sub::sub by |a: f32, b: f32| a - b,
    Floats: Mul::mul by |a: f32, b: f32| a * b,
    Floats: Div::div by |a: f32, b: f32| a / b,
    Words: Add::add by u32::wrapping_add,
    Words: Sub::sub by u32::wrapping_sub,
    Words: Mul::mul by u32::wrapping_mul,
    Words: BitAnd::bitand by |a: u32, b: u32| a & b,
    Words: BitOr::bitor by |a: u32, b: u32| a | b,
    Mask: BitAnd::bitand by |a: u32, b: u32| a & b,
    Mask: BitOr::bitor by |a: u32, b: u32| a | b,
}

#[inline(always)]
fn mask(of: impl Fn(usize) -> bool) -> Mask {
    Mask(from_fn(|k| 0u32.wrapping_sub(u32::from(of(k)))))
}

impl Simd for Portable {
    type Floats = Floats;
    type Words = Words;
    type Mask = Mask;

    #[inline(always)]
    fn floats(self, x: f32) -> Floats {
        Floats([x; LANES])
    }

    #[inline(always)]
    fn words(self, x: u32) -> Words {
        Words([x; LANES])
    }

    #[inline(always)]
    fn load(self, from: &Sixteen<f32>) -> Floats {
        Floats(*from)
    }

    #[inline(always)]
    fn load_words(self, from: &Sixteen<u32>) -> Words {
        Words(*from)
    }

    #[inline(always)]
    fn store(self, of: Floats, to: &mut Sixteen<f32>) {
        *to = of.0;
    }

    #[inline(always)]
    fn store_words(self, of: Words, to: &mut Sixteen<u32>) {
        *to = of.0;
    }

    #[inline(always)]
    fn store_where(self, mask: Mask, of: Floats, to: &mut Sixteen<f32>) {
        *to = self.select(mask, of, Floats(*to)).0;
    }

    #[inline(always)]
    fn smaller(self, a: Floats, b: Floats) -> Floats {
        Floats(from_fn(|k| if a.0[k] < b.0[k] { a.0[k] } else { b.0[k] }))
    }

    #[inline(always)]
    fn larger(self, a: Floats, b: Floats) -> Floats {
        Floats(from_fn(|k| if a.0[k] > b.0[k] { a.0[k] } else { b.0[k] }))
    }

    #[inline(always)]
    fn less(self, a: Floats, b: Floats) -> Mask {
        mask(|k| a.0[k] < b.0[k])
    }

    #[inline(always)]
    fn at_most(self, a: Floats, b: Floats) -> Mask {
        mask(|k| a.0[k] <= b.0[k])
    }

    #[inline(always)]
    fn select(self, mask: Mask, yes: Floats, no: Floats) -> Floats {
        Floats(from_fn(|k| if mask.0[k] != 0 { yes.0[k] } else { no.0[k] }))
    }

    #[inline(always)]
    fn select_words(self, mask: Mask, yes: Words, no: Words) -> Words {
        Words(from_fn(|k| if mask.0[k] != 0 { yes.0[k] } else { no.0[k] }))
    }

    #[inline(always)]
    fn multiply_halves(self, a: Words, b: Words) -> Words {
        let high = |a: u32, b: u32| (a >> 16).wrapping_mul(b >> 16) << 16;
        Words(from_fn(|k| high(a.0[k], b.0[k]) | a.0[k].wrapping_mul(b.0[k] & 0xffff) & 0xffff))
    }

    #[inline(always)]
    fn smaller_words(self, a: Words, b: Words) -> Words {
        Words(from_fn(|k| if a.0[k] < b.0[k] { a.0[k] } else { b.0[k] }))
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, of: Words) -> Words {
        Words(from_fn(|k| of.0[k] >> BITS))
    }

    #[inline(always)]
    fn shift_left<const BITS: u32>(self, of: Words) -> Words {
        Words(from_fn(|k| of.0[k] << BITS))
    }

    #[inline(always)]
    fn shift_right_by(self, of: Words, bits: Words) -> Words {
        Words(from_fn(|k| of.0[k].wrapping_shr(bits.0[k])))
    }

    #[inline(always)]
    fn to_bits(self, of: Floats) -> Words {
        Words(from_fn(|k| of.0[k].to_bits()))
    }

    #[inline(always)]
    fn to_floats(self, of: Words) -> Floats {
        Floats(from_fn(|k| f32::from_bits(of.0[k])))
    }

    #[inline(always)]
    fn bits(self, mask: Mask) -> u32 {
        let mut bits = 0;
        for k in 0..LANES {
            bits |= mask.0[k] & 1 << k;
        }
        bits
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> Mask {
        mask(|k| bits >> k & 1 != 0)
    }

    #[inline(always)]
    fn near_pairs(self, table: &[f32; LANES + 1], at: Words) -> [Floats; 2] {
        let place = |k: usize| at.0[k] as usize % LANES;
        [Floats(from_fn(|k| table[place(k)])), Floats(from_fn(|k| table[place(k) + 1]))]
    }

    #[inline(always)]
    fn pairs(self, table: &[f32], at: Words) -> [Floats; 2] {
        let mut out = [[0.0; LANES]; 2];
        if let Some(last) = table.len().checked_sub(2) {
            let [first, second] = &mut out;
            for ((at, first), second) in at.0.iter().zip(first).zip(second) {
                let at = (*at as usize).min(last);
                if let Some(&[a, b]) = table.get(at..at + 2) {
                    (*first, *second) = (a, b);
                }
            }
        }
        out.map(Floats)
    }

    #[inline(always)]
    fn texel_pairs(self, table: &[u8], at: Words) -> [Words; 2] {
        let mut out = [[0; LANES]; 2];
        if let Some(last) = (table.len() / 4).checked_sub(2) {
            let [first, second] = &mut out;
            for ((at, first), second) in at.0.iter().zip(first).zip(second) {
                let at = 4 * (*at as usize).min(last);
                if let Some(&[a, b, c, d, e, f, g, h]) = table.get(at..at + 8) {
                    (*first, *second) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
                }
            }
        }
        out.map(Words)
    }
}
