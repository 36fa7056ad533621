//! Pictures as Y'CbCr, 8 bits, limited range: 4:4:4 for Y4M, 4:2:0 for films.
//!
//! In integers, so that the bytes are the same everywhere. Pixels are converted in blocks, by loops
//! over arrays that the compiler makes vector instructions of; which ones is chosen when the
//! program runs ([`Instructions`]).

use std::num::Wrapping;
#[cfg(doc)]
use terravision_common::film::FrameEncoding;
use terravision_common::film::{Matrix, Y4M_FRAME, even};
use terravision_common::simd::{Instructions, Simd, Work};

/// Pixels of a block: nanoseconds a pixel of 4:4:4 and 4:2:0 by AVX2 are 0.76 and 0.57 with 16, 1.09
/// and 0.60 with 32, 1.01 and 0.68 with 64. One pixel after the other in 64 bits took 1.95.
const BLOCK: usize = 16;
/// Bytes of a block of RGBA.
const BLOCK_BYTES: usize = 4 * BLOCK;

/// Whole numbers of 32 bits without a check for overflow, which none of them can have: with checks
/// loops become no vector instructions.
type Whole = Wrapping<i32>;

/// A number of each pixel of a block.
type Numbers = [Whole; BLOCK];

/// Factors of a conversion, in 65536ths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Factors {
    /// Shares of red, green and blue in luma.
    luma: [Whole; 3],
    /// From luma to Y: 219/255.
    y: Whole,
    /// From blue less luma to Cb: 224/255 / (2 (1 - Kb)).
    cb: Whole,
    /// From red less luma to Cr: 224/255 / (2 (1 - Kr)).
    cr: Whole,
}

impl Factors {
    fn of(matrix: Matrix) -> Self {
        let luma = match matrix {
            Matrix::Bt601 => [19595, 38470, 7471],
            Matrix::Bt709 => [13933, 46871, 4732],
        };
        let chroma = |k: i32| (224.0 / 255.0 / (2.0 * (1.0 - f64::from(k) / 65536.0)) * 65536.0).round() as i32;
        let [cb, cr] = [luma[2], luma[0]].map(|k| Wrapping(chroma(k)));
        Self { luma: luma.map(Wrapping), y: Wrapping(219 * 65536 / 255), cb, cr }
    }

    #[inline(always)]
    fn luma(&self, r: Whole, g: Whole, b: Whole) -> Whole {
        let [kr, kg, kb] = self.luma;
        kr * r + kg * g + kb * b
    }
}

/// `value * factor / 2^SHIFT`, rounded to the nearest, halves up, for values of at most
/// `SHIFT - 8 + 1` bits with their sign. The product has more than 32 bits, of which these are as
/// exact as all: whole numbers may be rounded down twice.
#[inline(always)]
fn scaled<const SHIFT: usize>(value: Whole, factor: Whole) -> Whole {
    // Upper and lower bits of the value, so that neither product has more than 31 bits.
    let split = SHIFT / 2 - 4;
    let (upper, lower) = (value >> split, value & ((Wrapping(1) << split) - Wrapping(1)));
    let rest = SHIFT - split;
    (upper * factor + ((lower * factor) >> split) + (Wrapping(1) << (rest - 1))) >> rest
}

/// The block that begins with these texels, fewer than it has, and is filled with the last of them.
fn filled(texels: &[u8]) -> [u8; BLOCK_BYTES] {
    let mut block = [0; BLOCK_BYTES];
    block[..texels.len()].copy_from_slice(texels);
    if let Some(last) = texels.last_chunk::<4>() {
        block[texels.len()..].chunks_exact_mut(4).for_each(|texel| texel.copy_from_slice(last));
    }
    block
}

/// Red, green and blue of a block.
#[inline(always)]
fn channels(texels: &[u8; BLOCK_BYTES]) -> [Numbers; 3] {
    let texels: [u32; BLOCK] = bytemuck::cast(*texels);
    let [mut r, mut g, mut b] = [[Wrapping(0); BLOCK]; 3];
    for n in 0..BLOCK {
        let texel = u32::from_le(texels[n]);
        r[n] = Wrapping((texel & 0xff).cast_signed());
        g[n] = Wrapping(((texel >> 8) & 0xff).cast_signed());
        b[n] = Wrapping(((texel >> 16) & 0xff).cast_signed());
    }
    [r, g, b]
}

