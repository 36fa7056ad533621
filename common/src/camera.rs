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

/// Maximum number of pixels along one side of a picture; the device may allow fewer.
pub const MAX_SIDE_PX: u32 = 65_536;

/// The numbers that a [`Camera`] is made of, as they travel through shared memory: 72 bytes,
/// unchecked, every bit pattern is a value.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CameraFields {
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
    /// When the pose was made, nanoseconds of the monotonic clock; 0 in exact mode.
    pub timestamp_nanos: u64,
}

const _: () = assert!(size_of::<CameraFields>() == 72);

/// Why numbers do not make a [`Camera`].
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// One number is not finite, or out of its range.
    #[error("its {field} is {found}, expected {expected}")]
    OutOfRange {
        /// Which number.
        field: &'static str,
        /// What it is.
        found: f64,
        /// What it should have been.
        expected: &'static str,
    },
}

/// A camera: where the eye is, where it looks, and the size of its picture. Valid by construction;
/// who reads [`CameraFields`] from shared memory makes one of them before use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    fields: CameraFields,
    /// How far right of the line of sight the middle of the picture is, pixels. It belongs to a
    /// view, not to a pose, so it does not travel with the fields.
    lens_shift_px: f64,
}

/// A step of a path that is this many times as long as those before and after it is a cut.
const CUT: f64 = 8.0;

/// Whether a path is cut between two of its frames: the eye's way from one to the other is far
/// longer than the ways before and after it, metres.
#[must_use]
pub fn is_cut(way_m: f64, around_m: [f64; 2]) -> bool {
    way_m > CUT * around_m[0].max(around_m[1]) + 1.0
}

/// The plane of depth 1, on which a picture lies: x right, y up, 0 on the line of sight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PicturePlane {
    size: [f64; 2],
    half: [f64; 2],
    middle_x: f64,
}

impl PicturePlane {
    /// Half its width and half its height.
    #[must_use]
    pub fn half(&self) -> [f64; 2] {
        self.half
    }

    /// How far right of the line of sight its middle is.
    #[must_use]
    pub fn middle_x(&self) -> f64 {
        self.middle_x
    }

    /// The largest distance from the line of sight to its sides, across and up.
    #[must_use]
    pub fn reach(&self) -> [f64; 2] {
        [self.half[0] + self.middle_x.abs(), self.half[1]]
    }

    /// Where the point `(px, py)` of the picture is on it: pixels from the upper left corner (a
    /// pixel's centre is at + 0.5).
    #[must_use]
    pub fn place(&self, px: f64, py: f64) -> [f64; 2] {
        let x = (2.0 * px / self.size[0] - 1.0) * self.half[0] + self.middle_x;
        [x, (1.0 - 2.0 * py / self.size[1]) * self.half[1]]
    }

    /// The point of the picture at a place on it, as [`PicturePlane::place`] takes it.
    #[must_use]
    pub fn pixel(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let x = (x - self.middle_x) / self.half[0];
        [0.5 * (1.0 + x) * self.size[0], 0.5 * (1.0 - y / self.half[1]) * self.size[1]]
    }
}

impl Default for Camera {
    /// At the world's origin, level, looking north; a picture of one pixel.
    fn default() -> Self {
        let fields = CameraFields { vfov_rad: 1.0, width: 1, height: 1, ..CameraFields::zeroed() };
        Self { fields, lens_shift_px: 0.0 }
    }
}

