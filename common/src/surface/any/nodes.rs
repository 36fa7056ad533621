//! Nodes of a surface: their families, neighbours, posts and bounds.

use super::{Across, Children, MOST_CHILDREN, NodeBounds, Surface};
use crate::node::NodeId;
use crate::surface::globe::{GlobeBounds, Side};
use crate::surface::{PostLine, SIDES};
use glam::DVec3;

impl Surface {
    /// The children of a node; some of them may not exist where a plane ends.
    #[must_use]
    pub fn children(&self, node: NodeId) -> Children {
        match self {
            Self::Plane(_) => Children::new((0..4).filter_map(|index| node.child(index))),
            Self::Globe(globe) if node.q() > globe.lattice().top() => Children::new(globe.lattice().roots()),
            Self::Globe(globe) => Children::new(globe.lattice().children(node)),
        }
    }

    /// The node of the next coarser level that has this one as a child.
    #[inline]
    #[must_use]
    pub fn parent(&self, node: NodeId) -> NodeId {
        match self {
            Self::Plane(_) => node.parent(),
            Self::Globe(globe) => globe.lattice().parent(node).unwrap_or(globe.lattice().crown()),
        }
    }

    /// The ancestor at level `q`, or the node itself when that is its level. `q` must not be finer.
    #[inline]
    #[must_use]
    pub fn ancestor(&self, node: NodeId, q: u8) -> NodeId {
        match self {
            Self::Plane(_) => node.ancestor(q),
            Self::Globe(_) => (node.q()..q).fold(node, |node, _| self.parent(node)),
        }
    }

    /// The nodes of the same level across the west, east, south or north edge of a node, by its place in
    /// [`SIDES`]; where a row of nodes has no level as fine, those of the next coarser one.
    #[must_use]
    pub fn across(&self, node: NodeId, side: usize) -> Across {
        match self {
            Self::Plane(plane) => {
                let (east, north) = SIDES[side];
                [plane.neighbor(node, east, north), None]
            }
            Self::Globe(globe) => {
                let side = [Side::West, Side::East, Side::South, Side::North][side];
                let mut nodes = globe.lattice().neighbors(node, side);
                [nodes.next(), nodes.next()]
            }
        }
    }

    /// The nodes that touch a corner of a node, besides those across its edges, as
    /// [`Surface::across`] has them: `east` and `north` are -1 or 1.
    #[must_use]
    pub fn across_corner(&self, node: NodeId, east: i32, north: i32) -> Across {
        match self {
            Self::Plane(plane) => [plane.neighbor(node, east, north), None],
            Self::Globe(globe) => globe.lattice().across_corner(node, east > 0, north > 0),
        }
    }

    /// log2 of the steps from post to post of a node along each axis, in units that are the same for
    /// nodes on both sides of an edge.
    #[inline]
    #[must_use]
    pub fn log_steps(&self, node: NodeId) -> [u8; 2] {
        match self {
            Self::Plane(_) => [node.q(); 2],
            Self::Globe(globe) => globe.lattice().log_steps(node),
        }
    }

    /// The numbers of a node's children in the order from near to far, as seen from `eye`; how many
    /// there are.
    #[must_use]
    pub fn near_to_far(&self, node: NodeId, eye: DVec3) -> ([u8; MOST_CHILDREN], usize) {
        let mut order = [0; MOST_CHILDREN];
        match self {
            Self::Plane(plane) => {
                order[..4].copy_from_slice(&plane.near_to_far(node, eye));
                (order, 4)
            }
            Self::Globe(globe) => {
                let count = globe.near_to_far(self.children(node).iter(), eye, &mut order);
                (order, count)
            }
        }
    }

    /// Whether nodes that are in near-to-far order for an eye, with these children in their order, are
    /// so for another one too.
    #[must_use]
    pub fn is_same_order(&self, node: NodeId, eye: DVec3, other: DVec3) -> bool {
        self.near_to_far(node, eye).0[0] == self.near_to_far(node, other).0[0]
    }

    /// Bounds of the ground of a node. Its heights, exaggerated, lie between these two.
    #[must_use]
    pub fn node_bounds(&self, node: NodeId, heights: [f64; 2]) -> NodeBounds {
        match self {
            Self::Plane(plane) => {
                let bounds = plane.node_bounds(node, heights);
                NodeBounds::Plane(bounds, plane.reaches_border(&bounds))
            }
            Self::Globe(globe) if node.q() > globe.lattice().top() => NodeBounds::Everywhere,
            Self::Globe(globe) => NodeBounds::Globe(GlobeBounds::new(globe, node, heights)),
        }
    }