#[inline(always)]
fn y_of(factors: &Factors, [r, g, b]: &[Numbers; 3], out: &mut [u8; BLOCK]) {
    for n in 0..BLOCK {
        out[n] = (scaled::<32>(factors.luma(r[n], g[n], b[n]), factors.y).0 as u8).wrapping_add(16);
    }
}

/// Cb and Cr of every pixel.
#[inline(always)]
fn chroma_of(factors: &Factors, [r, g, b]: &[Numbers; 3], cb: &mut [u8; BLOCK], cr: &mut [u8; BLOCK]) {
    for n in 0..BLOCK {
        let luma = factors.luma(r[n], g[n], b[n]);
        cb[n] = (scaled::<32>((b[n] << 16) - luma, factors.cb).0 as u8).wrapping_add(128);
        cr[n] = (scaled::<32>((r[n] << 16) - luma, factors.cr).0 as u8).wrapping_add(128);
    }
}

/// Cb and Cr of the means of every two pixels above each other and the two beside them.
#[inline(always)]
fn shared_chroma_of(
    factors: &Factors,
    [upper, lower]: [&[u8; BLOCK_BYTES]; 2],
    cb: &mut [u8; BLOCK / 2],
    cr: &mut [u8; BLOCK / 2],
) {
    let [upper, lower]: [[u32; BLOCK]; 2] = [bytemuck::cast(*upper), bytemuck::cast(*lower)];
    // Two channels in a word, in 16 bits each.
    const HALVES: u32 = 0x00ff_00ff;
    let [mut red_and_blue, mut green] = [[0u32; BLOCK]; 2];
    for n in 0..BLOCK {
        let [upper, lower] = [u32::from_le(upper[n]), u32::from_le(lower[n])];
        red_and_blue[n] = (upper & HALVES).wrapping_add(lower & HALVES);
        green[n] = ((upper >> 8) & HALVES).wrapping_add((lower >> 8) & HALVES);
    }
    for n in 0..BLOCK / 2 {
        let red_and_blue = red_and_blue[2 * n].wrapping_add(red_and_blue[2 * n + 1]);
        let green = green[2 * n].wrapping_add(green[2 * n + 1]);
        let r = Wrapping((red_and_blue & 0xffff).cast_signed());
        let g = Wrapping((green & 0xffff).cast_signed());
        let b = Wrapping((red_and_blue >> 16).cast_signed());
        let luma = factors.luma(r, g, b);
        cb[n] = (scaled::<34>((b << 16) - luma, factors.cb).0 as u8).wrapping_add(128);
        cr[n] = (scaled::<34>((r << 16) - luma, factors.cr).0 as u8).wrapping_add(128);
    }
}

/// Pixels to planes of the same size.
struct Full<'a> {
    factors: Factors,
    rgba: &'a [u8],
    y: &'a mut [u8],
    cb: &'a mut [u8],
    cr: &'a mut [u8],
}

impl Work for Full<'_> {
    type Output = ();

    // No closures: they would be compiled without the instructions that this is inlined for.
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { factors, rgba, y, cb, cr } = self;
        let (blocks, rest) = rgba.as_chunks::<BLOCK_BYTES>();
        let (y, y_rest) = y.as_chunks_mut::<BLOCK>();
        let (cb, cb_rest) = cb.as_chunks_mut::<BLOCK>();
        let (cr, cr_rest) = cr.as_chunks_mut::<BLOCK>();
        for (block, ((y, cb), cr)) in blocks.iter().zip(y.iter_mut().zip(cb).zip(cr)) {
            let channels = channels(block);
            y_of(&factors, &channels, y);
            chroma_of(&factors, &channels, cb, cr);
        }
        let channels = channels(&filled(rest));
        let [mut y, mut cb, mut cr] = [[0; BLOCK]; 3];
        y_of(&factors, &channels, &mut y);
        chroma_of(&factors, &channels, &mut cb, &mut cr);
        for (out, found) in [(y_rest, y), (cb_rest, cb), (cr_rest, cr)] {
            out.copy_from_slice(&found[..out.len()]);
        }
    }
}

