//! A pose that a person gave: where the camera stands and looks, in the world's CRS.

use super::checks::in_range;
use crate::cli::pose::PoseArgs;
use crate::cli::values::{Place, Triple};
use crate::failure::Failure;
use crate::ground::{self, CLEARANCE_M};
use crate::path::crs::{Georeference, Transform};
use crate::path::{Ground, Pose};
use anyhow::anyhow;
use glam::{DVec2, DVec3};
use terravision_common::surface::{self, Surface};

/// How heights and coordinates of a pose are read.
#[derive(Clone, Copy)]
pub(super) struct PoseContext<'a> {
    /// The world's CRS.
    pub(super) georeference: &'a Georeference,
    /// Where places lie in space.
    pub(super) surface: &'a Surface,
    /// The ground, as it is drawn.
    pub(super) ground: &'a dyn Ground,
    /// Whether Z is above the ground.
    pub(super) is_agl: bool,
}

/// The pose, and a warning if the camera had to be lifted out of the ground.
///
/// # Errors
/// Bad input: too little or too much is said, or a place has no ground.
pub(super) fn resolve(args: &PoseArgs, context: PoseContext<'_>) -> Result<(Pose, Option<String>), Failure> {
    let (mut pose, target) = aimed(args, &PlaceReader::new(args, context)?)?;
    let before = pose.position.z;
    if !ground::lift(&mut pose, context.ground) {
        return Ok((pose, None));
    }
    let lifted = pose.position.z - before;
    if let Some(target) = target {
        pose = towards(context.surface, pose.position, target, pose.roll_rad);
    }
    let warning = format!(
        "the camera was lifted by {lifted:.1} m, to {CLEARANCE_M} m above the ground: it would have been below that"
    );
    Ok((pose, (lifted > 0.01).then_some(warning)))
}

const ANGLE: &str = "degrees from -1000000 to 1000000";

fn bad(text: impl Into<String>) -> Failure {
    Failure::bad_input(anyhow!(text.into()))
}

/// The pose as it is given, and the place that it looks at, if it is given by one.
fn aimed(args: &PoseArgs, places: &PlaceReader<'_>) -> Result<(Pose, Option<DVec3>), Failure> {
    let roll_rad = in_range("--roll", args.roll.unwrap_or(0.0), -1e6, 1e6, ANGLE)?.to_radians();
    let direction = args.heading.map(|_| "--heading").or(args.pitch.map(|_| "--pitch"));
    match (args.eye, args.look_at, args.from, direction) {
        (Some(eye), None, None, _) => {
            let (Some(heading), Some(pitch)) = (args.heading, args.pitch) else {
                return Err(bad(
                    "--eye says where the camera is, but not where it looks: add --look-at X,Y, or --heading and --pitch",
                ));
            };
            let heading_rad = places.heading(eye, in_range("--heading", heading, -1e6, 1e6, ANGLE)?)?;
            let pitch_rad = in_range("--pitch", pitch, -90.0, 90.0, "degrees from -90 to 90")?.to_radians();
            Ok((Pose { position: places.eye(eye)?, heading_rad, pitch_rad, roll_rad }, None))
        }
        (_, Some(_), _, Some(flag)) => {
            Err(bad(format!("{flag} and --look-at both say where the camera looks: leave one out")))
        }
        (Some(eye), Some(target), None, None) => {
            let (eye, target) = (places.eye(eye)?, places.target(target)?);
            if eye.distance(target) < 1e-3 {
                return Err(bad("--look-at and --eye are the same place: expected two different ones"));
            }
            Ok((towards(places.context.surface, eye, target, roll_rad), Some(target)))
        }
        (None, Some(target), Some(from), None) => from_a_distance(target, from, roll_rad, places),
        (None, Some(_), None, None) => Err(bad(
            "--look-at says where the camera looks, but not where it is: add --from AZIMUTH,ELEVATION,DISTANCE, or --eye X,Y,Z",
        )),
        (Some(_), _, Some(_), _) => Err(bad("--from and --eye both say where the camera is: leave one out")),
        (None, None, _, _) => Err(bad(
            "no pose is given: expected --eye with --heading and --pitch, --eye with --look-at, or --look-at with \
             --from AZIMUTH,ELEVATION,DISTANCE",
        )),
    }
}

