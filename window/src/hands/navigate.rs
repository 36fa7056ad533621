//! Poses out of poses: how a hand moves the camera. Angles are degrees, places are easting,
//! northing and height.

use super::view::{Point, Size, axes_of, eye_of, focal_of, ray_through, turn, with_eye};
use glam::{DQuat, DVec3};
use terravision_common::surface::level_right;
use terravision_common::viewer::ViewerPose;

/// Least height of the eye above ground, metres; the flight itself lifts what is lower than 2 m.
pub const LEAST_CLEARANCE_M: f64 = 2.5;
/// Rays that fall less than this (of their length along the axis) hold no ground.
const FLATTEST_DRAG: f64 = -0.03;
/// A place is not tilted below this many degrees above its own level.
const LOWEST_DEG: f64 = 1.5;

/// Lifts an eye that is in the ground, or too near to it.
#[must_use]
pub fn above_ground(pose: ViewerPose, ground_m: Option<f64>) -> ViewerPose {
    let least = ground_m.map_or(f64::NEG_INFINITY, |ground| ground + LEAST_CLEARANCE_M);
    ViewerPose { z: pose.z.max(least), ..pose }
}

/// Moves the eye in its level plane so that a place of the ground comes under a point of the
/// picture; `None` where the point is too near the horizon.
#[must_use]
pub fn drag_ground(pose: &ViewerPose, size: Size, place: DVec3, at: Point) -> Option<ViewerPose> {
    let ray = ray_through(pose, size, at);
    let fall = pose.z - place.z;
    (ray.z <= FLATTEST_DRAG && fall > 0.0).then(|| {
        let eye = place + ray * (fall / ray.z);
        ViewerPose { x: eye.x, y: eye.y, ..*pose }
    })
}

/// Turns the camera about itself so that the direction that was under one point comes under
/// another.
#[must_use]
pub fn drag_sky(pose: &ViewerPose, size: Size, from: Point, to: Point) -> ViewerPose {
    let per_pixel = 1f64.to_degrees() / focal_of(pose, size);
    look(pose, (from[0] - to[0]) * per_pixel, (to[1] - from[1]) * per_pixel)
}

/// Turns the camera about a vertical axis through a place; positive: the camera's heading grows.
#[must_use]
pub fn turn_about(pose: &ViewerPose, place: DVec3, angle: f64) -> ViewerPose {
    let offset = DQuat::from_rotation_z(-angle.to_radians()) * (eye_of(pose) - place);
    ViewerPose { heading: pose.heading + angle, ..with_eye(pose, place + offset) }
}

/// Tilts the camera about a level axis through a place, across the view; positive: it looks further
/// up. Not below the place's own height, and never over the top.
#[must_use]
pub fn tilt_about(pose: &ViewerPose, place: DVec3, angle: f64) -> ViewerPose {
    let offset = eye_of(pose) - place;
    let elevation = offset.z.atan2(offset.x.hypot(offset.y)).to_degrees();
    let allowed = angle.clamp(-90.0 - pose.pitch, 90.0 - pose.pitch);
    let bounded = if allowed > 0.0 { allowed.min(elevation - elevation.min(LOWEST_DEG)) } else { allowed };
    let across = level_right(pose.heading.to_radians());
    let offset = DQuat::from_axis_angle(across, bounded.to_radians()) * offset;
    ViewerPose { pitch: pose.pitch + bounded, ..with_eye(pose, place + offset) }
}

/// Brings the eye nearer to a place (factor below 1) or away from it, within these distances; the
/// place stays where it is in the picture.
#[must_use]
pub fn zoom_to(pose: &ViewerPose, place: DVec3, factor: f64, [least, most]: [f64; 2]) -> ViewerPose {
    let offset = eye_of(pose) - place;
    let distance = offset.length();
    if distance == 0.0 || !distance.is_finite() {
        return *pose;
    }
    let wanted = (distance * factor).clamp(least.min(distance), most.max(distance));
    with_eye(pose, place + offset * (wanted / distance))
}

