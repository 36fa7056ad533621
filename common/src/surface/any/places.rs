//! Where points of a surface are, and what is under a position.

use super::{Column, Row, Surface};
use crate::node::NodeId;
use crate::surface::globe::{Ellipsoid, Geodetic, Globe, GlobeColumn, GlobeEye, GlobeFrame, GlobeRow, MOST_LONGITUDE};
use crate::surface::{EyeFrame, LatticePoint, Plane, PlaneFrame, PostLine, VertexTerms};
use glam::{DVec2, DVec3};

impl Surface {
    /// The surface as seen by an eye that looks along a unit vector, which is given in the directions
    /// east, north and up of the eye.
    #[must_use]
    pub fn seen_by(&self, eye: DVec3, forward: DVec3) -> EyeFrame {
        match self {
            Self::Plane(plane) => EyeFrame::Plane(plane.seen_by(eye, forward)),
            Self::Globe(globe) => EyeFrame::Globe(GlobeFrame::new(globe, eye, forward)),
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
            Self::Globe(_) => foot.x.abs() <= MOST_LONGITUDE && foot.y.abs() <= 90.0,
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
    pub fn place_terms(&self, frame: &EyeFrame, node: NodeId, terms: &mut VertexTerms) {
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

fn place_on_plane(plane: &Plane, frame: &PlaneFrame, node: NodeId, terms: &mut VertexTerms) {
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
    pub fn eye_column(&self, eye: &GlobeEye, column: u64) -> GlobeColumn {
        eye.column(self.longitude(column % u64::from(self.lattice().size()[0])))
    }

    /// Of a lattice row. All points of a pole are one.
    #[must_use]
    pub fn eye_row(&self, eye: &GlobeEye, row: u64) -> GlobeRow {
        let made = eye.row(self.latitude(row));
        if row == 0 || row >= u64::from(self.lattice().size()[1]) { made.on_axis() } else { made }
    }
}
