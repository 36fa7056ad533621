//! Source rasters: what a name stands for ([`inputs`]) and may lead to ([`access`]), where they lie
//! ([`georef`], [`crs`], [`area`]) and which part of them is wanted ([`region`]), what their
//! samples mean ([`values`], [`color_values`]), and how to read them ([`raster`], [`open`]).

pub mod access;
pub mod area;
pub mod color_values;
pub mod crs;
pub mod georef;
pub mod inputs;
pub mod open;
pub mod raster;
pub mod region;
mod survey;
pub mod values;
mod vrt;
pub mod window;

pub use access::Access;
pub use crs::TargetCrs;
pub use georef::Affine;
pub use raster::Raster;
pub use region::Region;

/// Something that the user should know about, though the work goes on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Note {
    /// Done as asked; this is how.
    Info(String),
    /// Done differently than the data seem to ask for, or doubtful.
    Warning(String),
}