/// The pose that `--from` gives.
fn from_a_distance(
    target: Place,
    Triple([azimuth, elevation, distance]): Triple,
    roll_rad: f64,
    places: &PlaceReader<'_>,
) -> Result<(Pose, Option<DVec3>), Failure> {
    in_range("--from: the azimuth", azimuth, -1e6, 1e6, ANGLE)?;
    let elevation = in_range("--from: the elevation", elevation, -90.0, 90.0, "degrees from -90 to 90")?;
    in_range("--from: the distance", distance, 1e-3, 1e9, "metres, from 0.001 to 1000000000")?;
    let azimuth = places.heading(target, azimuth)?;
    let target = places.target(target)?;
    let way = surface::direction(azimuth, elevation.to_radians()) * distance;
    let eye = places.context.surface.moved(target, way);
    // Straight down the direction alone would not tell what is up in the picture.
    let heading_rad = azimuth + std::f64::consts::PI;
    Ok((Pose { position: eye, heading_rad, pitch_rad: -elevation.to_radians(), roll_rad }, Some(target)))
}

/// A camera that looks at a place; straight down it has north at the top.
fn towards(on: &Surface, eye: DVec3, target: DVec3, roll_rad: f64) -> Pose {
    let sight = on.seen_by(eye, DVec3::Y).way_to(target);
    Pose { position: eye, heading_rad: surface::heading(sight), pitch_rad: surface::pitch(sight), roll_rad }
}

/// Places as given, brought into the world's CRS.
struct PlaceReader<'a> {
    context: PoseContext<'a>,
    transform: Option<Transform>,
}

impl<'a> PlaceReader<'a> {
    fn new(args: &PoseArgs, context: PoseContext<'a>) -> Result<Self, Failure> {
        let transform =
            args.lonlat.then(|| context.georeference.from_lonlat()).transpose().map_err(Failure::bad_input)?;
        Ok(Self { context, transform })
    }

    /// Where it is in the world's CRS.
    fn level(&self, place: Place) -> Result<DVec2, Failure> {
        match &self.transform {
            Some(transform) => transform.position(place.x, place.y).map_err(Failure::bad_input),
            None => Ok(DVec2::new(place.x, place.y)),
        }
    }

    /// A direction at a place, in radians from grid north.
    fn heading(&self, place: Place, degrees: f64) -> Result<f64, Failure> {
        match &self.transform {
            Some(transform) => transform.heading(place.x, place.y, degrees.to_radians()).map_err(Failure::bad_input),
            None => Ok(degrees.to_radians()),
        }
    }

    fn eye(&self, place: Place) -> Result<DVec3, Failure> {
        let level = self.level(place)?;
        let height = match place.z {
            Some(z) if !self.context.is_agl => z,
            Some(z) => self.ground("--eye", level)? + z,
            None => self.ground("--eye", level)? + CLEARANCE_M,
        };
        Ok(level.extend(height))
    }

    fn target(&self, place: Place) -> Result<DVec3, Failure> {
        let level = self.level(place)?;
        let height = match place.z {
            Some(z) if !self.context.is_agl => z,
            other => self.ground("--look-at", level)? + other.unwrap_or(0.0),
        };
        Ok(level.extend(height))
    }

    fn ground(&self, flag: &str, level: DVec2) -> Result<f64, Failure> {
        self.context.ground.height_m(level.x, level.y).ok_or_else(|| {
            Failure::bad_input(anyhow!(
                "{flag} {:.1},{:.1} ({}): the world has no ground there; expected a place where it has, or a height (X,Y,Z) without --agl",
                level.x,
                level.y,
                self.context.georeference.name()
            ))
        })
    }
}

#[cfg(test)]
mod tests;
