//! The ground that rays are cast on: tiles of heights, side by side, of any mixture of levels, and
//! their voxels where a technique needs them.
//!
//! A tile of `n` x `n` cells has `(n + 1)²` columns of voxels, one per elevation post. A voxel is
//! as high as it is wide, and layers are counted from the same height for all tiles of a level, so
//! that two tiles have equal columns on the edge that they share. Each cell has four columns at its
//! corners. For each cell the *boundary array* has the lowest and the highest boundary cell: below
//! them is ground, above them air.

pub mod color;
mod density;
pub(crate) mod facet;
mod ground;
mod heights;
mod maxima;
mod neighbors;
mod pyramid;
mod spec;
mod steep;
mod tile;
mod tree;
mod voxels;
mod walls;
pub mod world;

pub use density::{BOX_HALF_WIDTH, Filter, SIGMA, THRESHOLD};
pub use ground::Ground;
pub(crate) use pyramid::{LevelDistances, Pyramid, Source, TileSource};
pub use pyramid::{PoolShape, PoolTile};
pub use spec::{Detail, GroundError, GroundShape, PatchSpec, TileSpec};
pub(crate) use steep::SLOPE_BOUND;
pub(crate) use tile::Tile;
pub(crate) use tree::Found;
pub use tree::{Link, Node, Occupied, Tree};
pub(crate) use voxels::{LOG_BLOCK, Span};

#[cfg(test)]
mod tests;
