//! Source rasters: which rasters a name means ([`inputs`]), which other files they may refer to
//! ([`access`]), their positions ([`georef`], [`crs`], [`area`]), the wanted part ([`region`]), the
//! meaning of their samples ([`values`], [`color_values`]), and how to read them ([`raster`],
//! [`readers`]).

pub mod access;
pub mod area;
pub mod color_values;
pub mod crs;
pub mod georef;
pub mod inputs;
pub mod raster;
pub mod readers;
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

/// A message for the user that does not end the work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Note {
    /// A choice that was made.
    Info(String),
    /// Something that is doubtful, or differs from what the data suggest.
    Warning(String),
}
