//! Colour levels where images are finer than the rest; elsewhere, a tint at the resolution of the
//! elevation.

use super::blocks::{BLOCK, meeting, repeat_border, samples_of};
use super::elevation::ElevationLevels;
use super::nodes::Nodes;
use crate::IngestError;
use crate::plan::{Lattice, Plan};
use crate::pyramid::color::{REACH, filter};
use crate::sample::color::eight_bits;
use crate::sample::kernel::Kernel;
use crate::sample::{Sampled, SourceSet};
use crate::source::readers::ColorReader;
use crate::source::values::ColorValues;
use crate::source::{Raster, TargetCrs};
use crate::store::{Level, Rect, Rgb};
use crate::tint::Tint;
use crate::work::Work;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Mutex;
use terravision_common::database::Layer;
use terravision_common::node::NodeId;
use terravision_common::world::COLOR_BORDER;

/// Margin of texels around the nodes of a level: tiles have a border, and the filter of the next
/// level reads them.
const MARGIN: usize = COLOR_BORDER as usize + REACH;

/// Inputs of all steps.
pub(super) struct Color<'a> {
    pub(super) plan: &'a Plan,
    pub(super) target: &'a TargetCrs,
    pub(super) sources: &'a [(Raster, ColorValues)],
    pub(super) elevation: &'a ElevationLevels,
    pub(super) tint: &'a Tint<'a>,
    pub(super) folder: &'a Path,
    pub(super) work: &'a Work,
}

/// Colour levels, which of their nodes exist, and the area that shows the tint.
pub(super) struct ColorLevels {
    pub(super) levels: Vec<Level<Rgb>>,
    pub(super) nodes: Nodes,
    pub(super) tint_area_m2: f64,
}

/// A texel's source and colour, if it has one.
type Texel = Option<(u32, [f32; 3])>;

/// Number of texels with a source, by node; nodes may share blocks.
type Known = BTreeMap<NodeId, u64>;

