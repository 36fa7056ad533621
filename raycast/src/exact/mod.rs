//! One exact ray per pixel: a walk through the pyramid of maxima (Tevs, Ihrke, Seidel: "Maximum
//! mipmaps for fast, accurate, and scalable dynamic height field rendering", I3D 2008), then the
//! facets of the cell, the same that the mesh draws. No voxels.
//!
//! ```text
//! walk: one ray, from node to node and tile to tile ─▶ cross: through a tile ─▶ entered: facets of a cell
//! line: the pixels of a line, bottom up  ─▶ follow: from facet to facet, over posts that are projected once
//! holes: rays that met a hole go on
//! ```

mod column;
mod cross;
mod entered;
mod follow;
mod highest;
pub(crate) mod holes;
mod line;
mod projected;
mod walk;

pub(crate) use column::{CHUNK, Target};
pub(crate) use entered::{LEAST_BELOW, LEAST_BELOW_M};
pub(crate) use follow::Follower;
pub(crate) use highest::HighestSeen;
pub(crate) use line::ExactRays;
pub(crate) use projected::Projected;
pub(crate) use walk::{Side, past};
