//! Truncation: which part of a frame's tree is drawn, given the resident tiles, and how its
//! elevation leaves meet.
//!
//! A node is expanded when the tiles of all its visible children are resident; otherwise it is
//! drawn itself, with the tiles that it has. After that, a leaf may lie beside a leaf that is
//! coarser by any number of levels. Edges can bridge up to `log2 Nz` levels, where the coarser
//! leaf's facets still have a vertex at both ends of the finer leaf's edge; a leaf that would need
//! more is drawn coarser. The same holds for colour leaves whose block is narrower than the steps
//! to which an edge of their elevation leaf collapses: facets at the edge would reach into the next
//! block, and beyond their colour tile.

use crate::frame_tree::{FrameTree, Tile};
use terravision_common::database::Layer;
use terravision_common::ids::SlotKey;
use terravision_common::node::NodeId;
use terravision_common::node_table::NodeTable;
use terravision_common::world::World;

/// The place of a tile in the colour pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColorPlace {
    /// The node whose tile it is.
    pub node: NodeId,
    /// Where it is.
    pub key: SlotKey,
}

/// The resident tiles. They stay resident while a frame is made.
pub trait Tiles {
    /// Where a node's colour tile lies in its pool.
    fn color(&self, node: NodeId) -> Option<SlotKey>;
    /// Posts of a node's elevation tile, `(Nz + 1)²`, row 0 in the south.
    fn elevation(&self, node: NodeId) -> Option<&[f32]>;
    /// Where a node's elevation tile lies in its pool.
    fn elevation_key(&self, node: NodeId) -> Option<SlotKey>;
}

/// The root's tiles are missing: nothing can be drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no picture can be drawn without the {} tile of the root node {}, which cannot be read", tile.layer, tile.node)]
pub struct RootMissing {
    /// The tile.
    pub tile: Tile,
}

/// How a leaf meets its neighbours: for each part of its border, the level of the coarsest leaf
/// that touches it, the leaf itself included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seams {
    /// Inside the west, east, south and north edge.
    pub edges: [u8; 4],
    /// At the south west, south east, north west and north east corner.
    pub corners: [u8; 4],
    /// The edge that is a pole, south (2) or north (3), and the level of the coarsest leaf around it.
    pub pole: Option<(usize, u8)>,
}

impl Seams {
    /// The level of the coarsest leaf that touches points inside each edge. All of an edge at a pole is
    /// one point.
    #[must_use]
    pub fn floors(&self) -> [u8; 4] {
        let mut floors = self.edges;
        if let Some((side, level)) = self.pole {
            floors[side] = level;
        }
        floors
    }

    /// The same at the corners.
    #[must_use]
    pub fn corner_floors(&self) -> [u8; 4] {
        let mut floors = self.corners;
        if let Some((side, level)) = self.pole {
            let first = 2 * (side - 2);
            floors[first..first + 2].fill(level);
        }
        floors
    }
}

/// The axis along which an edge runs: north for the west and the east, east for the others.
#[must_use]
pub fn along(side: usize) -> usize {
    usize::from(side < 2)
}

/// An elevation leaf that is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ElevationLeaf {
    /// The node.
    pub node: NodeId,
    /// How it meets its neighbours.
    pub seams: Seams,
    /// Its colour leaves: a range of [`Truncation::color_leaves`].
    pub first_color_leaf: u32,
    /// End of that range.
    pub end_color_leaf: u32,
    /// Its place among [`Truncation::elevation_nodes`].
    pub tile: u32,
    index: u32,
}

/// A colour leaf that is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColorLeaf {
    /// The node: the area that is drawn.
    pub node: NodeId,
    /// The tile with which it is drawn: its own, or that of the nearest ancestor that has one.
    pub color: ColorPlace,
    index: u32,
}

impl ColorLeaf {
    /// Its index in the full tree.
    pub(crate) fn index(&self) -> usize {
        self.index as usize
    }
}

/// The drawn part of one frame's tree, near to far; keeps its buffers from frame to frame.
#[derive(Debug)]
pub struct Truncation {
    world: World,
    colors: Vec<Option<SlotKey>>,
    is_there: Vec<bool>,
    is_blocked: Vec<bool>,
    stack: Vec<Step>,
    table: NodeTable,
    elevation_leaves: Vec<ElevationLeaf>,
    elevation_nodes: Vec<NodeId>,
    color_leaves: Vec<ColorLeaf>,
    node_count: u32,
    /// The level of the coarsest leaf at the south pole and at the north pole of a body.
    at_poles: [u8; 2],
}

#[derive(Debug, Clone, Copy)]
struct Step {
    index: u32,
    color: ColorPlace,
}