impl Color<'_> {
    fn fail(&self) -> impl Fn(std::io::Error) -> IngestError + Copy + '_ {
        |source| IngestError::Output { source, path: self.folder.to_owned() }
    }

    fn side(&self) -> usize {
        self.plan.world.color_tile() as usize
    }

    fn lattice(&self, q: u8) -> Lattice {
        let world = &self.plan.world;
        let step = world.color_spacing_m(q);
        Lattice { first: world.fields().origin.map(|v| v + 0.5 * step), step }
    }

    /// Samples all levels.
    pub(super) fn levels(&self) -> Result<ColorLevels, IngestError> {
        let world = &self.plan.world;
        let mut nodes = Nodes::new(world, Layer::Color);
        let mut levels: Vec<Level<Rgb>> = Vec::new();
        let mut known_m2 = 0.0;
        for q in world.finest_color_level()..world.levels() {
            let level = Level::create(self.folder, self.plan.color_size(q)).map_err(self.fail())?;
            let with_data = self.blocks_with_data(q, &level, &nodes);
            let (mut known, has_data) = self.sample(q, &level, &with_data)?;
            has_data.into_iter().for_each(|node| nodes.insert(node));
            self.nodes_of_tint(q).into_iter().for_each(|node| nodes.insert(node));
            nodes.close(q);
            let rest = self.blocks_of_nodes(q, &level, &nodes, &with_data);
            for (node, count) in self.sample(q, &level, &rest)?.0 {
                *known.entry(node).or_default() += count;
            }
            if let Some(finer) = levels.last() {
                self.filter(q, finer, &level, &nodes)?;
            }
            let leaves = known.iter().filter(|(node, _)| nodes.has(**node) && !nodes.has_children(**node));
            known_m2 += leaves.map(|(_, count)| *count as f64).sum::<f64>() * self.lattice(q).step.powi(2);
            levels.push(level);
        }
        let tint_area_m2 = (world.extent_m().iter().product::<f64>() - known_m2).max(0.0);
        Ok(ColorLevels { levels, nodes, tint_area_m2 })
    }

    /// Nodes whose tint is as fine as the elevation is there.
    fn nodes_of_tint(&self, q: u8) -> Vec<NodeId> {
        let world = &self.plan.world;
        let depth = world.elevation_over_color_levels();
        let Ok(level) = u8::try_from(i32::from(q) - depth) else { return Vec::new() };
        if level >= world.levels() {
            return Vec::new();
        }
        // If tiles have fewer texels than posts, a colour node of this level has finer elevation;
        // then it exists too.
        let nodes = self.elevation.nodes.of_level(level.max(world.finest_elevation_level()));
        nodes.into_iter().filter(|node| node.q() <= q).map(|node| node.ancestor(q)).collect()
    }

    fn is_covered(&self, q: u8, level: &Level<Rgb>, nodes: &Nodes, block: usize) -> bool {
        let rect = level.blocks(BLOCK).rect(block);
        nodes.meeting(q, rect, self.side()).all(|node| nodes.has_children(node))
    }

    /// Blocks with images that are as fine as the level.
    fn blocks_with_data(&self, q: u8, level: &Level<Rgb>, nodes: &Nodes) -> BTreeSet<usize> {
        let lattice = self.lattice(q);
        let natives = self.plan.color_levels.iter().zip(&self.plan.color_bounds);
        natives
            .filter(|(native, _)| **native == q)
            .filter_map(|(_, bounds)| samples_of(bounds, &lattice, level.size()))
            .flat_map(|rect| meeting(level.size(), rect))
            .filter(|block| !self.is_covered(q, level, nodes, *block))
            .collect()
    }

    fn blocks_of_nodes(&self, q: u8, level: &Level<Rgb>, nodes: &Nodes, made: &BTreeSet<usize>) -> BTreeSet<usize> {
        let side = self.side();
        let leaves = nodes.of_level(q).into_iter().filter(|node| !nodes.has_children(*node));
        let rects = leaves
            .map(|node| Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side; 2]).grown(MARGIN));
        let blocks = rects.flat_map(|rect| meeting(level.size(), rect));
        blocks.filter(|block| !made.contains(block) && !self.is_covered(q, level, nodes, *block)).collect()
    }

    /// Samples blocks of a level; how many texels of each node have a source, and the nodes that
    /// have one as fine as the level.
    fn sample(&self, q: u8, level: &Level<Rgb>, blocks: &BTreeSet<usize>) -> Result<(Known, Vec<NodeId>), IngestError> {
        let blocks: Vec<usize> = blocks.iter().copied().collect();
        let found = Mutex::new((Known::new(), Vec::new()));
        let (lattice, side) = (self.lattice(q), self.side() as u64);
        self.work.each(
            "colour",
            blocks.len(),
            || {
                let bounds = &self.plan.color_bounds;
                Ok(SourceSet::new(self.sources, bounds, self.target, lattice, ColorReader::open, Kernel::new))
            },
            |set, index| {
                let block = level.blocks(BLOCK).rect(blocks[index]);
                let texels = self.sample_block(q, set, block)?;
                let (mut known, mut has_data) = (Known::new(), BTreeSet::new());
                for (k, texel) in texels.iter().enumerate() {
                    let Some((source, _)) = texel else { continue };
                    let at = [k % block.size[0], k / block.size[0]];
                    let [m, n] = [0, 1].map(|a| ((block.origin[a] as u64 + at[a] as u64) / side) as u32);
                    let Some(node) = NodeId::new(m, n, q) else { continue };
                    *known.entry(node).or_default() += 1;
                    if self.plan.color_levels[*source as usize] <= q {
                        has_data.insert(node);
                    }
                }
                let tinted = match texels.iter().any(Option::is_none) {
                    true => self.tinted(q, block)?,
                    false => Vec::new(),
                };
                let colors: Vec<Rgb> = texels
                    .iter()
                    .enumerate()
                    .map(|(k, texel)| texel.map_or_else(|| tinted[k], |(_, color)| eight_bits(color)))
                    .collect();
                if let Ok(mut found) = found.lock() {
                    for (node, count) in known {
                        *found.0.entry(node).or_default() += count;
                    }
                    found.1.extend(has_data);
                }
                level.write(block, &colors).map_err(self.fail())
            },
        )?;
        Ok(found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
    }

    /// Colours of a block, and from which source each is.
    fn sample_block(
        &self,
        q: u8,
        set: &mut SourceSet<'_, ColorValues, ColorReader<'_>>,
        block: Rect,
    ) -> Result<Vec<Texel>, IngestError> {
        let world = &self.plan.world;
        let [nz, nc] = [world.elevation_tile(), world.color_tile()].map(i64::from);
        // For texels that lie inside with all of their area.
        let last = world.extent().map(|extent| i64::from(extent) * nc / (nz << q) - 1);
        let around = block.grown(1);
        let mut texels: Vec<Texel> = set.sample::<3>(around)?.into_iter().map(Sampled::known).collect();
        repeat_border(&mut texels, around, last);
        let rows = texels.chunks_exact(around.size[0]).skip(1).take(block.size[1]);
        Ok(rows.flat_map(|row| row[1..=block.size[0]].iter().copied()).collect())
    }

    /// The tint of a block, from the finest elevation that is everywhere under it, but no finer
    /// than the texels.
    fn tinted(&self, q: u8, block: Rect) -> Result<Vec<Rgb>, IngestError> {
        let world = &self.plan.world;
        let finest = world.finest_elevation_level();
        let wanted = i32::from(q) - world.elevation_over_color_levels();
        let wanted = (wanted.max(0) as u8).clamp(finest, world.root().q());
        let texel = self.lattice(q).step;
        let area = |level: u8| {
            let ratio = texel / world.elevation_spacing_m(level);
            let first = block.origin.map(|v| (v as f64 * ratio).floor() as i64);
            let size = block.size.map(|n| (n as f64 * ratio).ceil() as usize + 1);
            // Including the samples that shading uses.
            Rect::new(first, size).grown(4)
        };
        let side = world.elevation_tile() as usize;
        let nodes = &self.elevation.nodes;
        let has_all = |level: &u8| nodes.meeting(*level, area(*level), side).all(|node| nodes.has(node));
        let level = (wanted..world.levels()).find(has_all).unwrap_or(world.root().q());
        let posts = &self.elevation.levels[usize::from(level - finest)];
        self.tint.block_of(posts, world.elevation_spacing_m(level), texel, block).map_err(self.fail())
    }

    /// Filters the texels of nodes that exist on the level below from that level.
    fn filter(&self, q: u8, finer: &Level<Rgb>, level: &Level<Rgb>, nodes: &Nodes) -> Result<(), IngestError> {
        let side = self.side();
        let split: Vec<NodeId> = nodes.of_level(q).into_iter().filter(|node| nodes.has_children(*node)).collect();
        let rect = |node: &NodeId| Rect::new([node.m(), node.n()].map(|v| i64::from(v) * side as i64), [side; 2]);
        let blocks: BTreeSet<usize> = split.iter().flat_map(|node| meeting(level.size(), rect(node))).collect();
        let blocks: Vec<usize> = blocks.into_iter().collect();
        self.work.each(
            "colour levels",
            blocks.len(),
            || Ok(()),
            |(), index| {
                let block = level.blocks(BLOCK).rect(blocks[index]);
                let below = Rect::new(block.origin.map(|v| 2 * v), block.size.map(|n| 2 * n)).grown(REACH);
                let fine = finer.read(below).map_err(self.fail())?;
                let mut colors = filter(&fine, below.size[0], block.size);
                if !self.is_covered(q, level, nodes, blocks[index]) {
                    let sampled = level.read(block).map_err(self.fail())?;
                    for (k, color) in colors.iter_mut().enumerate() {
                        let at = [k % block.size[0], k / block.size[0]];
                        let [m, n] = [0, 1].map(|a| (block.origin[a] as usize + at[a]) / side);
                        if !NodeId::new(m as u32, n as u32, q).is_some_and(|node| nodes.has_children(node)) {
                            *color = sampled[k];
                        }
                    }
                }
                level.write(block, &colors).map_err(self.fail())
            },
        )
    }
}