/// Two rows of pixels to two rows of Y, with an even number of pixels, and one of each chroma.
struct TwoRows<'a> {
    factors: Factors,
    rows: [&'a [u8]; 2],
    y: [&'a mut [u8]; 2],
    chroma: [&'a mut [u8]; 2],
}

impl Work for TwoRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { factors, rows: [upper, lower], y: [upper_y, lower_y], chroma: [cb, cr] } = self;
        let ((upper, upper_rest), (lower, lower_rest)) = (upper.as_chunks(), lower.as_chunks());
        // An odd row may fill the last block of Y, which is even, so that blocks go by the row.
        let (upper_y, upper_y_rest) = upper_y.split_at_mut(BLOCK * upper.len());
        let (lower_y, lower_y_rest) = lower_y.split_at_mut(BLOCK * upper.len());
        let (cb, cb_rest) = cb.split_at_mut(BLOCK / 2 * upper.len());
        let (cr, cr_rest) = cr.split_at_mut(BLOCK / 2 * upper.len());
        let y = upper_y.as_chunks_mut().0.iter_mut().zip(lower_y.as_chunks_mut().0);
        let chroma = cb.as_chunks_mut().0.iter_mut().zip(cr.as_chunks_mut().0);
        for (((upper, lower), (upper_y, lower_y)), (cb, cr)) in upper.iter().zip(lower).zip(y).zip(chroma) {
            y_of(&factors, &channels(upper), upper_y);
            y_of(&factors, &channels(lower), lower_y);
            shared_chroma_of(&factors, [upper, lower], cb, cr);
        }
        let (upper, lower) = (filled(upper_rest), filled(lower_rest));
        let ([mut upper_y, mut lower_y], [mut cb, mut cr]) = ([[0; BLOCK]; 2], [[0; BLOCK / 2]; 2]);
        y_of(&factors, &channels(&upper), &mut upper_y);
        y_of(&factors, &channels(&lower), &mut lower_y);
        shared_chroma_of(&factors, [&upper, &lower], &mut cb, &mut cr);
        for (out, found) in [(upper_y_rest, &upper_y[..]), (lower_y_rest, &lower_y), (cb_rest, &cb), (cr_rest, &cr)] {
            out.copy_from_slice(&found[..out.len()]);
        }
    }
}

/// One frame of Y4M from RGBA, into `out`, which has its length ([`FrameEncoding::frame_bytes`]).
pub(super) fn y4m_frame(instructions: Instructions, size: [u32; 2], rgba: &[u8], out: &mut [u8]) {
    let count = rgba.len() / 4;
    let (head, planes) = out.split_at_mut(Y4M_FRAME.len());
    head.copy_from_slice(Y4M_FRAME);
    let (y, chroma) = planes.split_at_mut(count);
    let (cb, cr) = chroma.split_at_mut(count);
    instructions.run(Full { factors: Factors::of(Matrix::for_size(size)), rgba, y, cb, cr });
}

