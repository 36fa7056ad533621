//! The colours of pixels, once it is known where their rays hit the ground.
//!
//! A technique reports hits in one of two ways: pixel by pixel ([`Canvas::put_ground`]), or line by
//! line into a [`strip`], whose pixels are coloured together ([`Canvas::paint`]). Neither depends
//! on how rays are cast.

mod canvas;
mod footprint;
mod mip;
pub(crate) mod outline;
mod paint;
pub(crate) mod strip;

pub(crate) use canvas::{Canvas, OPAQUE_BLACK};
pub(crate) use footprint::Footprints;
