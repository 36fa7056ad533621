//! Raises the crests of coarser levels, so that distant skylines do not sink.
//!
//! A low-pass filter takes the tops off ridges, and a ridge is what stands against the sky. Where a
//! post of a coarser level lies above its neighbourhood, it is raised towards the highest post of
//! the finest level around it:
//!
//! ```text
//! z' = z + min(GAIN · clamp((c - σ/2) / 2.5, 0, σ), highest - z)
//!
//! c        = z - smooth(z), [1, 4, 6, 4, 1]/16 along both axes: how far the post stands out
//! σ        the root of the mean square of c over 13 x 13 posts: how far posts here stand out
//! highest  of the finest posts at most half a spacing of this level away, east or west, north or south
//! ```
//!
//! So ordinary ground keeps its least squares, the crests of smooth hills and of rough mountains are
//! found alike, and no post rises above the ground around it. The constants were fitted to pictures
//! (docs/quality.md). The finest level is not changed. A post is a function of the posts around it,
//! on a plane it stays what it is, and ground that was made up raises nothing.

use crate::IngestError;
use crate::nested::{Nodes, meeting};
use crate::pyramid::BLOCK;
use crate::pyramid::validity::Shares;
use crate::sample::elevation::quantized;
use crate::store::{Blocks, Level, Rect};
use crate::work::Work;
use std::collections::BTreeSet;
use std::io;
use std::path::Path;
use terravision_common::node::NodeId;
use terravision_common::world::World;

/// How far the strongest crests are raised, in σ.
const GAIN: f32 = 1.0;
/// Crests begin where `c` is this share of σ, and are whole this many σ above.
const FIRST: f32 = 0.5;
const RAMP: f32 = 2.5;
/// Smooths by a standard deviation of one post.
const SMOOTH: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const SMOOTH_REACH: usize = SMOOTH.len() / 2;
/// σ is taken over posts up to this far away.
const AROUND: usize = 6;
/// Posts of a level that a raised post depends on. Around the nodes of a nested level that many
/// exist.
const REACH: usize = SMOOTH_REACH + AROUND;

/// The levels of a world, to be raised.
#[derive(Clone, Copy)]
pub(crate) struct Crests<'a> {
    pub(crate) world: &'a World,
    /// Which nodes exist; all of them if `None`. Crests are raised where a node has children.
    pub(crate) nodes: Option<&'a Nodes>,
    /// The shares of the finest level's posts, if it has voids.
    pub(crate) shares: Option<&'a Level<Shares>>,
    pub(crate) folder: &'a Path,
    pub(crate) work: &'a Work,
}

/// What the highest ground is taken from.
enum Finer<'a> {
    /// The finest posts, and which of them were measured.
    Posts(&'a Level<f32>, Option<&'a Level<Shares>>),
    /// The highest of the finest posts in each cell of the finer level, borders included.
    Cells(Level<f32>),
}

