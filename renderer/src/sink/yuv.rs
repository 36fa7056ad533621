//! Pictures as Y'CbCr, 8 bits, limited range: 4:4:4 for Y4M, 4:2:0 for films.
//!
//! In integers, so that the bytes are the same everywhere. Pixels are converted in blocks, by loops
//! over arrays that the compiler makes vector instructions of; which ones is chosen when the
//! program runs ([`Instructions`]).

#[cfg(doc)]
use terravision_common::film::FrameEncoding;
use terravision_common::film::{Matrix, Y4M_FRAME, even};
use terravision_common::simd::{Instructions, Simd, Work, prefetch};

/// Pixels of a block: nanoseconds a pixel of 4:4:4 and 4:2:0 by AVX2 are 0.76 and 0.57 with 16, 1.09
/// and 0.60 with 32, 1.01 and 0.68 with 64. One pixel after the other in 64 bits took 1.95.
const BLOCK: usize = 16;
/// How far ahead a row is fetched, bytes: another core has drawn half of a picture, which is not where a
/// processor guesses.
const AHEAD: usize = 2048;
/// Bytes of a block of RGBA.
const BLOCK_BYTES: usize = 4 * BLOCK;

/// A number of each pixel of a block. Numbers wrap around: a sum may pass the largest one, or fall
/// below 0, on the way to what it comes to.
type Numbers = [u32; BLOCK];

/// Bits behind the point. All that comes out fits into the eight bits before it.
const POINT: u32 = 24;

/// What a level of red, green and blue adds to a number of the conversion, and what that begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Factors {
    colors: [u32; 3],
    begin: u32,
}

impl Factors {
    fn of(colors: [i32; 3], begin: u32) -> Self {
        let half = 1 << (POINT - 1);
        Self { colors: colors.map(i32::cast_unsigned), begin: (begin << POINT) + half }
    }

    /// For sums of four pixels.
    fn of_four(self) -> Self {
        Self { colors: self.colors.map(|factor| (factor.cast_signed() >> 2).cast_unsigned()), ..self }
    }

    /// To the nearest.
    #[inline(always)]
    fn apply(&self, r: u32, g: u32, b: u32) -> u8 {
        let [kr, kg, kb] = self.colors;
        let [r, g, b] = [r.wrapping_mul(kr), g.wrapping_mul(kg), b.wrapping_mul(kb)];
        (r.wrapping_add(g).wrapping_add(b).wrapping_add(self.begin) >> POINT) as u8
    }
}

/// A conversion: luma, and blue and red less it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Conversion {
    y: Factors,
    cb: Factors,
    cr: Factors,
}

impl Conversion {
    fn of(matrix: Matrix) -> Self {
        let [kr, kb] = match matrix {
            Matrix::Bt601 => [0.299, 0.114],
            Matrix::Bt709 => [0.2126, 0.0722],
        };
        // Whole shares of four: then factors for sums of four are none but these.
        let fixed = |share: f64| 4 * (share * f64::from(1u32 << (POINT - 2))).round() as i32;
        let luma = |k: f64| fixed(k * 219.0 / 255.0);
        let chroma = |k: f64, from: f64| fixed(-k / (2.0 * (1.0 - from)) * 224.0 / 255.0);
        // Green has what is left: grey is grey, and white as bright as can be.
        let of = |begin: u32, sum: i32, [r, b]: [i32; 2]| Factors::of([r, sum - r - b, b], begin);
        let most = fixed(0.5 * 224.0 / 255.0);
        Self {
            y: of(16, fixed(219.0 / 255.0), [luma(kr), luma(kb)]),
            cb: of(128, 0, [chroma(kr, kb), most]),
            cr: of(128, 0, [most, chroma(kb, kr)]),
        }
    }
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
    let [mut r, mut g, mut b] = [[0; BLOCK]; 3];
    for n in 0..BLOCK {
        let texel = u32::from_le(texels[n]);
        r[n] = texel & 0xff;
        g[n] = (texel >> 8) & 0xff;
        b[n] = (texel >> 16) & 0xff;
    }
    [r, g, b]
}

