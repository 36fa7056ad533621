//! From a camera to rays.
//!
//! Every ray of a frame is `eye + s·D`, sampled at the same parameters `s`. `D` has length 1 along
//! a *guide*, a direction in the vertical plane of the view axis that is as level as the picture
//! allows. So samples of one `s` lie in a nearly vertical plane, and a ray that is higher in the
//! picture crosses that plane nearly above the lower one. This makes coherence provable (see
//! [`crate::proof`]).

use glam::{DVec3, Vec3};
use terravision_common::camera::Camera;

/// The largest angle between rays and guide, if the field of view allows it.
const WIDEST_RAD: f64 = 60.0 / 180.0 * std::f64::consts::PI;
/// At larger angles rays are sampled more coarsely instead: `D` is never longer than one over this.
const LEAST_ALONG_GUIDE: f32 = 0.25;

/// A frame's rays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    eye_in_world: DVec3,
    /// Direction through the centre of the upper left pixel, of depth 1, and its change per column
    /// and row.
    first: Vec3,
    per_column: Vec3,
    per_row: Vec3,
    guide: Vec3,
    /// Rows of the matrix from a point relative to the eye to column times depth, row times depth,
    /// and depth.
    inverse: [Vec3; 3],
    /// Depth of a sample at s = 1 on the view axis.
    forward_along_guide: f32,
    focal_px: f32,
}

/// One ray: `eye + s·direction`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Per unit of s, world space.
    pub direction: Vec3,
    /// Metres along the view axis per unit of s.
    pub depth: f32,
}

impl View {
    /// The rays of a camera.
    #[must_use]
    pub fn new(camera: &Camera) -> Self {
        let [_, _, forward] = camera.axes_in_world();
        let at = |x: f64, y: f64| camera.ray_in_world(x + 0.5, y + 0.5);
        let first = at(0.0, 0.0);
        let [tan_x, tan_y] = camera.picture_plane().reach();
        let half_diagonal = tan_x.hypot(tan_y).atan();
        // The steepest ray, for any roll of the camera, decides how far the guide tilts down (or
        // up).
        let steepest = camera.pitch_rad().sin().asin();
        let tip = (steepest.abs() + half_diagonal - WIDEST_RAD).clamp(0.0, steepest.abs()).copysign(steepest);
        // A camera that is pitched past the vertical looks backwards: the guide lies on the side of
        // the view axis.
        let side = if camera.pitch_rad().cos() < 0.0 { -1.0 } else { 1.0 };
        let (sin, cos) = camera.heading_rad().sin_cos();
        let guide = DVec3::new(side * sin * tip.cos(), side * cos * tip.cos(), tip.sin());
        let (per_column, per_row) = (at(1.0, 0.0) - first, at(0.0, 1.0) - first);
        // Rows of the inverse of the matrix of these three, by Cramer's rule.
        let [column, row, depth] = [
            (per_row.cross(first), per_column),
            (first.cross(per_column), per_row),
            (per_column.cross(per_row), first),
        ]
        .map(|(normal, own)| (normal / normal.dot(own)).as_vec3());
        Self {
            eye_in_world: camera.eye(),
            first: first.as_vec3(),
            per_column: per_column.as_vec3(),
            per_row: per_row.as_vec3(),
            guide: guide.as_vec3(),
            inverse: [column, row, depth],
            forward_along_guide: forward.dot(guide) as f32,
            focal_px: camera.focal_px() as f32,
        }
    }

    /// The eye, world space.
    #[must_use]
    #[inline]
    pub fn eye_in_world(&self) -> DVec3 {
        self.eye_in_world
    }

    /// Pixels per metre at a depth of one metre.
    #[must_use]
    #[inline]
    pub fn focal_px(&self) -> f32 {
        self.focal_px
    }

    /// The change of s per metre on the view axis.
    #[must_use]
    pub fn s_per_depth(&self) -> f32 {
        self.forward_along_guide
    }

