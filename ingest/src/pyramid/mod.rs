//! The coarser levels: filtered, never decimated (design §3), voids masked; and voids filled.

pub mod color;
pub mod elevation;
pub mod validity;
pub mod voids;

/// The side of blocks of coarser levels.
pub(crate) const BLOCK: usize = 256;
