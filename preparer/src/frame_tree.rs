//! One frame's tree, copied out of shared memory and checked. The rest of the preparer trusts it.

use glam::DVec3;
use terravision_common::database::Layer;
pub use terravision_common::database::Tile;
use terravision_common::level::deepest_color_below;
use terravision_common::node::NodeId;
use terravision_common::tree::{COLOR_FROM_ANCESTOR, COLOR_LEAF, ELEVATION_LEAF, TreeNode};
use terravision_common::world::World;

/// What is wrong with a tree. The generator never writes such a tree: it comes from another build,
/// or memory is damaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TreeError {
    /// The number does not name a node of this world.
    #[error("node {index} of the tree has id {found:#x}, which is not a node of this world")]
    NotANode {
        /// Index in the tree.
        index: u32,
        /// The packed id.
        found: u64,
    },
    /// The first node is not the root.
    #[error("the tree begins with node {found}, expected the root {expected}")]
    NotTheRoot {
        /// The node that it begins with.
        found: NodeId,
        /// The root.
        expected: NodeId,
    },
    /// Children are not where a depth first tree has them.
    #[error("the children of node {index} of the tree begin at {found}, expected {expected}")]
    Children {
        /// Index in the tree.
        index: u32,
        /// Where they begin.
        found: u32,
        /// Where they should begin.
        expected: u32,
    },
    /// A child's id does not belong to its parent, or occurs twice.
    #[error("node {child} of the tree is listed as child of {parent}")]
    NotAChild {
        /// The parent.
        parent: NodeId,
        /// The child.
        child: NodeId,
    },
    /// The flags contradict the node's place.
    #[error("node {node} of the tree has flags {flags:#x}, which do not fit its place")]
    Flags {
        /// The node.
        node: NodeId,
        /// Its flags.
        flags: u8,
    },
    /// Some nodes cannot be reached from the root.
    #[error("the tree has {found} nodes, but only {reached} can be reached from its root")]
    Unreached {
        /// Nodes.
        found: u32,
        /// Nodes reached.
        reached: u32,
    },
    /// There are more elevation leaves than elevation arrays.
    #[error("the tree has {found} elevation leaves, but the elevation ring holds {capacity} arrays")]
    TooManyLeaves {
        /// Elevation leaves.
        found: u32,
        /// Arrays.
        capacity: u32,
    },
}

/// One node, checked.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameNode {
    pub(crate) id: NodeId,
    pub(crate) parent: u32,
    pub(crate) first_child: u32,
    pub(crate) child_count: u8,
    /// An elevation leaf.
    pub(crate) is_elevation_leaf: bool,
    /// At or above an elevation leaf: its elevation tile is wanted.
    pub(crate) wants_elevation: bool,
    /// Its own colour tile is wanted.
    pub(crate) wants_color: bool,
}

impl FrameNode {
    pub(crate) fn children(&self) -> std::ops::Range<usize> {
        let first = self.first_child as usize;
        first..first + usize::from(self.child_count)
    }
}

/// The checked tree; keeps its buffers from frame to frame.
#[derive(Debug)]
pub struct FrameTree {
    world: World,
    max_elevation_leaves: u32,
    pub(crate) nodes: Vec<FrameNode>,
    stack: Vec<(u32, bool)>,
    wanted: Vec<Tile>,
}

impl FrameTree {
    /// Buffers for trees of up to `nodes` nodes, `max_elevation_leaves` of them elevation leaves.
    #[must_use]
    pub fn new(world: &World, nodes: u32, max_elevation_leaves: u32) -> Self {
        let nodes = nodes as usize;
        Self {
            world: *world,
            max_elevation_leaves,
            nodes: Vec::with_capacity(nodes),
            stack: Vec::with_capacity(4 * 26),
            wanted: Vec::with_capacity(2 * nodes),
        }
    }

    /// Whether the tree, whose nodes are in near-to-far order as seen from `eye`, is in that order
    /// for another eye too. It is if both eyes are on the same sides of all borders between
    /// children.
    #[must_use]
    pub fn is_near_to_far(&self, eye: DVec3, other: DVec3) -> bool {
        let surface = self.world.surface();
        let mut split = self.nodes.iter().filter(|node| node.child_count > 0);
        surface.foot(eye) == surface.foot(other) || split.all(|node| surface.is_same_order(node.id, eye, other))
    }