#[inline(always)]
fn apply(factors: &Factors, [r, g, b]: &[Numbers; 3], out: &mut [u8; BLOCK]) {
    for n in 0..BLOCK {
        out[n] = factors.apply(r[n], g[n], b[n]);
    }
}

/// Cb and Cr of the means of every two pixels above each other and the two beside them.
#[inline(always)]
fn shared_chroma_of(
    [of_cb, of_cr]: &[Factors; 2],
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
        let (r, g, b) = (red_and_blue & 0xffff, green & 0xffff, red_and_blue >> 16);
        cb[n] = of_cb.apply(r, g, b);
        cr[n] = of_cr.apply(r, g, b);
    }
}

/// Pixels to planes of the same size.
struct Full<'a> {
    conversion: Conversion,
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
        let Self { conversion: of, rgba, y, cb, cr } = self;
        let (blocks, rest) = rgba.as_chunks::<BLOCK_BYTES>();
        let (y, y_rest) = y.as_chunks_mut::<BLOCK>();
        let (cb, cb_rest) = cb.as_chunks_mut::<BLOCK>();
        let (cr, cr_rest) = cr.as_chunks_mut::<BLOCK>();
        for (block, ((y, cb), cr)) in blocks.iter().zip(y.iter_mut().zip(cb).zip(cr)) {
            prefetch(block, AHEAD);
            let channels = channels(block);
            apply(&of.y, &channels, y);
            apply(&of.cb, &channels, cb);
            apply(&of.cr, &channels, cr);
        }
        let channels = channels(&filled(rest));
        let [mut y, mut cb, mut cr] = [[0; BLOCK]; 3];
        apply(&of.y, &channels, &mut y);
        apply(&of.cb, &channels, &mut cb);
        apply(&of.cr, &channels, &mut cr);
        for (out, found) in [(y_rest, y), (cb_rest, cb), (cr_rest, cr)] {
            out.copy_from_slice(&found[..out.len()]);
        }
    }
}

