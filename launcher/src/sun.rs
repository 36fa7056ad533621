//! Where the sun stands over a place on Earth at a time.

/// Azimuth, degrees clockwise from true north, and altitude above the horizon, degrees, as it is
/// seen through the air, at a longitude and latitude and a time, seconds since 1970.
///
/// The low-precision formulas of the Astronomical Almanac (section C, "Low precision formulas for
/// the Sun"): 0.01 degrees from 1950 to 2050, and refraction after G. G. Bennett as J. Meeus turns
/// it round (Astronomical Algorithms, chapter 16): 0.1 minutes of arc.
#[must_use]
pub fn sun_over([longitude_deg, latitude_deg]: [f64; 2], time: f64) -> [f64; 2] {
    // Days from noon of 1 January 2000.
    let days = time / 86_400.0 - 10_957.5;
    let mean_longitude_deg = 280.460 + 0.985_647_4 * days;
    let anomaly = (357.528 + 0.985_600_3 * days).to_radians();
    let longitude = (mean_longitude_deg + 1.915 * anomaly.sin() + 0.020 * (2.0 * anomaly).sin()).to_radians();
    let obliquity = (23.439 - 0.000_000_4 * days).to_radians();
    let right_ascension = (obliquity.cos() * longitude.sin()).atan2(longitude.cos());
    let declination = (obliquity.sin() * longitude.sin()).asin();
    let sidereal_deg = 15.0 * (18.697_374_558 + 24.065_709_824_419_08 * days) + longitude_deg;
    let hour_angle = sidereal_deg.rem_euclid(360.0).to_radians() - right_ascension;
    let latitude = latitude_deg.to_radians();
    let up = latitude.sin() * declination.sin() + latitude.cos() * declination.cos() * hour_angle.cos();
    let east = -declination.cos() * hour_angle.sin();
    let north = latitude.cos() * declination.sin() - latitude.sin() * declination.cos() * hour_angle.cos();
    let altitude_deg = up.clamp(-1.0, 1.0).asin().to_degrees();
    [east.atan2(north).to_degrees().rem_euclid(360.0), altitude_deg + refraction_deg(altitude_deg)]
}

/// By how much air lifts what is this high, degrees; nothing from well below the horizon.
fn refraction_deg(altitude_deg: f64) -> f64 {
    if altitude_deg < -1.0 {
        return 0.0;
    }
    1.02 / (altitude_deg + 10.3 / (altitude_deg + 5.11)).to_radians().tan() / 60.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::times::seconds_from_iso8601;

    /// Azimuth and true altitude by NREL's Solar Position Algorithm (I. Reda and A. Andreas,
    /// 2004), its own example: 17 October 2003, 12:30:30 at UTC-7, 105.1786 W, 39.742476 N.
    /// Azimuth 194.34024, zenith 50.11162 degrees with refraction.
    #[test]
    fn the_example_of_the_solar_position_algorithm_is_met() {
        let time = seconds_from_iso8601("2003-10-17T12:30:30-07:00").unwrap();
        let [azimuth, altitude] = sun_over([-105.1786, 39.742476], time);
        assert!((azimuth - 194.340_24).abs() < 0.02, "{azimuth}");
        assert!((altitude - (90.0 - 50.111_62)).abs() < 0.02, "{altitude}");
    }

    #[test]
    fn the_sun_stands_where_almanacs_have_it() {
        let at = |time: &str, place| sun_over(place, seconds_from_iso8601(time).unwrap());
        // The equinox of 2024 was on 20 March, 03:06 UTC: over the equator the sun passes the zenith.
        let [_, altitude] = at("2024-03-20T12:07:30Z", [0.0, 0.0]);
        assert!(altitude > 89.7, "{altitude}");
        // Solstices: noon in Greenwich, 51.48 N: 90 - 51.48 ± 23.44 degrees, in the south.
        let [azimuth, altitude] = at("2024-06-20T12:01:50Z", [0.0, 51.48]);
        assert!((azimuth - 180.0).abs() < 0.2 && (altitude - 61.96).abs() < 0.03, "{azimuth} {altitude}");
        let [azimuth, altitude] = at("2024-12-21T11:58:00Z", [0.0, 51.48]);
        assert!((azimuth - 180.0).abs() < 0.2 && (altitude - 15.13).abs() < 0.06, "{azimuth} {altitude}");
        // The midnight sun on the polar circle, in the north; a polar night.
        let [azimuth, altitude] = at("2024-06-20T23:58:00Z", [0.0, 68.0]);
        assert!((azimuth.min(360.0 - azimuth)) < 1.5 && (1.0..2.0).contains(&altitude), "{azimuth} {altitude}");
        assert!(at("2024-12-21T12:00:00Z", [0.0, 75.0])[1] < -8.0);
        // South of the tropics it stands in the north at noon.
        let [azimuth, _] = at("2024-12-21T12:00:00Z", [0.0, -45.0]);
        assert!(azimuth.min(360.0 - azimuth) < 3.0, "{azimuth}");
    }
}
