//! What TerraVision's tests stand on: a reference renderer, measures of pictures, and processes as values.

pub mod geotiff;
pub mod metrics;
pub mod reference;
