//! Which posts were measured, which were made up, and which are holes: for all levels, from the
//! voids of the finest one.
//!
//! `[ground, measured]` of each post, in 255ths (`terravision_common::validity`). On the finest
//! level they are 0 or 255. Coarser levels are filtered by `[1, 2, 1]` along both axes: the
//! narrowest filter that keeps a straight rim in place, so that no rim moves by more than a
//! fraction of the finer posts' distance from level to level.

use super::BLOCK;
use crate::IngestError;
use crate::sample::corners::Post;
use crate::sample::elevation::is_outside;
use crate::store::{Blocks, Level, Rect};
use crate::work::Work;
use std::collections::{BTreeSet, VecDeque};
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use terravision_common::database::Voids;

/// Shares of a post: ground, and measured.
pub type Shares = [u8; 2];

const MEASURED: Shares = [255, 255];
const MADE_UP: Shares = [255, 0];
const HOLE: Shares = [0, 0];

/// Beyond all files, while rims spread: rims do not spread there, and it becomes a hole.
const BEYOND: Shares = [0, 255];
/// Posts without a file in fewer than this many columns or rows are not beyond all files, but a gap
/// between two files: adjacent sheets may be off by a fraction of a pixel.
const THREAD: usize = 3;

/// The finest level's shares, from its heights, which are NaN in voids; and how many posts are
/// holes. With [`Voids::Clip`] a rim begins at `corners`.
///
/// # Errors
/// [`IngestError`].
pub(crate) fn finest(
    heights: &Level<f32>,
    voids: Voids,
    corners: &BTreeSet<Post>,
    folder: &Path,
    work: &Work,
) -> Result<(Level<Shares>, u64), IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, heights.size()).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    let holes = AtomicU64::new(0);
    let with_beyond = Mutex::new(BTreeSet::new());
    work.each(
        "voids",
        blocks.count(),
        || Ok(()),
        |(), index| {
            let block = blocks.rect(index);
            let reach = THREAD - 1;
            let heights = heights.read(block.grown(reach)).map_err(fail)?;
            let is_beyond = if voids == Voids::Clip { beyond(&heights, block) } else { Vec::new() };
            let width = block.size[0] + 2 * reach;
            let share = |k: usize| {
                let height = heights[(k / block.size[0] + reach) * width + k % block.size[0] + reach];
                match voids {
                    _ if !height.is_nan() => MEASURED,
                    Voids::Clip if is_beyond.get(k) == Some(&true) => BEYOND,
                    Voids::Keep => HOLE,
                    Voids::Clip | Voids::Fill => MADE_UP,
                }
            };
            let shares: Vec<Shares> = (0..block.area()).map(share).collect();
            let [kept, beyond] = [HOLE, BEYOND].map(|wanted| shares.iter().filter(|share| **share == wanted).count());
            // Relaxed: only the sum is taken, when the threads have been joined.
            holes.fetch_add((kept + beyond) as u64, Ordering::Relaxed);
            if beyond > 0 {
                with_beyond.lock().unwrap_or_else(PoisonError::into_inner).insert(index);
            }
            level.write(block, &shares).map_err(fail)
        },
    )?;
    let mut holes = holes.into_inner();
    if voids == Voids::Clip {
        holes += clip(&level, blocks, corners, folder, work)?;
        for index in with_beyond.into_inner().unwrap_or_else(PoisonError::into_inner) {
            let block = blocks.rect(index);
            let mut shares = level.read(block).map_err(fail)?;
            shares.iter_mut().filter(|share| **share == BEYOND).for_each(|share| *share = HOLE);
            level.write(block, &shares).map_err(fail)?;
        }
    }
    Ok((level, holes))
}

/// Which posts of a block lie beyond all files, without narrow gaps; empty when none do. `heights`
/// are those of the block and of `THREAD - 1` posts around.
fn beyond(heights: &[f32], block: Rect) -> Vec<bool> {
    let shrunk = |size: [usize; 2]| size.map(|n| n + 1 - THREAD);
    // First erosion (all posts of a square), then dilation (any post of a square).
    let squares = |is: &[bool], size: [usize; 2], all: bool| -> Vec<bool> {
        let [columns, rows] = shrunk(size);
        let square = |k: usize| {
            let first = k / columns * size[0] + k % columns;
            let mut rows = (0..THREAD).map(|row| &is[first + row * size[0]..][..THREAD]);
            if all { rows.all(|row| row.iter().all(|is| *is)) } else { rows.any(|row| row.contains(&true)) }
        };
        (0..columns * rows).map(square).collect()
    };
    if !heights.iter().any(|height| is_outside(*height)) {
        return Vec::new();
    }
    let size = block.grown(THREAD - 1).size;
    let is_outside: Vec<bool> = heights.iter().map(|height| is_outside(*height)).collect();
    // Morphological opening.
    squares(&squares(&is_outside, size, true), shrunk(size), false)
}

