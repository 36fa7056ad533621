//! RGBA8 tiles into BC1: blocks of 4 x 4 texels, each two colours of 5, 6 and 5 bits and four steps
//! between them.
//!
//! ```text
//!  covariance ─▶ main axis ─▶ outermost texels on it ─▶ colours, rounded ─▶ steps
//!                                   least squares over the steps ─▶ colours, rounded ─▶ steps: kept where they are nearer
//! ```
//!
//! The format and its decoding are those of the Khronos Data Format Specification 1.3, section 18.1
//! (the range of four colours, which has no transparent texel). The same bytes come out on every
//! processor: blocks are computed beside each other, in lanes that the compiler maps to vectors, by
//! additions, multiplications and divisions of `f32`, which IEEE 754 defines to the bit; none of
//! them is fused. (Intel's kernels, as the crate `intel_tex_2` has them, are four times as fast,
//! but one block in a hundred differs between processors with and without fused operations, and
//! they need a C++ library.)

use super::{BLOCK_SIDE, TexelFormat};
use std::array::from_fn;

/// Blocks that are computed in parallel lanes.
const LANES: usize = 8;
/// Texels of a block.
const TEXELS: usize = 16;
/// Bytes of a block.
const BLOCK_BYTES: usize = 8;
/// Largest values of red, green and blue in a block's colours.
const TOPS: [f32; 3] = [31.0, 63.0, 31.0];
/// Multiplications by the covariance that turn its largest row into the main axis, nearly.
const AXIS_ROUNDS: usize = 3;

/// One number of each block.
type Lane = [f32; LANES];
/// Red, green and blue of the texels, 0 to 255.
type Block = [[Lane; TEXELS]; 3];
/// The two colours, red, green and blue in the units of [`TOPS`].
type Ends = [[Lane; 3]; 2];
/// For each texel, the number of thirds from the first colour to the second.
type Steps = [Lane; TEXELS];

/// Compresses a decoded tile, `side` texels wide with its border: RGBA8 mip levels back to back
/// become BC1 levels back to back ([`TexelFormat::mips`]). Alpha is dropped; tiles are opaque.
///
/// # Panics
/// When `rgba` or `out` is shorter than a tile.
pub fn compress_tile(rgba: &[u8], side: u32, out: &mut [u8]) {
    for (from, to) in TexelFormat::Rgba8.mips(side).zip(TexelFormat::Bc1.mips(side)) {
        let texels = &rgba[from.offset as usize..][..from.bytes as usize];
        compress_level(texels, from.side as usize, &mut out[to.offset as usize..][..to.bytes as usize]);
    }
}

fn compress_level(rgba: &[u8], side: usize, out: &mut [u8]) {
    let columns = side.div_ceil(BLOCK_SIDE as usize);
    let mut block: Block = [[[0.0; LANES]; TEXELS]; 3];
    for (group, out) in out.chunks_mut(LANES * BLOCK_BYTES).enumerate() {
        for lane in 0..out.len() / BLOCK_BYTES {
            let index = group * LANES + lane;
            load(rgba, side, [index % columns, index / columns], lane, &mut block);
        }
        // Lanes without a block keep the texels of an earlier one; their results are not used.
        let (ends, steps) = fit(&block);
        for (lane, out) in out.chunks_exact_mut(BLOCK_BYTES).enumerate() {
            out.copy_from_slice(&bits(&ends, &steps, lane).to_le_bytes());
        }
    }
}

