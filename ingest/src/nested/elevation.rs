//! Elevation levels where sources of different spacings have data.

use super::blend::{BLEND, SourcePost, shares};
use super::blocks::{BLOCK, Pyramid, meeting, repeat_border, samples_of};
use super::nodes::Nodes;
use crate::IngestError;
use crate::plan::{Lattice, Plan};
use crate::pyramid::elevation::{REACH, filter};
use crate::pyramid::voids;
use crate::sample::elevation::{EMPTY, Summary, quantized, union};
use crate::sample::kernel::Kernel;
use crate::sample::{Sampled, SourceSet};
use crate::source::readers::ElevationReader;
use crate::source::values::ElevationValues;
use crate::source::{Raster, TargetCrs};
use crate::store::{Level, Rect};
use crate::work::Work;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Mutex;
use terravision_common::database::Layer;
use terravision_common::node::NodeId;

/// Margin of posts around the nodes of a level, because the filter of the next level reads them.
const MARGIN: usize = REACH + 1;

/// Inputs of all steps.
pub(super) struct NestedElevation<'a> {
    pub(super) plan: &'a Plan,
    pub(super) target: &'a TargetCrs,
    pub(super) sources: &'a [(Raster, ElevationValues)],
    pub(super) folder: &'a Path,
    pub(super) work: &'a Work,
}

/// Elevation levels without voids, which of their nodes exist, and what they hold.
pub(super) struct ElevationLevels {
    pub(super) levels: Vec<Level<f32>>,
    pub(super) nodes: Nodes,
    pub(super) summary: Summary,
    pub(super) void_area_m2: f64,
}

