//! The coarser levels: filtered, never decimated, with voids masked; and the filling of voids.

pub mod color;
pub mod elevation;
pub mod validity;
pub mod voids;

/// The side of blocks of coarser levels.
pub(crate) const BLOCK: usize = 256;
