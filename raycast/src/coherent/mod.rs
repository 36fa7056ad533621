//! Rays that start where the one below them hit, over voxels (voxel-flythrough-1999 §4).

pub mod cast;
pub(crate) mod surface;
pub(crate) mod voxels;
