//! Height ranges of worlds whose finest levels exist only where there are data: only of existing
//! nodes, with the layers of which each has a tile. ("TVnodes2": per level, level 0 first, the
//! number of nodes (u64), then 20 bytes for each, by row from the south, then column: column and
//! row (u32), low and high (f32), layers (u32); little endian.)

use super::{Layer, RangesError};
use crate::level::deepest_color_below;
use crate::node::NodeId;
use crate::surface::SIDES;
use crate::world::World;
use std::io::Read;

/// Bytes of a node in the file.
pub(super) const NODE_BYTES: u64 = 20;

/// The layers of which a node has a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Layers {
    /// It has an elevation tile.
    pub elevation: bool,
    /// It has a colour tile.
    pub color: bool,
}

impl Layers {
    /// Whether it contains a layer.
    #[must_use]
    pub fn has(self, layer: Layer) -> bool {
        match layer {
            Layer::Elevation => self.elevation,
            Layer::Color => self.color,
        }
    }

    fn bits(self) -> u32 {
        u32::from(self.elevation) | u32::from(self.color) << 1
    }

    /// No layers, or unknown ones, are an error: such a node would not exist.
    fn of_bits(bits: u32) -> Option<Self> {
        (1..=3).contains(&bits).then_some(Self { elevation: bits & 1 != 0, color: bits & 2 != 0 })
    }
}

/// A node that exists.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NodeRange {
    /// The node.
    pub node: NodeId,
    /// Lowest and highest ground, metres.
    pub range: [f32; 2],
    /// The layers of which it has a tile.
    pub layers: Layers,
}

/// Nodes of one level, by row, then column.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SparseLevel {
    keys: Vec<u64>,
    values: Vec<([f32; 2], Layers)>,
}

fn key(node: NodeId) -> u64 {
    u64::from(node.n()) << 32 | u64::from(node.m())
}

impl SparseLevel {
    pub(super) fn find(&self, node: NodeId) -> Option<([f32; 2], Layers)> {
        self.keys.binary_search(&key(node)).ok().map(|at| self.values[at])
    }

    pub(super) fn nodes(&self, q: u8) -> impl Iterator<Item = NodeRange> + '_ {
        self.keys.iter().zip(&self.values).filter_map(move |(key, (range, layers))| {
            let node = NodeId::new(*key as u32, (*key >> 32) as u32, q)?;
            Some(NodeRange { node, range: *range, layers: *layers })
        })
    }

    /// Adds a node; `false` when it does not come after all existing ones.
    fn push(&mut self, node: &NodeRange) -> bool {
        let is_after = self.keys.last().is_none_or(|last| *last < key(node.node));
        self.keys.push(key(node.node));
        self.values.push((node.range, node.layers));
        is_after
    }
}

/// The levels of these nodes, in any order.
pub(super) fn levels_of(world: &World, mut nodes: Vec<NodeRange>) -> Result<Vec<SparseLevel>, RangesError> {
    nodes.sort_unstable_by_key(|n| (n.node.q(), key(n.node)));
    let mut levels = vec![SparseLevel::default(); usize::from(world.levels())];
    for node in &nodes {
        let level = levels.get_mut(usize::from(node.node.q()));
        if !level.is_some_and(|level| level.push(node)) {
            return Err(RangesError::Order { node: node.node });
        }
    }
    check(world, &levels)?;
    Ok(levels)
}

/// The file's bytes.
pub(super) fn encode(levels: &[SparseLevel], mut put: impl FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
    for (q, level) in (0u8..).zip(levels) {
        put(&(level.keys.len() as u64).to_le_bytes())?;
        for NodeRange { node, range: [low, high], layers } in level.nodes(q) {
            let words = [node.m(), node.n(), low.to_bits(), high.to_bits(), layers.bits()];
            let mut bytes = [0; NODE_BYTES as usize];
            bytes.chunks_exact_mut(4).zip(words).for_each(|(b, w)| b.copy_from_slice(&w.to_le_bytes()));
            put(&bytes)?;
        }
    }
    Ok(())
}

/// Bytes of these levels in the file.
pub(super) fn encoded_bytes(levels: &[SparseLevel]) -> u64 {
    levels.iter().map(|level| 8 + NODE_BYTES * level.keys.len() as u64).sum()
}

