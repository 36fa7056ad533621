//! Where a camera begins that a person moves.

use super::stereo::ground_ahead;
use crate::cli::picture::PictureArgs;
use crate::failure::Failure;
use crate::ground::WorldGround;
use crate::path::orbit::{self, OrbitWishes};
use crate::path::{Course, Pose};
use anyhow::anyhow;
use terravision_common::viewer::ViewerPose;
use terravision_store::Store;

/// Vertical field of view of a camera that nobody has set.
const DEFAULT_VFOV_DEG: f64 = 60.0;

/// Where the camera is when nobody has moved it: at the start of the orbit. And how far away the
/// ground is there, metres, in the middle of the picture.
///
/// # Errors
/// Bad input: a field of view that is out of range.
pub fn start_pose(picture: &PictureArgs, database: &Store) -> Result<(ViewerPose, f64), Failure> {
    let world = database.world();
    let spacing = world.plane().end().max_element() / 200.0;
    let ground = WorldGround::coarse(database, world, picture.exaggeration, spacing).bounded(database.ranges());
    let wishes = OrbitWishes::usual(world.elevation_spacing_m(world.finest_elevation_level()));
    let orbit = orbit::orbit(&ground.extent(), &ground, &wishes);
    let first = match &orbit.path.course {
        Course::Round(poses) | Course::Frames(poses) => poses.first().copied(),
        Course::Timed(_) => None,
    };
    let Some(pose) = first else {
        return Err(Failure::failed(anyhow!("the orbit of this world has no pose")));
    };
    let Pose { position, heading_rad, pitch_rad, roll_rad } = pose;
    // Numbers that people can read.
    let round = |value: f64, per_unit: f64| (value * per_unit).round() / per_unit;
    let degrees = |radians: f64| round(radians.to_degrees(), 100.0);
    let start = ViewerPose {
        x: round(position.x, 10.0),
        y: round(position.y, 10.0),
        z: round(position.z, 10.0),
        heading: degrees(heading_rad).rem_euclid(360.0),
        pitch: degrees(pitch_rad),
        roll: degrees(roll_rad),
        vfov: start_vfov(picture.vfov)?,
    };
    Ok((start, round(ground_ahead(&pose, &ground), 0.1)))
}

fn start_vfov(asked: Option<f64>) -> Result<f64, Failure> {
    let vfov = asked.unwrap_or(DEFAULT_VFOV_DEG);
    if !(1.0..=170.0).contains(&vfov) {
        return Err(Failure::bad_input(anyhow!("--vfov {vfov}: expected degrees from 1 to 170")));
    }
    Ok(vfov)
}
