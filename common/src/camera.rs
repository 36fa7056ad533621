//! The camera: pose, projection and view frustum.
//!
//! World space is x east, y north, z up, metres. Camera space is x right, y up, z *backwards* (the
//! camera looks along -z), metres. Angles are radians: heading clockwise from grid north, pitch up
//! from the horizontal, roll clockwise as the camera's operator sees it (the horizon turns the
//! other way).

use crate::surface;
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};

/// Most pixels along one side that a picture may have; the device may allow fewer.
pub const MAX_SIDE_PX: u32 = 65_536;

/// A camera as it travels through shared memory. 72 bytes, every bit pattern is a value;
/// [`Camera::is_valid`] says whether it is a camera.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Camera {
    /// Eye in world coordinates, metres (z is height, in the database's vertical datum, before
    /// exaggeration of terrain).
    pub eye_in_world: [f64; 3],
    /// Heading, radians clockwise from grid north.
    pub heading_rad: f64,
    /// Pitch, radians up from the horizontal.
    pub pitch_rad: f64,
    /// Roll, radians clockwise.
    pub roll_rad: f64,
    /// Vertical field of view, radians.
    pub vfov_rad: f64,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// When the pose was made, nanoseconds of the monotonic clock; 0 when time plays no part.
    pub timestamp_nanos: u64,
}

const _: () = assert!(size_of::<Camera>() == 72);

