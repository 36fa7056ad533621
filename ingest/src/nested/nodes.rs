//! Which nodes of each level exist.

use crate::store::Rect;
use std::collections::HashSet;
use terravision_common::database::Layer;
use terravision_common::node::NodeId;
use terravision_common::world::World;

/// The nodes of one pyramid that exist, by level. A node has all of its children or none; so the
/// tree can be cut anywhere.
#[derive(Debug, Clone)]
pub(crate) struct Nodes {
    world: World,
    layer: Layer,
    levels: Vec<HashSet<[u32; 2]>>,
}

impl Nodes {
    pub(crate) fn new(world: &World, layer: Layer) -> Self {
        Self { world: *world, layer, levels: vec![HashSet::new(); usize::from(world.levels())] }
    }

    fn finest(&self) -> u8 {
        match self.layer {
            Layer::Elevation => self.world.finest_elevation_level(),
            Layer::Color => self.world.finest_color_level(),
        }
    }

    pub(crate) fn insert(&mut self, node: NodeId) {
        self.levels[usize::from(node.q())].insert([node.m(), node.n()]);
    }

    pub(crate) fn has(&self, node: NodeId) -> bool {
        self.levels.get(usize::from(node.q())).is_some_and(|level| level.contains(&[node.m(), node.n()]))
    }

    /// Whether the children of a node exist.
    pub(crate) fn has_children(&self, node: NodeId) -> bool {
        node.child(0).is_some_and(|child| self.has(child))
    }

    /// Nodes of a level, by row, then column.
    pub(crate) fn of_level(&self, q: u8) -> Vec<NodeId> {
        let mut all: Vec<[u32; 2]> = self.levels[usize::from(q)].iter().copied().collect();
        all.sort_unstable_by_key(|[m, n]| [*n, *m]);
        all.into_iter().filter_map(|[m, n]| NodeId::new(m, n, q)).collect()
    }

    pub(crate) fn count(&self) -> usize {
        self.levels.iter().map(HashSet::len).sum()
    }

    /// Whether all nodes of the world exist.
    pub(crate) fn is_whole(&self) -> bool {
        (self.finest()..self.world.levels()).all(|q| {
            let all: u64 = self.world.nodes_at(q).map(u64::from).iter().product();
            self.levels[usize::from(q)].len() as u64 == all
        })
    }

    /// Adds the nodes that a level needs besides those with data: parents of the level below; for
    /// elevation, the neighbours of these parents, so that levels of neighbouring leaves never
    /// differ by more than one; and all siblings.
    pub(crate) fn close(&mut self, q: u8) {
        let world = self.world;
        if q > self.finest() {
            let parents: HashSet<NodeId> = self.of_level(q - 1).into_iter().map(NodeId::parent).collect();
            for parent in parents {
                self.insert(parent);
                if self.layer == Layer::Elevation {
                    let around = (-1..=1).flat_map(|east| (-1..=1).map(move |north| (east, north)));
                    let beside = around.filter_map(|(east, north)| world.neighbor(parent, east, north));
                    beside.for_each(|node| self.insert(node));
                }
            }
        }
        if q == world.root().q() {
            self.insert(world.root());
            return;
        }
        let parents: HashSet<NodeId> = self.of_level(q).into_iter().map(NodeId::parent).collect();
        for child in parents.into_iter().flat_map(|parent| (0..4).filter_map(move |k| parent.child(k))) {
            if world.contains(child) {
                self.insert(child);
            }
        }
    }

    /// Nodes of level `q` that a rectangle of samples touches, if a node has `side` samples along a
    /// side.
    pub(crate) fn meeting(&self, q: u8, rect: Rect, side: usize) -> impl Iterator<Item = NodeId> + use<> {
        let counts = self.world.nodes_at(q);
        let [x, y] = [0, 1].map(|axis| {
            let last = i64::from(counts[axis]) - 1;
            let first = rect.origin[axis].div_euclid(side as i64).clamp(0, last);
            let end = (rect.origin[axis] + rect.size[axis] as i64 - 1).div_euclid(side as i64).clamp(0, last);
            first as u32..=end as u32
        });
        y.flat_map(move |n| x.clone().filter_map(move |m| NodeId::new(m, n, q)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_testkit::worlds;

    #[test]
    fn one_node_brings_a_graded_tree() {
        let world = worlds::world([1000, 900], 1.0, [8, 32]);
        let mut nodes = Nodes::new(&world, Layer::Elevation);
        nodes.insert(NodeId::new(61, 40, 0).unwrap());
        (0..world.levels()).for_each(|q| nodes.close(q));
        assert_eq!(nodes.of_level(0).len(), 4);
        assert!(nodes.count() < 4 + 16 + 5 * 36 && !nodes.is_whole());
        for q in 0..world.levels() - 1 {
            for node in nodes.of_level(q) {
                let parent = node.parent();
                assert!(nodes.has(parent) && nodes.has_children(parent));
                for (east, north) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                    assert!(world.neighbor(parent, east, north).is_none_or(|n| nodes.has(n)));
                }
            }
        }
    }
}
