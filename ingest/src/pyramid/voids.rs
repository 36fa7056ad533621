//! Fills voids from coarser levels, the coarsest first (push-pull: Gortler et al., The Lumigraph,
//! 1996).
//!
//! A void post is interpolated from the coarser level by the half-band filter's own `[-1, 9, 9,
//! -1]/16`, then relaxed a few times towards the mean of its neighbours, so that there is no
//! visible crease at the rim of the void.

use super::BLOCK;
use crate::IngestError;
use crate::sample::elevation::quantized;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::path::Path;

/// Number of relaxations, and so the required margin around a block.
const ROUNDS: usize = 6;

/// Fills the voids of the coarsest level with the mean of its posts, or with `otherwise` if all are
/// void.
///
/// # Errors
/// What the file system says.
pub fn fill_coarsest(level: &Level<f32>, otherwise: f32) -> std::io::Result<()> {
    let all = Rect::new([0, 0], level.size().map(|v| v as usize));
    let mut heights = level.read(all)?;
    let known: Vec<f64> = heights.iter().filter(|h| !h.is_nan()).map(|h| f64::from(*h)).collect();
    let mean = if known.is_empty() { otherwise } else { (known.iter().sum::<f64>() / known.len() as f64) as f32 };
    let mean = quantized(mean);
    heights.iter_mut().filter(|h| h.is_nan()).for_each(|h| *h = mean);
    level.write(all, &heights)
}

/// A level with its voids filled from the next coarser level, which has no voids; only in these
/// blocks.
///
/// # Errors
/// [`IngestError`].
pub fn fill(
    level: Level<f32>,
    coarser: &Level<f32>,
    numbers: &[usize],
    folder: &Path,
    work: &Work,
) -> Result<Level<f32>, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    // Written to a new level, so that a block sees its neighbours with their voids, in any order.
    let out = Level::create(folder, level.size()).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    work.each(
        "voids",
        numbers.len(),
        || Ok(()),
        |(), index| {
            let block = blocks.rect(numbers[index]);
            let mut heights = level.read(block).map_err(fail)?;
            if heights.iter().any(|h| h.is_nan()) {
                let around = block.grown(ROUNDS);
                let known = level.read(around).map_err(fail)?;
                heights = filled(&known, around, block, level.size(), coarser).map_err(fail)?;
            }
            out.write(block, &heights).map_err(fail)
        },
    )?;
    Ok(out)
}

fn filled(
    heights: &[f32],
    around: Rect,
    block: Rect,
    level_size: [u64; 2],
    coarser: &Level<f32>,
) -> std::io::Result<Vec<f32>> {
    let width = around.size[0];
    let is_void: Vec<bool> = heights.iter().map(|h| h.is_nan()).collect();
    let mut now = heights.to_vec();
    // Posts beyond the level are copies of its border, and are filled in the same way.
    let inside = |k: usize| {
        [0, 1].map(|a| {
            let at = around.origin[a] + (if a == 0 { k % width } else { k / width }) as i64;
            at.clamp(0, level_size[a] as i64 - 1)
        })
    };
    let first = around.origin.map(|v| v.max(0).div_euclid(2) - 1);
    let coarse_rect = Rect::new(first, around.size.map(|n| n / 2 + 4));
    let coarse = coarser.read(coarse_rect)?;
    let pull = |[x, y]: [i64; 2]| {
        let (column, row) = ((x.div_euclid(2) - first[0]) as usize, (y.div_euclid(2) - first[1]) as usize);
        let across = |row: usize| {
            let line = &coarse[row * coarse_rect.size[0]..];
            if x % 2 == 0 {
                line[column]
            } else {
                (9.0 * (line[column] + line[column + 1]) - line[column - 1] - line[column + 2]) / 16.0
            }
        };
        if y % 2 == 0 {
            across(row)
        } else {
            (9.0 * (across(row) + across(row + 1)) - across(row - 1) - across(row + 2)) / 16.0
        }
    };
    for k in (0..now.len()).filter(|&k| is_void[k]) {
        now[k] = pull(inside(k));
    }
    let mut next = now.clone();
    for round in 1..=ROUNDS {
        for j in round..around.size[1] - round {
            for k in (j * width + round..(j + 1) * width - round).filter(|&k| is_void[k]) {
                next[k] = 0.25 * (now[k - 1] + now[k + 1] + now[k - width] + now[k + width]);
            }
        }
        std::mem::swap(&mut now, &mut next);
    }
    let rows = (0..block.size[1]).map(|j| (j + ROUNDS) * width + ROUNDS);
    Ok(rows.flat_map(|start| now[start..start + block.size[0]].iter().copied().map(quantized)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hole_in_a_plane_becomes_the_plane_and_no_void_is_left() {
        let folder = std::env::temp_dir();
        let plane = |i: usize, j: usize| i as f32 * 2.0 + j as f32;
        let (w, h) = (300usize, 70usize);
        let fine = Level::create(&folder, [w as u64, h as u64]).unwrap();
        let is_hole = |i: usize, j: usize| (240..270).contains(&i) && (20..50).contains(&j);
        let heights: Vec<f32> =
            (0..w * h).map(|k| if is_hole(k % w, k / w) { f32::NAN } else { plane(k % w, k / w) }).collect();
        fine.write(Rect::new([0, 0], [w, h]), &heights).unwrap();
        let coarse = Level::create(&folder, [151, 36]).unwrap();
        let below: Vec<f32> = (0..151 * 36).map(|k| 2.0 * plane(k % 151, k / 151)).collect();
        coarse.write(Rect::new([0, 0], [151, 36]), &below).unwrap();
        let all: Vec<usize> = (0..fine.blocks(BLOCK).count()).collect();
        let filled = fill(fine, &coarse, &all, &folder, &Work::quiet(2)).unwrap();
        let out = filled.read(Rect::new([0, 0], [w, h])).unwrap();
        assert!((0..w * h).all(|k| (out[k] - plane(k % w, k / w)).abs() < 0.02));
    }

    #[test]
    fn the_coarsest_level_gets_its_mean() {
        let level = Level::create(&std::env::temp_dir(), [3, 2]).unwrap();
        let all = Rect::new([0, 0], [3, 2]);
        level.write(all, &[4.0, 6.0, f32::NAN, f32::NAN, f32::NAN, f32::NAN]).unwrap();
        fill_coarsest(&level, 9.0).unwrap();
        assert_eq!(level.read(all).unwrap(), [4.0, 6.0, 5.0, 5.0, 5.0, 5.0]);
        level.write(all, &[f32::NAN; 6]).unwrap();
        fill_coarsest(&level, 9.0).unwrap();
        assert_eq!(level.read(all).unwrap(), [9.0; 6]);
    }
}
