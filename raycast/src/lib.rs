//! Voxel ray casting on the processor (voxel-flythrough-1999): a second way to draw the ground, whose cost does not depend
//! on how rough it is. No polygon, no graphics device, no other process.
//!
//! ```text
//! heights, tile by tile ─▶ Ground: densities · boundary array · maxima     (ground/)
//! camera ─▶ View: rays, planes ─▶ Lines: each pixel once, for any roll     (view, lines)
//!                │
//!                ▼  neighbouring lines, to whichever worker is free        (caster, workers)
//!          cast: from the bottom up, each ray from where the last one hit  (cast, surface)
//!          mipmap: one exact ray per pixel                  (mipmap, projected, trace, strip, paint)
//!                ▼
//!          Picture: colour and depth ─▶ outlines of tiles, if wanted        (outline)
//! ```
//!
//! A [`ground::Ground`] is filled with tiles of any mixture of levels: the elevation arrays of a frame's slots, or tiles of a
//! database. Colours stay where they are. [`caster::Caster::draw`] allocates nothing from the second frame of a size on.

#![forbid(unsafe_code)]

pub mod cast;
pub mod caster;
pub mod color;
mod facets;
mod frame;
pub mod ground;
pub mod lines;
mod mipmap;
mod outline;
mod paint;
pub mod picture;
mod projected;
mod shares;
mod steepness;
mod strip;
mod surface;
mod trace;
pub mod view;
mod voxels;
pub mod workers;
pub mod world;

pub use cast::{Coherence, Counts};
pub use caster::{CastOptions, Caster, Method};
pub use picture::Picture;
