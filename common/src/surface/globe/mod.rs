//! A body: an ellipsoid whose ground is given over longitude and latitude.
//!
//! * [`Ellipsoid`]: positions, places and verticals, in double precision.
//! * [`GlobeLattice`]: lattice points, nodes and what is beside them, in integers.
//! * [`Globe`]: where lattice points are. [`GlobeEye`]: the same relative to an eye, in single
//!   precision, made of terms of columns and of rows. [`GlobeFrame`]: distances and depths. [`GlobeBounds`]:
//!   what space a node may fill, and whether it is behind the limb.
//!
//! Invariant, as of the plane: a vertex depends on its canonical lattice point, its height and the eye
//! alone, so that it is equal to the bit whichever node names it.

mod bounds;
mod ellipsoid;
mod eye;
mod frame;
mod lattice;
mod nodes;
#[cfg(test)]
mod tests;

pub use bounds::GlobeBounds;
pub use ellipsoid::{Ellipsoid, Geodetic};
pub use eye::{GlobeColumn, GlobeEye, GlobeRow};
pub use frame::GlobeFrame;
pub use lattice::{GlobeLattice, Side};

use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Longitudes may be given within this many degrees: a turn from either meridian that maps begin at.
pub const MOST_LONGITUDE: f64 = 360.0;

/// A body's ground: its lattice on its ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Globe {
    body: Ellipsoid,
    lattice: GlobeLattice,
    /// Longitude of column 0, radians.
    west: f64,
    /// Latitude of row 1, and from row to row, radians. The poles are rows of their own, wherever the
    /// samples beside them lie.
    first_row: f64,
    row_step: f64,
}

impl Globe {
    /// A lattice whose column 0 is at a longitude (radians), and whose rows lie at `first_row` (of
    /// row 1) and `row_step` (radians); those of the poles are at the poles. `None` unless all rows
    /// lie between these, in order.
    #[must_use]
    pub fn new(body: Ellipsoid, lattice: GlobeLattice, west: f64, [first_row, row_step]: [f64; 2]) -> Option<Self> {
        let globe = Self { body, lattice, west, first_row, row_step };
        let rows = u64::from(lattice.size()[1]);
        let is_in_order = row_step > 0.0
            && west.is_finite()
            && first_row > -FRAC_PI_2
            && (rows == 2 || globe.latitude(rows - 1) < FRAC_PI_2);
        is_in_order.then_some(globe)
    }

    /// The body.
    #[must_use]
    pub const fn body(&self) -> &Ellipsoid {
        &self.body
    }

    /// The lattice.
    #[must_use]
    pub const fn lattice(&self) -> &GlobeLattice {
        &self.lattice
    }

    /// Longitude of a lattice column, radians.
    #[must_use]
    pub fn longitude(&self, column: u64) -> f64 {
        self.west + TAU * (column as f64 / f64::from(self.lattice.size()[0]))
    }

    /// Latitude of a lattice row, radians.
    #[must_use]
    pub fn latitude(&self, row: u64) -> f64 {
        let rows = u64::from(self.lattice.size()[1]);
        match row {
            0 => -FRAC_PI_2,
            row if row >= rows => FRAC_PI_2,
            row => self.first_row + self.row_step * (row - 1) as f64,
        }
    }

    /// The place of a lattice point at a height.
    #[must_use]
    pub fn place(&self, point: [u64; 2], height_m: f64) -> Geodetic {
        let [column, row] = self.lattice.canonical(point);
        Geodetic { longitude: self.longitude(column), latitude: self.latitude(row), height_m }
    }

    /// From row to row along a meridian, divided among the levels that cut columns alone: what posts
    /// of level 0 are apart, where they are furthest, metres.
    #[must_use]
    pub fn unit_m(&self) -> f64 {
        self.body.semi_major_m() * self.row_step / f64::from(1u32 << self.lattice.rows_level())
    }

    /// The body as seen from an eye: longitude and latitude in degrees, and height.
    #[must_use]
    pub fn eye(&self, eye: DVec3) -> GlobeEye {
        GlobeEye::new(self.body, Geodetic::of_degrees(eye))
    }
}
