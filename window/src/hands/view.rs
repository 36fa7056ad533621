//! What a pose sees: its axes, the ray through a point of the picture, and where a place shows.

use glam::DVec3;
use terravision_common::surface::look;
use terravision_common::viewer::ViewerPose;

/// A point of the picture, from its upper left corner, in the unit of its size.
pub type Point = [f64; 2];
/// Width and height of the picture, in any unit.
pub type Size = [f64; 2];

/// The eye: easting, northing and height.
#[must_use]
pub fn eye_of(pose: &ViewerPose) -> DVec3 {
    DVec3::new(pose.x, pose.y, pose.z)
}

/// The same pose with another eye.
#[must_use]
pub fn with_eye(pose: &ViewerPose, eye: DVec3) -> ViewerPose {
    ViewerPose { x: eye.x, y: eye.y, z: eye.z, ..*pose }
}

/// The camera's axes: right, up and forward (docs/frame-ring.md).
#[must_use]
pub fn axes_of(pose: &ViewerPose) -> [DVec3; 3] {
    let [level, forward] = look(pose.heading.to_radians(), pose.pitch.to_radians());
    let upright = level.cross(forward);
    let (sin, cos) = pose.roll.to_radians().sin_cos();
    [level * cos - upright * sin, level * sin + upright * cos, forward]
}

/// The focal length, in the unit of the picture's size.
#[must_use]
pub fn focal_of(pose: &ViewerPose, [_, height]: Size) -> f64 {
    0.5 * height / (0.5 * pose.vfov.to_radians()).tan()
}

/// The direction that a point of the picture shows; its part along the view axis is 1, so that a
/// multiple is a depth.
#[must_use]
pub fn ray_through(pose: &ViewerPose, size: Size, at: Point) -> DVec3 {
    let [right, up, forward] = axes_of(pose);
    let focal = focal_of(pose, size);
    let [x, y] = [0, 1].map(|axis| (at[axis] - 0.5 * size[axis]) / focal);
    forward + right * x - up * y
}

/// Where in the picture a place is; `None` behind the camera.
#[must_use]
pub fn project(pose: &ViewerPose, size: Size, place: DVec3) -> Option<Point> {
    let [right, up, forward] = axes_of(pose);
    let away = place - eye_of(pose);
    let depth = away.dot(forward);
    let scale = focal_of(pose, size) / depth;
    (depth > 0.0).then(|| [0.5 * size[0] + scale * away.dot(right), 0.5 * size[1] - scale * away.dot(up)])
}

/// An angle in degrees, from 0 to 360.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    angle.rem_euclid(360.0)
}

/// The shorter way from one angle to another, degrees, from -180 to 180.
#[must_use]
pub fn turn(from: f64, to: f64) -> f64 {
    let way = wrap(to - from);
    if way > 180.0 { way - 360.0 } else { way }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terravision_common::camera::{Camera, CameraFields};

    proptest! {
        #[test]
        fn rays_are_those_of_the_camera_and_places_come_back(
            heading in -400.0f64..400.0, pitch in -89.0f64..89.0, roll in -180.0f64..180.0, u in 0.0f64..640.0, v in 0.0f64..360.0,
        ) {
            let pose = ViewerPose { x: 10.0, y: 20.0, z: 30.0, heading, pitch, roll, vfov: 50.0 };
            let camera = Camera::new(CameraFields {
                eye_in_world: [10.0, 20.0, 30.0],
                heading_rad: heading.to_radians(),
                pitch_rad: pitch.to_radians(),
                roll_rad: roll.to_radians(),
                vfov_rad: 50f64.to_radians(),
                width: 640,
                height: 360,
                timestamp_nanos: 0,
            }).unwrap();
            let size = [640.0, 360.0];
            let ray = ray_through(&pose, size, [u, v]);
            prop_assert!((ray - camera.ray_in_world(u, v)).length() < 1e-9);
            let [back_u, back_v] = project(&pose, size, eye_of(&pose) + ray * 777.0).unwrap();
            prop_assert!((back_u - u).abs() < 1e-6 && (back_v - v).abs() < 1e-6);
            prop_assert_eq!(project(&pose, size, eye_of(&pose) - ray), None);
        }
    }

    #[test]
    fn turns_go_the_shorter_way() {
        assert_eq!((turn(350.0, 10.0), turn(10.0, 350.0), turn(0.0, 180.0), wrap(-90.0)), (20.0, -20.0, 180.0, 270.0));
    }
}
