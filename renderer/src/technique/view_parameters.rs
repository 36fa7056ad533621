//! From a camera to what the vertex shader needs of it.

use crate::gpu::ViewParameters;
use glam::DVec3;
use terravision_common::camera::Camera;
use terravision_common::surface::EyeCell;
use terravision_common::world::{COLOR_BORDER, World};

/// Near plane, metres. Depth is reversed and the far plane infinitely far: a depth buffer of 32-bit
/// floats then has a relative precision of 2^-24 at any distance, so nothing is gained by moving it
/// out.
pub const NEAR_M: f64 = 0.5;

/// Places between two pixels that rasterizers take vertices to: 8 bits, lavapipe's and the usual
/// `subPixelPrecisionBits`.
const SUBPIXELS: f32 = 256.0;

/// The view, and the eye's lattice cell, which all lattice points are relative to. `datum_z_m`:
/// what elevations are above.
#[must_use]
pub fn view_parameters(camera: &Camera, world: &World, datum_z_m: f64) -> (ViewParameters, EyeCell) {
    let surface = world.surface();
    let on_device = surface.on_device(camera.eye());
    let cell = on_device.cell;
    let [right, up, forward] = camera.axes_in_world();
    let plane = camera.picture_plane();
    let [tan_x, tan_y] = plane.half();
    let row = |v: DVec3| v.as_vec3().to_array();
    let extent = world.extent();
    let view = ViewParameters {
        clip_x: row((right - forward * plane.middle_x()) / tan_x),
        unit_m: on_device.scale_m,
        // Vulkan's y points down the picture.
        clip_y: row(-up / tan_y),
        near_m: NEAR_M as f32,
        clip_w: row(forward),
        posts_reciprocal: 1.0 / world.elevation_posts() as f32,
        eye_in_cell_m: on_device.eye,
        extent_from_cell: [0, 1].map(|axis| cell.count(axis, extent[axis])),
        posts: world.elevation_posts(),
        color_border: COLOR_BORDER as f32 / world.color_stored() as f32,
        grid: [camera.width(), camera.height()].map(|side| 0.5 * side as f32 * SUBPIXELS),
        datum_m: datum_above_eye_m(camera, world, datum_z_m),
        reserved: [0; 3],
    };
    (view, cell)
}

/// What elevations are above, metres above the eye: 0 for the view that the frame's pose itself is.
pub(super) fn datum_above_eye_m(camera: &Camera, world: &World, datum_z_m: f64) -> f32 {
    (datum_z_m - world.surface().height_m(camera.eye())) as f32
}
