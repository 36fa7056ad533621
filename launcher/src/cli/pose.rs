//! Where the camera stands and looks, given by a person.

use super::values::{Pair, Place, Triple, parse_agl};
use clap::Args;

/// A pose; of `still`, `fly` and `path`.
#[derive(Debug, Default, Clone, Args)]
#[command(next_help_heading = "Pose")]
pub struct PoseArgs {
    /// Where the camera is: easting, northing (metres, in the world's CRS) and height (metres); without a height 2 m above the
    /// ground
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    pub eye: Option<Place>,
    /// What is in the middle of the picture; without a height the ground there
    #[arg(long, value_name = "X,Y[,Z]", allow_hyphen_values = true)]
    pub look_at: Option<Place>,
    /// Where the camera stands, as seen from --look-at: the direction (degrees clockwise from north), degrees above the
    /// horizon, and metres away
    ///
    /// --from 180,30,5000 looks from the south, from 30 degrees up, 5 km away.
    #[arg(long, value_name = "AZIMUTH,ELEVATION,DISTANCE", allow_hyphen_values = true)]
    pub from: Option<Triple>,
    /// Where the camera looks, degrees clockwise from north: grid north, with --lonlat true north
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub heading: Option<f64>,
    /// How far up it looks, degrees from the horizontal, -90 to 90
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub pitch: Option<f64>,
    /// How far it leans to the right, degrees [default: 0]
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    pub roll: Option<f64>,
    /// X,Y are longitude and latitude, degrees (WGS 84; on other bodies the body's own), and directions are from true north
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
    /// Distance of the camera from there, along the ground, metres [default: it follows from the relief]
    #[arg(long, value_name = "METRES")]
    pub radius: Option<f64>,
    /// Height of the camera above the ground that it circles, metres [default: it follows from the radius and the relief]
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    pub height: Option<f64>,
    /// How many times it goes around, in 240 frames each; counter-clockwise, clockwise if negative [default: 1]
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
    /// Height above ground at which a track is flown, metres [default of GPX: 150]; without a number: the Z of --eye and
    /// --look-at are heights above the ground
    #[arg(long, value_name = "METRES", num_args = 0..=1, value_parser = parse_agl)]
    #[expect(clippy::option_option, reason = "not given, given alone, given with a number")]
    pub agl: Option<Option<f64>>,
}