/// Loads the texels of a block; beyond the picture, its last texels are repeated.
fn load(rgba: &[u8], side: usize, [column, row]: [usize; 2], lane: usize, block: &mut Block) {
    let mut set = |texel: usize, rgba: &[u8]| {
        for channel in 0..3 {
            block[channel][texel][lane] = f32::from(rgba[channel]);
        }
    };
    for y in 0..4 {
        let start = ((row * 4 + y).min(side - 1) * side + column * 4) * 4;
        if let Some(texels) = rgba.get(start..start + 16).filter(|_| column * 4 + 4 <= side) {
            for (x, texel) in texels.chunks_exact(4).enumerate() {
                set(y * 4 + x, texel);
            }
        } else {
            for x in 0..4 {
                let beyond = (column * 4 + x).saturating_sub(side - 1);
                set(y * 4 + x, &rgba[start + (x - beyond) * 4..][..4]);
            }
        }
    }
}

/// The encoded block: the colours, the larger one first, which selects the mode with four colours;
/// then two bits per texel.
fn bits(ends: &Ends, steps: &Steps, lane: usize) -> u64 {
    let [first, second] = ends.each_ref().map(|[r, g, b]| {
        let [r, g, b] = [r, g, b].map(|channel| channel[lane] as u64);
        r << 11 | g << 5 | b
    });
    if first == second {
        // A single colour, which all codes but the last mean: code 0 is one of these.
        return first | second << 16;
    }
    // Four bits a step: 0 means the larger colour, 1 the smaller, 2 and 3 what is a third and two
    // thirds of the way.
    let codes: u64 = if first > second { 0x1320 } else { 0x0231 };
    let code = |step: f32| (codes >> (4 * step as u32)) & 3;
    let picked = steps.iter().enumerate().fold(0, |picked, (texel, step)| picked | code(step[lane]) << (2 * texel));
    first.max(second) | first.min(second) << 16 | picked << 32
}

/// Colours and steps for the texels.
fn fit(block: &Block) -> (Ends, Steps) {
    let mut ends = outermost(block);
    let (mut steps, mut error) = nearest(block, &ends);
    let refined = least_squares(block, &steps, &ends);
    let (new_steps, new_error) = nearest(block, &refined);
    let is_better: [bool; LANES] = from_fn(|l| new_error[l] < error[l]);
    let take = |old: &mut Lane, new: &Lane| *old = from_fn(|l| if is_better[l] { new[l] } else { old[l] });
    steps.iter_mut().zip(&new_steps).for_each(|(old, new)| take(old, new));
    ends.as_flattened_mut().iter_mut().zip(refined.as_flattened()).for_each(|(old, new)| take(old, new));
    take(&mut error, &new_error);
    (ends, steps)
}

/// The colours of the texels that lie farthest apart on the main axis of all.
fn outermost(block: &Block) -> Ends {
    let mean: [Lane; 3] = from_fn(|c| total(|k, l| block[c][k][l]).map(|sum| sum / TEXELS as f32));
    let off = |c: usize, k: usize, l: usize| block[c][k][l] - mean[c][l];
    let covariance = |a: usize, b: usize| total(|k, l| off(a, k, l) * off(b, k, l));
    let (rr, rg, rb) = (covariance(0, 0), covariance(0, 1), covariance(0, 2));
    let (gg, gb, bb) = (covariance(1, 1), covariance(1, 2), covariance(2, 2));
    // The row of the channel that varies most; for a single colour the axis is zero, and so are all
    // distances along it.
    let largest = |r: &Lane, g: &Lane, b: &Lane| -> Lane {
        from_fn(|l| {
            if rr[l] >= gg[l] && rr[l] >= bb[l] {
                r[l]
            } else if gg[l] >= bb[l] {
                g[l]
            } else {
                b[l]
            }
        })
    };
    let mut axis = [largest(&rr, &rg, &rb), largest(&rg, &gg, &gb), largest(&rb, &gb, &bb)];
    // Keeps numbers small, and avoids divisions by zero.
    let scale: Lane = from_fn(|l| 1.0 / (rr[l] + gg[l] + bb[l] + 1e-6));
    for _ in 0..AXIS_ROUNDS {
        let [x, y, z] = axis.map(|lane| from_fn::<f32, LANES, _>(|l| lane[l] * scale[l]));
        let row = |r: &Lane, g: &Lane, b: &Lane| from_fn(|l| r[l] * x[l] + g[l] * y[l] + b[l] * z[l]);
        axis = [row(&rr, &rg, &rb), row(&rg, &gg, &gb), row(&rb, &gb, &bb)];
    }
    let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
    for k in 0..TEXELS {
        for l in 0..LANES {
            let along = off(0, k, l) * axis[0][l] + off(1, k, l) * axis[1][l] + off(2, k, l) * axis[2][l];
            low[l] = if along < low[l] { along } else { low[l] };
            high[l] = if along > high[l] { along } else { high[l] };
        }
    }
    let per_length: Lane =
        from_fn(|l| 1.0 / (axis[0][l] * axis[0][l] + axis[1][l] * axis[1][l] + axis[2][l] * axis[2][l] + 1e-12));
    [low, high]
        .map(|along| from_fn(|c| from_fn(|l| rounded(mean[c][l] + axis[c][l] * along[l] * per_length[l], TOPS[c]))))
}