    /// Reads and checks a tree. An empty tree is a frame in which nothing is visible.
    ///
    /// # Errors
    /// [`TreeError`]; the previous tree is lost then.
    pub fn read(&mut self, tree: &[TreeNode]) -> Result<(), TreeError> {
        self.nodes.clear();
        self.wanted.clear();
        let Some(root) = tree.first() else { return Ok(()) };
        let found = self.id(0, root)?;
        let expected = self.world.root();
        if found != expected {
            return Err(TreeError::NotTheRoot { found, expected });
        }
        // Nodes are first copied in order, then walked, so that parents are known before their
        // children.
        for (index, node) in (0u32..).zip(tree) {
            let id = self.id(index, node)?;
            self.nodes.push(FrameNode {
                id,
                parent: 0,
                first_child: node.first_child,
                child_count: node.child_count,
                is_elevation_leaf: node.flags & ELEVATION_LEAF != 0,
                wants_elevation: false,
                wants_color: false,
            });
        }
        self.walk(tree)
    }

    fn id(&self, index: u32, node: &TreeNode) -> Result<NodeId, TreeError> {
        let exists = |id: &NodeId| self.world.contains(*id) || index == 0 && self.world.is_crown(*id);
        let id = node.id().filter(exists);
        id.ok_or(TreeError::NotANode { index, found: node.node })
    }

    fn walk(&mut self, tree: &[TreeNode]) -> Result<(), TreeError> {
        let len = tree.len() as u32;
        let deepest = deepest_color_below(&self.world);
        let mut next = 1u32;
        let mut reached = 0u32;
        let mut elevation_leaves = 0u32;
        self.stack.clear();
        self.stack.push((0, false));
        while let Some((index, is_below_elevation)) = self.stack.pop() {
            reached += 1;
            let node = tree[index as usize];
            let FrameNode { id, is_elevation_leaf, .. } = self.nodes[index as usize];
            elevation_leaves += u32::from(is_elevation_leaf);
            let has_children = node.child_count > 0;
            let is_whole = (node.flags & COLOR_LEAF != 0) != has_children
                && !(is_below_elevation && is_elevation_leaf)
                && (has_children || is_below_elevation || is_elevation_leaf)
                && (!is_elevation_leaf || self.world.has_elevation(id))
                && !(index == 0 && node.flags & COLOR_FROM_ANCESTOR != 0)
                && node.flags & !(ELEVATION_LEAF | COLOR_LEAF | COLOR_FROM_ANCESTOR) == 0;
            if !is_whole {
                return Err(TreeError::Flags { node: id, flags: node.flags });
            }
            let record = &mut self.nodes[index as usize];
            record.wants_elevation = !is_below_elevation && self.world.has_elevation(id);
            record.wants_color = node.flags & COLOR_FROM_ANCESTOR == 0 && self.world.has_color(id);
            for (is_wanted, layer) in [(record.wants_elevation, Layer::Elevation), (record.wants_color, Layer::Color)] {
                if is_wanted {
                    self.wanted.push(Tile { layer, node: id });
                }
            }
            let children = node.children(index, len).filter(|c| c.is_empty() || c.start == next);
            let children = children.ok_or(TreeError::Children { index, found: node.first_child, expected: next })?;
            next += children.len() as u32;
            let mut seen = 0u8;
            let family = self.world.surface().children(id);
            for at in children.rev() {
                let child = &mut self.nodes[at as usize];
                child.parent = index;
                let bit = family.number(child.id).map_or(0, |number| 1u8 << number);
                if bit == 0 || seen & bit != 0 {
                    return Err(TreeError::NotAChild { parent: id, child: child.id });
                }
                seen |= bit;
                let inherited = node.flags & COLOR_FROM_ANCESTOR;
                let flags = tree[at as usize].flags;
                if flags & inherited != inherited {
                    return Err(TreeError::Flags { node: child.id, flags });
                }
                self.stack.push((at, is_below_elevation || is_elevation_leaf));
            }
            if is_below_elevation && has_children && self.levels_below_elevation(index) >= deepest {
                return Err(TreeError::Flags { node: id, flags: node.flags });
            }
        }
        if reached != len {
            return Err(TreeError::Unreached { found: len, reached });
        }
        if elevation_leaves > self.max_elevation_leaves {
            return Err(TreeError::TooManyLeaves { found: elevation_leaves, capacity: self.max_elevation_leaves });
        }
        Ok(())
    }

    /// Levels between a node and the elevation leaf above it, which the walk has passed.
    fn levels_below_elevation(&self, index: u32) -> u8 {
        let mut node = &self.nodes[index as usize];
        let q = node.id.q();
        while !node.is_elevation_leaf {
            node = &self.nodes[node.parent as usize];
        }
        node.id.q() - q
    }

    /// Every tile that the frame wants, in the order of the tree: a tile comes after those of its
    /// ancestors.
    #[must_use]
    pub fn wanted(&self) -> &[Tile] {
        &self.wanted
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.nodes.len()
    }

    /// Whether nothing is visible.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }
}
