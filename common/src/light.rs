//! Light and air: where the sun stands, how bright ground is under it, and how far one sees.

use crate::tint::HeightColors;
use serde::{Deserialize, Serialize};

/// Brightness of ground in the shadow by day, as a factor on its colour.
const AMBIENT: f64 = 0.42;
/// The same when the sun is far below the horizon.
const NIGHT: f64 = 0.2;
/// At this altitude of the sun below the horizon, degrees, the sky has no light left (the end of
/// nautical twilight).
const DARK_DEG: f64 = -12.0;
/// Below this sine of the sun's altitude level ground is no longer made as bright as its colour,
/// as an eye or a camera would that adapts to it: mornings stay dim.
const LEAST_EXPOSED: f64 = 0.5;
/// The sun's own light fades in between these altitudes, degrees.
const RISE_DEG: [f64; 2] = [-0.5, 3.0];
/// Below this altitude, degrees, the sun's light becomes redder, and that of the sky bluer.
const WARM_BELOW_DEG: f64 = 20.0;
/// What the sun's light lacks of red, green and blue on the horizon.
const DIRECT_LOSS: [f64; 3] = [0.0, 0.26, 0.52];
/// What the light in the shadow lacks of them then.
const AMBIENT_LOSS: [f64; 3] = [0.12, 0.04, -0.12];

/// Where the sun stands.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sun {
    /// Degrees clockwise from grid north.
    pub azimuth_deg: f64,
    /// Degrees above the horizon.
    pub altitude_deg: f64,
}

impl Sun {
    /// North west, as relief maps are lit.
    pub const AUTO: Self = Self { azimuth_deg: 315.0, altitude_deg: 45.0 };

    /// Unit vector towards it: east, north, up.
    #[must_use]
    pub fn direction(&self) -> [f64; 3] {
        let ((east, north), (up, across)) =
            (self.azimuth_deg.to_radians().sin_cos(), self.altitude_deg.to_radians().sin_cos());
        [east * across, north * across, up]
    }

    /// How low it is: 0 where its light is white, 1 on the horizon and below.
    #[must_use]
    pub fn warmth(&self) -> f64 {
        (1.0 - self.altitude_deg / WARM_BELOW_DEG).clamp(0.0, 1.0).powi(2)
    }

    /// How much light the sky has: 1 by day, 0 at night.
    #[must_use]
    pub fn daylight(&self) -> f64 {
        (1.0 - self.altitude_deg / DARK_DEG).clamp(0.0, 1.0)
    }

    /// How much of its own light arrives: 1 by day, 0 when it is down.
    #[must_use]
    pub fn strength(&self) -> f64 {
        ((self.altitude_deg - RISE_DEG[0]) / (RISE_DEG[1] - RISE_DEG[0])).clamp(0.0, 1.0)
    }

    /// How bright ground is.
    #[must_use]
    pub fn brightness(&self) -> Brightness {
        let (warmth, up) = (self.warmth(), self.altitude_deg.to_radians().sin());
        let ambient = NIGHT + (AMBIENT - NIGHT) * self.daylight();
        let direct = (1.0 - AMBIENT) / up.max(LEAST_EXPOSED) * self.strength();
        Brightness {
            ambient: AMBIENT_LOSS.map(|loss| (ambient * (1.0 - warmth * loss)) as f32),
            direct: DIRECT_LOSS.map(|loss| (direct * (1.0 - warmth * loss)) as f32),
        }
    }
}

/// Factors on red, green and blue of ground: `ambient + direct * max(0, n · l)`, where n is the
/// normal of the ground and l the direction to the sun. They are factors on stored values. With the
/// sun 30 degrees high or higher, level ground keeps its colours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Brightness {
    /// In the shadow.
    pub ambient: [f32; 3],
    /// What the sun adds where its light falls at a right angle.
    pub direct: [f32; 3],
}

/// Light that colour tiles are lit with when they are loaded.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightConfig {
    /// Where it comes from.
    pub sun: Sun,
    /// Whether ground throws shadows on other ground.
    pub has_shadows: bool,
    /// Factor on slopes, beside that on all heights: flat land gets relief, too.
    pub relief: f64,
    /// Colours that are lit in place of those of tiles, which were shaded when they were made.
    #[serde(default)]
    pub tint: Option<HeightColors>,
}

/// The air between the eye and the ground, and the sky.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AirConfig {
    /// The sun in the sky; `None`: a sky without one.
    pub sun: Option<Sun>,
    /// How far one sees, metres: at this distance dark ground has 2 % of its contrast left. `None`:
    /// without haze.
    pub visibility_m: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_by_compass() {
        let close = |sun: Sun, expected: [f64; 3]| {
            let found = sun.direction();
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        };
        close(Sun { azimuth_deg: 90.0, altitude_deg: 0.0 }, [1.0, 0.0, 0.0]);
        close(Sun { azimuth_deg: 180.0, altitude_deg: 30.0 }, [0.0, -(0.75f64.sqrt()), 0.5]);
        close(Sun::AUTO, [-0.5, 0.5, 0.5f64.sqrt()]);
    }

    #[test]
    fn level_ground_keeps_its_colors_by_day_and_night_is_ambient_alone() {
        for altitude_deg in [30.0, 45.0, 90.0] {
            let sun = Sun { azimuth_deg: 10.0, altitude_deg };
            let Brightness { ambient, direct } = sun.brightness();
            for channel in 0..3 {
                let level = f64::from(ambient[channel]) + f64::from(direct[channel]) * sun.direction()[2];
                assert!((level - 1.0).abs() < 1e-6, "{altitude_deg}: {level}");
            }
        }
        let low = Sun { azimuth_deg: 100.0, altitude_deg: 3.0 }.brightness();
        assert!(low.direct[0] > 1.1 && low.direct[2] < 0.75 * low.direct[0] && low.ambient[2] > low.ambient[0]);
        let night = Sun { azimuth_deg: 0.0, altitude_deg: -20.0 }.brightness();
        assert!(night.direct == [0.0; 3] && night.ambient.iter().all(|v| (0.15..0.25).contains(v)));
    }
}