impl Crests<'_> {
    /// The levels, the finest first, with their crests raised; they have no voids.
    ///
    /// # Errors
    /// [`IngestError`].
    pub(crate) fn raise(&self, levels: Vec<Level<f32>>) -> Result<Vec<Level<f32>>, IngestError> {
        let mut levels = levels.into_iter();
        let Some(finest) = levels.next() else { return Ok(Vec::new()) };
        let mut raised = Vec::with_capacity(levels.len());
        let mut finer = Finer::Posts(&finest, self.shares);
        for (q, level) in (self.world.finest_elevation_level() + 1..).zip(levels) {
            let (level, cells) = self.raise_level(q, &level, &finer)?;
            raised.push(level);
            finer = Finer::Cells(cells);
        }
        raised.insert(0, finest);
        Ok(raised)
    }

    /// A level with its crests raised, and the highest ground in its cells.
    fn raise_level(
        &self,
        q: u8,
        level: &Level<f32>,
        finer: &Finer<'_>,
    ) -> Result<(Level<f32>, Level<f32>), IngestError> {
        let fail = |source| IngestError::Output { source, path: self.folder.to_owned() };
        let raised = Level::create(self.folder, level.size()).map_err(fail)?;
        let cells = Level::create(self.folder, level.size().map(|posts| posts - 1)).map_err(fail)?;
        let blocks = level.blocks(BLOCK);
        let numbers = self.blocks_with_nodes(q, level.size());
        self.work.each(
            "crests",
            numbers.len(),
            || Ok(()),
            |(), index| {
                let block = blocks.rect(numbers[index]);
                let around = block.grown(REACH);
                let mut heights = level.read(around).map_err(fail)?;
                continue_planes(&mut heights, around, level.size());
                // The cells of the finer level beside the block's posts.
                let beside = Rect::new(block.origin.map(|v| 2 * v - 1), block.size.map(|n| 2 * n + 1));
                let tops = finer.tops(beside).map_err(fail)?;
                let highest = highest_of_four(&tops, beside.size[0], [0, 0], block.size);
                let mut own = highest_of_four(&tops, beside.size[0], [1, 1], block.size);
                let mut out = raised_block(&heights, around.size[0], &highest, block.size);
                if let Some(nodes) = self.nodes {
                    self.keep_leaves(nodes, q, block, &heights, (&mut out, &mut own));
                }
                write_cells(&cells, block, &own).map_err(fail)?;
                raised.write(block, &out).map_err(fail)
            },
        )?;
        Ok((raised, cells))
    }

    /// The blocks of a level that nodes have posts in.
    fn blocks_with_nodes(&self, q: u8, size: [u64; 2]) -> Vec<usize> {
        let Some(nodes) = self.nodes else { return (0..Blocks::new(size, BLOCK).count()).collect() };
        let side = self.world.elevation_tile() as usize;
        let posts = |node: NodeId| Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side + 1; 2]);
        let blocks: BTreeSet<usize> =
            nodes.of_level(q).into_iter().flat_map(|node| meeting(size, posts(node))).collect();
        blocks.into_iter().collect()
    }

    /// In nodes without children, their borders included, posts are the finest there are: they stay,
    /// and cells are as high as their corners. `heights` are `REACH` wider than the block.
    fn keep_leaves(&self, nodes: &Nodes, q: u8, block: Rect, heights: &[f32], (out, cells): (&mut [f32], &mut [f32])) {
        let side = i64::from(self.world.elevation_tile());
        let counts = self.world.nodes_at(q).map(i64::from);
        let is_leaf = |cell: [i64; 2]| {
            let [m, n] = [0, 1].map(|a| cell[a].div_euclid(side).clamp(0, counts[a] - 1) as u32);
            !NodeId::new(m, n, q).is_some_and(|node| nodes.has_children(node))
        };
        let width = block.size[0] + 2 * REACH;
        for k in 0..block.area() {
            let at = [k % block.size[0], k / block.size[0]];
            let [x, y] = [0, 1].map(|a| block.origin[a] + at[a] as i64);
            let post = (at[1] + REACH) * width + at[0] + REACH;
            if [[x - 1, y - 1], [x, y - 1], [x - 1, y], [x, y]].into_iter().any(is_leaf) {
                out[k] = heights[post];
            }
            if is_leaf([x, y]) {
                cells[k] = [post, post + 1, post + width, post + width + 1]
                    .map(|p| heights[p])
                    .into_iter()
                    .fold(f32::NAN, f32::max);
            }
        }
    }
}

impl Finer<'_> {
    /// The highest ground in cells of the finer level; NaN where none was measured.
    fn tops(&self, cells: Rect) -> io::Result<Vec<f32>> {
        let (posts, shares) = match self {
            Self::Cells(level) => return level.read(cells),
            Self::Posts(posts, shares) => (posts, shares),
        };
        let corners = Rect::new(cells.origin, cells.size.map(|n| n + 1));
        let mut heights = posts.read(corners)?;
        if let Some(shares) = shares {
            let made_up = heights.iter_mut().zip(shares.read(corners)?).filter(|(_, share)| *share != [255; 2]);
            made_up.for_each(|(height, _)| *height = f32::NAN);
        }
        let width = corners.size[0];
        let top = |k: usize| {
            let at = k / cells.size[0] * width + k % cells.size[0];
            // The maximum of a number and NaN is the number.
            heights[at].max(heights[at + 1]).max(heights[at + width]).max(heights[at + width + 1])
        };
        Ok((0..cells.area()).map(top).collect())
    }
}

/// Writes the cells of a block of posts: the last column and row of posts begin no cell.
fn write_cells(level: &Level<f32>, block: Rect, cells: &[f32]) -> io::Result<()> {
    let [columns, rows] = [0, 1].map(|a| (level.size()[a] - block.origin[a] as u64).min(block.size[a] as u64) as usize);
    if columns == 0 {
        return Ok(());
    }
    let lines = cells.chunks_exact(block.size[0]).take(rows);
    let cells: Vec<f32> = lines.flat_map(|line| &line[..columns]).copied().collect();
    level.write(Rect::new(block.origin, [columns, rows]), &cells)
}

/// The highest of every 2 x 2 cells, from the column and row `first`.
fn highest_of_four(tops: &[f32], width: usize, first: [usize; 2], [columns, rows]: [usize; 2]) -> Vec<f32> {
    let mut out = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        let [south, north] = [0, 1].map(|k| &tops[(first[1] + 2 * j + k) * width + first[0]..][..2 * columns]);
        let pairs = south.chunks_exact(2).zip(north.chunks_exact(2));
        out.extend(pairs.map(|(s, n)| s[0].max(s[1]).max(n[0]).max(n[1])));
    }
    out
}

