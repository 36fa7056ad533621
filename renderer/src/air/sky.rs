//! Colours of the sky by direction, and of the air in front of the ground.

use terravision_common::light::Sun;

/// What is left of a sky's colour at the zenith: it is darker and bluer there.
const ZENITH: [f64; 3] = [0.62, 0.76, 0.94];
/// Colour that the horizon takes on by day, and its share.
const PALE: [f64; 3] = [232.0, 238.0, 244.0];
const PALE_SHARE: f64 = 0.65;
/// Colour that the horizon takes on when the sun is on it, and its share.
const DUSK: [f64; 3] = [236.0, 196.0, 172.0];
const DUSK_SHARE: f64 = 0.55;
/// Colour of the air around the sun: high in the sky, and on the horizon.
const GLOW: [[f64; 3]; 2] = [[255.0, 252.0, 244.0], [255.0, 206.0, 138.0]];
/// Skies of at least this brightness are of thick air; what is darker has less haze and glow. A
/// black sky has none.
const FULL: f64 = 150.0;
/// What is left of a night sky.
const NIGHT: f64 = 0.06;

/// A sky, 0 to 255 in each channel. It is `horizon` on the horizon and below, `zenith` above, and
/// `glow` around the sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sky {
    pub(super) zenith: [f32; 3],
    pub(super) horizon: [f32; 3],
    pub(super) glow: [f32; 3],
    /// How much of it there is at most, 0 to 1.
    pub(super) glow_share: f32,
    /// Direction to the sun, if there is one to be seen: east, north, up.
    pub(super) sun: Option<[f32; 3]>,
}

impl Sky {
    /// Of this colour by day, with the sun where it stands.
    pub(super) fn new(sky_rgb: [u8; 3], sun: Option<Sun>) -> Self {
        let base = sky_rgb.map(f64::from);
        let air = (base.iter().fold(0.0, |a: f64, b| a.max(*b)) / FULL).min(1.0);
        let (warmth, daylight) = sun.map_or((0.0, 1.0), |sun| (sun.warmth(), sun.daylight()));
        let light = NIGHT + (1.0 - NIGHT) * daylight;
        let mix = |a: f64, b: f64, share: f64| a + share * air * (b - a);
        let channels = [0, 1, 2];
        let horizon = channels.map(|c| mix(mix(base[c], PALE[c], PALE_SHARE), DUSK[c], DUSK_SHARE * warmth) * light);
        let glow = channels.map(|c| GLOW[0][c] + warmth * (GLOW[1][c] - GLOW[0][c]));
        Self {
            zenith: channels.map(|c| (base[c] * ZENITH[c] * light) as f32),
            horizon: horizon.map(|v| v as f32),
            glow: glow.map(|v| v as f32),
            glow_share: if sun.is_some() { (air * daylight) as f32 } else { 0.0 },
            sun: sun.filter(|sun| sun.daylight() > 0.0).map(|sun| sun.direction().map(|v| v as f32)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skies_are_pale_below_dark_at_night_and_black_without_air() {
        let sun = |altitude_deg| Some(Sun { azimuth_deg: 90.0, altitude_deg });
        let day = Sky::new([150, 190, 235], sun(50.0));
        assert!(day.horizon[0] > 190.0 && day.zenith[0] < 100.0 && day.zenith[2] > 200.0);
        let dawn = Sky::new([150, 190, 235], sun(1.0));
        assert!(dawn.horizon[0] > dawn.horizon[2] && dawn.glow[0] > 1.5 * dawn.glow[2]);
        let night = Sky::new([150, 190, 235], sun(-30.0));
        assert!(night.horizon.iter().all(|v| *v < 20.0) && night.sun.is_none());
        let moon = Sky::new([0; 3], sun(50.0));
        assert!(moon.horizon == [0.0; 3] && moon.glow_share == 0.0 && moon.sun.is_some());
        assert!(Sky::new([150, 190, 235], None).sun.is_none());
    }
}
