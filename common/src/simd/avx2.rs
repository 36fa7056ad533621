//! Vectors by AVX2: two halves.

#![expect(unsafe_code, reason = "instructions that not every processor has")]

use super::{LANES, Simd, Sixteen};
use std::arch::x86_64::*;
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Made where the processor has AVX2: [`Avx2::new`].
#[derive(Debug, Clone, Copy)]
pub struct Avx2(());

/// Made by an [`Avx2`] alone, as are the others.
#[derive(Debug, Clone, Copy)]
pub struct Floats(__m256, __m256);

#[derive(Debug, Clone, Copy)]
pub struct Words(__m256i, __m256i);

/// All bits of a lane, or none.
#[derive(Debug, Clone, Copy)]
pub struct Mask(__m256, __m256);

/// Of each lane, its bit.
const BIT_OF_LANE: Sixteen<u32> = [
    1,
    1 << 1,
    1 << 2,
    1 << 3,
    1 << 4,
    1 << 5,
    1 << 6,
    1 << 7,
    1 << 8,
    1 << 9,
    1 << 10,
    1 << 11,
    1 << 12,
    1 << 13,
    1 << 14,
    1 << 15,
];

/// Calls an instruction for both halves of vectors.
macro_rules! call {
    ($out:ident by $instruction:ident $(::<$number:tt>)? ($($of:expr),*)) => {{
        // SAFETY: an `Avx2`, and a vector that it made, are only there on a processor with these
        // instructions.
        unsafe { $out($instruction $(::<$number>)? ($($of.0),*), $instruction $(::<$number>)? ($($of.1),*)) }
    }};
}

macro_rules! operators {
    ($($of:ident: $trait:ident :: $name:ident by $instruction:ident),* $(,)?) => {$(
        impl $trait for $of {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                call!(Self by $instruction(self, other))
            }
        }
    )*};
}

operators! {
    Floats: Add::add by _mm256_add_ps,
    Floats: Sub::sub by _mm256_sub_ps,
    Floats: Mul::mul by _mm256_mul_ps,
    Floats: Div::div by _mm256_div_ps,
    Words: Add::add by _mm256_add_epi32,
    Words: Sub::sub by _mm256_sub_epi32,
    Words: Mul::mul by _mm256_mullo_epi32,
    Words: BitAnd::bitand by _mm256_and_si256,
    Words: BitOr::bitor by _mm256_or_si256,
    Mask: BitAnd::bitand by _mm256_and_ps,
    Mask: BitOr::bitor by _mm256_or_ps,
}

impl Avx2 {
    /// # Safety
    /// The processor has AVX2.
    pub unsafe fn new() -> Self {
        Self(())
    }

    /// The four bytes at sixteen places in units of four bytes, and the four bytes behind them.
    ///
    /// # Safety
    /// All of them lie within one object.
    #[inline(always)]
    unsafe fn pairs_at(self, from: *const u8, at: Words) -> [Words; 2] {
        // SAFETY: the caller's promise; instructions as in `call`.
        unsafe {
            let (first, second) = (from.cast::<i32>(), from.add(4).cast::<i32>());
            [
                Words(_mm256_i32gather_epi32::<4>(first, at.0), _mm256_i32gather_epi32::<4>(first, at.1)),
                Words(_mm256_i32gather_epi32::<4>(second, at.0), _mm256_i32gather_epi32::<4>(second, at.1)),
            ]
        }
    }
}

impl Simd for Avx2 {
    type Floats = Floats;
    type Words = Words;
    type Mask = Mask;

    #[inline(always)]
    fn floats(self, x: f32) -> Floats {
        // SAFETY: as in `call`.
        let half = unsafe { _mm256_set1_ps(x) };
        Floats(half, half)
    }

    #[inline(always)]
    fn words(self, x: u32) -> Words {
        // SAFETY: as in `call`.
        let half = unsafe { _mm256_set1_epi32(x.cast_signed()) };
        Words(half, half)
    }

    #[inline(always)]
    fn load(self, from: &Sixteen<f32>) -> Floats {
        // SAFETY: as in `call`; there are sixteen numbers.
        unsafe { Floats(_mm256_loadu_ps(from.as_ptr()), _mm256_loadu_ps(from.as_ptr().add(8))) }
    }

    #[inline(always)]
    fn load_words(self, from: &Sixteen<u32>) -> Words {
        // SAFETY: as in `call`; there are sixteen numbers.
        unsafe { Words(_mm256_loadu_si256(from.as_ptr().cast()), _mm256_loadu_si256(from.as_ptr().add(8).cast())) }
    }

    #[inline(always)]
    fn store(self, of: Floats, to: &mut Sixteen<f32>) {
        // SAFETY: as in `call`; there is room for sixteen numbers.
        unsafe {
            _mm256_storeu_ps(to.as_mut_ptr(), of.0);
            _mm256_storeu_ps(to.as_mut_ptr().add(8), of.1);
        }
    }

    #[inline(always)]
    fn store_words(self, of: Words, to: &mut Sixteen<u32>) {
        // SAFETY: as in `call`; there is room for sixteen numbers.
        unsafe {
            _mm256_storeu_si256(to.as_mut_ptr().cast(), of.0);
            _mm256_storeu_si256(to.as_mut_ptr().add(8).cast(), of.1);
        }
    }

