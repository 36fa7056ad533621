//! The ground that a point of the picture shows.

use crate::hub::{Hub, Refusal};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::viewer::ViewerPose;

/// A place on the ground, and how far it is from the eye.
pub(crate) type Picked = ([f64; 3], f64);

/// The ground at a point of the newest picture, from 0 to 1 from its upper left corner; `None` for
/// sky.
pub(crate) fn pick(hub: &Hub, [u, v]: [f64; 2]) -> Result<Option<Picked>, Refusal> {
    if ![u, v].iter().all(|share| (0.0..=1.0).contains(share)) {
        return Err(("malformed", format!("u, v: expected two numbers from 0 to 1, found {u}, {v}")));
    }
    let Some(picture) = hub.pictures.borrow().clone() else {
        return Err(("no-picture", "there is no picture yet".into()));
    };
    let ViewerPose { x, y, z, heading, pitch, roll, vfov } = picture.pose;
    let [width, height] = picture.size;
    let crs = hub.terrain.crs_frame();
    let camera = Camera::new(CameraFields {
        eye_in_world: crs.position([x, y, z].into()).to_array(),
        heading_rad: heading.to_radians(),
        pitch_rad: pitch.to_radians(),
        roll_rad: roll.to_radians(),
        vfov_rad: vfov.to_radians(),
        width,
        height,
        timestamp_nanos: 0,
    });
    let camera = camera.map_err(|error| ("no-picture", error.to_string()))?;
    // The depth is that at the pixel's centre.
    let [column, row] = [(u, width), (v, height)]
        .map(|(share, side)| ((share * f64::from(side)).floor() as usize).min(side as usize - 1));
    let depth = picture.frame.depth.get(row * width as usize + column).copied().filter(|depth| depth.is_finite());
    Ok(depth.map(|depth| {
        let way = camera.ray_in_world(column as f64 + 0.5, row as f64 + 0.5) * f64::from(depth);
        let place = crs.place(camera.eye() + way);
        let exaggeration = hub.flight.borrow().settings.exaggeration.unwrap_or(1.0);
        ([place.x, place.y, place.z / exaggeration], way.length())
    }))
}
