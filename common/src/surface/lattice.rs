//! Names of points that may be vertices.

/// A point of the lattice: an elevation post that the finest level has or would have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LatticePoint {
    /// Lattice units east of the origin.
    pub x: u64,
    /// Lattice units north of the origin.
    pub y: u64,
}

/// Steps east and north to the nodes across the west, east, south and north edge of a node: the
/// order in which edges are listed everywhere.
pub const SIDES: [(i32, i32); 4] = [(-1, 0), (1, 0), (0, -1), (0, 1)];
