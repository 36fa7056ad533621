//! Source rasters: where they lie ([`georef`], [`crs`]), what their samples mean ([`values`]), and how to read them
//! ([`raster`], [`open`]).

pub mod crs;
pub mod georef;
pub mod open;
pub mod raster;
pub mod values;

pub use crs::TargetCrs;
pub use georef::Affine;
pub use raster::Raster;

/// Something that the user should know about, though the work goes on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Note {
    /// Done as asked; this is how.
    Info(String),
    /// Done differently than the data seem to ask for, or doubtful.
    Warning(String),
}