impl Camera {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`CameraError`] for the first number that is wrong.
    pub fn new(fields: CameraFields) -> Result<Self, CameraError> {
        let CameraFields { eye_in_world, heading_rad, pitch_rad, roll_rad, vfov_rad, width, height, .. } = fields;
        let fail = |field, found, expected| Err(CameraError::OutOfRange { field, found, expected });
        if let Some(wrong) = eye_in_world.into_iter().find(|v| v.is_nan() || v.abs() >= 1e12) {
            return fail("eye", wrong, "coordinates within 1e12 m of the world's origin");
        }
        for (field, angle) in [("heading", heading_rad), ("pitch", pitch_rad), ("roll", roll_rad)] {
            if !angle.is_finite() {
                return fail(field, angle, "a finite angle");
            }
        }
        if !(vfov_rad > 1e-4 && vfov_rad < 3.1) {
            return fail("vertical field of view", vfov_rad, "0.0001 to 3.1 rad");
        }
        for (field, side) in [("width", width), ("height", height)] {
            if !(1..=MAX_SIDE_PX).contains(&side) {
                return fail(field, side.into(), "1 to 65536 pixels");
            }
        }
        Ok(Self { fields, lens_shift_px: 0.0 })
    }

    /// The same camera, the middle of its picture this far right of the line of sight, pixels: an
    /// off-axis frustum.
    ///
    /// # Errors
    /// [`CameraError`]: it is not a number, or more pixels than a picture may have.
    pub fn with_lens_shift(self, lens_shift_px: f64) -> Result<Self, CameraError> {
        let most = f64::from(MAX_SIDE_PX);
        if lens_shift_px.abs() <= most {
            return Ok(Self { lens_shift_px, ..self });
        }
        let expected = "-65536 to 65536 pixels";
        Err(CameraError::OutOfRange { field: "lens shift", found: lens_shift_px, expected })
    }

    /// The numbers it is made of.
    #[must_use]
    pub fn fields(&self) -> &CameraFields {
        &self.fields
    }

    /// Heading, radians clockwise from grid north.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        self.fields.heading_rad
    }

    /// Pitch, radians up from the horizontal.
    #[must_use]
    pub fn pitch_rad(&self) -> f64 {
        self.fields.pitch_rad
    }

    /// Roll, radians clockwise.
    #[must_use]
    pub fn roll_rad(&self) -> f64 {
        self.fields.roll_rad
    }

    /// Vertical field of view, radians.
    #[must_use]
    pub fn vfov_rad(&self) -> f64 {
        self.fields.vfov_rad
    }

    /// Width of the picture, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.fields.width
    }

    /// Height of the picture, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.fields.height
    }

    /// How far right of the line of sight the middle of the picture is, pixels.
    #[must_use]
    pub fn lens_shift_px(&self) -> f64 {
        self.lens_shift_px
    }

    /// When the pose was made, nanoseconds of the monotonic clock; 0 when time plays no part.
    #[must_use]
    pub fn timestamp_nanos(&self) -> u64 {
        self.fields.timestamp_nanos
    }

    /// The same camera, its pose made at another moment.
    #[must_use]
    pub fn made_at(&self, timestamp_nanos: u64) -> Self {
        Self { fields: CameraFields { timestamp_nanos, ..self.fields }, ..*self }
    }

    /// Whether both have the same view, regardless of their times.
    #[must_use]
    pub fn is_same_view(&self, other: &Self) -> bool {
        self.made_at(0) == other.made_at(0)
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
        let (from, to) = (&self.fields, &other.fields);
        let between = Self::new(CameraFields {
            eye_in_world: std::array::from_fn(|axis| linear(from.eye_in_world[axis], to.eye_in_world[axis])),
            heading_rad: turn(from.heading_rad, to.heading_rad),
            pitch_rad: linear(from.pitch_rad, to.pitch_rad),
            roll_rad: turn(from.roll_rad, to.roll_rad),
            vfov_rad: linear(from.vfov_rad, to.vfov_rad),
            ..*from
        });
        let between =
            between.and_then(|camera| camera.with_lens_shift(linear(self.lens_shift_px, other.lens_shift_px)));
        // Numbers between valid ones are valid; only a share beyond 0 to 1 leads out of them.
        between.unwrap_or(*self)
    }

    /// Eye in world coordinates.
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        DVec3::from_array(self.fields.eye_in_world)
    }

    /// Unit vectors right, up and forward of the camera, in world space.
    #[must_use]
    pub fn axes_in_world(&self) -> [DVec3; 3] {
        let (sr, cr) = self.fields.roll_rad.sin_cos();
        let [level_right, forward] = surface::look(self.fields.heading_rad, self.fields.pitch_rad);
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
        0.5 * f64::from(self.fields.height) / (0.5 * self.fields.vfov_rad).tan()
    }

    /// Where its picture lies on the plane of depth 1.
    #[must_use]
    pub fn picture_plane(&self) -> PicturePlane {
        let v = (0.5 * self.fields.vfov_rad).tan();
        let size = [f64::from(self.fields.width), f64::from(self.fields.height)];
        PicturePlane { size, half: [v * size[0] / size[1], v], middle_x: self.lens_shift_px / self.focal_px() }
    }

    /// Direction in world space, of depth 1 along the forward axis, through the point `(px, py)` of
    /// the picture: pixels from its upper left corner (a pixel's centre is at + 0.5).
    #[must_use]
    pub fn ray_in_world(&self, px: f64, py: f64) -> DVec3 {
        let [right, up, forward] = self.axes_in_world();
        let [x, y] = self.picture_plane().place(px, py);
        forward + right * x + up * y
    }

    /// The four side planes of the view frustum as inward normals in world space; all pass through
    /// the eye. A point p is outside when `normal · (p - eye) < 0` for any of them.
    #[must_use]
    pub fn frustum_normals_in_world(&self) -> [DVec3; 4] {
        let [right, up, forward] = self.axes_in_world();
        let plane = self.picture_plane();
        let ([tx, ty], middle) = (plane.half(), plane.middle_x());
        [forward * (tx - middle) + right, forward * (tx + middle) - right, forward * ty + up, forward * ty - up]
            .map(DVec3::normalize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(heading: f64, pitch: f64, roll: f64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: [1.0, 2.0, 3.0],
            heading_rad: heading.to_radians(),
            pitch_rad: pitch.to_radians(),
            roll_rad: roll.to_radians(),
            vfov_rad: 1.0,
            width: 1280,
            height: 720,
            timestamp_nanos: 0,
        })
        .expect("valid")
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
    fn numbers_that_make_no_camera_are_refused_by_name() {
        let good = *camera(10.0, -5.0, 0.0).fields();
        let refused = |fields| Camera::new(fields).unwrap_err().to_string();
        assert_eq!(
            refused(CameraFields { eye_in_world: [0.0, 1e12, 0.0], ..good }),
            "its eye is 1000000000000, expected coordinates within 1e12 m of the world's origin"
        );
        for heading_rad in [f64::NAN, f64::INFINITY] {
            assert!(refused(CameraFields { heading_rad, ..good }).starts_with("its heading is "));
        }
        assert!(refused(CameraFields { pitch_rad: f64::NAN, ..good }).starts_with("its pitch is NaN"));
        assert!(refused(CameraFields { roll_rad: f64::NAN, ..good }).starts_with("its roll is NaN"));
        for vfov_rad in [f64::NAN, 0.0, 3.1] {
            assert!(refused(CameraFields { vfov_rad, ..good }).starts_with("its vertical field of view is "));
        }
        for side in [0, MAX_SIDE_PX + 1] {
            assert!(refused(CameraFields { width: side, ..good }).starts_with("its width is "));
            assert!(refused(CameraFields { height: side, ..good }).starts_with("its height is "));
        }
        assert_eq!(Camera::new(*Camera::default().fields()), Ok(Camera::default()));
    }

    #[test]
    fn a_view_between_two_turns_the_shorter_way() {
        let [from, to] = [camera(350.0, -10.0, 0.0), camera(370.0 - 360.0, -20.0, 0.0)];
        let middle = from.toward(&to, 0.5);
        assert!((middle.heading_rad() - 360f64.to_radians()).abs() < 1e-12 && !middle.is_same_view(&from));
        assert!((middle.pitch_rad() + 15f64.to_radians()).abs() < 1e-12);
        assert!(from.toward(&to, 0.0).is_same_view(&from.made_at(5)));
    }

    #[test]
    fn roll_clockwise_tips_the_right_side_down() {
        let [right, up, _] = camera(0.0, 0.0, 90.0).axes_in_world();
        assert!(close(right, -DVec3::Z) && close(up, DVec3::X));
    }

    #[test]
    fn a_shifted_lens_moves_the_picture_and_its_frustum_to_the_right() {
        let straight = camera(30.0, -20.0, 10.0);
        let shifted = straight.with_lens_shift(100.0).expect("valid");
        assert!(close(shifted.ray_in_world(640.0, 360.0), straight.ray_in_world(740.0, 360.0)));
        assert!(close(shifted.ray_in_world(0.0, 7.0), straight.ray_in_world(100.0, 7.0)));
        let plane = shifted.picture_plane();
        let [px, py] = plane.pixel(plane.place(12.5, 700.25));
        assert!((px - 12.5).abs() < 1e-9 && (py - 700.25).abs() < 1e-9);
        assert!((plane.pixel([0.0; 2])[0] - 540.0).abs() < 1e-9, "the line of sight is left of the middle");
        let normals = shifted.frustum_normals_in_world();
        let holds = |px: f64| normals.iter().all(|normal| normal.dot(straight.ray_in_world(px, 360.0)) > -1e-12);
        assert!(holds(100.1) && holds(1379.9) && !holds(99.9) && !holds(1380.1));
        let refused = straight.with_lens_shift(f64::NAN).unwrap_err().to_string();
        assert_eq!(refused, "its lens shift is NaN, expected -65536 to 65536 pixels");
        assert!(straight.with_lens_shift(65_537.0).is_err());
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
