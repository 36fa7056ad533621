//! A path that a window plays. Its poses are handed over in a file without a name, which lives as
//! long as the plan: they may be too many for what stages are told.

use crate::failure::Failure;
use anyhow::anyhow;
use rustix::fs::{MemfdFlags, memfd_create};
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use terravision_common::camera::Camera;
use terravision_common::run::WindowPath;
use terravision_common::viewer::{ViewerPose, poses_to_bytes};
use terravision_common::world::World;

/// The pose of a camera, as people type it.
fn pose_of(camera: &Camera, world: &World) -> ViewerPose {
    let place = world.crs_frame().place(camera.eye());
    ViewerPose {
        x: place.x,
        y: place.y,
        z: place.z,
        // Paths that turn many times have more than a window takes.
        heading: camera.heading_rad().to_degrees().rem_euclid(360.0),
        // From 90 degrees to radians and back may be a little more.
        pitch: camera.pitch_rad().to_degrees().clamp(-90.0, 90.0),
        roll: camera.roll_rad().to_degrees() % 360.0,
        // From 170 degrees to radians and back may be a little more, too.
        vfov: (camera.vfov_rad().to_degrees() * 1e9).round() / 1e9,
    }
}

/// These cameras, `fps` of them a second, for a window; with the pose of the first.
///
/// # Errors
/// A pose that a window cannot show, or no memory.
pub(super) fn share(cameras: &[Camera], fps: f64, world: &World) -> Result<(ViewerPose, WindowPath, File), Failure> {
    let poses: Vec<ViewerPose> = cameras.iter().map(|camera| pose_of(camera, world)).collect();
    for (frame, pose) in poses.iter().enumerate() {
        if let Some(fault) = pose.fault() {
            return Err(Failure::bad_input(anyhow!("a window cannot play frame {frame} of the path: {fault}")));
        }
    }
    let refuse = |error: io::Error| Failure::failed(anyhow!("there is no memory for the path: {error}"));
    let made = memfd_create("terravision-path", MemfdFlags::CLOEXEC).map_err(|error| refuse(error.into()))?;
    let mut file = File::from(made);
    file.write_all(poses_to_bytes(&poses)).map_err(refuse)?;
    let name = format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd());
    let first = poses.first().copied().ok_or_else(|| Failure::bad_input(anyhow!("the path has no frame")))?;
    Ok((first, WindowPath { file: name.into(), fps }, file))
}
