//! The surface that a world has: a plane, or a body.
//!
//! * `nodes`: families of nodes, what is beside them, their posts and bounds.
//! * `places`: positions.

mod nodes;
mod places;

use super::globe::{Globe, GlobeBounds};
use super::{Plane, WorldBox};
use crate::node::NodeId;
use glam::DVec3;

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
