//! The surface that a world has: a plane, or a body.

use super::globe::{Globe, GlobeColumn, GlobeFrame, GlobeRow, Side};
use super::{EyeFrame, LatticePoint, Plane, PlaneFrame, PostLine, WorldBox};
use crate::node::NodeId;
use crate::surface::globe::{Ellipsoid, Geodetic, GlobeBounds};
use glam::{DVec2, DVec3};

/// Children that a node may have at most: those of the crown, which is above the roots of a body.
pub const MOST_CHILDREN: usize = 8;

/// The term that the vertices of a column share: metres east of the origin, or cosine and sine of the
/// longitude.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Column {
    /// Metres, or the cosine.
    pub x: f64,
    /// 0, or the sine.
    pub y: f64,
}

/// The terms of several columns.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Columns {
    /// [`Column::x`] of each.
    pub x: Vec<f64>,
    /// [`Column::y`] of each.
    pub y: Vec<f64>,
}

impl Columns {
    /// Room for as many.
    #[must_use]
    pub fn new(count: usize) -> Self {
        Self { x: vec![0.0; count], y: vec![0.0; count] }
    }

    /// Puts one.
    pub fn set(&mut self, index: usize, column: Column) {
        (self.x[index], self.y[index]) = (column.x, column.y);
    }
}

/// The term that the vertices of a row share: metres north of the origin; or, of a body, distance from
/// its axis and from its equator's plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Row {
    /// Metres north, or from the axis.
    pub x: f64,
    /// 0, or metres from the plane of the equator.
    pub y: f64,
    /// What a metre of height adds to `x`.
    pub from_axis: f64,
    /// What a metre of height adds to `y`.
    pub along: f64,
}

/// A world's surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Surface {
    /// Metres east and north of an origin, and height.
    Plane(Plane),
    /// Longitude and latitude in degrees, and height above an ellipsoid.
    Globe(Globe),
}

/// What space the ground of a node may fill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NodeBounds {
    /// A box of a plane; whether it touches the border of the world, below which there may be a skirt.
    Plane(WorldBox, bool),
    /// A box along the directions of the node's middle.
    Globe(GlobeBounds),
    /// That of the crown, which is all of a body.
    Everywhere,
}

/// The children of a node: those that may exist, each with a number.
#[derive(Debug, Clone, Copy)]
pub struct Children {
    nodes: [Option<NodeId>; MOST_CHILDREN],
}

impl Children {
    fn new(nodes: impl Iterator<Item = NodeId>) -> Self {
        let mut children = Self { nodes: [None; MOST_CHILDREN] };
        for (place, node) in children.nodes.iter_mut().zip(nodes) {
            *place = Some(node);
        }
        children
    }

    /// In the order of their numbers.
    pub fn iter(&self) -> impl Iterator<Item = NodeId> + use<> {
        self.nodes.into_iter().flatten()
    }

    /// The number of a child.
    #[must_use]
    pub fn number(&self, child: NodeId) -> Option<u8> {
        self.iter().position(|node| node == child).map(|number| number as u8)
    }
}

/// Nodes across an edge: up to two.
pub type Across = [Option<NodeId>; 2];

impl Surface {
    /// Cells along the side of a tile: Nz.
    #[inline]
    #[must_use]
    pub const fn cells(&self) -> u32 {
        match self {
            Self::Plane(plane) => plane.cells(),
            Self::Globe(globe) => globe.lattice().cells(),
        }
    }

    /// Distance of two posts of level 0, metres; of a body, where they are farthest apart.
    #[inline]
    #[must_use]
    pub fn unit_m(&self) -> f64 {
        match self {
            Self::Plane(plane) => plane.unit_m(),
            Self::Globe(globe) => globe.unit_m(),
        }
    }

    /// The same of level `q`.
    #[inline]
    #[must_use]
    pub fn spacing_m(&self, q: u8) -> f64 {
        self.unit_m() * f64::from(1u32 << q)
    }

    /// The coarsest level whose posts are as close together as any are: 0 of a plane; of a body that
    /// from which on rows are cut.
    #[must_use]
    pub const fn rows_level(&self) -> u8 {
        match self {
            Self::Plane(_) => 0,
            Self::Globe(globe) => globe.lattice().rows_level(),
        }
    }

    /// Levels by which nodes beside each other may differ along their common edge more than their own
    /// levels do.
    #[must_use]
    pub const fn lag(&self) -> u8 {
        matches!(self, Self::Globe(_)) as u8
    }

