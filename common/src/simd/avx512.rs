//! Vectors by AVX-512.

#![expect(unsafe_code, reason = "instructions that not every processor has")]

use super::{LANES, Simd, Sixteen};
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Made where the processor has AVX-512F, BW, DQ and VL: [`Avx512::new`].
#[derive(Debug, Clone, Copy)]
pub struct Avx512(());

/// Made by an [`Avx512`] alone, as are the others.
#[derive(Debug, Clone, Copy)]
pub struct Floats(__m512);

#[derive(Debug, Clone, Copy)]
pub struct Words(__m512i);

#[derive(Debug, Clone, Copy)]
pub struct Mask(__mmask16);

/// Calls an instruction.
macro_rules! call {
    ($($instruction:tt)*) => {{
        // SAFETY: an `Avx512`, and a vector that it made, are only there on a processor with these
        // instructions.
        unsafe { $($instruction)* }
    }};
}

macro_rules! operators {
    ($($of:ident: $trait:ident :: $name:ident by $instruction:ident),* $(,)?) => {$(
        impl $trait for $of {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                Self(call!($instruction(self.0, other.0)))
            }
        }
    )*};
}

operators! {
    Floats: Add::add by _mm512_add_ps,
    Floats: Sub::sub by _mm512_sub_ps,
    Floats: Mul::mul by _mm512_mul_ps,
    Floats: Div::div by _mm512_div_ps,
    Words: Add::add by _mm512_add_epi32,
    Words: Sub::sub by _mm512_sub_epi32,
    Words: Mul::mul by _mm512_mullo_epi32,
    Words: BitAnd::bitand by _mm512_and_si512,
    Words: BitOr::bitor by _mm512_or_si512,
}

