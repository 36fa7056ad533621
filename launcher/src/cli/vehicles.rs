//! Vehicles, as typed.

use clap::Args;
use std::path::PathBuf;

const HEADING: &str = "Vehicles (docs/vehicles.md)";

/// The vehicles of a flight or a still.
#[derive(Debug, Clone, Default, Args)]
pub struct VehicleArgs {
    /// Vehicles: CZML, or GeoJSON of lines or points with times; may be given several times
    ///
    /// They are drawn where they are at the time of each frame: models on the ground or in the air,
    /// or points.
    #[arg(long, help_heading = HEADING, value_name = "FILE")]
    pub vehicles: Vec<PathBuf>,
    /// The vehicles' time of frame 0: a date and time, or seconds after the first moment in the
    /// files
    /// [default: 0]
    #[arg(long, help_heading = HEADING, value_name = "TIME|SECONDS", requires = "vehicles", allow_hyphen_values = true)]
    pub vehicles_start: Option<String>,
}