    /// Bounds of the ground of `side` cells of a node's tile a side, from a corner. Its heights,
    /// exaggerated, lie between the last two. `None` past the end of the ground.
    #[must_use]
    pub fn cells_bounds(&self, node: NodeId, [x, y]: [u32; 2], side: u32, heights: [f64; 2]) -> Option<NodeBounds> {
        let [columns, rows] = self.post_lines(node);
        let ends = |line: PostLine, first: u32| [line.post(first), line.post(first + side)].map(i64::cast_unsigned);
        let ([west, east], [south, north]) = (ends(columns, x), ends(rows, y));
        match self {
            Self::Plane(plane) => {
                let is_inside = west < plane.extent()[0].into() && south < plane.extent()[1].into();
                let bounds = plane.lattice_bounds([west, south], [east, north], heights);
                is_inside.then_some(NodeBounds::Plane(bounds, false))
            }
            Self::Globe(globe) => (west < east && south < north)
                .then(|| NodeBounds::Globe(GlobeBounds::of_rectangle(globe, [west, east], [south, north], heights))),
        }
    }

    /// First column and row of the block that a node below an elevation leaf (or the leaf itself) has in
    /// the leaf's array, and its sides, in posts of the leaf.
    #[must_use]
    pub fn block_of(&self, leaf: NodeId, below: NodeId) -> [[u32; 2]; 2] {
        let (own, block) = (self.post_lines(leaf), self.post_lines(below));
        let start = [0, 1].map(|axis| ((block[axis].origin() - own[axis].origin()) >> own[axis].log_step()) as u32);
        let cells = u64::from(self.cells());
        let side = [0, 1].map(|axis| ((cells << block[axis].log_step()) >> own[axis].log_step()) as u32);
        [start, side]
    }

    /// The columns of posts at the west and the east edge of a node's ground, and the rows at its south
    /// and north edge. Posts beyond them lie on them.
    #[must_use]
    pub fn edge_posts(&self, node: NodeId) -> [u32; 4] {
        let last = self.cells();
        match self {
            Self::Plane(_) => [0, last, 0, last],
            Self::Globe(globe) => {
                let [columns, rows] = globe.post_lines(node);
                [columns.first_inside(), columns.last_inside(), rows.first_inside(), rows.last_inside()]
            }
        }
    }

    /// The place, among the edges of a node, of the one that is a pole: south (2) or north (3).
    #[must_use]
    pub fn pole_of(&self, node: NodeId) -> Option<usize> {
        match self {
            Self::Plane(_) => None,
            Self::Globe(globe) => {
                let [_, rows] = globe.lattice().span(node);
                let last = u64::from(globe.lattice().size()[1]);
                if rows.start == 0 { Some(2) } else { (rows.end == last).then_some(3) }
            }
        }
    }

    /// The lattice coordinates along an axis of a node's posts: its columns (axis 0) or its rows. Those
    /// past the end of the ground are on it.
    pub fn posts(&self, node: NodeId, axis: usize) -> impl Iterator<Item = u64> {
        let line = match self {
            Self::Plane(plane) => {
                let origin = plane.node_origin(node)[axis].cast_signed();
                PostLine::new(origin, node.q(), plane.cells(), [0, plane.extent()[axis].into()])
            }
            Self::Globe(globe) => globe.post_lines(node)[axis],
        };
        (0..=self.cells()).map(move |index| line.post(index).cast_unsigned())
    }

    /// Where the numbers of a node's tile lie, along each axis. (A tile that reaches past the end of a
    /// plane has posts there.)
    #[inline]
    #[must_use]
    pub fn post_lines(&self, node: NodeId) -> [PostLine; 2] {
        match self {
            Self::Plane(plane) => plane.node_origin(node).map(|at| PostLine::even(at, node.q(), plane.cells())),
            Self::Globe(globe) => globe.post_lines(node),
        }
    }

    /// The lattice rows of the south and the north edge of a node, if heights on them are those between
    /// every second of its posts, because the nodes beside have no others there.
    #[inline]
    #[must_use]
    pub fn joined_rows(&self, node: NodeId) -> [Option<u64>; 2] {
        match self {
            Self::Plane(_) => [None; 2],
            Self::Globe(globe) => globe.lattice().joined_rows(node),
        }
    }

    /// How many cells of a node, from its corner, lie inside along each axis, at least in part.
    #[must_use]
    pub fn cells_inside(&self, node: NodeId) -> [u64; 2] {
        match self {
            Self::Plane(plane) => plane
                .cells_inside(plane.node_origin(node), node.q())
                .map(|cells: Option<u64>| cells.unwrap_or_default()),
            Self::Globe(globe) => globe.post_lines(node).map(|line| {
                let end = line.end();
                (0..=line.cells()).find(|index| line.post(*index) == end).map_or(0, u64::from)
            }),
        }
    }

    /// Lower left corner of a node, lattice units.
    #[inline]
    #[must_use]
    pub fn node_origin(&self, node: NodeId) -> [u64; 2] {
        match self {
            Self::Plane(plane) => plane.node_origin(node),
            Self::Globe(globe) => globe.post_lines(node).map(|line| line.post(0).cast_unsigned()),
        }
    }
}