    /// Direction of depth 1 through a pixel's centre.
    #[inline(always)]
    #[must_use]
    pub fn direction(&self, [x, y]: [u32; 2]) -> Vec3 {
        self.direction_at(x as f32, y as f32)
    }

    /// Direction of depth 1 through any point of the picture, in pixels from the centre of the
    /// upper left one.
    #[inline(always)]
    #[must_use]
    pub fn direction_at(&self, x: f32, y: f32) -> Vec3 {
        self.first + self.per_column * x + self.per_row * y
    }

    /// Rows of the matrix from a point relative to the eye to column times depth, row times depth,
    /// and depth. Columns and rows count from the centre of the upper left pixel.
    #[must_use]
    #[inline]
    pub fn inverse(&self) -> [Vec3; 3] {
        self.inverse
    }

    /// The direction along which all rays advance by the same length per unit of s.
    #[must_use]
    #[inline]
    pub fn guide(&self) -> Vec3 {
        self.guide
    }

    /// The change of a direction of depth 1 from column to column, and from row to row.
    #[must_use]
    #[inline]
    pub fn steps(&self) -> [Vec3; 2] {
        [self.per_column, self.per_row]
    }

    /// The ray through a pixel's centre.
    #[inline(always)]
    #[must_use]
    pub fn ray(&self, pixel: [u32; 2]) -> Ray {
        let direction = self.direction(pixel);
        let depth = 1.0 / self.along(direction).unwrap_or_else(|least| least);
        Ray { direction: direction * depth, depth }
    }

    /// The ray through any point of the picture; `None` where its length along the guide had to be
    /// clamped.
    #[inline(always)]
    #[must_use]
    pub(crate) fn ray_along(&self, x: f32, y: f32) -> Option<Ray> {
        let direction = self.direction_at(x, y);
        let depth = 1.0 / self.along(direction).ok()?;
        Some(Ray { direction: direction * depth, depth })
    }

    /// The component of a direction along the guide; if that is too small, an error with the value
    /// to be used instead.
    #[inline(always)]
    fn along(&self, direction: Vec3) -> Result<f32, f32> {
        let along = direction.dot(self.guide);
        let least = LEAST_ALONG_GUIDE * LEAST_ALONG_GUIDE * direction.length_squared();
        if along > 0.0 && along * along > least { Ok(along) } else { Err(least.sqrt()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terravision_common::camera::CameraFields;

    proptest! {
        #[test]
        fn rays_are_those_of_the_camera_and_no_sample_is_far_from_the_last(
            heading in -7.0f64..7.0, pitch in -1.6f64..1.6, roll in -4.0f64..4.0, vfov in 0.1f64..1.4,
            x in 0u32..320, y in 0u32..240,
        ) {
            let camera = Camera::new(CameraFields {
                eye_in_world: [10.0, 20.0, 30.0], heading_rad: heading, pitch_rad: pitch, roll_rad: roll,
                vfov_rad: vfov, width: 320, height: 240, timestamp_nanos: 0,
            }).expect("valid");
            let view = View::new(&camera);
            let wanted = camera.ray_in_world(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let ray = view.ray([x, y]);
            let found = (ray.direction / ray.depth).as_dvec3();
            prop_assert!((found - wanted).length() < 1e-5, "{found} {wanted}");
            prop_assert!(ray.direction.length() <= 1.001 / LEAST_ALONG_GUIDE && ray.depth > 0.0);
            prop_assert!(view.s_per_depth() > 0.49);
            let point = (wanted * 700.0).as_vec3();
            let [column, row, depth] = view.inverse().map(|of| of.dot(point));
            prop_assert!((depth - 700.0).abs() < 0.01, "{depth}");
            let off = [column / depth - x as f32, row / depth - y as f32];
            prop_assert!(off.iter().all(|off| off.abs() < 0.01), "{off:?}");
        }
    }
}