    /// The surface as seen by an eye that looks along a unit vector, which is given in the directions
    /// east, north and up of the eye.
    #[must_use]
    pub fn seen_by(&self, eye: DVec3, forward: DVec3) -> EyeFrame {
        match self {
            Self::Plane(plane) => EyeFrame::Plane(plane.seen_by(eye, forward)),
            Self::Globe(globe) => EyeFrame::Globe(GlobeFrame::new(globe, eye, forward)),
        }
    }

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
    /// [`SIDES`](super::SIDES); where a row of nodes has no level as fine, those of the next coarser one.
    #[must_use]
    pub fn across(&self, node: NodeId, side: usize) -> Across {
        match self {
            Self::Plane(plane) => {
                let (east, north) = super::SIDES[side];
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

    /// Whether lines of the lattice are straight, as seen from above an eye.
    #[must_use]
    pub const fn is_straight(&self) -> bool {
        matches!(self, Self::Plane(_))
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

    /// The foot at a share of a node's sides from its corner, and the area of all of the node were it as
    /// it is there, square metres. `None` past the end of the ground.
    #[must_use]
    pub fn foot_in_node(&self, node: NodeId, share: DVec2) -> Option<(DVec2, f64)> {
        match self {
            Self::Plane(plane) => {
                let side_m = plane.node_side_m(node.q());
                let corner = plane.foot_of_lattice(DVec2::from_array(plane.node_origin(node).map(|at| at as f64)));
                let foot = corner + share * side_m;
                plane.holds(foot).then_some((foot, side_m * side_m))
            }
            Self::Globe(globe) => globe.foot_in_node(node, share),
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

    /// The term that the vertices of a column share.
    #[inline(always)]
    #[must_use]
    pub fn column(&self, lattice: u64) -> Column {
        match self {
            Self::Plane(plane) => Column { x: plane.column(lattice), y: 0.0 },
            Self::Globe(globe) => globe.column(lattice),
        }
    }

    /// The term that the vertices of a row share.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, lattice: u64) -> Row {
        match self {
            Self::Plane(plane) => Row { x: plane.row(lattice), ..Row::default() },
            Self::Globe(globe) => globe.row(lattice),
        }
    }

    /// A vertex in a space in which lines of sight are straight: of a body, body-fixed.
    #[must_use]
    pub fn vertex(&self, point: LatticePoint, height_m: f64) -> DVec3 {
        match self {
            Self::Plane(plane) => plane.vertex(point, height_m),
            Self::Globe(globe) => globe.body().position(globe.place([point.x, point.y], height_m)),
        }
    }

    /// A position in that space.
    #[must_use]
    pub fn straight(&self, position: DVec3) -> DVec3 {
        match self {
            Self::Plane(_) => position,
            Self::Globe(globe) => globe.body().position(Geodetic::of_degrees(position)),
        }
    }

    /// The position of a point of that space.
    #[must_use]
    pub fn of_straight(&self, point: DVec3) -> DVec3 {
        match self {
            Self::Plane(_) => point,
            Self::Globe(globe) => globe.body().place(point).degrees(),
        }
    }

    /// A direction in that space, in the directions east, north and up of a position.
    #[must_use]
    pub fn to_local(&self, position: DVec3, direction: DVec3) -> DVec3 {
        match self {
            Self::Plane(_) => direction,
            Self::Globe(_) => Ellipsoid::east_north_up(Geodetic::of_degrees(position)).transpose() * direction,
        }
    }

    /// The position at a way from another one, metres east, north and up there.
    #[must_use]
    pub fn moved(&self, position: DVec3, way: DVec3) -> DVec3 {
        match self {
            Self::Plane(_) => position + way,
            Self::Globe(globe) => {
                let axes = Ellipsoid::east_north_up(Geodetic::of_degrees(position));
                let moved = globe.body().place(self.straight(position) + axes * way).degrees();
                // No jump where longitudes begin again.
                let turns = ((position.x - moved.x) / 360.0).round();
                DVec3::new(moved.x + 360.0 * turns, moved.y, moved.z)
            }
        }
    }

    /// The one name of a position: longitudes from -180 to 180 degrees.
    #[must_use]
    pub fn named(&self, position: DVec3) -> DVec3 {
        match self {
            Self::Plane(_) => position,
            Self::Globe(_) if position.x.abs() <= 180.0 => position,
            Self::Globe(_) => DVec3::new((position.x + 180.0).rem_euclid(360.0) - 180.0, position.y, position.z),
        }
    }

    /// The node of a level that contains a foot inside the world; where a body has none as fine, the
    /// finest.
    #[inline]
    #[must_use]
    pub fn node_at(&self, foot: DVec2, q: u8) -> Option<NodeId> {
        match self {
            Self::Plane(plane) => plane.node_at(foot, q),
            Self::Globe(globe) => globe.node_at(foot, q),
        }
    }

    /// The position of a foot in the tile of a node, in cells from its corner.
    #[inline]
    #[must_use]
    pub fn place_in_node(&self, foot: DVec2, node: NodeId) -> DVec2 {
        match self {
            Self::Plane(plane) => plane.place_in_node(foot, node),
            Self::Globe(globe) => globe.place_in_node(foot, node),
        }
    }

    /// The point of the surface under (or over) a position.
    #[inline(always)]
    #[must_use]
    pub fn foot(&self, position: DVec3) -> DVec2 {
        position.truncate()
    }

    /// The height of a position.
    #[inline(always)]
    #[must_use]
    pub fn height_m(&self, position: DVec3) -> f64 {
        position.z
    }

    /// Height of a position above ground of this height below it.
    #[inline(always)]
    #[must_use]
    pub fn height_above(&self, position: DVec3, ground_m: f64) -> f64 {
        position.z - ground_m
    }

    /// The position over a foot at a height.
    #[inline(always)]
    #[must_use]
    pub fn position(&self, foot: DVec2, height_m: f64) -> DVec3 {
        foot.extend(height_m)
    }

    /// The unit normal of ground at a foot in the tile of a node, where it rises by this much over a
    /// cell of the tile, metres east and north: east, north and up in the local frame of the foot.
    #[must_use]
    pub fn normal(&self, foot: DVec2, node: NodeId, slope: [f64; 2]) -> DVec3 {
        match self {
            Self::Plane(plane) => plane.normal(foot, node.q(), slope),
            Self::Globe(globe) => globe.normal(foot, node, slope),
        }
    }

    /// Whether there is ground, or a hole in it, at a foot.
    #[inline]
    #[must_use]
    pub fn holds(&self, foot: DVec2) -> bool {
        match self {
            Self::Plane(plane) => plane.holds(foot),
            Self::Globe(_) => foot.x.abs() <= super::globe::MOST_LONGITUDE && foot.y.abs() <= 90.0,
        }
    }

    /// Whether a position is over (or under) the world. An eye beside the world may look below its
    /// edge.
    #[inline]
    #[must_use]
    pub fn is_over(&self, position: DVec3) -> bool {
        self.holds(self.foot(position))
    }

    /// The terms of the columns and rows of a node's posts for vertices that an eye sees.
    pub fn place_terms(&self, frame: &EyeFrame, node: NodeId, terms: &mut super::VertexTerms) {
        match (self, frame) {
            (Self::Plane(plane), EyeFrame::Plane(frame)) => place_on_plane(plane, frame, node, terms),
            (Self::Globe(globe), EyeFrame::Globe(frame)) => {
                let eye = frame.terms();
                let [columns, rows] = globe.post_lines(node);
                let place = |line: &PostLine, index: u32| line.post(index).cast_unsigned();
                let cells = self.cells();
                terms.globe_columns.clear();
                terms.globe_columns.extend((0..=cells).map(|index| globe.eye_column(eye, place(&columns, index))));
                terms.globe_rows.clear();
                terms.globe_rows.extend((0..=cells).map(|index| globe.eye_row(eye, place(&rows, index))));
                terms.globe = Some(*eye);
            }
            _ => {}
        }
    }
}

fn place_on_plane(plane: &Plane, frame: &PlaneFrame, node: NodeId, terms: &mut super::VertexTerms) {
    let posts = plane.cells() as usize + 1;
    terms.columns.clear();
    terms.columns.extend(plane.posts(node, 0).take(posts).map(|x| frame.column_from_eye(plane.column(x))));
    terms.rows.clear();
    terms.rows.extend(plane.posts(node, 1).take(posts).map(|y| frame.row_from_eye(plane.row(y))));
}

/// Terms of columns and rows of a body, from an eye.
impl Globe {
    /// Of a lattice column.
    #[must_use]
    pub fn eye_column(&self, eye: &super::globe::GlobeEye, column: u64) -> GlobeColumn {
        eye.column(self.longitude(column % u64::from(self.lattice().size()[0])))
    }

    /// Of a lattice row. All points of a pole are one.
    #[must_use]
    pub fn eye_row(&self, eye: &super::globe::GlobeEye, row: u64) -> GlobeRow {
        let made = eye.row(self.latitude(row));
        if row == 0 || row >= u64::from(self.lattice().size()[1]) { made.on_axis() } else { made }
    }
}

impl NodeBounds {
    /// The same with a skirt down to this height, where the node is on the border of the world.
    #[must_use]
    pub fn with_skirt(self, low_m: f64) -> Self {
        match self {
            Self::Plane(bounds, true) => Self::Plane(bounds.down_to(low_m), true),
            other => other,
        }
    }

    /// Where a straight way from `start`, in the space of [`Surface::straight`], meets it, widened by a
    /// margin on all sides: the share of the way, 0 to 1; `None` where it passes by.
    #[must_use]
    pub fn met_by(&self, start: DVec3, way: DVec3, margin: f64) -> Option<f64> {
        match self {
            Self::Plane(bounds, _) => bounds.met_by(start, way, margin),
            Self::Globe(bounds) => bounds.met_by(start, way, margin),
            Self::Everywhere => Some(0.0),
        }
    }
}
