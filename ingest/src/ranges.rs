//! Lowest and highest ground under every node, from the filled elevation levels.

use crate::IngestError;
use crate::nested::Nodes;
use crate::store::{Level, Rect};
use crate::work::Work;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io;
use std::path::Path;
use terravision_common::database::{Layers, NodeRange, NodeRanges};
use terravision_common::node::NodeId;
use terravision_common::world::World;

type Range = [f32; 2];

const EMPTY: Range = [f32::MAX, f32::MIN];

fn union(a: Range, b: Range) -> Range {
    [a[0].min(b[0]), a[1].max(b[1])]
}

fn range_of<'a>(heights: impl Iterator<Item = &'a f32>) -> Range {
    heights.fold(EMPTY, |r, &h| [r[0].min(h), r[1].max(h)])
}

/// Side, in nodes, of the blocks that are processed at a time.
const BLOCK_NODES: u64 = 8;

/// Ranges of all nodes. `levels[k]` is elevation level `finest_elevation_level + k`.
///
/// # Errors
/// [`IngestError`].
pub fn compute(world: &World, levels: &[Level<f32>], folder: &Path, work: &Work) -> Result<NodeRanges, IngestError> {
    let fail = |source: io::Error| IngestError::Output { source, path: folder.to_owned() };
    let finest = world.finest_elevation_level();
    let mut all: Vec<Vec<Range>> = Vec::with_capacity(usize::from(world.levels()));
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q).map(u64::from);
        let blocks = [columns, rows].map(|n| n.div_ceil(BLOCK_NODES));
        let mut ranges = vec![EMPTY; (columns * rows) as usize];
        work.in_order(
            "height ranges",
            (blocks[0] * blocks[1]) as usize,
            || Ok(()),
            |(), index| {
                let first = [index as u64 % blocks[0] * BLOCK_NODES, index as u64 / blocks[0] * BLOCK_NODES];
                let count = [0, 1].map(|a| (([columns, rows])[a] - first[a]).min(BLOCK_NODES));
                block_ranges(world, levels, finest, q, (first, count), None)
                    .map(|ranges| (first, count, ranges))
                    .map_err(fail)
            },
            |(first, count, part)| {
                for (j, line) in part.chunks_exact(count[0] as usize).enumerate() {
                    let at = ((first[1] + j as u64) * columns + first[0]) as usize;
                    ranges[at..at + line.len()].copy_from_slice(line);
                }
                Ok(())
            },
        )?;
        // A node's range includes those of its descendants; children of level q are complete.
        if let Some(below) = all.last() {
            let [child_columns, child_rows] = world.nodes_at(q - 1).map(u64::from);
            for n in 0..child_rows {
                for m in 0..child_columns {
                    let parent = (n / 2 * columns + m / 2) as usize;
                    ranges[parent] = union(ranges[parent], below[(n * child_columns + m) as usize]);
                }
            }
        }
        all.push(ranges);
    }
    NodeRanges::from_parts(world, all).map_err(|e| fail(io::Error::other(e)))
}

/// Ranges of only the existing nodes. `levels[k]` is elevation level `finest_elevation_level + k`.
///
/// # Errors
/// [`IngestError`].
pub(crate) fn compute_nested(
    world: &World,
    levels: &[Level<f32>],
    [elevation, color]: [&Nodes; 2],
    folder: &Path,
    work: &Work,
) -> Result<NodeRanges, IngestError> {
    let fail = |source: io::Error| IngestError::Output { source, path: folder.to_owned() };
    let finest = world.finest_elevation_level();
    let mut all: Vec<NodeRange> = Vec::new();
    let mut below: HashMap<NodeId, Range> = HashMap::new();
    for q in 0..world.levels() {
        let mut blocks: BTreeMap<[u64; 2], BTreeSet<NodeId>> = BTreeMap::new();
        for node in elevation.of_level(q).into_iter().chain(color.of_level(q)) {
            let first = [node.n(), node.m()].map(|v| u64::from(v) / BLOCK_NODES * BLOCK_NODES);
            blocks.entry(first).or_default().insert(node);
        }
        let blocks: Vec<([u64; 2], BTreeSet<NodeId>)> = blocks.into_iter().collect();
        let mut here: HashMap<NodeId, Range> = HashMap::new();
        work.in_order(
            "height ranges",
            blocks.len(),
            || Ok(()),
            |(), index| {
                let ([n0, m0], nodes) = &blocks[index];
                let block = ([*m0, *n0], [BLOCK_NODES; 2]);
                let ranges = block_ranges(world, levels, finest, q, block, Some(elevation)).map_err(fail)?;
                let at = |node: &NodeId| (u64::from(node.n()) - n0) * BLOCK_NODES + u64::from(node.m()) - m0;
                Ok(nodes.iter().map(|node| (*node, ranges[at(node) as usize])).collect::<Vec<_>>())
            },
            |part| {
                for (node, range) in part {
                    let children = (0..4).filter_map(|k| node.child(k)).filter_map(|child| below.get(&child));
                    let range = children.fold(range, |range, child| union(range, *child));
                    here.insert(node, range);
                    let layers = Layers { elevation: elevation.has(node), color: color.has(node) };
                    all.push(NodeRange { node, range, layers });
                }
                Ok(())
            },
        )?;
        below = here;
    }
    NodeRanges::from_nodes(world, all).map_err(|e| fail(io::Error::other(e)))
}

/// Ranges of a block of nodes (first column and row, and how many) of level `q`, from their own
/// posts and those of every coarser level over their area. (Posts of finer levels come from the
/// children.)
fn block_ranges(
    world: &World,
    levels: &[Level<f32>],
    finest: u8,
    q: u8,
    (first, count): ([u64; 2], [u64; 2]),
    nodes: Option<&Nodes>,
) -> io::Result<Vec<Range>> {
    let side = world.node_side(q);
    let mut ranges = vec![EMPTY; (count[0] * count[1]) as usize];
    for (level, posts) in (finest..).zip(levels).filter(|(level, _)| *level >= q) {
        // Posts from the one at or before a lattice position to the one at or after another: whole
        // cells.
        let spacing = 1u64 << level;
        let before = |node: u64| node * side / spacing;
        let after = |node: u64| (node * side).div_ceil(spacing);
        let origin = first.map(before);
        let rect =
            Rect::new(origin.map(|v| v as i64), [0, 1].map(|a| (after(first[a] + count[a]) - origin[a] + 1) as usize));
        let heights = posts.read(rect)?;
        for (k, range) in ranges.iter_mut().enumerate() {
            let node = [first[0] + k as u64 % count[0], first[1] + k as u64 / count[0]];
            let above = node.map(|v| (v >> (level - q)) as u32);
            if nodes.is_some_and(|nodes| !NodeId::new(above[0], above[1], level).is_some_and(|n| nodes.has(n))) {
                continue;
            }
            let from = [0, 1].map(|a| (before(node[a]) - origin[a]) as usize);
            let to = [0, 1].map(|a| (after(node[a] + 1) - origin[a]) as usize);
            for row in from[1]..=to[1] {
                let line = &heights[row * rect.size[0]..][from[0]..=to[0]];
                *range = union(*range, range_of(line.iter()));
            }
        }
    }
    Ok(ranges)
}