/// For each texel the nearest step; and the sum of squared errors.
fn nearest(block: &Block, ends: &Ends) -> (Steps, Lane) {
    let start: [Lane; 3] = from_fn(|c| ends[0][c].map(|value| value * (255.0 / TOPS[c])));
    let way: [Lane; 3] = from_fn(|c| from_fn(|l| ends[1][c][l] * (255.0 / TOPS[c]) - start[c][l]));
    let per_length: Lane = from_fn(|l| {
        let squared = way[0][l] * way[0][l] + way[1][l] * way[1][l] + way[2][l] * way[2][l];
        if squared > 0.0 { 3.0 / squared } else { 0.0 }
    });
    let (mut steps, mut error) = ([[0.0; LANES]; TEXELS], [0.0; LANES]);
    for k in 0..TEXELS {
        for l in 0..LANES {
            let off: [f32; 3] = from_fn(|c| block[c][k][l] - start[c][l]);
            let along = (off[0] * way[0][l] + off[1] * way[1][l] + off[2] * way[2][l]) * per_length[l];
            let step = whole(within(along, 3.0));
            let left: [f32; 3] = from_fn(|c| off[c] - step * (way[c][l] * (1.0 / 3.0)));
            steps[k][l] = step;
            error[l] += left[0] * left[0] + left[1] * left[1] + left[2] * left[2];
        }
    }
    (steps, error)
}

/// The colours that fit these steps best; `ends` where all steps are the same.
fn least_squares(block: &Block, steps: &Steps, ends: &Ends) -> Ends {
    let rest = |k: usize, l: usize| 3.0 - steps[k][l];
    let first = total(|k, l| rest(k, l) * rest(k, l));
    let both = total(|k, l| rest(k, l) * steps[k][l]);
    let second = total(|k, l| steps[k][l] * steps[k][l]);
    let determinant: Lane = from_fn(|l| first[l] * second[l] - both[l] * both[l]);
    let mut fitted = *ends;
    for c in 0..3 {
        let to_first = total(|k, l| rest(k, l) * block[c][k][l]);
        let to_second = total(|k, l| steps[k][l] * block[c][k][l]);
        for l in 0..LANES {
            let scale = 3.0 / determinant[l];
            let colors = [
                rounded((second[l] * to_first[l] - both[l] * to_second[l]) * scale, TOPS[c]),
                rounded((first[l] * to_second[l] - both[l] * to_first[l]) * scale, TOPS[c]),
            ];
            for (fitted, color) in fitted.iter_mut().zip(colors) {
                fitted[c][l] = if determinant[l] > 0.0 { color } else { fitted[c][l] };
            }
        }
    }
    fitted
}

/// Sums over the texels of each block.
#[inline(always)]
fn total(value: impl Fn(usize, usize) -> f32) -> Lane {
    let mut sums = [0.0; LANES];
    for k in 0..TEXELS {
        for (l, sum) in sums.iter_mut().enumerate() {
            *sum += value(k, l);
        }
    }
    sums
}

