//! The next coarser elevation level: a low-pass filter on posts.
//!
//! Post i of the coarser level is on post 2i of the finer one. Drawing interpolates linearly
//! between posts, which is a second low-pass filter; so the posts are those whose *linear
//! interpolation* is closest to the finer level in the sense of least squares (Unser, Aldroubi,
//! Eden: "The L2 polynomial spline pyramid", IEEE PAMI 1993, degree 1). Against an interpolating
//! half-band filter (`[-1, 0, 9, 16, 9, 0, -1]/32`) the error of height falls by a quarter at every
//! level, as if posts were a third closer, and the picture gains 2 dB at equal cost
//! (docs/quality.md). Where a post under the filter is void, `[1, 2, 1]/4` over the other posts is
//! used. The border is repeated outwards.

use super::BLOCK;
use crate::IngestError;
use crate::sample::elevation::quantized;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::path::Path;

/// Radius of the filter, posts of the finer level.
pub(crate) const REACH: usize = 7;
/// The filter by distance from its middle, 4096ths. It is the impulse response of `(1 + cos w) /
/// (1.5 + 0.5 cos 2w)`, cut where it falls below 1/1000 and rounded so that the sum is 4096 (planes
/// are preserved), and with alternating signs 0 (frequencies beyond the coarser level are removed).
const TAPS: [f32; REACH + 1] = [2904.0, 1201.0, -498.0, -206.0, 85.0, 35.0, -15.0, -6.0];

/// The filter over posts `at(-7)` to `at(7)`.
pub(crate) fn filtered(at: impl Fn(isize) -> f32) -> f32 {
    let pairs = TAPS.iter().zip(0isize..).skip(1).map(|(weight, d)| weight * (at(-d) + at(d)));
    (TAPS[0] * at(0) + pairs.sum::<f32>()) / 4096.0
}

/// Makes the next coarser level of `size` posts.
///
/// # Errors
/// [`IngestError`].
pub fn coarser(finer: &Level<f32>, size: [u64; 2], folder: &Path, work: &Work) -> Result<Level<f32>, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, size).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    work.each(
        "elevation levels",
        blocks.count(),
        || Ok(()),
        |(), index| {
            let block = blocks.rect(index);
            let below = Rect::new(block.origin.map(|v| 2 * v), block.size.map(|n| 2 * n - 1)).grown(REACH);
            let heights = finer.read(below).map_err(fail)?;
            level.write(block, &filter(&heights, below.size[0], block.size)).map_err(fail)
        },
    )?;
    Ok(level)
}

/// Filters a block of the finer level, `REACH` posts wider than the coarser one on each side.
pub(crate) fn filter(fine: &[f32], width: usize, [columns, rows]: [usize; 2]) -> Vec<f32> {
    let height = fine.len() / width;
    // Rows first: every row of the finer block, the columns of the coarser one. A void makes every
    // sum with it NaN.
    let mut across = Vec::with_capacity(columns * height);
    for line in fine.chunks_exact(width) {
        across.extend((0..columns).map(|i| filtered(|d| line[(REACH + 2 * i).wrapping_add_signed(d)])));
    }
    let mut out = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        for i in 0..columns {
            let sum = filtered(|d| across[(REACH + 2 * j).wrapping_add_signed(d) * columns + i]);
            let sum = if sum.is_nan() { filter_around_voids(fine, width, REACH + 2 * i, REACH + 2 * j) } else { sum };
            out.push(quantized(sum));
        }
    }
    out
}

/// `[1, 2, 1]` along both axes over posts that are not void; void if their weights are less than
/// that of a single centre.
fn filter_around_voids(fine: &[f32], width: usize, column: usize, row: usize) -> f32 {
    let (mut sum, mut known) = (0.0, 0.0);
    for (j, down) in [1.0f32, 2.0, 1.0].into_iter().enumerate() {
        for (i, across) in [1.0f32, 2.0, 1.0].into_iter().enumerate() {
            let height = fine[(row + j - 1) * width + column + i - 1];
            if !height.is_nan() {
                sum += down * across * height;
                known += down * across;
            }
        }
    }
    if known >= 4.0 { sum / known } else { f32::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn level(size: [u64; 2], f: impl Fn(usize, usize) -> f32) -> Level<f32> {
        let level = Level::create(&std::env::temp_dir(), size).unwrap();
        let [w, h] = size.map(|v| v as usize);
        let all: Vec<f32> = (0..w * h).map(|k| f(k % w, k / w)).collect();
        level.write(Rect::new([0, 0], [w, h]), &all).unwrap();
        level
    }

    fn coarse(finer: &Level<f32>, size: [u64; 2]) -> Vec<f32> {
        let level = coarser(finer, size, &std::env::temp_dir(), &Work::quiet(2)).unwrap();
        level.read(Rect::new([0, 0], size.map(|v| v as usize))).unwrap()
    }

    #[test]
    fn a_plane_stays_inside_and_a_checkerboard_goes() {
        let plane = level([600, 600], |i, j| i as f32 * 0.5 + j as f32);
        let out = coarse(&plane, [301, 301]);
        for (i, j) in [(4usize, 4usize), (128, 127), (255, 256), (296, 200)] {
            assert_eq!(out[j * 301 + i], i as f32 + 2.0 * j as f32);
        }
        let board = level([64, 64], |i, j| if (i + j) % 2 == 0 { 100.0 } else { -100.0 });
        let out = coarse(&board, [33, 33]);
        assert!(out.iter().skip(33 * 4).take(33 * 20).enumerate().all(|(k, v)| {
            let i = k % 33;
            !(4..29).contains(&i) || v.abs() < 1e-3
        }));
    }

    #[test]
    fn no_other_posts_would_interpolate_nearer_to_the_finer_level() {
        // Least squares: what interpolation leaves over is orthogonal to the hat of every coarser
        // post.
        let rough = |i: usize, j: usize| {
            let hash = (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b);
            (hash.wrapping_mul(0xc2b2_ae35) >> 16) as f32 / 655.36
        };
        let fine = level([129, 129], rough);
        let posts = coarse(&fine, [65, 65]);
        let between = |i: usize, j: usize| {
            let at = |i: usize, j: usize| posts[j * 65 + i];
            let row = |j: usize| 0.5 * (at(i / 2, j) + at(i.div_ceil(2), j));
            0.5 * (row(j / 2) + row(j.div_ceil(2)))
        };
        for (i, j) in [(20usize, 20usize), (32, 40), (50, 11), (33, 33)] {
            let mut product = 0.0;
            for (dj, v) in [0.5f32, 1.0, 0.5].into_iter().enumerate() {
                for (di, u) in [0.5f32, 1.0, 0.5].into_iter().enumerate() {
                    let (x, y) = (2 * i + di - 1, 2 * j + dj - 1);
                    product += u * v * (rough(x, y) - between(x, y));
                }
            }
            assert!(product.abs() < 0.7, "at {i}, {j}: {product} of heights up to 100");
        }
    }

    #[test]
    fn voids_are_masked_not_smeared() {
        let holed = level([33, 33], |i, j| if (10..20).contains(&i) && (10..20).contains(&j) { f32::NAN } else { 7.0 });
        let out = coarse(&holed, [17, 17]);
        let at = |i: usize, j: usize| out[j * 17 + i];
        assert!(at(7, 7).is_nan() && at(6, 8).is_nan());
        assert!(out.iter().all(|v| v.is_nan() || *v == 7.0), "a constant beside a void stays what it is");
        assert_eq!(at(4, 7), 7.0);
    }
}