impl Camera {
    /// Whether every number is finite and in range; the reader of shared memory asks before use.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let finite = [self.heading_rad, self.pitch_rad, self.roll_rad, self.vfov_rad];
        self.eye_in_world.iter().chain(&finite).all(|v| v.is_finite())
            && self.eye_in_world.iter().all(|v| v.abs() < 1e12)
            && self.vfov_rad > 1e-4
            && self.vfov_rad < 3.1
            && (1..=MAX_SIDE_PX).contains(&self.width)
            && (1..=MAX_SIDE_PX).contains(&self.height)
    }

    /// Whether this is the same view as the other's, whenever each was made.
    #[must_use]
    pub fn is_same_view(&self, other: &Self) -> bool {
        Self { timestamp_nanos: 0, ..*self } == Self { timestamp_nanos: 0, ..*other }
    }

    /// The view a `share` (0 to 1) of the way to another, turning the shorter way round. Size and
    /// time are this one's.
    #[must_use]
    pub fn toward(&self, other: &Self, share: f64) -> Self {
        let linear = |from: f64, to: f64| from + (to - from) * share;
        let turn = |from: f64, to: f64| {
            let by = (to - from).rem_euclid(TAU);
            from + share * if by > PI { by - TAU } else { by }
        };
        Self {
            eye_in_world: std::array::from_fn(|axis| linear(self.eye_in_world[axis], other.eye_in_world[axis])),
            heading_rad: turn(self.heading_rad, other.heading_rad),
            pitch_rad: linear(self.pitch_rad, other.pitch_rad),
            roll_rad: turn(self.roll_rad, other.roll_rad),
            vfov_rad: linear(self.vfov_rad, other.vfov_rad),
            ..*self
        }
    }

    /// Eye in world coordinates.
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        DVec3::from_array(self.eye_in_world)
    }

    /// Unit vectors right, up and forward of the camera, in world space.
    #[must_use]
    pub fn axes_in_world(&self) -> [DVec3; 3] {
        let (sr, cr) = self.roll_rad.sin_cos();
        let [level_right, forward] = surface::look(self.heading_rad, self.pitch_rad);
        let level_up = level_right.cross(forward);
        // Rolling clockwise tips the camera's right side down.
        let right = level_right * cr - level_up * sr;
        let up = level_right * sr + level_up * cr;
        [right, up, forward]
    }

    /// Rotation that takes a direction in world space to camera space.
    #[must_use]
    pub fn camera_from_world_rotation(&self) -> DMat3 {
        let [right, up, forward] = self.axes_in_world();
        DMat3::from_cols(right, up, -forward).transpose()
    }

    /// Focal length in pixels: pixels per metre at one metre's depth.
    #[must_use]
    pub fn focal_px(&self) -> f64 {
        0.5 * f64::from(self.height) / (0.5 * self.vfov_rad).tan()
    }

    /// Tangents of half the horizontal and half the vertical field of view.
    #[must_use]
    pub fn half_tangents(&self) -> [f64; 2] {
        let v = (0.5 * self.vfov_rad).tan();
        [v * f64::from(self.width) / f64::from(self.height), v]
    }

    /// Direction in world space, of depth 1 along the forward axis, through the point `(px, py)` of
    /// the picture: pixels from its upper left corner (a pixel's centre is at + 0.5).
    #[must_use]
    pub fn ray_in_world(&self, px: f64, py: f64) -> DVec3 {
        let [right, up, forward] = self.axes_in_world();
        let [tx, ty] = self.half_tangents();
        let x = (2.0 * px / f64::from(self.width) - 1.0) * tx;
        let y = (1.0 - 2.0 * py / f64::from(self.height)) * ty;
        forward + right * x + up * y
    }

    /// The four side planes of the view frustum as inward normals in world space; all pass through
    /// the eye. A point p is outside when `normal · (p - eye) < 0` for any of them.
    #[must_use]
    pub fn frustum_normals_in_world(&self) -> [DVec3; 4] {
        let [right, up, forward] = self.axes_in_world();
        let [tx, ty] = self.half_tangents();
        [forward * tx + right, forward * tx - right, forward * ty + up, forward * ty - up].map(DVec3::normalize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(heading: f64, pitch: f64, roll: f64) -> Camera {
        Camera {
            eye_in_world: [1.0, 2.0, 3.0],
            heading_rad: heading.to_radians(),
            pitch_rad: pitch.to_radians(),
            roll_rad: roll.to_radians(),
            vfov_rad: 1.0,
            width: 1280,
            height: 720,
            timestamp_nanos: 0,
        }
    }

    fn close(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn heading_turns_clockwise_from_north_and_pitch_is_up() {
        let [right, up, forward] = camera(0.0, 0.0, 0.0).axes_in_world();
        assert!(close(forward, DVec3::Y) && close(right, DVec3::X) && close(up, DVec3::Z));
        assert!(close(camera(90.0, 0.0, 0.0).axes_in_world()[2], DVec3::X));
        assert!(close(camera(0.0, 90.0, 0.0).axes_in_world()[2], DVec3::Z));
    }

    #[test]
    fn a_view_between_two_turns_the_shorter_way() {
        let [from, to] = [camera(350.0, -10.0, 0.0), camera(370.0 - 360.0, -20.0, 0.0)];
        let middle = from.toward(&to, 0.5);
        assert!((middle.heading_rad - 360f64.to_radians()).abs() < 1e-12 && !middle.is_same_view(&from));
        assert!((middle.pitch_rad + 15f64.to_radians()).abs() < 1e-12);
        assert!(from.toward(&to, 0.0).is_same_view(&Camera { timestamp_nanos: 5, ..from }));
    }

    #[test]
    fn roll_clockwise_tips_the_right_side_down() {
        let [right, up, _] = camera(0.0, 0.0, 90.0).axes_in_world();
        assert!(close(right, -DVec3::Z) && close(up, DVec3::X));
    }

    #[test]
    fn the_picture_centre_looks_forward_and_frustum_planes_hold_the_corners() {
        let camera = camera(30.0, -20.0, 10.0);
        assert!(close(camera.ray_in_world(640.0, 360.0), camera.axes_in_world()[2]));
        let corner = camera.ray_in_world(0.0, 0.0);
        let outside = camera.ray_in_world(-1.0, 0.0);
        let normals = camera.frustum_normals_in_world();
        assert!(normals.iter().all(|n| n.dot(corner) > -1e-12));
        assert!(normals.iter().any(|n| n.dot(outside) < 0.0));
    }
}
