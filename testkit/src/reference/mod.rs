//! The reference renderer: what the picture should be.
//!
//! Plain ray casting of the finest elevation, interpolated *bilinearly* (no facets, no levels),
//! several rays per pixel, colour averaged over each ray's footprint on the ground. It knows no
//! tree, no tile and no pyramid of the database; it reads the rasters that were ingested. It is
//! exact where the pipeline approximates, and slow.
//!
//! Coordinates are those of the rasters' CRS: easting, northing, height, metres.

mod cast;
mod color;
mod heights;
mod render;

pub use cast::Hit;
pub use color::Colors;
pub use heights::Heights;
pub use render::{Picture, RenderOptions, Scene, render};