/// Reads the levels from a file of which `left` bytes are left. A count that does not fit into
/// these is an error.
pub(super) fn decode(world: &World, file: &mut impl Read, mut left: u64) -> Result<Vec<SparseLevel>, RangesError> {
    let mut levels = Vec::with_capacity(usize::from(world.levels()));
    for q in 0..world.levels() {
        let mut count = [0; 8];
        file.read_exact(&mut count)?;
        left = left.saturating_sub(8);
        let (count, most) = (u64::from_le_bytes(count), left / NODE_BYTES);
        if count > most {
            return Err(RangesError::Level { level: q, expected: most, found: count });
        }
        left -= count * NODE_BYTES;
        let mut level = SparseLevel::default();
        let mut bytes = [0; NODE_BYTES as usize];
        for _ in 0..count {
            file.read_exact(&mut bytes)?;
            let word =
                |k: usize| u32::from_le_bytes([bytes[4 * k], bytes[4 * k + 1], bytes[4 * k + 2], bytes[4 * k + 3]]);
            let node = NodeId::new(word(0), word(1), q).filter(|node| world.contains(*node));
            let node = node.ok_or(RangesError::NoNode { level: q, place: [word(0), word(1)] })?;
            let layers = Layers::of_bits(word(4)).ok_or(RangesError::Order { node })?;
            let range = [f32::from_bits(word(2)), f32::from_bits(word(3))];
            if !level.push(&NodeRange { node, range, layers }) {
                return Err(RangesError::Order { node });
            }
        }
        levels.push(level);
    }
    if left > 0 {
        return Err(RangesError::Level { level: world.levels(), expected: 0, found: left });
    }
    check(world, &levels)?;
    Ok(levels)
}

/// Checks the assumptions of the tree search: ranges are valid; the root exists; a node's parent
/// and all of its siblings exist; a node that has elevation below it has neighbours of its level on
/// all sides; colour is not too far below elevation.
fn check(world: &World, levels: &[SparseLevel]) -> Result<(), RangesError> {
    let layers = |node: NodeId| levels[usize::from(node.q())].find(node).map(|(_, layers)| layers).unwrap_or_default();
    let root = world.root();
    if layers(root) != (Layers { elevation: true, color: true }) {
        return Err(RangesError::Order { node: root });
    }
    for (q, level) in (0u8..).zip(levels) {
        for NodeRange { node, range, layers: own } in level.nodes(q) {
            if !(range[0].is_finite() && range[1].is_finite() && range[0] <= range[1]) {
                return Err(RangesError::Range { node, range });
            }
            let is_placed = (!own.elevation || world.has_elevation(node)) && (!own.color || world.has_color(node));
            let above_color = (q + deepest_color_below(world)).max(world.finest_elevation_level());
            let color_parent = node.ancestor(above_color.min(root.q()));
            let is_whole = node == root || {
                let siblings = (0..4).filter_map(|k| node.parent().child(k)).filter(|s| world.contains(*s));
                let above = layers(node.parent());
                let is_below = |layer: Layer| !own.has(layer) || above.has(layer);
                is_below(Layer::Elevation)
                    && is_below(Layer::Color)
                    && (!own.color || layers(color_parent).elevation)
                    && siblings.into_iter().all(|s| layers(s) == own)
                    && (!own.elevation || is_surrounded(world, node.parent(), &layers))
            };
            if !is_placed || !is_whole {
                return Err(RangesError::Order { node });
            }
        }
    }
    Ok(())
}

fn is_surrounded(world: &World, node: NodeId, layers: &impl Fn(NodeId) -> Layers) -> bool {
    SIDES.iter().filter_map(|(east, north)| world.neighbor(node, *east, *north)).all(|n| layers(n).elevation)
}

/// The finest level from which on every node exists and has all its tiles.
pub(super) fn complete_level(world: &World, levels: &[SparseLevel]) -> u8 {
    let is_complete = |q: u8| {
        let [columns, rows] = world.nodes_at(q).map(u64::from);
        let count = |layer: Layer| levels[usize::from(q)].values.iter().filter(|(_, l)| l.has(layer)).count() as u64;
        let is_all = |layer, finest: u8| q < finest || count(layer) == columns * rows;
        is_all(Layer::Elevation, world.finest_elevation_level()) && is_all(Layer::Color, world.finest_color_level())
    };
    let sparse = (0..world.levels()).rev().find(|q| !is_complete(*q));
    sparse.map_or(0, |q| q + 1)
}
