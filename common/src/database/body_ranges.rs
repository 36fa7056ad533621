//! Height ranges of bodies, whose rows of nodes have different numbers of columns. ("TVnodes3": per
//! level, level 0 first, 8 bytes for each node that exists, by row from the south, then column: low and
//! high (f32, little endian). The lattice says how many there are.)

use super::RangesError;
use crate::node::NodeId;
use crate::world::World;

pub(super) const BODY_MAGIC: &[u8; 8] = b"TVnodes3";

/// Ranges of one level.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BodyLevel {
    /// The first node of each row, and the end.
    starts: Vec<usize>,
    ranges: Vec<[f32; 2]>,
}

impl BodyLevel {
    /// The range of a node that exists.
    pub(super) fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        let start = self.starts.get(node.n() as usize)?;
        self.ranges.get(start + node.m() as usize).copied()
    }

    /// All of them, by row, then column.
    pub(super) fn all(&self) -> &[[f32; 2]] {
        &self.ranges
    }
}

/// Checks the ranges of all levels.
pub(super) fn levels_of(world: &World, levels: Vec<Vec<[f32; 2]>>) -> Result<Vec<BodyLevel>, RangesError> {
    (0..world.levels())
        .zip(levels)
        .map(|(q, ranges)| {
            let mut starts = vec![0usize];
            for n in 0..world.nodes_at(q)[1] {
                starts.push(starts[starts.len() - 1] + world.columns_of_row(q, n) as usize);
            }
            let expected = starts[starts.len() - 1];
            if ranges.len() != expected {
                return Err(RangesError::Level { level: q, expected: expected as u64, found: ranges.len() as u64 });
            }
            let is_bad = |r: &[f32; 2]| !(r[0].is_finite() && r[1].is_finite() && r[0] <= r[1]);
            if let Some(at) = ranges.iter().position(is_bad) {
                let row = starts.partition_point(|start| *start <= at).saturating_sub(1);
                let node = NodeId::new((at - starts[row]) as u32, row as u32, q).unwrap_or(world.root());
                return Err(RangesError::Range { node, range: ranges[at] });
            }
            Ok(BodyLevel { starts, ranges })
        })
        .collect()
}
