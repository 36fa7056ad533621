//! Directions in the local frame of a place: east, north and up.

use glam::DVec3;

/// The level direction to the right of a heading (radians clockwise from grid north), and the
/// direction of that heading and a pitch (radians up from the horizontal).
#[must_use]
pub fn look(heading_rad: f64, pitch_rad: f64) -> [DVec3; 2] {
    let (sh, ch) = heading_rad.sin_cos();
    let (sp, cp) = pitch_rad.sin_cos();
    [DVec3::new(ch, -sh, 0.0), DVec3::new(sh * cp, ch * cp, sp)]
}

/// The direction of a heading and a pitch.
#[must_use]
pub fn direction(heading_rad: f64, pitch_rad: f64) -> DVec3 {
    look(heading_rad, pitch_rad)[1]
}

/// The level direction a right angle clockwise from a heading.
#[must_use]
pub fn level_right(heading_rad: f64) -> DVec3 {
    look(heading_rad, 0.0)[0]
}

/// The heading of a vector; north if it is vertical.
#[must_use]
pub fn heading(way: DVec3) -> f64 {
    if way.truncate().length() > 1e-6 { way.x.atan2(way.y) } else { 0.0 }
}

/// The pitch of a vector.
#[must_use]
pub fn pitch(way: DVec3) -> f64 {
    way.z.atan2(way.truncate().length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    proptest! {
        #[test]
        fn a_direction_has_its_heading_and_pitch(h in -3.1f64..3.1, p in -1.5f64..1.5, length in 0.1f64..1e6) {
            let way = direction(h, p) * length;
            prop_assert!((heading(way) - h).abs() < 1e-9 && (pitch(way) - p).abs() < 1e-9);
            prop_assert!(level_right(h).dot(way).abs() < 1e-9 * length);
            prop_assert!((level_right(h) - direction(h + FRAC_PI_2, 0.0)).length() < 1e-12);
        }
    }

    #[test]
    fn straight_down_is_a_pitch_and_looks_north() {
        assert_eq!((heading(-DVec3::Z), pitch(-DVec3::Z)), (0.0, -FRAC_PI_2));
    }
}
