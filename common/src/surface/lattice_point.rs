//! Lattice points: the points that may be vertices.

/// A point of the lattice: a place of an elevation post of the finest level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LatticePoint {
    /// Lattice units east of the origin.
    pub x: u64,
    /// Lattice units north of the origin.
    pub y: u64,
}

/// Steps east and north to the neighbours across the west, east, south and north edge of a node.
/// Edges are always listed in this order.
pub const SIDES: [(i32, i32); 4] = [(-1, 0), (1, 0), (0, -1), (0, 1)];