/// The planes of a frame of a film, Y, Cb and Cr, from RGBA, into `out`, which has their length
/// ([`FrameEncoding::frame_bytes`]): BT.709, sides even, a last column or row repeated.
pub(super) fn planar_420(instructions: Instructions, size: [u32; 2], rgba: &[u8], out: &mut [u8]) {
    let [width, height] = even(size).map(|side| side as usize);
    let (y, chroma) = out.split_at_mut(width * height);
    let (cb, cr) = chroma.split_at_mut(width * height / 4);
    let factors = Factors::of(Matrix::Bt709);
    let row_bytes = (4 * size[0] as usize).max(1);
    let chroma = cb.chunks_exact_mut((width / 2).max(1)).zip(cr.chunks_exact_mut((width / 2).max(1)));
    let outs = y.chunks_exact_mut((2 * width).max(1)).zip(chroma);
    for (rows, (y, (cb, cr))) in rgba.chunks(2 * row_bytes).zip(outs) {
        let upper = &rows[..row_bytes.min(rows.len())];
        let lower = rows.get(row_bytes..).filter(|lower| !lower.is_empty()).unwrap_or(upper);
        let (upper_y, lower_y) = y.split_at_mut(width);
        instructions.run(TwoRows { factors, rows: [upper, lower], y: [upper_y, lower_y], chroma: [cb, cr] });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Y, Cb and Cr of the mean of pixels, in the widest whole numbers.
    fn converted(matrix: Matrix, pixels: &[[u8; 4]]) -> [u8; 3] {
        let Factors { luma, y, cb, cr } = Factors::of(matrix);
        let [kr, kg, kb] = luma.map(|k| i64::from(k.0));
        let sum = |channel: usize| pixels.iter().map(|pixel| i64::from(pixel[channel])).sum::<i64>();
        let [r, g, b] = [0, 1, 2].map(sum);
        let luma = kr * r + kg * g + kb * b;
        let scale = (pixels.len() as i64) << 32;
        let scaled = |value: i64, factor: Whole| (value * i64::from(factor.0) + scale / 2).div_euclid(scale);
        [16 + scaled(luma, y), 128 + scaled((b << 16) - luma, cb), 128 + scaled((r << 16) - luma, cr)].map(|v| v as u8)
    }

    /// A frame of Y4M as it was made before there were vectors.
    fn expected_y4m(size: [u32; 2], pixels: &[[u8; 4]]) -> Vec<u8> {
        let found: Vec<[u8; 3]> = pixels.iter().map(|pixel| converted(Matrix::for_size(size), &[*pixel])).collect();
        let planes = (0..3).flat_map(|plane| found.iter().map(move |pixel| pixel[plane]));
        Y4M_FRAME.iter().copied().chain(planes).collect()
    }

    fn expected_420(size: [u32; 2], pixels: &[[u8; 4]]) -> Vec<u8> {
        let [width, height] = size.map(|side| side as usize);
        let at = |x: usize, y: usize| pixels[y.min(height - 1) * width + x.min(width - 1)];
        let [even_width, even_height] = even(size).map(|side| side as usize);
        let places = |step: usize| {
            (0..even_height).step_by(step).flat_map(move |y| (0..even_width).step_by(step).map(move |x| (x, y)))
        };
        let mut out: Vec<u8> = places(1).map(|(x, y)| converted(Matrix::Bt709, &[at(x, y)])[0]).collect();
        let mean = |(x, y)| converted(Matrix::Bt709, &[at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)]);
        for plane in [1, 2] {
            out.extend(places(2).map(|place| mean(place)[plane]));
        }
        out
    }

    proptest! {
        #[test]
        fn every_set_of_instructions_makes_the_same_bytes(
            size in [1u32..150, 1u32..6], wide in any::<bool>(), seed in any::<u64>(),
        ) {
            // Some wide enough for the other matrix, and all corners of the cube of colours.
            let size = if wide { [size[0] + 1279, size[1]] } else { size };
            let mut state = seed | 1;
            let mut next = || {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                let [r, g, b, a, corner, ..] = state.to_le_bytes();
                if corner < 64 { [r, g, b, a].map(|v| if v < 128 { 0 } else { 255 }) } else { [r, g, b, a] }
            };
            let pixels: Vec<[u8; 4]> = (0..size[0] * size[1]).map(|_| next()).collect();
            let expected = [expected_y4m(size, &pixels), expected_420(size, &pixels)];
            for instructions in Instructions::all() {
                // Whatever was in it before.
                let [mut y4m, mut film] = expected.each_ref().map(|expected| vec![7; expected.len()]);
                y4m_frame(instructions, size, pixels.as_flattened(), &mut y4m);
                planar_420(instructions, size, pixels.as_flattened(), &mut film);
                prop_assert!(y4m == expected[0], "4:4:4 by {}", instructions.name());
                prop_assert!(film == expected[1], "4:2:0 by {}", instructions.name());
            }
        }
    }

    #[test]
    fn colours_have_the_values_of_the_standards() {
        let [small, large] = [[320, 180], [1280, 720]];
        let planes = |size: [u32; 2], [r, g, b]: [u8; 3]| -> [u8; 3] {
            let mut out = [0; 9];
            y4m_frame(Instructions::widest(), size, &[r, g, b, 255], &mut out);
            assert!(out.starts_with(b"FRAME\n"));
            [out[6], out[7], out[8]]
        };
        for size in [small, large] {
            assert_eq!(planes(size, [0, 0, 0]), [16, 128, 128]);
            assert_eq!(planes(size, [255, 255, 255]), [235, 128, 128]);
        }
        // Reference values: 601 red (81, 90, 240), 709 green (173, 42, 26), 709 blue (32, 240,
        // 118).
        assert_eq!(planes(small, [255, 0, 0]), [81, 90, 240]);
        assert_eq!(planes(large, [0, 255, 0]), [173, 42, 26]);
        assert_eq!(planes(large, [0, 0, 255]), [32, 240, 118]);
    }

    #[test]
    fn what_pixels_share_in_a_film_is_their_mean() {
        let mut out = [0; 12];
        // Two columns of blue above one of black and one of white, and an odd one of red.
        let [blue, red] = [[0, 0, 255, 255], [255, 0, 0, 255]];
        let rgba = [blue, blue, red, [0, 0, 0, 255], [255; 4], red];
        planar_420(Instructions::widest(), [3, 2], rgba.as_flattened(), &mut out);
        assert_eq!(out, [32, 32, 63, 63, 16, 235, 63, 63, 184, 102, 123, 240]);
    }
}
