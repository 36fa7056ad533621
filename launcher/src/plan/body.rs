//! What flights over whole bodies do not have yet, and their usual path.

use crate::cli::draw::DrawArgs;
use crate::failure::Failure;
use crate::path::{CameraPath, Course, PathSettings, Pose};
use anyhow::anyhow;
use glam::DVec3;
use std::f64::consts::TAU;
use terravision_common::surface::globe::Globe;
use terravision_common::surface::{Surface, heading, pitch};
use terravision_common::world::World;

/// Frames of one round.
const ROUND_FRAMES: usize = 240;
/// Height of the usual round above the ground, as a share of the body's radius.
const HEIGHT_SHARE: f64 = 0.9;
/// Angle between its plane and that of the equator, degrees.
const INCLINATION_DEG: f64 = 50.0;
/// How far below the limb it looks, degrees.
const BELOW_LIMB_DEG: f64 = 14.0;

/// Refuses what is not there for bodies.
///
/// # Errors
/// Bad input, in one sentence.
pub(super) fn check(args: &DrawArgs, world: &World) -> Result<(), Failure> {
    let picture = &args.picture;
    let asked = [
        (picture.views.is_some(), "--views"),
        (picture.stereo.stereo.is_some(), "--stereo"),
        (picture.light.lights_ground(), "--sun"),
    ];
    match asked.into_iter().find(|(is_asked, _)| *is_asked && world.globe().is_some()) {
        Some((_, flag)) => Err(Failure::bad_input(anyhow!(
            "{flag}: whole bodies are drawn without it so far; expected a flight without {flag}"
        ))),
        None => Ok(()),
    }
}

/// Refuses what moves the camera by hand.
///
/// # Errors
/// Bad input, in one sentence.
pub fn check_hands(command: &str, world: &World) -> Result<(), Failure> {
    if world.globe().is_none() {
        return Ok(());
    }
    Err(Failure::bad_input(anyhow!(
        "terravision {command}: hands do not move cameras around whole bodies yet; expected terravision fly or terravision still \
         over this world"
    )))
}

/// Once around a body, high enough that all of its limb is seen in turn.
pub(super) fn around_body(globe: &Globe) -> CameraPath {
    let radius_m = globe.body().semi_major_m();
    let height_m = HEIGHT_SHARE * radius_m;
    let limb = (radius_m / (radius_m + height_m)).acos();
    let (sin, cos) = INCLINATION_DEG.to_radians().sin_cos();
    let poses = (0..ROUND_FRAMES).map(|frame| {
        let (along_sin, along_cos) = (TAU * frame as f64 / ROUND_FRAMES as f64).sin_cos();
        let longitude = (cos * along_sin).atan2(along_cos);
        let latitude = (sin * along_sin).asin();
        Pose {
            position: DVec3::new(longitude.to_degrees(), latitude.to_degrees(), height_m),
            heading_rad: cos.atan2(sin * along_cos),
            pitch_rad: -limb - BELOW_LIMB_DEG.to_radians(),
            roll_rad: 0.0,
        }
    });
    CameraPath { settings: PathSettings::default(), course: Course::Round(poses.collect()) }
}

/// Once around a place of a body: positions in longitude and latitude, degrees, and height.
pub(super) fn around_place(surface: &Surface, target: DVec3, radius_m: f64, height_m: f64, turns: f64) -> CameraPath {
    let frames = (ROUND_FRAMES as f64 * turns.abs()).round().max(1.0) as usize;
    let poses = (0..frames).map(|frame| {
        let (sin, cos) = (turns.signum() * TAU * frame as f64 / ROUND_FRAMES as f64).sin_cos();
        let eye = surface.moved(target, DVec3::new(radius_m * cos, radius_m * sin, height_m));
        let sight = surface.seen_by(eye, DVec3::Y).way_to(target);
        Pose { position: eye, heading_rad: heading(sight), pitch_rad: pitch(sight), roll_rad: 0.0 }
    });
    CameraPath { settings: PathSettings::default(), course: Course::Round(poses.collect()) }
}
