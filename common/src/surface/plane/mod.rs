//! The plane: a foot is metres east and north of the world's origin, height is z.

mod cell;
mod crs;
mod eye;
mod nodes;

pub use cell::EyeCell;
pub use crs::CrsFrame;
pub use eye::{EyeFrame, EyeRow};

use super::{LatticePoint, WorldBox};
use crate::node::NodeId;
use glam::{DVec2, DVec3};

/// The term of a column in the position of a vertex: metres east of the world's origin.
pub type Column = f64;
/// The term of a row in the position of a vertex: metres north of the world's origin.
pub type Row = f64;

/// A world's rectangle of a plane, cut into nodes whose vertices are lattice points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Distance of two lattice points, metres.
    unit_m: f64,
    /// Where the ground ends east and north, lattice units.
    extent: [u32; 2],
    /// Side of a node of level 0, lattice units: a power of two.
    side: u32,
}

impl Plane {
    /// A plane of lattice points `unit_m` apart that ends `extent` units east and north of its
    /// origin, with nodes of level 0 of `side` units.
    #[inline]
    #[must_use]
    pub const fn new(unit_m: f64, extent: [u32; 2], side: u32) -> Self {
        Self { unit_m, extent, side }
    }

    /// Distance of two lattice points, metres.
    #[inline]
    #[must_use]
    pub const fn unit_m(&self) -> f64 {
        self.unit_m
    }

    /// Where the ground ends east and north, lattice units.
    #[inline]
    #[must_use]
    pub const fn extent(&self) -> [u32; 2] {
        self.extent
    }

    /// Cells along the side of a tile: Nz.
    #[inline]
    #[must_use]
    pub const fn cells(&self) -> u32 {
        self.side
    }
}

/// Positions, world coordinates: metres.
impl Plane {
    /// The term that the vertices of a column share.
    #[inline(always)]
    #[must_use]
    pub fn column(&self, lattice: u64) -> Column {
        lattice as f64 * self.unit_m
    }

    /// The term that the vertices of a row share.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, lattice: u64) -> Row {
        lattice as f64 * self.unit_m
    }

    /// The position of a vertex: of its column, its row, and its height.
    #[inline(always)]
    #[must_use]
    pub fn vertex(&self, point: LatticePoint, height_m: f64) -> DVec3 {
        DVec3::new(self.column(point.x), self.row(point.y), height_m)
    }

    /// The foot of a place on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn foot_of_lattice(&self, lattice: DVec2) -> DVec2 {
        lattice * self.unit_m
    }

    /// The place of a foot on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn lattice_of_foot(&self, foot: DVec2) -> DVec2 {
        foot / self.unit_m
    }

    /// The vector from the foot of an eye to a place on the lattice, in lattice units.
    #[inline(always)]
    #[must_use]
    pub fn lattice_from_eye(&self, lattice: DVec2, eye: DVec3) -> DVec2 {
        self.foot_of_lattice(lattice) - self.foot(eye)
    }

    /// The place on the lattice, in lattice units, at this vector from the foot of an eye.
    #[inline(always)]
    #[must_use]
    pub fn lattice_of_way(&self, way: DVec2, eye: DVec3) -> DVec2 {
        self.lattice_of_foot(way + self.foot(eye))
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

    /// The direction in which height grows.
    #[inline(always)]
    #[must_use]
    pub fn up(&self, _position: DVec3) -> DVec3 {
        DVec3::Z
    }

    /// The lattice point south west of a position, clamped to the extent.
    #[inline]
    #[must_use]
    pub fn lattice_under(&self, position: DVec3) -> LatticePoint {
        // Casts of negative numbers give 0.
        let [x, y] = [position.x, position.y].map(|v| (v / self.unit_m) as u64);
        LatticePoint { x, y }
    }

    /// The corner of the world that is farthest from its origin.
    #[inline]
    #[must_use]
    pub fn end(&self) -> DVec2 {
        DVec2::from_array(self.extent.map(|e| f64::from(e) * self.unit_m))
    }

    /// Whether there is ground, or a hole in it, at a foot.
    #[inline]
    #[must_use]
    pub fn holds(&self, foot: DVec2) -> bool {
        let end = self.end();
        foot.x >= 0.0 && foot.y >= 0.0 && foot.x <= end.x && foot.y <= end.y
    }

    /// Whether a position is over (or under) the world. An eye beside the world may look below its
    /// edge.
    #[inline]
    #[must_use]
    pub fn is_over(&self, position: DVec3) -> bool {
        self.holds(self.foot(position))
    }

    /// The node of a level that contains a foot inside the world.
    #[inline]
    #[must_use]
    pub fn node_at(&self, foot: DVec2, q: u8) -> Option<NodeId> {
        let (side_m, [columns, rows]) = (self.node_side_m(q), self.nodes_at(q));
        NodeId::new(((foot.x / side_m) as u32).min(columns - 1), ((foot.y / side_m) as u32).min(rows - 1), q)
    }

    /// The position of a foot in the tile of a node, in cells from its corner.
    #[inline]
    #[must_use]
    pub fn place_in_node(&self, foot: DVec2, node: NodeId) -> DVec2 {
        let corner = DVec2::from_array(self.node_origin(node).map(|v| v as f64 * self.unit_m));
        (foot - corner) / self.spacing_m(node.q())
    }

    /// Bounds of the ground of a node, clipped to the extent. Its heights, exaggerated, lie between
    /// these two.
    #[must_use]
    pub fn node_bounds(&self, node: NodeId, [a, b]: [f64; 2]) -> WorldBox {
        let (side, low) = (self.node_side(node.q()), self.node_origin(node));
        let high = [0, 1].map(|axis| self.canonical(axis, low[axis] + side) as f64 * self.unit_m);
        WorldBox {
            min: DVec3::new(low[0] as f64 * self.unit_m, low[1] as f64 * self.unit_m, a.min(b)),
            max: DVec3::new(high[0], high[1], a.max(b)),
        }
    }

    /// Whether a node's bounds touch the border of the world, below which there may be a skirt.
    #[must_use]
    pub fn reaches_border(&self, bounds: &WorldBox) -> bool {
        let end = self.end();
        (0..2).any(|axis| bounds.min[axis] <= 0.0 || bounds.max[axis] >= end[axis])
    }

    /// The surface as seen by an eye that looks along a unit vector.
    #[must_use]
    pub fn seen_by(&self, eye: DVec3, forward: DVec3) -> EyeFrame {
        EyeFrame::new(eye, forward)
    }
}

#[cfg(test)]
mod tests;