/// Metres that the camera flies: ahead and to the right in the level plane, and up.
#[must_use]
pub fn fly(pose: &ViewerPose, ahead: f64, right: f64, up: f64) -> ViewerPose {
    let across = level_right(pose.heading.to_radians());
    let along = DVec3::Z.cross(across);
    with_eye(pose, eye_of(pose) + along * ahead + across * right + DVec3::Z * up)
}

/// Metres that the camera flies along its own axis, as an aircraft does, and to the right.
#[must_use]
pub fn fly_along_axis(pose: &ViewerPose, ahead: f64, right: f64) -> ViewerPose {
    let [_, _, forward] = axes_of(pose);
    let sideways = fly(pose, 0.0, right, 0.0);
    with_eye(&sideways, eye_of(&sideways) + forward * ahead)
}

/// Turns the camera about itself.
#[must_use]
pub fn look(pose: &ViewerPose, heading: f64, pitch: f64) -> ViewerPose {
    ViewerPose { heading: pose.heading + heading, pitch: (pose.pitch + pitch).clamp(-90.0, 90.0), ..*pose }
}

/// Speed of flight, metres a second: most of the height above ground each second, within what the
/// world allows.
#[must_use]
pub fn speed_at(clearance_m: f64, world_side_m: f64) -> f64 {
    (clearance_m * 0.7).clamp(4.0, (world_side_m / 4.0).max(4.0))
}

/// From 0 to 1 with rest at both ends.
#[must_use]
pub fn ease(share: f64) -> f64 {
    let s = share.clamp(0.0, 1.0);
    s * s * s * (s * (6.0 * s - 15.0) + 10.0)
}

/// The pose a share of the way from one to another. Heights go in proportion to their logarithm
/// above `ground_m`, so that a descent from far above does not end in a rush.
#[must_use]
pub fn between(a: &ViewerPose, b: &ViewerPose, share: f64, ground_m: f64) -> ViewerPose {
    let mix = |from: f64, to: f64, by: f64| from + (to - from) * by;
    let low = (a.z.min(b.z) - ground_m).max(1.0);
    let [from, to] = [a, b].map(|pose| (pose.z - ground_m).max(low));
    let z = match share {
        s if s <= 0.0 => a.z,
        s if s >= 1.0 => b.z,
        s => ground_m + from * (to / from).powf(s),
    };
    // What moves with the height moves as fast as it, so that the flight is a straight line.
    let along = if (b.z - a.z).abs() > 1e-3 { (z - a.z) / (b.z - a.z) } else { share };
    ViewerPose {
        x: mix(a.x, b.x, along),
        y: mix(a.y, b.y, along),
        z,
        heading: a.heading + turn(a.heading, b.heading) * share,
        pitch: mix(a.pitch, b.pitch, share),
        roll: a.roll + turn(a.roll, b.roll) * share,
        vfov: mix(a.vfov, b.vfov, share),
    }
}

/// How long a flight from one pose to another takes, seconds: longer ones take longer, but no one
/// waits.
#[must_use]
pub fn duration_s(a: &ViewerPose, b: &ViewerPose, clearance_m: f64) -> f64 {
    let far = (eye_of(a) - eye_of(b)).length() / clearance_m.max(10.0);
    (0.45 + 0.3 * far.ln_1p() + turn(a.heading, b.heading).abs() / 400.0).clamp(0.45, 2.5)
}

#[cfg(test)]
mod tests {
    use super::super::view::project;
    use super::*;
    use proptest::prelude::*;

    const SIZE: Size = [800.0, 600.0];

    fn pose() -> ViewerPose {
        ViewerPose { x: 100.0, y: 200.0, z: 900.0, heading: 30.0, pitch: -35.0, roll: 0.0, vfov: 60.0 }
    }

    fn place_under(pose: &ViewerPose, at: Point) -> DVec3 {
        let ray = ray_through(pose, SIZE, at);
        eye_of(pose) + ray * (-pose.z / ray.z)
    }

