//! Voxel ray casting on the processor (voxel-flythrough-1999): a second way to draw the ground,
//! whose cost does not depend on its roughness. It needs no polygons, no graphics device and no
//! other process.
//!
//! ```text
//! heights, tile by tile ─▶ Ground: densities · boundary array · maxima       (model/)
//! camera ─▶ View: rays ─▶ Scene: the ground seen from the eye                (view, scene)
//!        └▶ Lines: each pixel once, for any roll                             (lines)
//!                │
//!                ▼  neighboring lines, to whichever worker is free           (caster, workers)
//!          coherent: from the bottom up, each ray from where the last one hit
//!          exact: one exact ray per pixel                      } by what is proven of a ray's way (proof/)
//!          sweep: vertical planes, all rays of each at once    (sweep/)
//!                ▼
//!          Canvas: picture of color and depth ─▶ outlines of tiles, if wanted (shade/)
//! ```
//!
//! A technique fills lines of pixels: it gets a `Scene`, writes what pixels see to a `Canvas`, and
//! does not depend on the other techniques. Imports: `model` ← `scene` ← `proof`, `shade` ← `exact`
//! ← `coherent` ← `caster`, and `shade` ← `sweep` ← `caster`.
//!
//! A [`model::Ground`] is filled with tiles of any mixture of levels: the elevation arrays of a
//! frame's slots, or tiles of a database. Colours are not copied. From the second frame of a size
//! on, [`Caster::draw`] allocates nothing.

#![forbid(unsafe_code)]

mod caster;
mod coherent;
mod counts;
mod exact;
pub mod lines;
pub mod model;
mod picture;
mod proof;
mod scene;
mod shade;
mod sweep;
pub mod view;
pub mod workers;

pub use caster::{CastOptions, CastTask, Caster, Method};
pub use coherent::Sampling;
pub use counts::Counts;
pub use picture::Picture;
pub use proof::{StartRule, Steepness, Unproven};
pub use sweep::{EdgeStretch, SweepDetail};