impl BitAnd for Mask {
    type Output = Self;
    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOr for Mask {
    type Output = Self;
    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl Avx512 {
    /// # Safety
    /// The processor has AVX-512F, BW, DQ and VL.
    pub unsafe fn new() -> Self {
        Self(())
    }

    /// Eight bytes at each of sixteen places, in units of four bytes: the first four of each, and
    /// the last four.
    ///
    /// # Safety
    /// All of them lie within one object.
    #[inline(always)]
    unsafe fn pairs_at(self, from: *const u8, at: __m512i) -> [__m512i; 2] {
        // SAFETY: the caller's promise; instructions as above.
        unsafe {
            let low = _mm512_i32gather_epi64::<4>(_mm512_castsi512_si256(at), from.cast());
            let high = _mm512_i32gather_epi64::<4>(_mm512_extracti64x4_epi64::<1>(at), from.cast());
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
            [_mm512_permutex2var_epi32(low, even, high), _mm512_permutex2var_epi32(low, odd, high)]
        }
    }
}

impl Simd for Avx512 {
    type Floats = Floats;
    type Words = Words;
    type Mask = Mask;

    #[inline(always)]
    fn floats(self, x: f32) -> Floats {
        Floats(call!(_mm512_set1_ps(x)))
    }

    #[inline(always)]
    fn words(self, x: u32) -> Words {
        Words(call!(_mm512_set1_epi32(x.cast_signed())))
    }

    #[inline(always)]
    fn load(self, from: &Sixteen<f32>) -> Floats {
        // SAFETY: as in `call`; there are sixteen numbers.
        Floats(unsafe { _mm512_loadu_ps(from.as_ptr()) })
    }

    #[inline(always)]
    fn load_words(self, from: &Sixteen<u32>) -> Words {
        // SAFETY: as in `call`; there are sixteen numbers.
        Words(unsafe { _mm512_loadu_si512(from.as_ptr().cast()) })
    }

    #[inline(always)]
    fn store(self, of: Floats, to: &mut Sixteen<f32>) {
        // SAFETY: as in `call`; there is room for sixteen numbers.
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), of.0) }
    }

    #[inline(always)]
    fn store_words(self, of: Words, to: &mut Sixteen<u32>) {
        // SAFETY: as in `call`; there is room for sixteen numbers.
        unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), of.0) }
    }

    #[inline(always)]
    fn store_where(self, mask: Mask, of: Floats, to: &mut Sixteen<f32>) {
        // SAFETY: as in `call`; there is room for sixteen numbers.
        unsafe { _mm512_mask_storeu_ps(to.as_mut_ptr(), mask.0, of.0) }
    }

    #[inline(always)]
    fn smaller(self, a: Floats, b: Floats) -> Floats {
        Floats(call!(_mm512_min_ps(a.0, b.0)))
    }

    #[inline(always)]
    fn larger(self, a: Floats, b: Floats) -> Floats {
        Floats(call!(_mm512_max_ps(a.0, b.0)))
    }

    #[inline(always)]
    fn less(self, a: Floats, b: Floats) -> Mask {
        Mask(call!(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a.0, b.0)))
    }

    #[inline(always)]
    fn at_most(self, a: Floats, b: Floats) -> Mask {
        Mask(call!(_mm512_cmp_ps_mask::<_CMP_LE_OQ>(a.0, b.0)))
    }

    #[inline(always)]
    fn select(self, mask: Mask, yes: Floats, no: Floats) -> Floats {
        Floats(call!(_mm512_mask_blend_ps(mask.0, no.0, yes.0)))
    }

    #[inline(always)]
    fn select_words(self, mask: Mask, yes: Words, no: Words) -> Words {
        Words(call!(_mm512_mask_blend_epi32(mask.0, no.0, yes.0)))
    }

    #[inline(always)]
    fn multiply_halves(self, a: Words, b: Words) -> Words {
        Words(call!(_mm512_mullo_epi16(a.0, b.0)))
    }

    #[inline(always)]
    fn smaller_words(self, a: Words, b: Words) -> Words {
        Words(call!(_mm512_min_epu32(a.0, b.0)))
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, of: Words) -> Words {
        Words(call!(_mm512_srli_epi32::<BITS>(of.0)))
    }

    #[inline(always)]
    fn shift_left<const BITS: u32>(self, of: Words) -> Words {
        Words(call!(_mm512_slli_epi32::<BITS>(of.0)))
    }

    #[inline(always)]
    fn shift_right_by(self, of: Words, bits: Words) -> Words {
        Words(call!(_mm512_srlv_epi32(of.0, bits.0)))
    }

    #[inline(always)]
    fn to_bits(self, of: Floats) -> Words {
        Words(call!(_mm512_castps_si512(of.0)))
    }

    #[inline(always)]
    fn to_floats(self, of: Words) -> Floats {
        Floats(call!(_mm512_castsi512_ps(of.0)))
    }

    #[inline(always)]
    fn bits(self, mask: Mask) -> u32 {
        mask.0.into()
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> Mask {
        Mask(bits as u16)
    }

    #[inline(always)]
    fn near_pairs(self, table: &[f32; LANES + 1], at: Words) -> [Floats; 2] {
        // SAFETY: as in `call`; from the first number on there are sixteen, and from the second, too.
        unsafe {
            let [first, second] = [_mm512_loadu_ps(table.as_ptr()), _mm512_loadu_ps(table.as_ptr().add(1))];
            [Floats(_mm512_permutexvar_ps(at.0, first)), Floats(_mm512_permutexvar_ps(at.0, second))]
        }
    }

    #[inline(always)]
    fn pairs(self, table: &[f32], at: Words) -> [Floats; 2] {
        let Some(last) = super::last_pair(table.len()) else { return [self.floats(0.0); 2] };
        let at = self.smaller_words(at, self.words(last));
        // SAFETY: `last` has a number behind it in the table, and is less than 2^31.
        let [first, second] = unsafe { self.pairs_at(table.as_ptr().cast(), at.0) };
        [self.to_floats(Words(first)), self.to_floats(Words(second))]
    }

    #[inline(always)]
    fn texel_pairs(self, table: &[u8], at: Words) -> [Words; 2] {
        let Some(last) = super::last_pair(table.len() / 4) else { return [self.words(0); 2] };
        let at = self.smaller_words(at, self.words(last));
        // SAFETY: `last` has four bytes and four more behind it in the table, and is less than 2^31.
        let [first, second] = unsafe { self.pairs_at(table.as_ptr(), at.0) };
        [Words(first), Words(second)]
    }
}