impl NestedElevation<'_> {
    fn fail(&self) -> impl Fn(std::io::Error) -> IngestError + Copy + '_ {
        |source| IngestError::Output { source, path: self.folder.to_owned() }
    }

    fn side(&self) -> usize {
        self.plan.world.elevation_tile() as usize
    }

    fn lattice(&self, q: u8) -> Lattice {
        let finest = self.plan.world.finest_elevation_level();
        Lattice { step: self.plan.elevation.step * f64::from(1u32 << (q - finest)), ..self.plan.elevation }
    }

    /// Samples all levels. `wanted` are nodes that have to exist in any case, because finer colour
    /// lies below them.
    pub(super) fn levels(&self, wanted: &[NodeId]) -> Result<ElevationLevels, IngestError> {
        let world = &self.plan.world;
        let finest = world.finest_elevation_level();
        let mut nodes = Nodes::new(world, Layer::Elevation);
        let mut pyramid = Pyramid::default();
        let mut source_range = EMPTY;
        for q in finest..world.levels() {
            let level = Level::create(self.folder, self.plan.elevation_size(q)).map_err(self.fail())?;
            wanted.iter().filter(|node| node.q() == q).for_each(|node| nodes.insert(*node));
            let with_data = self.blocks_with_data(q, &level, &nodes);
            let mut made = BTreeSet::new();
            for is_rest in [false, true] {
                let blocks = if is_rest { self.blocks_of_nodes(q, &level, &nodes, &made) } else { with_data.clone() };
                let (found, range) = self.sample(q, &level, &blocks)?;
                source_range = union(source_range, range);
                made.extend(blocks);
                if !is_rest {
                    found.into_iter().for_each(|node| nodes.insert(node));
                    nodes.close(q);
                }
            }
            if let Some(finer) = pyramid.levels.last() {
                self.filter(q, finer, &level, &nodes, &mut made)?;
            }
            pyramid.levels.push(level);
            pyramid.made.push(made);
        }
        let (range, void_area_m2, voids) = self.summary(&pyramid.levels, &nodes)?;
        let summary = Summary { voids, range, source_range };
        if range[0] > range[1] {
            let reason = "has no elevation data: every sample is \"no data\"";
            return Err(IngestError::source(self.sources[0].0.path(), reason));
        }
        let levels = if voids > 0 { self.fill(pyramid, range)? } else { pyramid.levels };
        Ok(ElevationLevels { levels, nodes, summary, void_area_m2 })
    }

    /// Whether the level below has all posts that a block needs.
    fn is_covered(&self, q: u8, level: &Level<f32>, nodes: &Nodes, block: usize) -> bool {
        let rect = level.blocks(BLOCK).rect(block);
        nodes.meeting(q, rect, self.side()).all(|node| nodes.has_children(node))
    }

    /// Blocks with sources that are as fine as the level.
    fn blocks_with_data(&self, q: u8, level: &Level<f32>, nodes: &Nodes) -> Vec<usize> {
        let lattice = self.lattice(q);
        let natives = self.plan.elevation_levels.iter().zip(&self.plan.elevation_bounds);
        let mut blocks: Vec<usize> = natives
            .filter(|(native, _)| **native == q)
            .filter_map(|(_, bounds)| samples_of(bounds, &lattice, level.size()))
            .flat_map(|rect| meeting(level.size(), rect))
            .collect();
        blocks.sort_unstable();
        blocks.dedup();
        blocks.retain(|block| !self.is_covered(q, level, nodes, *block));
        blocks
    }

    /// Blocks that the nodes of the level need, and that are neither made nor wholly filtered from
    /// the level below.
    fn blocks_of_nodes(&self, q: u8, level: &Level<f32>, nodes: &Nodes, made: &BTreeSet<usize>) -> Vec<usize> {
        let side = self.side();
        let rects = nodes.of_level(q).into_iter().filter(|node| !nodes.has_children(*node)).map(|node| {
            Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side + 1; 2]).grown(MARGIN)
        });
        let blocks: BTreeSet<usize> = rects.flat_map(|rect| meeting(level.size(), rect)).collect();
        let is_left = |block: &usize| !made.contains(block) && !self.is_covered(q, level, nodes, *block);
        blocks.into_iter().filter(is_left).collect()
    }

    /// Samples blocks of a level; the nodes that have data as fine as the level, and the range of
    /// the sources.
    fn sample(&self, q: u8, level: &Level<f32>, blocks: &[usize]) -> Result<(Vec<NodeId>, [f32; 2]), IngestError> {
        let found = Mutex::new((Vec::new(), EMPTY));
        let (lattice, side) = (self.lattice(q), self.side() as i64);
        let bounds = &self.plan.elevation_bounds;
        self.work.each(
            "elevation",
            blocks.len(),
            || {
                let open = ElevationReader::open;
                Ok(SourceSet::new(self.sources, bounds, self.target, lattice, open, Kernel::of_heights))
            },
            |set, index| {
                let block = level.blocks(BLOCK).rect(blocks[index]);
                let (heights, is_fine) = self.sample_block(q, set, block)?;
                let mut nodes = Vec::new();
                for k in (0..block.area()).filter(|k| is_fine[*k]) {
                    let at = [k % block.size[0], k / block.size[0]];
                    let at = [0, 1].map(|a| block.origin[a] + at[a] as i64);
                    // A post on a border belongs to the nodes on both sides.
                    let [x, y] = at.map(|v| [v.div_euclid(side), (v - 1).div_euclid(side)]);
                    for (m, n) in [(x[0], y[0]), (x[1], y[0]), (x[0], y[1]), (x[1], y[1])] {
                        nodes.extend(u32::try_from(m).ok().zip(u32::try_from(n).ok()));
                    }
                }
                nodes.sort_unstable();
                nodes.dedup();
                let world = &self.plan.world;
                let nodes = nodes.into_iter().filter_map(|(m, n)| NodeId::new(m, n, q)).filter(|n| world.contains(*n));
                if let Ok(mut found) = found.lock() {
                    found.0.extend(nodes);
                    found.1 = union(found.1, set.range());
                }
                level.write(block, &heights).map_err(self.fail())
            },
        )?;
        Ok(found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Heights of a block, and which of them come from sources as fine as the level.
    fn sample_block(
        &self,
        q: u8,
        set: &mut SourceSet<'_, ElevationValues, ElevationReader<'_>>,
        block: Rect,
    ) -> Result<(Vec<f32>, Vec<bool>), IngestError> {
        let around = block.grown(BLEND);
        let is_fine_source = |source: u32| self.plan.elevation_levels[source as usize] <= q;
        let mut posts: Vec<SourcePost> = set
            .sample::<1>(around)?
            .into_iter()
            .map(|post| post.known().map(|(source, [height])| (is_fine_source(source), height)))
            .collect();
        repeat_border(&mut posts, around, self.plan.world.extent().map(|extent| i64::from(extent >> q)));
        let shares = shares(&posts, around);
        let inner = |k: usize| (k / block.size[0] + BLEND) * around.size[0] + k % block.size[0] + BLEND;
        let is_mixed = |k: usize| posts[inner(k)].is_some_and(|(is_fine, _)| is_fine) && shares[k] < 1.0;
        let mut coarse = vec![Sampled::Outside; block.area()];
        if (0..block.area()).any(is_mixed) {
            coarse = set.sample_where::<1>(block, |source| !is_fine_source(source), |k| !is_mixed(k))?;
        }
        let height = |k: usize| {
            let Some((is_fine, height)) = posts[inner(k)] else { return f32::NAN };
            match coarse[k] {
                Sampled::Value(_, [coarse]) if is_fine => quantized(coarse + shares[k] * (height - coarse)),
                _ => quantized(height),
            }
        };
        let heights = (0..block.area()).map(height).collect();
        let is_fine = (0..block.area()).map(|k| posts[inner(k)].is_some_and(|(is_fine, _)| is_fine)).collect();
        Ok((heights, is_fine))
    }

    /// Filters the posts of nodes that exist on the level below from that level.
    fn filter(
        &self,
        q: u8,
        finer: &Level<f32>,
        level: &Level<f32>,
        nodes: &Nodes,
        made: &mut BTreeSet<usize>,
    ) -> Result<(), IngestError> {
        let side = self.side();
        let split = nodes.of_level(q).into_iter().filter(|node| nodes.has_children(*node));
        let rect = |node: NodeId| Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side + 1; 2]);
        let blocks: BTreeSet<usize> = split.flat_map(|node| meeting(level.size(), rect(node))).collect();
        let blocks: Vec<usize> = blocks.into_iter().collect();
        self.work.each(
            "elevation levels",
            blocks.len(),
            || Ok(()),
            |(), index| {
                let block = level.blocks(BLOCK).rect(blocks[index]);
                let below = Rect::new(block.origin.map(|v| 2 * v), block.size.map(|n| 2 * n - 1)).grown(REACH);
                let fine = finer.read(below).map_err(self.fail())?;
                let mut heights = filter(&fine, below.size[0], block.size);
                if !self.is_covered(q, level, nodes, blocks[index]) {
                    let sampled = level.read(block).map_err(self.fail())?;
                    let is_filtered = self.posts_of_split(q, nodes, block);
                    let kept = heights.iter_mut().zip(sampled).zip(is_filtered).filter(|(_, is)| !is);
                    kept.for_each(|((height, sampled), _)| *height = sampled);
                }
                level.write(block, &heights).map_err(self.fail())
            },
        )?;
        made.extend(blocks);
        Ok(())
    }

    /// Which posts of a block lie on nodes that have children, borders included.
    fn posts_of_split(&self, q: u8, nodes: &Nodes, block: Rect) -> Vec<bool> {
        let side = self.side() as i64;
        let mut out = vec![false; block.area()];
        for node in nodes.meeting(q, block.grown(1), side as usize).filter(|node| nodes.has_children(*node)) {
            let first = [node.m(), node.n()].map(|v| i64::from(v) * side);
            let [x, y] = [0, 1].map(|a| {
                let low = (first[a] - block.origin[a]).clamp(0, block.size[a] as i64);
                low as usize..(first[a] + side + 1 - block.origin[a]).clamp(low, block.size[a] as i64) as usize
            });
            y.for_each(|row| out[row * block.size[0]..][x.clone()].fill(true));
        }
        out
    }

    /// Lowest and highest post, area and number of voids, where there is no finer level.
    fn summary(&self, levels: &[Level<f32>], nodes: &Nodes) -> Result<([f32; 2], f64, u64), IngestError> {
        let finest = self.plan.world.finest_elevation_level();
        let side = self.side();
        let found = Mutex::new((EMPTY, vec![0u64; levels.len()]));
        for (q, level) in (finest..).zip(levels) {
            let leaves: Vec<NodeId> = nodes.of_level(q).into_iter().filter(|n| !nodes.has_children(*n)).collect();
            self.work.each(
                "elevation",
                leaves.len(),
                || Ok(()),
                |(), index| {
                    let node = leaves[index];
                    let rect = Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side; 2]);
                    let last = [0, 1].map(|a| level.size()[a] as i64 - rect.origin[a]);
                    let size = last.map(|left| left.clamp(0, side as i64) as usize);
                    if size.contains(&0) {
                        return Ok(());
                    }
                    let heights = level.read(Rect::new(rect.origin, size)).map_err(self.fail())?;
                    let known = heights.iter().filter(|h| !h.is_nan());
                    let range = known.fold(EMPTY, |range, h| union(range, [*h; 2]));
                    if let Ok(mut found) = found.lock() {
                        found.0 = union(found.0, range);
                        found.1[usize::from(q - finest)] += heights.iter().filter(|h| h.is_nan()).count() as u64;
                    }
                    Ok(())
                },
            )?;
        }
        let (range, voids) = found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        let area = (finest..).zip(&voids).map(|(q, count)| *count as f64 * self.lattice(q).step.powi(2)).sum();
        Ok((range, area, voids.iter().sum()))
    }

    /// Fills voids, the coarsest level first.
    fn fill(&self, pyramid: Pyramid<f32>, range: [f32; 2]) -> Result<Vec<Level<f32>>, IngestError> {
        let middle = 0.5 * (range[0] + range[1]);
        let mut filled: Vec<Level<f32>> = Vec::with_capacity(pyramid.levels.len());
        for (level, made) in pyramid.levels.into_iter().zip(pyramid.made).rev() {
            let blocks: Vec<usize> = made.into_iter().collect();
            let level = match filled.last() {
                Some(coarser) => voids::fill(level, coarser, &blocks, self.folder, self.work)?,
                None => {
                    voids::fill_coarsest(&level, middle).map_err(self.fail())?;
                    level
                }
            };
            filled.push(level);
        }
        filled.reverse();
        Ok(filled)
    }
}