/// Raises a block of posts. `heights` are `REACH` wider on each side.
fn raised_block(heights: &[f32], width: usize, highest: &[f32], [columns, rows]: [usize; 2]) -> Vec<f32> {
    let smooth = window(heights, width, &SMOOTH);
    let inner = width - 2 * SMOOTH_REACH;
    let stand_out: Vec<f32> = (0..smooth.len())
        .map(|k| heights[(k / inner + SMOOTH_REACH) * width + k % inner + SMOOTH_REACH] - smooth[k])
        .collect();
    let squares: Vec<f32> = stand_out.iter().map(|c| c * c).collect();
    let mean = 1.0 / (2 * AROUND + 1) as f32;
    let variance = window(&squares, inner, &[mean; 2 * AROUND + 1]);
    let mut out = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        for i in 0..columns {
            let height = heights[(j + REACH) * width + i + REACH];
            let rise = highest[j * columns + i] - height;
            let sigma = variance[j * columns + i].sqrt();
            let wanted = (stand_out[(j + AROUND) * inner + i + AROUND] - FIRST * sigma) / RAMP;
            let wanted = GAIN * wanted.min(sigma);
            // Not so where nothing was measured: then `rise` is NaN.
            let is_raised = wanted > 0.0 && rise > 0.0;
            out.push(if is_raised { quantized(height + wanted.min(rise)) } else { height });
        }
    }
    out
}

/// Weighted sums along both axes; the result is narrower by the reach of the weights. Each is the same
/// sum in the same order, wherever its block begins.
fn window(values: &[f32], width: usize, weights: &[f32]) -> Vec<f32> {
    let (columns, rows) = (width + 1 - weights.len(), values.len() / width + 1 - weights.len());
    let mut across = vec![0.0; columns * (rows + weights.len() - 1)];
    for (out, line) in across.chunks_exact_mut(columns).zip(values.chunks_exact(width)) {
        for (weight, shifted) in weights.iter().zip(line.windows(columns)) {
            out.iter_mut().zip(shifted).for_each(|(out, value)| *out += weight * value);
        }
    }
    let mut sums = vec![0.0; columns * rows];
    for (j, out) in sums.chunks_exact_mut(columns).enumerate() {
        for (weight, line) in weights.iter().zip(across[j * columns..].chunks_exact(columns)) {
            out.iter_mut().zip(line).for_each(|(out, value)| *out += weight * value);
        }
    }
    sums
}