/// Turns all made-up posts that are connected to one of the corners (by edges) into holes. Returns
/// their number. The rim of a raster that was warped, rotated or cut along an outline contains a
/// corner; a gap in the data that reaches a side does not.
///
/// Works block by block: if a block changes at a side, its neighbour is processed again, until
/// nothing changes. The result does not depend on the order.
fn clip(
    level: &Level<Shares>,
    blocks: Blocks,
    corners: &BTreeSet<Post>,
    folder: &Path,
    work: &Work,
) -> Result<u64, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let columns = level.size()[0].div_ceil(BLOCK as u64) as usize;
    let rows = blocks.count() / columns;
    let block_of = |[x, y]: &Post| (y / BLOCK as u64) as usize * columns + (x / BLOCK as u64) as usize;
    let mut open: BTreeSet<usize> = corners.iter().map(block_of).collect();
    let mut holes = 0;
    while let Some(index) = open.pop_first() {
        work.check()?;
        let Spread { count, sides } = spread(level, blocks.rect(index), corners).map_err(fail)?;
        holes += count;
        let [west, east, south, north] = sides;
        let at = [index % columns, index / columns];
        open.extend((west && at[0] > 0).then(|| index - 1));
        open.extend((east && at[0] + 1 < columns).then_some(index + 1));
        open.extend((south && at[1] > 0).then(|| index - columns));
        open.extend((north && at[1] + 1 < rows).then_some(index + columns));
    }
    Ok(holes)
}

/// The result for a block.
struct Spread {
    /// Posts that became holes.
    count: u64,
    /// Whether some of them are at the west, east, south and north side.
    sides: [bool; 4],
}

/// Spreads holes within a block, from corners and from holes around the block.
fn spread(level: &Level<Shares>, block: Rect, corners: &BTreeSet<Post>) -> io::Result<Spread> {
    let [columns, rows] = block.size;
    let around = block.grown(1);
    let width = around.size[0];
    let mut shares = level.read(around)?;
    let mut open: VecDeque<[usize; 2]> = VecDeque::new();
    for j in 1..=rows {
        for i in 1..=columns {
            let at = j * width + i;
            let post = [(0, i), (1, j)].map(|(axis, k)| block.origin[axis] as u64 + k as u64 - 1);
            let is_beside_hole = || [at - 1, at + 1, at - width, at + width].into_iter().any(|at| shares[at] == HOLE);
            if shares[at] == MADE_UP && (is_beside_hole() || corners.contains(&post)) {
                open.push_back([i, j]);
            }
        }
    }
    let mut spread = Spread { count: 0, sides: [false; 4] };
    while let Some([i, j]) = open.pop_front() {
        let is_inside = (1..=columns).contains(&i) && (1..=rows).contains(&j);
        if !is_inside || shares[j * width + i] != MADE_UP {
            continue;
        }
        shares[j * width + i] = HOLE;
        spread.count += 1;
        let at_sides = [i == 1, i == columns, j == 1, j == rows];
        spread.sides.iter_mut().zip(at_sides).for_each(|(side, at_side)| *side |= at_side);
        open.extend([[i - 1, j], [i + 1, j], [i, j - 1], [i, j + 1]]);
    }
    if spread.count > 0 {
        let inner: Vec<Shares> = (1..=rows).flat_map(|j| &shares[j * width + 1..][..columns]).copied().collect();
        level.write(block, &inner)?;
    }
    Ok(spread)
}

/// Makes the next coarser level of `size` posts.
///
/// # Errors
/// [`IngestError`].
pub fn coarser(
    finer: &Level<Shares>,
    size: [u64; 2],
    folder: &Path,
    work: &Work,
) -> Result<Level<Shares>, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let level = Level::create(folder, size).map_err(fail)?;
    let blocks = level.blocks(BLOCK);
    work.each(
        "voids",
        blocks.count(),
        || Ok(()),
        |(), index| {
            let block = blocks.rect(index);
            let below = Rect::new(block.origin.map(|v| 2 * v), block.size.map(|n| 2 * n - 1)).grown(1);
            let fine = finer.read(below).map_err(fail)?;
            level.write(block, &filter(&fine, below.size[0], block.size)).map_err(fail)
        },
    )?;
    Ok(level)
}

