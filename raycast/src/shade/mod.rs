//! What pixels show once it is known where their rays meet the ground.
//!
//! A technique says it in one of two ways: pixel by pixel ([`Canvas::put_ground`]), or line by line into a
//! [`strip`], whose pixels are colored together ([`Canvas::paint`]). Neither knows how rays were cast.

mod canvas;
mod footprint;
mod mip;
pub(crate) mod outline;
mod paint;
pub(crate) mod strip;

pub(crate) use canvas::{Canvas, OPAQUE_BLACK};
pub(crate) use footprint::Footprints;
