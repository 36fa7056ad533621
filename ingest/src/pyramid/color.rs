//! The next coarser colour level: a half-band filter between cells.
//!
//! Texel i of the coarser level covers texels 2i and 2i + 1 of the finer one. Eight taps, Lanczos'
//! window of two lobes widened by two (`sinc(x/2)·sinc(x/4)` at ±0.5, ±1.5, ±2.5, ±3.5), in 128ths,
//! in whole numbers: the same everywhere.

use super::BLOCK;
use crate::IngestError;
use crate::store::{Level, Rect, Rgb};
use crate::work::Work;
use std::path::Path;

/// Taps on one side of the middle, 256ths: both sides sum to 256.
const TAPS: [i32; 4] = [111, 30, -11, -2];
/// How far the filter reaches beyond the two texels that it covers.
pub(crate) const REACH: usize = 3;

/// Makes the next coarser level of `size` texels.
///
/// # Errors
/// [`IngestError`].
pub fn coarser(finer: &Level<Rgb>, size: [u64; 2], folder: &Path, work: &Work) -> Result<Level<Rgb>, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, size).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    work.each(
        "colour levels",
        blocks.count(),
        || Ok(()),
        |(), index| {
            let block = blocks.rect(index);
            let below = Rect::new(block.origin.map(|v| 2 * v), block.size.map(|n| 2 * n)).grown(REACH);
            let texels = finer.read(below).map_err(fail)?;
            level.write(block, &filter(&texels, below.size[0], block.size)).map_err(fail)
        },
    )?;
    Ok(level)
}

pub(crate) fn filter(fine: &[Rgb], width: usize, [columns, rows]: [usize; 2]) -> Vec<Rgb> {
    let height = fine.len() / width;
    let mut across = Vec::with_capacity(columns * height);
    for line in fine.chunks_exact(width) {
        across.extend((0..columns).map(|i| {
            let around: &[Rgb] = &line[2 * i..2 * i + 8];
            [0, 1, 2].map(|c| {
                (0..4).map(|t| TAPS[t] * (i32::from(around[3 - t][c]) + i32::from(around[4 + t][c]))).sum::<i32>()
            })
        }));
    }
    let mut out = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        for i in 0..columns {
            let at = |k: usize| across[(2 * j + k) * columns + i];
            out.push([0, 1, 2].map(|c| {
                let sum: i32 = (0..4).map(|t| TAPS[t] * (at(3 - t)[c] + at(4 + t)[c])).sum();
                ((sum + (1 << 15)) >> 16).clamp(0, 255) as u8
            }));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coarse(size: [u64; 2], f: impl Fn(usize, usize) -> u8) -> Vec<Rgb> {
        let finer = Level::create(&std::env::temp_dir(), size).unwrap();
        let [w, h] = size.map(|v| v as usize);
        let all: Vec<Rgb> = (0..w * h).map(|k| [f(k % w, k / w); 3]).collect();
        finer.write(Rect::new([0, 0], [w, h]), &all).unwrap();
        let size = size.map(|v| v.div_ceil(2));
        let level = coarser(&finer, size, &std::env::temp_dir(), &Work::quiet(2)).unwrap();
        level.read(Rect::new([0, 0], size.map(|v| v as usize))).unwrap()
    }

    #[test]
    fn constants_and_ramps_stay_and_the_finest_stripes_go() {
        assert_eq!(2 * TAPS.iter().sum::<i32>(), 256);
        assert!(coarse([601, 35], |_, _| 200).iter().all(|t| *t == [200; 3]));
        let ramp = coarse([120, 16], |i, _| (2 * i) as u8);
        assert!((2..58).all(|i| (i32::from(ramp[i][0]) - (4 * i as i32 + 1)).abs() <= 1));
        let stripes = coarse([64, 64], |i, _| if i % 2 == 0 { 0 } else { 255 });
        assert!(stripes.iter().all(|t| t[0].abs_diff(127) <= 3 || t[0].abs_diff(127) > 0));
        let inner: Vec<_> = stripes.chunks(32).flat_map(|row| &row[2..30]).collect();
        assert!(inner.iter().all(|t| t[0].abs_diff(128) <= 1), "{inner:?}");
    }
}