fn filter(fine: &[Shares], width: usize, [columns, rows]: [usize; 2]) -> Vec<Shares> {
    const WEIGHTS: [u32; 3] = [1, 2, 1];
    let mut out = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        for i in 0..columns {
            let mut sums = [8u32; 2];
            for (down, v) in WEIGHTS.into_iter().enumerate() {
                for (across, u) in WEIGHTS.into_iter().enumerate() {
                    let share = fine[(2 * j + down) * width + 2 * i + across];
                    sums[0] += u * v * u32::from(share[0]);
                    sums[1] += u * v * u32::from(share[1]);
                }
            }
            out.push(sums.map(|sum| (sum / 16) as u8));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heights(size: [u64; 2], is_void: impl Fn(usize, usize) -> bool) -> Level<f32> {
        let level = Level::create(&std::env::temp_dir(), size).unwrap();
        let [w, h] = size.map(|v| v as usize);
        let all: Vec<f32> = (0..w * h).map(|k| if is_void(k % w, k / w) { f32::NAN } else { 5.0 }).collect();
        level.write(Rect::new([0, 0], [w, h]), &all).unwrap();
        level
    }

    fn shares(level: &Level<Shares>) -> Vec<Shares> {
        level.read(Rect::new([0, 0], level.size().map(|v| v as usize))).unwrap()
    }

    fn corners_of(size: [u64; 2]) -> BTreeSet<Post> {
        let [x, y] = size.map(|n| n - 1);
        BTreeSet::from([[0, 0], [x, 0], [0, y], [x, y]])
    }

    /// Shares as asked, holes beginning at the level's corners.
    fn cut(level: &Level<f32>, voids: Voids, threads: usize) -> (Level<Shares>, u64) {
        finest(level, voids, &corners_of(level.size()), &std::env::temp_dir(), &Work::quiet(threads)).unwrap()
    }

    /// A spiral of one post's width from a corner into the middle of many blocks, and a lake that
    /// it does not touch.
    fn is_spiral(i: usize, j: usize) -> bool {
        let (x, y) = (i as i64 - 400, j as i64 - 400);
        let ring = x.abs().max(y.abs());
        ring % 40 == 39 && !(x == -ring && y.abs() < 5) || x == -(ring) && y == 6 && ring > 30 || x == -400 && y >= 6
    }

    #[test]
    fn what_reaches_a_corner_is_clipped_and_lakes_and_bays_are_filled_in_any_number_of_threads() {
        let size = [801u64, 801];
        // A comb: a row along the border to a corner, teeth across all blocks, joined far from it;
        // a lake between two teeth; and a gap that reaches a side and no corner.
        let is_bay = |i: usize, j: usize| i < 5 && (300..310).contains(&j);
        let is_lake = |i: usize, j: usize| (300..310).contains(&i) && (405..415).contains(&j) || is_bay(i, j);
        let is_comb = |i: usize, j: usize| {
            let tooth = i % 100 == 50 && i < 780;
            tooth && (1..790).contains(&j) || j == 790 && (50..760).contains(&i) || i >= 750 && j == 0
        };
        let level = heights(size, |i, j| is_lake(i, j) || is_comb(i, j));
        let (clipped, holes) = cut(&level, Voids::Clip, 3);
        let mut wanted = 0;
        for (k, share) in shares(&clipped).into_iter().enumerate() {
            let (i, j) = (k % 801, k / 801);
            let expected = if is_comb(i, j) {
                HOLE
            } else if is_lake(i, j) {
                MADE_UP
            } else {
                MEASURED
            };
            wanted += u64::from(is_comb(i, j));
            assert_eq!(share, expected, "at {i}, {j}");
        }
        assert_eq!(holes, wanted);
        let (kept, holes) = cut(&level, Voids::Keep, 1);
        assert_eq!(holes, wanted + 100 + 50);
        assert!(shares(&kept).iter().all(|share| *share == MEASURED || *share == HOLE));
        let (filled, holes) = cut(&level, Voids::Fill, 1);
        assert_eq!(holes, 0);
        assert!(shares(&filled).iter().all(|share| *share == MEASURED || *share == MADE_UP));
    }

    #[test]
    fn spirals_are_followed_to_their_end() {
        let level = heights([801, 801], is_spiral);
        let (clipped, holes) = cut(&level, Voids::Clip, 2);
        // The same by one flood over the whole level.
        let mut whole: Vec<bool> = (0..801 * 801).map(|k| is_spiral(k % 801, k / 801)).collect();
        let mut open: Vec<usize> =
            (0..801 * 801).filter(|k| [k % 801, k / 801].into_iter().all(|v| v == 0 || v == 800)).collect();
        let mut expected = vec![false; 801 * 801];
        while let Some(k) = open.pop() {
            if std::mem::take(&mut whole[k]) {
                expected[k] = true;
                let (i, j) = (k % 801, k / 801);
                open.extend((i > 0).then(|| k - 1).into_iter().chain((i < 800).then_some(k + 1)));
                open.extend((j > 0).then(|| k - 801).into_iter().chain((j < 800).then_some(k + 801)));
            }
        }
        assert_eq!(holes, expected.iter().filter(|is_hole| **is_hole).count() as u64);
        assert!(shares(&clipped).iter().zip(expected).all(|(share, is_hole)| (*share == HOLE) == is_hole));
    }

    #[test]
    fn what_lies_beyond_all_files_is_clipped_but_no_thread_between_two_and_no_gap_beside_it() {
        let size = [601u64, 300];
        let is_beyond = |i: usize, j: usize| i + j < 120 || (i + 2 * j > 1100) || (250..258).contains(&i) && j < 200;
        // Two posts between two files, from side to side, and a gap that meets the rim.
        let is_thread = |i: usize, j: usize| j == 150 || j == 151 || i == 400;
        let is_gap = |i: usize, j: usize| (50..90).contains(&i) && (31..100).contains(&j);
        let all = (0..601 * 300).map(|k| (k % 601, k / 601));
        let level = heights(size, is_gap);
        let mut posts = level.read(Rect::new([0, 0], [601, 300])).unwrap();
        for (post, (i, j)) in posts.iter_mut().zip(all.clone()) {
            if is_beyond(i, j) || is_thread(i, j) {
                *post = crate::sample::elevation::OUTSIDE;
            }
        }
        level.write(Rect::new([0, 0], [601, 300]), &posts).unwrap();
        let folder = std::env::temp_dir();
        let (clipped, holes) = finest(&level, Voids::Clip, &BTreeSet::new(), &folder, &Work::quiet(2)).unwrap();
        let clipped = shares(&clipped);
        // Where a thread meets what lies beyond, a post or two may go with either.
        let is_near_beyond = |i: usize, j: usize| {
            (-2..=2)
                .any(|d: isize| is_beyond(i.saturating_add_signed(d), j) || is_beyond(i, j.saturating_add_signed(d)))
        };
        for (share, (i, j)) in clipped.iter().zip(all) {
            let expected = match (is_beyond(i, j), is_thread(i, j) || is_gap(i, j)) {
                (true, _) => HOLE,
                (_, true) if is_thread(i, j) && is_near_beyond(i, j) => continue,
                (_, true) => MADE_UP,
                _ => MEASURED,
            };
            assert_eq!(*share, expected, "at {i}, {j}");
        }
        assert_eq!(holes, clipped.iter().filter(|share| **share == HOLE).count() as u64);
        // A rim that begins at a corner of a file takes the gap, and nothing beyond.
        let corner = BTreeSet::from([[50, 99]]);
        let (rim, more) = finest(&level, Voids::Clip, &corner, &folder, &Work::quiet(2)).unwrap();
        let in_gap = (0..601 * 300).filter(|k| is_gap(k % 601, k / 601) && !is_beyond(k % 601, k / 601)).count() as u64;
        assert_eq!(more, holes + in_gap);
        assert_eq!(shares(&rim)[99 * 601 + 50], HOLE);
    }

    #[test]
    fn a_rim_keeps_its_place_from_level_to_level() {
        let folder = std::env::temp_dir();
        for rim in 200..208usize {
            let level = heights([513, 9], |i, _| i < rim);
            let (mut shares_of, _) = cut(&level, Voids::Keep, 1);
            for (q, size) in [257u64, 129, 65].into_iter().enumerate() {
                shares_of = coarser(&shares_of, [size, 5], &folder, &Work::quiet(1)).unwrap();
                let row = &shares(&shares_of)[..size as usize];
                let after = row.iter().position(|share| share[0] >= 128).unwrap();
                let [low, high] = [row[after - 1][0], row[after][0]].map(f64::from);
                let spacing = f64::from(2 << q);
                let found = spacing * ((after - 1) as f64 + (127.5 - low) / (high - low));
                let wanted = rim as f64 - 0.5;
                assert!((found - wanted).abs() < 0.25 * spacing, "level {q}: rim at {found}, not {wanted}");
            }
        }
    }
}
