//! Voxel ray casting on the processor (voxel-flythrough-1999): a second way to draw the ground, whose cost does not depend
//! on how rough it is. No polygon, no graphics device, no other process.
//!
//! ```text
//! heights, tile by tile ─▶ Ground: densities · boundary array · maxima     (model/)
//! camera ─▶ View: rays, planes ─▶ Lines: each pixel once, for any roll     (view, lines)
//!                │
//!                ▼  neighbouring lines, to whichever worker is free        (caster, workers)
//!          cast: from the bottom up, each ray from where the last one hit  (coherent/)
//!          mipmap: one exact ray per pixel                                 (exact/)
//!                ▼
//!          Picture: colour and depth ─▶ outlines of tiles, if wanted        (shade/)
//! ```
//!
//! A [`model::Ground`] is filled with tiles of any mixture of levels: the elevation arrays of a frame's slots, or tiles of a
//! database. Colours stay where they are. [`caster::Caster::draw`] allocates nothing from the second frame of a size on.

#![forbid(unsafe_code)]

pub mod caster;
pub mod coherent;
mod exact;
mod frame;
pub mod lines;
pub mod model;
pub mod picture;
mod shade;
mod steepness;
pub mod view;
pub mod workers;

pub use caster::{CastOptions, Caster, Method};
pub use coherent::cast::{Coherence, Counts};
pub use picture::Picture;
