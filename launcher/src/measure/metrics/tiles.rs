//! Of which nodes there are tiles in the pools, and which are wanted: for maps of a flight.

use serde_json::json;
use std::cmp::Reverse;
use std::collections::BTreeSet;
use terravision_common::database::Tile;
use terravision_common::node::NodeId;
use terravision_common::shm::{PoolReader, RunId, SegmentKind, ShmError, WantListWatcher};

/// Most nodes of either kind that are told of, coarse ones first.
const MOST_NODES: usize = 1500;

/// Nodes, coarse ones first.
type Nodes = BTreeSet<(Reverse<u8>, u32, u32)>;

/// Looks at the pools and at the want list of a run.
#[derive(Debug)]
pub(super) struct TileMap {
    pools: [PoolReader; 2],
    wants: WantListWatcher,
    wanted: Vec<Tile>,
}

impl TileMap {
    pub(super) fn open(run: &RunId) -> Result<Self, ShmError> {
        let pools =
            [PoolReader::open(run, SegmentKind::ElevationPool)?, PoolReader::open(run, SegmentKind::ColorPool)?];
        Ok(Self { pools, wants: WantListWatcher::open(run)?, wanted: Vec::new() })
    }

    /// Level, m and n of each node, one behind the other.
    pub(super) fn write(&mut self) -> String {
        let slots = self.pools.iter().flat_map(PoolReader::slots).filter(|slot| slot.state.is_readable());
        let resident: Nodes = slots.filter_map(|slot| slot.node).map(entry).collect();
        // A list that cannot be read is told of by the stage whose it is; the one before stays.
        self.wants.read(&mut self.wanted).ok();
        let wanted: Nodes =
            self.wanted.iter().map(|tile| entry(tile.node)).filter(|node| !resident.contains(node)).collect();
        let left_out = resident.len().saturating_sub(MOST_NODES) + wanted.len().saturating_sub(MOST_NODES);
        json!({"resident": flat(&resident), "wanted": flat(&wanted), "left_out": left_out}).to_string()
    }
}

fn entry(node: NodeId) -> (Reverse<u8>, u32, u32) {
    (Reverse(node.q()), node.m(), node.n())
}

fn flat(nodes: &Nodes) -> Vec<u32> {
    nodes.iter().take(MOST_NODES).flat_map(|(Reverse(q), m, n)| [u32::from(*q), *m, *n]).collect()
}