/// Converts a channel from 0..255 to 0..`top`, rounded.
#[inline(always)]
fn rounded(channel: f32, top: f32) -> f32 {
    whole(within(channel * (top / 255.0), top))
}

/// Clamps to 0..`top`, with comparisons that vectorize, unlike `clamp`. NaN becomes 0.
#[inline(always)]
fn within(value: f32, top: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < top { value } else { top }
}

/// Rounds a small number to the nearest integer (ties to even): the sum has no bits for the
/// fraction.
#[inline(always)]
fn whole(value: f32) -> f32 {
    const ONES: f32 = 12_582_912.0; // 1.5 * 2^23
    (value + ONES) - ONES
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The colours of a block, as specified.
    fn decoded(block: &[u8]) -> [[f64; 3]; TEXELS] {
        let number = |at: usize| u16::from_le_bytes([block[at], block[at + 1]]);
        let [a, b] = [number(0), number(2)].map(|c| {
            [f64::from(c >> 11) / 31.0, f64::from(c >> 5 & 63) / 63.0, f64::from(c & 31) / 31.0].map(|v| v * 255.0)
        });
        assert!(number(0) >= number(2), "the range of three colours has a black one");
        let picked = u32::from_le_bytes([block[4], block[5], block[6], block[7]]);
        assert!(number(0) > number(2) || picked == 0);
        let mixed = |t: f64| from_fn(|c| a[c] + (b[c] - a[c]) * t);
        let colors = [a, b, mixed(1.0 / 3.0), mixed(2.0 / 3.0)];
        from_fn(|texel| colors[(picked >> (2 * texel) & 3) as usize])
    }

    /// A level and back: RGB.
    fn round_trip(rgba: &[u8], side: usize) -> Vec<[f64; 3]> {
        let columns = side.div_ceil(4);
        let mut blocks = vec![0; columns * columns * BLOCK_BYTES];
        compress_level(rgba, side, &mut blocks);
        let texel = |x: usize, y: usize| {
            decoded(&blocks[(y / 4 * columns + x / 4) * BLOCK_BYTES..][..BLOCK_BYTES])[y % 4 * 4 + x % 4]
        };
        (0..side * side).map(|i| texel(i % side, i / side)).collect()
    }

    fn picture(side: usize, color: impl Fn(usize, usize) -> [u8; 3]) -> Vec<u8> {
        let rgb = (0..side * side).map(|i| color(i % side, i / side));
        rgb.flat_map(|[r, g, b]| [r, g, b, 255]).collect()
    }

    fn worst(rgba: &[u8], out: &[[f64; 3]]) -> f64 {
        let pairs = rgba.chunks_exact(4).zip(out);
        pairs.flat_map(|(a, b)| (0..3).map(|c| (f64::from(a[c]) - b[c]).abs())).fold(0.0, f64::max)
    }

    #[test]
    fn colours_that_a_block_can_have_come_back() {
        // White to black in thirds, and a single colour of each kind.
        let ramp = picture(4, |x, _| [85 * x as u8; 3]);
        assert!(worst(&ramp, &round_trip(&ramp, 4)) < 1e-3);
        for color in [[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 0, 255]] {
            let flat = picture(4, |_, _| color);
            assert!(worst(&flat, &round_trip(&flat, 4)) < 1e-3, "{color:?}");
        }
        let grey = picture(4, |_, _| [100, 50, 155]);
        assert!(worst(&grey, &round_trip(&grey, 4)) <= 255.0 / 62.0);
    }

    #[test]
    fn sides_that_are_no_multiple_of_a_block_keep_their_last_texels() {
        // Texels beyond the picture must not affect those within: two columns and two rows of a
        // separate colour are encoded as well as any flat colour.
        for side in [6, 66] {
            let rgba = picture(side, |x, y| if x >= side - 2 || y >= side - 2 { [255, 0, 0] } else { [0, 0, 255] });
            assert!(worst(&rgba, &round_trip(&rgba, side)) < 1e-3, "{side}");
        }
    }

    #[test]
    fn every_level_of_a_tile_is_compressed_where_the_layout_says() {
        let side = 24;
        let mut rgba = Vec::new();
        for (mip, color) in TexelFormat::Rgba8.mips(side).zip([[255, 0, 0], [0, 255, 0], [0, 0, 255]]) {
            rgba.extend(picture(mip.side as usize, |_, _| color));
        }
        let bytes = TexelFormat::Bc1.tile_bytes(side) as usize;
        let mut out = vec![0xaa; bytes + 8];
        compress_tile(&rgba, side, &mut out);
        assert_eq!(out[bytes..], [0xaa; 8]);
        for (mip, color) in TexelFormat::Bc1.mips(side).zip([0xf800u64, 0x07e0, 0x001f]) {
            let blocks = &out[mip.offset as usize..][..mip.bytes as usize];
            assert!(blocks.chunks_exact(8).all(|block| block == (color | color << 16).to_le_bytes()));
        }
    }

    #[test]
    fn a_natural_picture_loses_little() {
        // Two tones with grain: what ground looks like.
        let grain = |x: usize, y: usize| ((x * 7919 + y * 104_729 + x * y * 31) % 29) as f64 - 14.0;
        let rgba = picture(264, |x, y| {
            let tone = ((x as f64 * 0.05).sin() * (y as f64 * 0.04).cos() + 1.0) / 2.0;
            [90.0 + 80.0 * tone, 100.0 + 30.0 * tone, 60.0 + 60.0 * tone].map(|v| (v + grain(x, y)) as u8)
        });
        let out = round_trip(&rgba, 264);
        let squares =
            rgba.chunks_exact(4).zip(&out).flat_map(|(a, b)| (0..3).map(|c| (f64::from(a[c]) - b[c]).powi(2)));
        let psnr = 10.0 * (255.0f64.powi(2) / (squares.sum::<f64>() / (3.0 * 264.0 * 264.0))).log10();
        assert!(psnr > 37.0, "{psnr} dB");
    }

    #[test]
    fn the_bytes_are_the_same_on_every_processor() {
        let noise = |i: usize| (i.wrapping_mul(2_654_435_761) >> 7) as u8;
        let rgba = picture(66, |x, y| [0, 1, 2].map(|c| noise(c + 3 * (x / 3 + 41 * y)) / 3 + (x + y) as u8));
        let mut blocks = vec![0; TexelFormat::Bc1.square_bytes(66) as usize];
        compress_level(&rgba, 66, &mut blocks);
        assert_eq!(crc32fast::hash(&blocks), 0x0da8_0bcf);
    }

    proptest! {
        #[test]
        fn a_block_is_never_worse_than_its_mean(texels in prop::array::uniform16(any::<[u8; 3]>())) {
            let rgba = picture(4, |x, y| texels[y * 4 + x]);
            let out = round_trip(&rgba, 4);
            let mean: [f64; 3] = from_fn(|c| texels.iter().map(|t| f64::from(t[c])).sum::<f64>() / 16.0);
            let squares = |of: &dyn Fn(usize, usize) -> f64| -> f64 {
                (0..48).map(|i| (f64::from(texels[i / 3][i % 3]) - of(i / 3, i % 3)).powi(2)).sum()
            };
            let (ours, flat) = (squares(&|k, c| out[k][c]), squares(&|_, c| mean[c]));
            // The mean itself is rounded to 5, 6 and 5 bits.
            prop_assert!(ours <= flat + 16.0 * (4.2 * 4.2 + 2.1 * 2.1 + 4.2 * 4.2), "{ours} {flat}");
        }
    }
}
