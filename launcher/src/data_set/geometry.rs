//! The camera model as matrices, in double precision and in the full coordinates of the CRS.
//!
//! ```text
//! f = height / 2 / tan(vfov / 2)      K = | f 0 width/2 - shift |      pixel (column, row) has its centre at
//! square pixels                           | 0 f height/2        |      (column + 0.5, row + 0.5), from the
//!                                         | 0 0 1               |      picture's upper left corner
//! shift: pixels from the line of sight to the picture's middle, to the right (eyes of a stereo pair)
//! ```

use glam::{DMat3, DVec3};
use terravision_common::camera::Camera;
use terravision_common::surface::CrsFrame;

/// Rows of a 4x4 matrix.
pub type Rows4 = [[f64; 4]; 4];

/// The matrix K of a camera, rows: from camera space (x right, y down, z forward) to pixels.
#[must_use]
pub fn intrinsics(camera: &Camera) -> [[f64; 3]; 3] {
    let f = camera.focal_px();
    let [cx, cy] = [camera.width(), camera.height()].map(|side| 0.5 * f64::from(side));
    [[f, 0.0, cx - camera.lens_shift_px()], [0.0, f, cy], [0.0, 0.0, 1.0]]
}

/// The eye in the CRS: easting, northing, and the height at which it is drawn.
#[must_use]
pub fn eye_in_crs(camera: &Camera, origin: [f64; 2]) -> DVec3 {
    CrsFrame::new(origin).place(camera.eye())
}

/// From camera space (x right, y down, z forward) to the CRS.
#[must_use]
pub fn camera_to_world(camera: &Camera, origin: [f64; 2]) -> Rows4 {
    let [right, up, forward] = camera.axes_in_world();
    rows(DMat3::from_cols(right, -up, forward), eye_in_crs(camera, origin))
}

/// The inverse of [`camera_to_world`].
#[must_use]
pub fn world_to_camera(camera: &Camera, origin: [f64; 2]) -> Rows4 {
    let [right, up, forward] = camera.axes_in_world();
    let rotation = DMat3::from_cols(right, -up, forward).transpose();
    rows(rotation, -(rotation * eye_in_crs(camera, origin)))
}

/// The same camera with the axes of OpenGL (x right, y up, z backwards).
#[must_use]
pub fn with_opengl_axes(camera_to_world: Rows4) -> Rows4 {
    let [x, y, z, _] = camera_to_world.map(|[right, down, forward, at]| [right, -down, -forward, at]);
    [x, y, z, [0.0, 0.0, 0.0, 1.0]]
}

fn rows(rotation: DMat3, translation: DVec3) -> Rows4 {
    let [x, y, z] = [rotation.row(0), rotation.row(1), rotation.row(2)];
    [
        [x.x, x.y, x.z, translation.x],
        [y.x, y.y, y.z, translation.y],
        [z.x, z.y, z.z, translation.z],
        [0.0, 0.0, 0.0, 1.0],
    ]
}