/// Beyond the level, which repeats its border there, continues its slopes: posts are mirrored in the
/// border's, along each axis. (A slope that ends at the border is not a crest.)
fn continue_planes(heights: &mut [f32], rect: Rect, size: [u64; 2]) {
    let inside = [0, 1].map(|a| {
        let last = (size[a] as i64 - 1 - rect.origin[a]).min(rect.size[a] as i64 - 1);
        ((-rect.origin[a]).max(0) as usize, last as usize)
    });
    let width = rect.size[0];
    for (axis, (first, last)) in inside.into_iter().enumerate() {
        let lines = if axis == 0 { rect.size[1] } else { width };
        for line in 0..lines {
            let at = |v: usize| if axis == 0 { line * width + v } else { v * width + line };
            for v in 0..first {
                let mirrored = (2 * first - v).min(last);
                heights[at(v)] = 2.0 * heights[at(first)] - heights[at(mirrored)];
            }
            for v in last + 1..rect.size[axis] {
                let mirrored = (2 * last).saturating_sub(v).max(first);
                heights[at(v)] = 2.0 * heights[at(last)] - heights[at(mirrored)];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pyramid::elevation::coarser;
    use terravision_testkit::worlds;

    /// So that the last block of level 1 is a single post.
    const SIDE: u32 = 512;

    fn level(size: [u64; 2], f: impl Fn(usize, usize) -> f32) -> Level<f32> {
        let level = Level::create(&std::env::temp_dir(), size).unwrap();
        let [w, h] = size.map(|v| v as usize);
        let all: Vec<f32> = (0..w * h).map(|k| f(k % w, k / w)).collect();
        level.write(Rect::new([0, 0], [w, h]), &all).unwrap();
        level
    }

    fn all(level: &Level<f32>) -> Vec<f32> {
        level.read(Rect::new([0, 0], level.size().map(|v| v as usize))).unwrap()
    }

    /// Filtered levels of a square of `SIDE` intervals, and the same with their crests raised.
    fn levels(f: impl Fn(usize, usize) -> f32, shares: Option<&Level<Shares>>, threads: usize) -> [Vec<Vec<f32>>; 2] {
        let (folder, work) = (std::env::temp_dir(), Work::quiet(threads));
        let world = worlds::world([SIDE; 2], 1.0, [16, 256]);
        let mut levels = vec![level([u64::from(SIDE) + 1; 2], f)];
        for q in 1..world.levels() {
            let size = [u64::from(SIDE.div_ceil(1 << q)) + 1; 2];
            levels.push(coarser(&levels[levels.len() - 1], size, &folder, &work).unwrap());
        }
        let filtered = levels.iter().map(all).collect();
        let crests = Crests { world: &world, nodes: None, shares, folder: &folder, work: &work };
        [filtered, crests.raise(levels).unwrap().iter().map(all).collect()]
    }

    fn rough(i: usize, j: usize) -> f32 {
        let noise = |i: usize, j: usize| {
            let hash = (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b);
            (hash.wrapping_mul(0xc2b2_ae35) >> 16) as f32 / 65536.0
        };
        quantized((0..6).map(|octave| (1 << octave) as f32 * noise(i >> octave, j >> octave)).sum())
    }

    #[test]
    fn a_plane_stays_up_to_its_borders() {
        let [filtered, raised] = levels(|i, j| 2000.0 + 0.5 * i as f32 - 0.25 * j as f32, None, 2);
        // The filter itself bends a plane beside the border, where it is repeated.
        let (width, side) = (SIDE as usize / 2 + 1, SIDE as usize / 2 - 12);
        for k in (0..side * side).map(|k| (k / side + 6) * width + k % side + 6) {
            assert_eq!(filtered[1][k], raised[1][k]);
        }
        let plane = level([33, 33], |i, j| 3.0 * i as f32 + j as f32);
        let rect = Rect::new([-8, -8], [49, 49]);
        let mut heights = plane.read(rect).unwrap();
        continue_planes(&mut heights, rect, plane.size());
        assert!((0..49 * 49).all(|k| heights[k] == 3.0 * (k % 49) as f32 + (k / 49) as f32 - 32.0));
    }

    #[test]
    fn crests_rise_never_above_the_ground_around_and_nothing_else_changes() {
        let [filtered, raised] = levels(rough, None, 2);
        assert_eq!(filtered[0], raised[0], "the finest level");
        for q in 1..filtered.len() {
            let (step, width) = (1usize << q, (SIDE as usize).div_ceil(1 << q) + 1);
            let mut count = 0;
            for (k, (before, after)) in filtered[q].iter().zip(&raised[q]).enumerate() {
                let around = |v: usize| {
                    let last = SIDE as usize;
                    (v * step).saturating_sub(step / 2).min(last)..=(v * step + step / 2).min(last)
                };
                let highest = around(k / width)
                    .flat_map(|j| around(k % width).map(move |i| rough(i, j)))
                    .fold(f32::MIN, f32::max);
                assert!(after >= before && *after <= before.max(highest), "level {q}, post {k}: {before} to {after}");
                count += usize::from(after > before);
            }
            assert!(q > 4 || (filtered[q].len() / 20..filtered[q].len() / 2).contains(&count), "level {q}: {count}");
        }
    }

    #[test]
    fn a_post_depends_on_the_posts_around_it_alone() {
        let [_, here] = levels(rough, None, 1);
        // Blocks begin elsewhere, and more threads take them.
        let by = 64;
        let [_, there] = levels(|i, j| rough(i + by, j), None, 3);
        for q in 1..=3 {
            let (width, margin) = (SIDE as usize / (1 << q) + 1, 24);
            for k in (0..here[q].len()).filter(|k| (margin..width - margin).contains(&(k / width))) {
                let (i, shifted) = (k % width, k.wrapping_sub(by >> q));
                if i >= margin + (by >> q) && i + margin < width {
                    assert_eq!(here[q][k], there[q][shifted], "level {q}, post {k}");
                }
            }
        }
    }

    #[test]
    fn made_up_ground_raises_nothing() {
        let spike = |i: usize, j: usize| if i % 32 == 15 && j % 32 == 16 { 100.0 } else { 0.0 };
        let shares = Level::create(&std::env::temp_dir(), [u64::from(SIDE) + 1; 2]).unwrap();
        let width = SIDE as usize + 1;
        let share = |k: usize| if spike(k % width, k / width) > 0.0 { [255, 0] } else { [255; 2] };
        let all: Vec<Shares> = (0..width * width).map(share).collect();
        shares.write(Rect::new([0, 0], [width; 2]), &all).unwrap();
        let [filtered, raised] = levels(spike, None, 2);
        assert!(filtered[1] != raised[1] && filtered[2] != raised[2]);
        let [filtered, raised] = levels(spike, Some(&shares), 2);
        let highest = raised.iter().skip(1).zip(&filtered[1..]);
        highest.for_each(|(raised, filtered)| {
            assert!(raised.iter().zip(filtered).all(|(after, before)| after == before || *after <= 0.0));
        });
    }
}