/// Two rows of pixels to two rows of Y, with an even number of pixels, and one of each chroma.
struct TwoRows<'a> {
    luma: Factors,
    /// Of blue and red, for sums of four pixels.
    chroma_of_four: [Factors; 2],
    rows: [&'a [u8]; 2],
    y: [&'a mut [u8]; 2],
    chroma: [&'a mut [u8]; 2],
}

impl Work for TwoRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        let Self { luma, chroma_of_four, rows: [upper, lower], y: [upper_y, lower_y], chroma: [cb, cr] } = self;
        let ((upper, upper_rest), (lower, lower_rest)) = (upper.as_chunks(), lower.as_chunks());
        // An odd row may fill the last block of Y, which is even, so that blocks go by the row.
        let (upper_y, upper_y_rest) = upper_y.split_at_mut(BLOCK * upper.len());
        let (lower_y, lower_y_rest) = lower_y.split_at_mut(BLOCK * upper.len());
        let (cb, cb_rest) = cb.split_at_mut(BLOCK / 2 * upper.len());
        let (cr, cr_rest) = cr.split_at_mut(BLOCK / 2 * upper.len());
        let y = upper_y.as_chunks_mut().0.iter_mut().zip(lower_y.as_chunks_mut().0);
        let chroma = cb.as_chunks_mut().0.iter_mut().zip(cr.as_chunks_mut().0);
        for (((upper, lower), (upper_y, lower_y)), (cb, cr)) in upper.iter().zip(lower).zip(y).zip(chroma) {
            prefetch(upper, AHEAD);
            prefetch(lower, AHEAD);
            apply(&luma, &channels(upper), upper_y);
            apply(&luma, &channels(lower), lower_y);
            shared_chroma_of(&chroma_of_four, [upper, lower], cb, cr);
        }
        let (upper, lower) = (filled(upper_rest), filled(lower_rest));
        let ([mut upper_y, mut lower_y], [mut cb, mut cr]) = ([[0; BLOCK]; 2], [[0; BLOCK / 2]; 2]);
        apply(&luma, &channels(&upper), &mut upper_y);
        apply(&luma, &channels(&lower), &mut lower_y);
        shared_chroma_of(&chroma_of_four, [&upper, &lower], &mut cb, &mut cr);
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
    instructions.run(Full { conversion: Conversion::of(Matrix::for_size(size)), rgba, y, cb, cr });
}

/// The planes of a frame of a film, Y, Cb and Cr, from RGBA, into `out`, which has their length
/// ([`FrameEncoding::frame_bytes`]): BT.709, sides even, a last column or row repeated.
pub(super) fn planar_420(instructions: Instructions, size: [u32; 2], rgba: &[u8], out: &mut [u8]) {
    let [width, height] = even(size).map(|side| side as usize);
    let (y, chroma) = out.split_at_mut(width * height);
    let (cb, cr) = chroma.split_at_mut(width * height / 4);
    let Conversion { y: luma, cb: of_cb, cr: of_cr } = Conversion::of(Matrix::Bt709);
    let chroma_of_four = [of_cb, of_cr].map(Factors::of_four);
    let row_bytes = (4 * size[0] as usize).max(1);
    let chroma = cb.chunks_exact_mut((width / 2).max(1)).zip(cr.chunks_exact_mut((width / 2).max(1)));
    let outs = y.chunks_exact_mut((2 * width).max(1)).zip(chroma);
    for (rows, (y, (cb, cr))) in rgba.chunks(2 * row_bytes).zip(outs) {
        let upper = &rows[..row_bytes.min(rows.len())];
        let lower = rows.get(row_bytes..).filter(|lower| !lower.is_empty()).unwrap_or(upper);
        let (upper_y, lower_y) = y.split_at_mut(width);
        instructions.run(TwoRows {
            luma,
            chroma_of_four,
            rows: [upper, lower],
            y: [upper_y, lower_y],
            chroma: [cb, cr],
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Y, Cb and Cr of the mean of pixels, in the widest whole numbers.
    fn converted(matrix: Matrix, pixels: &[[u8; 4]]) -> [u8; 3] {
        let sum = |channel: usize| pixels.iter().map(|pixel| i64::from(pixel[channel])).sum::<i64>();
        let Conversion { y, cb, cr } = Conversion::of(matrix);
        [y, cb, cr].map(|Factors { colors, begin }| {
            let factor = |channel: usize| i64::from(colors[channel].cast_signed());
            let mean: i64 = (0..3).map(|channel| sum(channel) * factor(channel)).sum::<i64>() / pixels.len() as i64;
            u8::try_from((mean + i64::from(begin)) >> POINT).unwrap()
        })
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
    fn every_colour_is_that_of_the_standard_to_the_nearest() {
        for (matrix, [kr, kb]) in [(Matrix::Bt601, [0.299, 0.114]), (Matrix::Bt709, [0.2126, 0.0722])] {
            let of = Conversion::of(matrix);
            for color in 0..1u32 << 15 {
                // All corners, and every eighth level between them.
                let [r, g, b] = [color >> 10, (color >> 5) & 31, color & 31].map(|v| v * 8 + v / 4);
                let luma = kr * f64::from(r) + (1.0 - kr - kb) * f64::from(g) + kb * f64::from(b);
                let chroma = |of: u32, k: f64| 128.0 + (f64::from(of) - luma) / (2.0 * (1.0 - k)) * 224.0 / 255.0;
                let exact = [16.0 + luma * 219.0 / 255.0, chroma(b, kb), chroma(r, kr)];
                for (factors, exact) in [of.y, of.cb, of.cr].iter().zip(exact) {
                    let found = f64::from(factors.apply(r, g, b));
                    assert!((found - exact).abs() < 0.5001, "{r} {g} {b}: {found}, {exact} is exact");
                }
                assert!(r != g || g != b || of.cb.apply(r, g, b) == 128 && of.cr.apply(r, g, b) == 128);
            }
        }
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
