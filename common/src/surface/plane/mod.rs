//! The plane: a foot is metres east and north of the world's origin, height is z.

mod cell;
mod crs;
mod eye;
mod nodes;
mod positions;

pub use cell::EyeCell;
pub use crs::CrsFrame;
pub use eye::{PlaneFrame, PlaneRow};

use glam::DVec3;

/// The term of a column in the position of a vertex: metres east of the world's origin.
pub(super) type Column = f64;
/// The term of a row in the position of a vertex: metres north of the world's origin.
pub(super) type Row = f64;

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

    /// The surface as seen by an eye that looks along a unit vector.
    #[must_use]
    pub fn seen_by(&self, eye: DVec3, forward: DVec3) -> PlaneFrame {
        PlaneFrame::new(eye, forward)
    }
}

#[cfg(test)]
mod tests;
