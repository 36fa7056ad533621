//! Where the camera stands and looks, given by a person.

use super::values::{Pair, Place, Triple, parse_agl};
use clap::Args;

/// A pose; of `still`, `fly` and `path`.
#[derive(Debug, Default, Clone, Args)]
#[command(next_help_heading = "Pose")]
pub struct PoseArgs {
    /// Where the camera is: easting, northing (metres, in the world's CRS) and height (metres);
    /// without a height 2 m above the ground
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    pub eye: Option<Place>,
    /// What is in the middle of the picture; without a height the ground there
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    pub look_at: Option<Place>,
    /// Where the camera is, as seen from --look-at: its direction (degrees clockwise from north),
    /// its elevation above the horizon (degrees) and its distance (metres)
    ///
    /// --from 180,30,5000 looks from the south, from 30 degrees up, 5 km away.
    #[arg(long, value_name = "AZIMUTH,ELEVATION,DISTANCE", allow_hyphen_values = true)]
    pub from: Option<Triple>,
    /// Where the camera looks, degrees clockwise from north: grid north, with --lonlat true north
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub heading: Option<f64>,
    /// How far up the camera looks, degrees from the horizontal, -90 to 90
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub pitch: Option<f64>,
    /// How far the camera leans to the right, degrees [default: 0]
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub roll: Option<f64>,
    /// X,Y are longitude and latitude, degrees (WGS 84; on other bodies the body's own), and
    /// directions are from true north
    #[arg(long)]
    pub lonlat: bool,
}

impl PoseArgs {
    /// The first flag of a pose that is given.
    #[must_use]
    pub fn given(&self) -> Option<&'static str> {
        let flags = [
            ("--eye", self.eye.is_some()),
            ("--look-at", self.look_at.is_some()),
            ("--from", self.from.is_some()),
            ("--heading", self.heading.is_some()),
            ("--pitch", self.pitch.is_some()),
            ("--roll", self.roll.is_some()),
        ];
        flags.into_iter().find(|(_, is_given)| *is_given).map(|(flag, _)| flag)
    }
}

/// What an orbit turns around; of `fly` and `path`.
#[derive(Debug, Default, Clone, Args)]
#[command(next_help_heading = "Orbit (--path orbit)")]
pub struct OrbitArgs {
    /// What the camera circles [default: the strongest relief of the world]
    #[arg(long, value_name = "X,Y", allow_hyphen_values = true)]
    pub around: Option<Pair>,
    /// Horizontal distance of the camera from --around, metres [default: from the relief]
    #[arg(long, value_name = "METRES")]
    pub radius: Option<f64>,
    /// Height of the camera above the ground at --around, metres [default: from the radius and the
    /// relief]
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    pub height: Option<f64>,
    /// Number of rounds of 240 frames: counter-clockwise, clockwise if negative [default: 1]
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub turns: Option<f64>,
}

impl OrbitArgs {
    /// The first flag that is given.
    #[must_use]
    pub fn given(&self) -> Option<&'static str> {
        let flags = [
            ("--around", self.around.is_some()),
            ("--radius", self.radius.is_some()),
            ("--height", self.height.is_some()),
            ("--turns", self.turns.is_some()),
        ];
        flags.into_iter().find(|(_, is_given)| *is_given).map(|(flag, _)| flag)
    }
}

/// `--agl` of `fly` and `path`.
#[derive(Debug, Default, Clone, Copy, Args)]
#[command(next_help_heading = "Flight")]
pub struct AglArgs {
    /// Fly a track at this height above the ground, metres [default for GPX: 150]; without a
    /// number: the Z of --eye and --look-at are heights above the ground
    #[arg(long, value_name = "METRES", num_args = 0..=1, value_parser = parse_agl)]
    pub agl: Option<Option<f64>>,
}
