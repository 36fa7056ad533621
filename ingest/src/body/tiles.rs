//! Tiles of a body's heights, and the lowest and highest ground under every node.

use super::archive::{Archive, ArchivePlan};
use super::grid::Grid;
use super::posts::{Line, Posts};
use crate::IngestError;
use crate::archive::Tile;
use crate::work::Work;
use pmtiles::TileType;
use std::collections::BTreeMap;
use std::io;
use terravision_common::database::{ArchiveRecord, NodeRanges, encode_elevation_tile, tile_coord};
use terravision_common::node::NodeId;

type Range = [f32; 2];

const EMPTY: Range = [f32::MAX, f32::MIN];

fn union(a: Range, b: Range) -> Range {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// What a row of nodes becomes: a tile of each node, and the range of its posts and of those of all
/// coarser levels over it.
type RowOfNodes = Vec<(Tile, Range)>;

/// Writes all elevation tiles. Returns the archive's record and the ranges of all nodes.
pub(super) fn write(
    posts: &Posts<'_>,
    plan: &ArchivePlan<'_>,
    work: &Work,
) -> Result<(ArchiveRecord, NodeRanges), IngestError> {
    let grid = posts.grid();
    let fail = |source| IngestError::Output { source, path: plan.path.to_owned() };
    let mut archive = Archive::create(plan, TileType::Unknown, 0)?;
    let mut levels: Vec<Vec<Range>> = vec![Vec::new(); usize::from(grid.world.levels())];
    for q in (0..grid.world.levels()).rev() {
        let rows: Vec<NodeId> = grid.node_rows(q).collect();
        let ranges = &mut levels[usize::from(q)];
        work.in_order(
            "elevation tiles",
            rows.len(),
            || Ok(()),
            |(), index| row_of_nodes(posts, rows[index]).map_err(fail),
            |row: RowOfNodes| {
                for (tile, range) in row {
                    archive.add(tile)?;
                    ranges.push(range);
                }
                Ok(())
            },
        )?;
    }
    let record = archive.finish()?;
    add_descendants(grid, &mut levels);
    let ranges = NodeRanges::from_parts(&grid.world, levels).map_err(|e| fail(io::Error::other(e)))?;
    Ok((record, ranges))
}

/// Widens every node's range by those of its children.
fn add_descendants(grid: &Grid, levels: &mut [Vec<Range>]) {
    for q in 1..grid.world.levels() {
        let [below, own] = {
            let (below, own) = levels.split_at_mut(usize::from(q));
            [&mut below[usize::from(q) - 1], &mut own[0]]
        };
        // Where the rows of a level begin.
        let starts = |q: u8| {
            let rows = 0..grid.world.nodes_at(q)[1];
            rows.scan(0usize, move |start, n| {
                let at = *start;
                *start += grid.world.columns_of_row(q, n) as usize;
                Some(at)
            })
            .collect::<Vec<usize>>()
        };
        let (below_starts, own_starts) = (starts(q - 1), starts(q));
        for n in 0..grid.world.nodes_at(q)[1] {
            for m in 0..grid.world.columns_of_row(q, n) {
                let Some(node) = NodeId::new(m, n, q) else { continue };
                for child in grid.world.children(node) {
                    let range = below[below_starts[child.n() as usize] + child.m() as usize];
                    let parent = &mut own[own_starts[n as usize] + m as usize];
                    *parent = union(*parent, range);
                }
            }
        }
    }
}

fn row_of_nodes(posts: &Posts<'_>, first: NodeId) -> io::Result<RowOfNodes> {
    let grid = posts.grid();
    let lattice = *grid.lattice();
    let (q, n, cells) = (first.q(), first.n(), lattice.cells());
    let side = cells as usize + 1;
    let lines = lines_of(posts, first, 0..=cells)?;
    // Lines of the coarser levels over the row; all of its nodes have ancestors in the same rows.
    let mut above = Vec::new();
    for level in q + 1..grid.world.levels() {
        let Some(ancestor) = grid.world.ancestor(first, level) else { break };
        let [_, span] = lattice.span(first);
        let rows: Vec<u64> = (0..=cells).map(|k| lattice.row_post(ancestor, k)).collect();
        let from = rows.partition_point(|row| *row <= span.start).saturating_sub(1);
        let to = rows.partition_point(|row| *row < span.end).min(cells as usize);
        above.push((level, lines_of(posts, ancestor, from as u32..=to as u32)?));
    }
    let mut all = Vec::new();
    for m in 0..grid.world.columns_of_row(q, n) {
        let Some(node) = NodeId::new(m, n, q) else { continue };
        let columns: Vec<u64> = (0..=cells).map(|k| lattice.column_post(node, k)).collect();
        let mut heights = Vec::with_capacity(side * side);
        for k in 0..=cells {
            let line = &lines[&lattice.row_post(node, k)];
            heights.extend(columns.iter().map(|column| line.at(*column)));
        }
        let mut range = heights.iter().fold(EMPTY, |range, h| union(range, [*h; 2]));
        for (level, lines) in &above {
            let Some(ancestor) = grid.world.ancestor(node, *level) else { continue };
            range = union(range, range_above(grid, node, ancestor, lines));
        }
        let first = heights[0];
        let key = heights.iter().all(|h| *h == first).then(|| u64::from(first.to_bits()));
        let coord = tile_coord(&grid.world, node).ok_or_else(|| io::Error::other("a node has no place in archives"))?;
        all.push(((coord, encode_elevation_tile(&heights, cells + 1), key), range));
    }
    Ok(all)
}

/// The lines of posts of a row of nodes, by their lattice rows.
fn lines_of(posts: &Posts<'_>, node: NodeId, range: std::ops::RangeInclusive<u32>) -> io::Result<BTreeMap<u64, Line>> {
    let rows = range.map(|k| posts.grid().lattice().row_post(node, k));
    let mut lines = BTreeMap::new();
    for row in rows {
        if let std::collections::btree_map::Entry::Vacant(entry) = lines.entry(row) {
            entry.insert(posts.line(node.q(), row)?);
        }
    }
    Ok(lines)
}

/// The range of an ancestor's posts in these lines, of the cells that a node lies in.
fn range_above(grid: &Grid, node: NodeId, ancestor: NodeId, lines: &BTreeMap<u64, Line>) -> Range {
    let lattice = grid.lattice();
    let [columns, _] = lattice.span(node);
    let [log_step, _] = lattice.log_steps(ancestor);
    let origin = (u64::from(ancestor.m()) * u64::from(lattice.cells())) << log_step;
    let from = columns.start.saturating_sub(origin) >> log_step;
    let to = (columns.end - origin).div_ceil(1 << log_step).min(lattice.cells().into());
    let mut range = EMPTY;
    for k in from..=to {
        let column = lattice.column_post(ancestor, k as u32);
        range = lines.values().fold(range, |range, line| union(range, [line.at(column); 2]));
    }
    range
}
