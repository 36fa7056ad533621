//! Light and air, as typed.

use super::values::ValueError;
use crate::path::times::seconds_from_iso8601;
use clap::Args;
use std::str::FromStr;

const HEADING: &str = "Light and air (docs/light.md)";

/// How the ground is lit, and how far one sees; shared by everything that draws.
#[derive(Debug, Clone, Args)]
pub struct LightArgs {
    /// Light the ground: auto, azimuth and altitude of the sun in degrees, or a date and time; off
    /// for colours as they are stored [default: off]
    ///
    /// 'auto' is a sun in the north west, 45 degrees high, as relief maps have it. The azimuth is
    /// clockwise from grid north. A date and time, e.g. 2026-06-21T05:45-07:00 (UTC without an
    /// offset), is that of the middle of the world, whose CRS must be known. An orthophoto has the
    /// light of its own day in it already.
    #[arg(long, help_heading = HEADING, value_name = "auto|AZIMUTH,ALTITUDE|DATE-TIME|off", allow_hyphen_values = true)]
    pub sun: Option<SunArg>,
    /// Ground throws shadows; with --sun
    ///
    /// Tiles take longer to load, the longer the lower the sun.
    #[arg(long, help_heading = HEADING)]
    pub shadows: bool,
    /// Haze: how far one sees, in metres or with km, e.g. 30km
    ///
    /// At that distance 2 % of the contrast is left.
    #[arg(long, help_heading = HEADING, value_name = "VISIBILITY", allow_hyphen_values = true)]
    pub haze: Option<Visibility>,
}

impl LightArgs {
    /// Whether a sun lights the ground.
    #[must_use]
    pub fn lights_ground(&self) -> bool {
        !matches!(self.sun, None | Some(SunArg::Off))
    }

    /// What is wrong with flags that need each other, in a sentence.
    #[must_use]
    pub fn fault(&self) -> Option<&'static str> {
        let has_sun = self.sun.is_some_and(|sun| sun != SunArg::Off);
        (self.shadows && !has_sun).then_some("--shadows needs a sun: expected --sun as well, e.g. --sun auto")
    }
}

/// Where the sun stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SunArg {
    /// Nowhere: colours as they are stored.
    Off,
    /// Where relief maps have it.
    Auto,
    /// Azimuth and altitude, degrees.
    Angles([f64; 2]),
    /// Where it is at this time, seconds since 1970.
    At(f64),
}

impl FromStr for SunArg {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let expected = "auto, off, an azimuth and an altitude in degrees, e.g. 120,8, or a date and time, \
                        e.g. 2026-06-21T05:45-07:00 or 2026-06-21T12:45Z";
        let text = text.trim();
        if text.eq_ignore_ascii_case("auto") {
            return Ok(Self::Auto);
        }
        if text.eq_ignore_ascii_case("off") {
            return Ok(Self::Off);
        }
        if let Some((azimuth, altitude)) = text.split_once(',') {
            let angles = [azimuth, altitude].map(|angle| angle.trim().parse().ok().filter(|v: &f64| v.is_finite()));
            let [Some(azimuth), Some(altitude)] = angles else { return Err(ValueError { expected }) };
            if !(-90.0..=90.0).contains(&altitude) {
                return Err(ValueError { expected: "an altitude of the sun from -90 to 90 degrees, e.g. 120,8" });
            }
            if !(-360.0..=360.0).contains(&azimuth) {
                return Err(ValueError { expected: "an azimuth of the sun from 0 to 360 degrees, e.g. 120,8" });
            }
            return Ok(Self::Angles([azimuth, altitude]));
        }
        seconds_from_iso8601(text).map(Self::At).ok_or(ValueError { expected })
    }
}

/// How far one sees, metres; finite and more than zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility(pub f64);

impl FromStr for Visibility {
    type Err = ValueError;
    fn from_str(text: &str) -> Result<Self, ValueError> {
        let text = text.trim();
        let (number, factor) = match (text.strip_suffix("km"), text.strip_suffix('m')) {
            (Some(number), _) => (number, 1000.0),
            (None, Some(number)) => (number, 1.0),
            (None, None) => (text, 1.0),
        };
        let metres = number.trim().parse::<f64>().ok().map(|number| number * factor);
        metres
            .filter(|metres| (1.0..=1e9).contains(metres))
            .map(Self)
            .ok_or(ValueError { expected: "a distance of at least 1 m in metres or with km, e.g. 30km" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suns_are_angles_or_times() {
        assert_eq!("auto".parse(), Ok(SunArg::Auto));
        assert_eq!("120, -3.5".parse(), Ok(SunArg::Angles([120.0, -3.5])));
        for text in ["2026-06-21T12:45Z", "2026-06-21 05:45-07:00", "2026-06-21T12:45:00", "2026-06-21T14:45+02:00"] {
            assert_eq!(text.parse(), Ok(SunArg::At(1_782_045_900.0)), "{text}");
        }
        for text in [
            "",
            "noon",
            "1",
            "1,2,3",
            "nan,3",
            "10,91",
            "10,-91",
            "900,3",
            "2026-13-01T00:00Z",
            "2026-02-30T00:00Z",
            "2026-06-21",
            "2026-06-21T25:00Z",
        ] {
            assert!(text.parse::<SunArg>().is_err(), "{text}");
        }
    }

    #[test]
    fn visibilities_are_distances() {
        for (text, metres) in [("500", 500.0), ("30km", 30_000.0), (" 2.5 km", 2500.0), ("800m", 800.0)] {
            assert_eq!(text.parse(), Ok(Visibility(metres)), "{text}");
        }
        for text in ["", "0", "0km", "-5", "nan", "inf", "km", "far", "1e12km"] {
            assert!(text.parse::<Visibility>().is_err(), "{text}");
        }
    }
}