    #[inline(always)]
    fn store_where(self, mask: Mask, of: Floats, to: &mut Sixteen<f32>) {
        let merged = self.select(mask, of, self.load(to));
        self.store(merged, to);
    }

    #[inline(always)]
    fn smaller(self, a: Floats, b: Floats) -> Floats {
        call!(Floats by _mm256_min_ps(a, b))
    }

    #[inline(always)]
    fn larger(self, a: Floats, b: Floats) -> Floats {
        call!(Floats by _mm256_max_ps(a, b))
    }

    #[inline(always)]
    fn less(self, a: Floats, b: Floats) -> Mask {
        call!(Mask by _mm256_cmp_ps::<_CMP_LT_OQ>(a, b))
    }

    #[inline(always)]
    fn at_most(self, a: Floats, b: Floats) -> Mask {
        call!(Mask by _mm256_cmp_ps::<_CMP_LE_OQ>(a, b))
    }

    #[inline(always)]
    fn select(self, mask: Mask, yes: Floats, no: Floats) -> Floats {
        call!(Floats by _mm256_blendv_ps(no, yes, mask))
    }

    #[inline(always)]
    fn select_words(self, mask: Mask, yes: Words, no: Words) -> Words {
        self.to_bits(self.select(mask, self.to_floats(yes), self.to_floats(no)))
    }

    #[inline(always)]
    fn multiply_halves(self, a: Words, b: Words) -> Words {
        call!(Words by _mm256_mullo_epi16(a, b))
    }

    #[inline(always)]
    fn smaller_words(self, a: Words, b: Words) -> Words {
        call!(Words by _mm256_min_epu32(a, b))
    }

    #[inline(always)]
    fn shift_right<const BITS: u32>(self, of: Words) -> Words {
        // SAFETY: as in `call`.
        let bits = unsafe { _mm_cvtsi32_si128(BITS.cast_signed()) };
        // SAFETY: as in `call`.
        unsafe { Words(_mm256_srl_epi32(of.0, bits), _mm256_srl_epi32(of.1, bits)) }
    }

    #[inline(always)]
    fn shift_left<const BITS: u32>(self, of: Words) -> Words {
        // SAFETY: as in `call`.
        let bits = unsafe { _mm_cvtsi32_si128(BITS.cast_signed()) };
        // SAFETY: as in `call`.
        unsafe { Words(_mm256_sll_epi32(of.0, bits), _mm256_sll_epi32(of.1, bits)) }
    }

    #[inline(always)]
    fn shift_right_by(self, of: Words, bits: Words) -> Words {
        call!(Words by _mm256_srlv_epi32(of, bits))
    }

    #[inline(always)]
    fn to_bits(self, of: Floats) -> Words {
        call!(Words by _mm256_castps_si256(of))
    }

    #[inline(always)]
    fn to_floats(self, of: Words) -> Floats {
        call!(Floats by _mm256_castsi256_ps(of))
    }

    #[inline(always)]
    fn bits(self, mask: Mask) -> u32 {
        // SAFETY: as in `call`.
        let [low, high] = unsafe { [_mm256_movemask_ps(mask.0), _mm256_movemask_ps(mask.1)] };
        low.cast_unsigned() | high.cast_unsigned() << 8
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> Mask {
        let bits = self.words(bits);
        let of_lane = self.load_words(&BIT_OF_LANE);
        let set = bits & of_lane;
        // SAFETY: as in `call`.
        let equal = unsafe { Words(_mm256_cmpeq_epi32(set.0, of_lane.0), _mm256_cmpeq_epi32(set.1, of_lane.1)) };
        let Floats(low, high) = self.to_floats(equal);
        Mask(low, high)
    }

    #[inline(always)]
    fn near_pairs(self, table: &[f32; LANES + 1], at: Words) -> [Floats; 2] {
        let at = at & self.words(LANES as u32 - 1);
        // SAFETY: as in `call`; the lowest and the next number lie within the table, and the places
        // are less than 16.
        unsafe {
            let (first, second) = (table.as_ptr(), table.as_ptr().add(1));
            [
                Floats(_mm256_i32gather_ps::<4>(first, at.0), _mm256_i32gather_ps::<4>(first, at.1)),
                Floats(_mm256_i32gather_ps::<4>(second, at.0), _mm256_i32gather_ps::<4>(second, at.1)),
            ]
        }
    }

    #[inline(always)]
    fn pairs(self, table: &[f32], at: Words) -> [Floats; 2] {
        let Some(last) = super::last_pair(table.len()) else { return [self.floats(0.0); 2] };
        let at = self.smaller_words(at, self.words(last));
        // SAFETY: `last` has a number behind it in the table, and is less than 2^31.
        let [first, second] = unsafe { self.pairs_at(table.as_ptr().cast(), at) };
        [self.to_floats(first), self.to_floats(second)]
    }

    #[inline(always)]
    fn texel_pairs(self, table: &[u8], at: Words) -> [Words; 2] {
        let Some(last) = super::last_pair(table.len() / 4) else { return [self.words(0); 2] };
        let at = self.smaller_words(at, self.words(last));
        // SAFETY: `last` has four bytes and four more behind it in the table, and is less than 2^31.
        unsafe { self.pairs_at(table.as_ptr(), at) }
    }
}