impl Truncation {
    /// Buffers for trees of up to `nodes` nodes.
    #[must_use]
    pub fn new(world: &World, nodes: u32) -> Self {
        let nodes = nodes as usize;
        Self {
            world: *world,
            colors: Vec::with_capacity(nodes),
            is_there: Vec::with_capacity(nodes),
            is_blocked: Vec::with_capacity(nodes),
            stack: Vec::with_capacity(4 * 26),
            table: NodeTable::new(nodes),
            elevation_leaves: Vec::with_capacity(nodes),
            elevation_nodes: Vec::with_capacity(nodes),
            color_leaves: Vec::with_capacity(nodes),
            node_count: 0,
            at_poles: [0; 2],
        }
    }

    /// Elevation leaves, near to far.
    #[must_use]
    pub fn elevation_leaves(&self) -> &[ElevationLeaf] {
        &self.elevation_leaves
    }

    /// Elevation leaves and all nodes above them: a node comes after the one above it.
    #[must_use]
    pub fn elevation_nodes(&self) -> &[NodeId] {
        &self.elevation_nodes
    }

    /// Colour leaves, near to far.
    #[must_use]
    pub fn color_leaves(&self) -> &[ColorLeaf] {
        &self.color_leaves
    }

    /// Colour leaves of an elevation leaf, near to far.
    #[must_use]
    pub fn colors_of(&self, leaf: &ElevationLeaf) -> &[ColorLeaf] {
        &self.color_leaves[leaf.first_color_leaf as usize..leaf.end_color_leaf as usize]
    }

    /// Nodes of the truncated tree.
    #[must_use]
    pub fn node_count(&self) -> u32 {
        self.node_count
    }

    /// Truncates a frame's tree to the resident tiles. Each tile is looked up once, so that the
    /// whole frame is consistent.
    ///
    /// # Errors
    /// [`RootMissing`] when not even the root can be drawn.
    pub fn truncate(&mut self, tree: &FrameTree, tiles: &impl Tiles) -> Result<(), RootMissing> {
        self.colors.clear();
        self.is_there.clear();
        self.is_blocked.clear();
        self.elevation_leaves.clear();
        self.elevation_nodes.clear();
        self.color_leaves.clear();
        self.node_count = 0;
        for node in &tree.nodes {
            let color = if node.wants_color { tiles.color(node.id) } else { None };
            let has_elevation = !node.wants_elevation || tiles.elevation(node.id).is_some();
            self.colors.push(color);
            self.is_there.push(has_elevation && (!node.wants_color || color.is_some()));
            self.is_blocked.push(false);
        }
        let Some(root) = tree.nodes.first() else { return Ok(()) };
        // The crown of a body has no tiles; all of its children are roots.
        let roots = if self.world.is_crown(root.id) { root.children() } else { 0..1 };
        let mut first_color = None;
        for at in roots {
            let node = tree.nodes[at].id;
            let missing = |layer| RootMissing { tile: Tile { layer, node } };
            let key = self.colors[at].ok_or(missing(Layer::Color))?;
            if !self.is_there[at] {
                return Err(missing(Layer::Elevation));
            }
            first_color.get_or_insert(ColorPlace { node, key });
        }
        let Some(color) = first_color else { return Ok(()) };
        loop {
            self.collect(tree, color);
            if self.meet(tree) {
                return Ok(());
            }
        }
    }

    /// Walks the tree depth first and collects the leaves.
    fn collect(&mut self, tree: &FrameTree, root_color: ColorPlace) {
        self.elevation_leaves.clear();
        self.elevation_nodes.clear();
        self.color_leaves.clear();
        self.table.clear();
        self.node_count = 0;
        self.stack.clear();
        self.stack.push(Step { index: 0, color: root_color });
        while let Some(Step { index, color }) = self.stack.pop() {
            let node = tree.nodes[index as usize];
            self.node_count += 1;
            let children = node.children();
            let is_expanded = !children.is_empty()
                && !self.is_blocked[index as usize]
                && self.is_there[children.clone()].iter().all(|is_there| *is_there);
            let tile = self.elevation_nodes.len() as u32;
            if node.wants_elevation {
                self.elevation_nodes.push(node.id);
            }
            // A node that is cut above its elevation leaves becomes one.
            if node.is_elevation_leaf || (!is_expanded && node.wants_elevation) {
                let first = self.color_leaves.len() as u32;
                let seams = Seams { edges: [node.id.q(); 4], corners: [node.id.q(); 4], pole: None };
                let (first_color_leaf, end_color_leaf) = (first, first);
                let leaf = ElevationLeaf { node: node.id, seams, first_color_leaf, end_color_leaf, tile, index };
                // The table has room for every node of a tree.
                if self.table.insert(node.id, self.elevation_leaves.len() as u32).is_ok() {
                    self.elevation_leaves.push(leaf);
                }
            }
            if !is_expanded {
                self.color_leaves.push(ColorLeaf { node: node.id, color, index });
                if let Some(leaf) = self.elevation_leaves.last_mut() {
                    leaf.end_color_leaf = self.color_leaves.len() as u32;
                }
                continue;
            }
            for child in children.rev() {
                let own = self.colors[child].map(|key| ColorPlace { node: tree.nodes[child].id, key });
                self.stack.push(Step { index: child as u32, color: own.unwrap_or(color) });
            }
        }
    }

