//! Nodes: where they are, in integers and in metres, and what space they may fill; lengths of sides.

use super::Plane;
use crate::node::NodeId;
use crate::surface::WorldBox;
use glam::{DVec2, DVec3};

impl Plane {
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
        let high = [0, 1].map(|axis| self.canonical(axis, low[axis] + side));
        self.lattice_bounds(low, high, [a, b])
    }

    /// Bounds of the ground of a rectangle of the lattice. Its heights, exaggerated, lie between
    /// the last two.
    #[must_use]
    pub fn lattice_bounds(&self, low: [u64; 2], high: [u64; 2], [a, b]: [f64; 2]) -> WorldBox {
        WorldBox {
            min: DVec3::new(low[0] as f64 * self.unit_m, low[1] as f64 * self.unit_m, a.min(b)),
            max: DVec3::new(high[0] as f64 * self.unit_m, high[1] as f64 * self.unit_m, a.max(b)),
        }
    }

    /// Whether a node's bounds touch the border of the world, below which there may be a skirt.
    #[must_use]
    pub fn reaches_border(&self, bounds: &WorldBox) -> bool {
        let end = self.end();
        (0..2).any(|axis| bounds.min[axis] <= 0.0 || bounds.max[axis] >= end[axis])
    }

    /// Side of a node of level `q`, lattice units.
    #[inline]
    #[must_use]
    pub fn node_side(&self, q: u8) -> u64 {
        u64::from(self.side) << q
    }

    /// Side of a node of level `q`, metres.
    #[inline]
    #[must_use]
    pub fn node_side_m(&self, q: u8) -> f64 {
        self.node_side(q) as f64 * self.unit_m
    }

    /// Distance of two posts of level `q`, metres.
    #[inline]
    #[must_use]
    pub fn spacing_m(&self, q: u8) -> f64 {
        self.unit_m * f64::from(1u32 << q)
    }

    /// Lower left corner of a node, lattice units.
    #[inline]
    #[must_use]
    pub fn node_origin(&self, node: NodeId) -> [u64; 2] {
        let side = self.node_side(node.q());
        [u64::from(node.m()) * side, u64::from(node.n()) * side]
    }

    /// Columns and rows of nodes of level `q` that contain ground.
    #[inline]
    #[must_use]
    pub fn nodes_at(&self, q: u8) -> [u32; 2] {
        let side = self.node_side(q);
        self.extent.map(|e| u64::from(e).div_ceil(side) as u32)
    }

    /// The node of the same level `east` columns and `north` rows away, if it can exist.
    #[inline]
    #[must_use]
    pub fn neighbor(&self, node: NodeId, east: i32, north: i32) -> Option<NodeId> {
        let (m, n) = (node.m().checked_add_signed(east)?, node.n().checked_add_signed(north)?);
        NodeId::new(m, n, node.q())
    }

    /// Children of a node, front to back as seen from `eye`: the quadrant of the eye, the one
    /// across the nearer of the two middle lines, the one across the other, the opposite one. No
    /// ray from the eye meets them in another order.
    #[must_use]
    pub fn near_to_far(&self, node: NodeId, eye: DVec3) -> [u8; 4] {
        let half = 0.5 * self.node_side_m(node.q());
        let middle = self.node_origin(node).map(|c| c as f64 * self.unit_m + half);
        let (dx, dy) = (eye.x - middle[0], eye.y - middle[1]);
        let nearest = u8::from(dx >= 0.0) | u8::from(dy >= 0.0) << 1;
        let (second, third) = if dx.abs() <= dy.abs() { (1, 2) } else { (2, 1) };
        [nearest, nearest ^ second, nearest ^ third, nearest ^ 3]
    }

    /// The canonical lattice coordinate of a vertex along an axis (0 east, 1 north): points past
    /// the extent are clamped to it.
    #[inline(always)]
    #[must_use]
    pub fn canonical(&self, axis: usize, lattice: u64) -> u64 {
        lattice.min(self.extent[axis].into())
    }

    /// The lattice coordinates along an axis of a node's posts, canonical: its columns (axis 0) or
    /// its rows.
    #[inline]
    pub fn posts(&self, node: NodeId, axis: usize) -> impl Iterator<Item = u64> {
        self.posts_from(self.node_origin(node)[axis], node.q(), axis)
    }

    #[inline]
    fn posts_from(self, origin: u64, q: u8, axis: usize) -> impl Iterator<Item = u64> {
        (0u64..).map(move |index| self.canonical(axis, origin + (index << q)))
    }

    /// How many cells of `1 << log_cell` lattice units from a lattice point on lie inside, at least
    /// in part, east and north; `None` past the extent.
    #[inline]
    #[must_use]
    pub fn cells_inside(&self, origin: [u64; 2], log_cell: u8) -> [Option<u64>; 2] {
        [0, 1].map(|axis| {
            let left = u64::from(self.extent[axis]).checked_sub(origin[axis])?;
            Some(left.div_ceil(1 << log_cell))
        })
    }
}
