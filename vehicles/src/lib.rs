//! Vehicles: models of glTF 2.0 and their pictures.
//!
//! * [`model`]: a file of glTF as triangles, coarser ones of it for far away, and textures.
//! * [`raster`]: triangles and points into a picture with depth.
//! * [`painter`]: all vehicles of a frame, over a finished picture, whatever drew it. So the mesh
//!   and all
//!   kinds of rays show the same vehicles, hidden by the same ground, and depth has them.
//!
//! Where vehicles are, the launcher decides ([`terravision_common::vehicle`], docs/vehicles.md).

#![forbid(unsafe_code)]

pub mod model;
pub mod painter;
pub mod raster;