    /// Finds the neighbours of every elevation leaf. Returns `false` when some neighbours are too
    /// coarse: then the ancestors that are coarse enough have been marked to be drawn instead.
    fn meet(&mut self, tree: &FrameTree) -> bool {
        let most = self.world.elevation_tile().ilog2() as u8;
        let mut is_bridged = true;
        self.find_poles();
        for at in 0..self.elevation_leaves.len() {
            let seams = self.seams(self.elevation_leaves[at].node);
            self.elevation_leaves[at].seams = seams;
            let leaf = self.elevation_leaves[at];
            let snap = self.most_snap(leaf.node);
            if snap > most {
                self.block(tree, leaf.index, leaf.node.q() + snap - most);
                is_bridged = false;
                continue;
            }
            // Blocks of 2^snap cells are this many levels below.
            let finest = (leaf.node.q() + snap).saturating_sub(most);
            for color in leaf.first_color_leaf..leaf.end_color_leaf {
                let ColorLeaf { node, index, .. } = self.color_leaves[color as usize];
                if node.q() < finest {
                    self.block(tree, index, finest);
                    is_bridged = false;
                }
            }
        }
        is_bridged
    }

    /// Marks the ancestor at level `q` of a node (or the node itself) to be drawn unsplit.
    fn block(&mut self, tree: &FrameTree, index: u32, q: u8) {
        let mut index = index as usize;
        while tree.nodes[index].id.q() < q {
            index = tree.nodes[index].parent as usize;
        }
        self.is_blocked[index] = true;
    }

    /// The elevation leaves across the west, east, south and north edge of a leaf, by index, where
    /// there is one that is as long as the leaf's edge.
    #[must_use]
    pub fn neighbors(&self, node: NodeId) -> [Option<u32>; 4] {
        [0, 1, 2, 3].map(|side| match self.leaves_across(node, side) {
            (1, [leaf, _]) => leaf,
            (_, [leaf, other]) => leaf.filter(|_| leaf == other),
        })
    }

    /// How many nodes of a level are across an edge, none, one, or two of half its length; and the
    /// elevation leaves that cover them, `None` where finer leaves do, or none.
    #[must_use]
    pub fn leaves_across(&self, node: NodeId, side: usize) -> (usize, [Option<u32>; 2]) {
        let exists = |id: &NodeId| self.world.contains(*id);
        let across = self.world.surface().across(node, side).map(|id| id.filter(exists));
        (across.iter().flatten().count(), across.map(|id| id.and_then(|id| self.leaf_at(id))))
    }

    fn seams(&self, node: NodeId) -> Seams {
        let leaves = &self.elevation_leaves;
        let surface = self.world.surface();
        let level = |across: [Option<u32>; 2]| {
            across.into_iter().flatten().map(|at| leaves[at as usize].node.q()).fold(node.q(), u8::max)
        };
        let edges = [0, 1, 2, 3].map(|side| level(self.leaves_across(node, side).1));
        let corner = |east, north| {
            let across = surface.across_corner(node, east, north);
            level(across.map(|id| id.filter(|id| self.world.contains(*id)).and_then(|id| self.leaf_at(id))))
        };
        let [west, east, south, north] = edges;
        let corners = [
            corner(-1, -1).max(south).max(west),
            corner(1, -1).max(south).max(east),
            corner(-1, 1).max(north).max(west),
            corner(1, 1).max(north).max(east),
        ];
        let pole = surface.pole_of(node).map(|side| (side, self.at_poles[side - 2].max(node.q())));
        Seams { edges, corners, pole }
    }

    /// Finds the coarsest leaf at each pole: all leaves around it share that point.
    fn find_poles(&mut self) {
        self.at_poles = [0; 2];
        for leaf in &self.elevation_leaves {
            if let Some(side) = self.world.surface().pole_of(leaf.node) {
                let level = &mut self.at_poles[side - 2];
                *level = leaf.node.q().max(*level);
            }
        }
    }

    /// log2 of the longest step of the four edges of a leaf, in its own posts.
    fn most_snap(&self, node: NodeId) -> u8 {
        let surface = self.world.surface();
        let own = surface.log_steps(node);
        let leaves = self.neighbors(node).into_iter().enumerate();
        let snaps = leaves.filter_map(|(side, leaf)| {
            let axis = along(side);
            let step = surface.log_steps(self.elevation_leaves[leaf? as usize].node)[axis];
            Some(step.saturating_sub(own[axis]))
        });
        snaps.max().unwrap_or(0)
    }

    /// The elevation leaf that covers a node; `None` when finer leaves cover it, or none.
    fn leaf_at(&self, mut id: NodeId) -> Option<u32> {
        loop {
            if let Some(at) = self.table.get(id) {
                return Some(at);
            }
            if id.q() + 1 >= self.world.levels() {
                return None;
            }
            id = self.world.surface().parent(id);
        }
    }
}