    fn is_at(pose: &ViewerPose, place: DVec3, at: Point) -> bool {
        project(pose, SIZE, place).is_some_and(|found| (0..2).all(|axis| (found[axis] - at[axis]).abs() < 1e-6))
    }

    proptest! {
        #[test]
        fn held_ground_stays_under_the_cursor(u in 0.0f64..800.0, v in 200.0f64..600.0, du in -50.0f64..50.0, dv in -50.0f64..50.0) {
            let place = place_under(&pose(), [u, v]);
            let at = [u + du, v + dv];
            let moved = drag_ground(&pose(), SIZE, place, at).unwrap();
            prop_assert!(is_at(&moved, place, at) && moved.z == 900.0);
        }

        #[test]
        fn what_is_zoomed_to_stays_where_it_is(u in 0.0f64..800.0, v in 200.0f64..600.0, factor in 0.2f64..3.0) {
            let place = place_under(&pose(), [u, v]);
            let zoomed = zoom_to(&pose(), place, factor, [3.0, 1e9]);
            prop_assert!(is_at(&zoomed, place, [u, v]));
        }

        #[test]
        fn turning_and_tilting_keep_their_distance(angle in -60.0f64..60.0, u in 0.0f64..800.0) {
            let place = place_under(&pose(), [u, 400.0]);
            let distance = |pose: &ViewerPose| (eye_of(pose) - place).length();
            for moved in [turn_about(&pose(), place, angle), tilt_about(&pose(), place, angle)] {
                prop_assert!((distance(&moved) - distance(&pose())).abs() < 1e-6);
                prop_assert!(moved.pitch.abs() <= 90.0 && moved.z >= place.z);
            }
        }
    }

    #[test]
    fn the_ground_is_never_entered_and_the_horizon_holds_nothing() {
        assert_eq!(above_ground(pose(), Some(900.0)).z, 902.5);
        assert_eq!(above_ground(pose(), Some(100.0)), pose());
        assert_eq!(above_ground(pose(), None), pose());
        assert_eq!(drag_ground(&pose(), SIZE, DVec3::ZERO, [400.0, -900.0]), None);
        let below = DVec3::new(0.0, 0.0, 1000.0);
        assert_eq!(drag_ground(&pose(), SIZE, below, [400.0, 500.0]), None);
    }

    #[test]
    fn keys_fly_where_the_camera_looks() {
        let north = ViewerPose { heading: 0.0, ..pose() };
        let (ahead, right) = (fly(&north, 10.0, 0.0, 0.0), fly(&north, 0.0, 10.0, 5.0));
        assert!((ahead.y - 210.0).abs() < 1e-9 && (ahead.x - 100.0).abs() < 1e-9 && ahead.z == 900.0);
        assert!((right.x - 110.0).abs() < 1e-9 && right.z == 905.0);
        let down = fly_along_axis(&ViewerPose { pitch: -90.0, ..north }, 10.0, 0.0);
        assert!((down.z - 890.0).abs() < 1e-9);
        assert_eq!((speed_at(1000.0, 1e5), speed_at(1.0, 1e5), speed_at(1e9, 1e5)), (700.0, 4.0, 25_000.0));
    }

    #[test]
    fn a_flight_begins_and_ends_at_its_poses() {
        let b = ViewerPose { x: 5000.0, z: 90.0, heading: 350.0, ..pose() };
        assert_eq!(between(&pose(), &b, 0.0, 0.0), pose());
        let end = between(&pose(), &b, 1.0, 0.0);
        assert!((end.x - 5000.0).abs() < 1e-9 && end.z == 90.0 && wrapped(end.heading) == 350.0);
        let heights: Vec<f64> = (0..=10).map(|k| between(&pose(), &b, f64::from(k) / 10.0, 0.0).z).collect();
        assert!(heights.is_sorted_by(|a, b| a > b), "{heights:?}");
        assert!((0.45..=2.5).contains(&duration_s(&pose(), &b, 800.0)));
    }

    fn wrapped(angle: f64) -> f64 {
        super::super::view::wrap(angle)
    }
}
