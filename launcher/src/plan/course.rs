//! The path that a command line means, in the world's CRS.

use super::body;
use super::checks::{frame_range, in_range, pace, speed};
use super::pose::PoseContext;
use crate::cli::course::{CourseArgs, Rests};
use crate::cli::pose::PoseArgs;
use crate::cli::values::Pair;
use crate::failure::Failure;
use crate::ground::WorldGround;
use crate::path::crs::Georeference;
use crate::path::orbit::{self, Orbit, OrbitWishes};
use crate::path::{self, CameraPath, Course, CourseOptions, Ground, PathSettings, Pose, Remarks};
use anyhow::anyhow;
use glam::{DVec2, DVec3};
use std::path::{Path, PathBuf};
use terravision_common::surface::globe::Globe;
use terravision_store::Store;

/// Where `--path orbit` is meant, unless a file has that name.
const ORBIT: &str = "orbit";

/// A camera path, and what is to be said about it.
#[derive(Debug)]
pub struct LoadedPath {
    /// The path.
    pub path: CameraPath,
    /// What is good to know, a sentence each.
    pub notes: Vec<String>,
    /// What may not be as meant, a sentence each.
    pub warnings: Vec<String>,
}

/// A path, a pose for each of its frames.
#[derive(Debug)]
pub(super) struct PathFrames {
    /// Frames in a second.
    pub(super) fps: f64,
    /// Numbers of its frames: the first, and one past the last.
    pub(super) frames: [u64; 2],
    /// Their poses.
    pub(super) poses: Vec<Pose>,
    /// What the path says about the picture.
    pub(super) settings: PathSettings,
    /// What is good to know, a sentence each.
    pub(super) notes: Vec<String>,
    /// What may not be as meant, a sentence each.
    pub(super) warnings: Vec<String>,
}

impl PathFrames {
    /// Of the path that the command line means.
    ///
    /// # Errors
    /// Bad input.
    pub(super) fn load(args: &CourseArgs, database: &Store, exaggeration: f64) -> Result<Self, Failure> {
        Self::of_loaded(load_path(args, database, exaggeration)?, args)
    }

    /// Of the path in a file, or 'orbit', to be played N times as fast. A path with a pose for each
    /// frame, which has no times, is played at N times its rate.
    ///
    /// # Errors
    /// Bad input.
    pub(super) fn to_play(
        path: PathBuf,
        factor: Option<f64>,
        database: &Store,
        exaggeration: f64,
    ) -> Result<Self, Failure> {
        let factor = speed(factor)?;
        let mut args = CourseArgs::of_path(path);
        let loaded = load_path(&args, database, exaggeration)?;
        let is_timed = matches!(loaded.path.course, Course::Timed(_));
        args.speed = is_timed.then_some(factor);
        let mut frames = Self::of_loaded(loaded, &args)?;
        if !is_timed {
            frames.fps *= factor;
        }
        Ok(frames)
    }

    fn of_loaded(loaded: LoadedPath, args: &CourseArgs) -> Result<Self, Failure> {
        let LoadedPath { path, notes, warnings } = loaded;
        let (fps, speed) = pace(args, &path)?;
        let frames = frame_range(args.frames, &path.course, fps, speed)?;
        let poses: Option<Vec<Pose>> =
            (frames[0]..frames[1]).map(|frame| path.course.pose(frame, fps, speed)).collect();
        let poses = poses.ok_or_else(|| Failure::bad_input(anyhow!("the path ends before frame {}", frames[1])))?;
        Ok(Self { fps, frames, poses, settings: path.settings, notes, warnings })
    }
}

/// The CRS of a world, for paths in other coordinates.
#[must_use]
pub fn georeference(database: &Store) -> Georeference {
    let (manifest, world) = (database.manifest().fields(), database.world());
    let crs = &manifest.crs;
    let middle = world.crs_middle().to_array();
    Georeference::new(crs.name.clone(), crs.epsg, crs.proj4.as_deref()).with_table(manifest.lonlat.clone(), middle)
}

/// The path that `--path` means, or the pose of a camera that stands still.
///
/// # Errors
/// Bad input: the file cannot be read or is not a path, or flags contradict each other.
pub fn load_path(args: &CourseArgs, database: &Store, exaggeration: f64) -> Result<LoadedPath, Failure> {
    if let Some(flag) = args.pose.given() {
        return standing(flag, args, database, exaggeration);
    }
    if args.path == Path::new(ORBIT) {
        return orbit_path(args, database, exaggeration);
    }
    if let Some(flag) = args.orbit.given() {
        return Err(Failure::bad_input(anyhow!(
            "{flag} applies to --path orbit, not to --path {}",
            args.path.display()
        )));
    }
    if args.pose.lonlat {
        return Err(only_for_places("--lonlat"));
    }
    let agl_m = match args.agl.agl {
        Some(None) => return Err(only_for_places("--agl without a number")),
        Some(Some(metres)) => Some(in_range("--agl", metres, 1.0, 1e6, "metres from 1 to 1000000")?),
        None => None,
    };
    let ground = WorldGround::finest(database, database.world(), exaggeration).bounded(database.ranges());
    let options = CourseOptions { agl_m, keeps_rests: args.rests == Rests::Keep };
    let mut remarks = Remarks::default();
    let georeference = georeference(database);
    let path = path::load(&args.path, &georeference, &ground, options, &mut remarks).map_err(Failure::bad_input)?;
    let Remarks { notes, mut warnings } = remarks;
    warnings.extend(georeference.take_doubts());
    Ok(LoadedPath { path, notes, warnings })
}

fn only_for_places(flag: &str) -> Failure {
    Failure::bad_input(anyhow!("{flag} applies to --eye, --look-at and --around: give one of them, or leave it out"))
}

/// One pose, again and again.
fn standing(flag: &str, args: &CourseArgs, database: &Store, exaggeration: f64) -> Result<LoadedPath, Failure> {
    if let Some(other) = args.orbit.given().or(args.speed.map(|_| "--speed")) {
        return Err(Failure::bad_input(anyhow!(
            "{other} and {flag}: with {flag} the camera stands still; leave one of them out"
        )));
    }
    if args.path != Path::new(ORBIT) {
        return Err(Failure::bad_input(anyhow!(
            "{flag} and --path {}: both say where the camera is; leave one of them out",
            args.path.display()
        )));
    }
    if let Some(Some(metres)) = args.agl.agl {
        return Err(Failure::bad_input(anyhow!(
            "--agl {metres}: expected --agl without a number with {flag}: it then says that the Z of --eye and --look-at are \
             heights above the ground"
        )));
    }
    let (pose, warnings) = pose(&args.pose, args.agl.agl.is_some(), database, exaggeration)?;
    let path = CameraPath { settings: PathSettings::default(), course: Course::Round(vec![pose]) };
    Ok(LoadedPath { path, notes: Vec::new(), warnings })
}

/// The pose that `--eye`, `--look-at` and their like give, and what is to be warned of.
///
/// # Errors
/// Bad input.
pub(super) fn pose(
    args: &PoseArgs,
    is_agl: bool,
    database: &Store,
    exaggeration: f64,
) -> Result<(Pose, Vec<String>), Failure> {
    let ground = WorldGround::finest(database, database.world(), exaggeration).bounded(database.ranges());
    let georeference = georeference(database);
    let context =
        PoseContext { georeference: &georeference, surface: database.world().surface(), ground: &ground, is_agl };
    let (pose, warning) = super::pose::resolve(args, context)?;
    Ok((pose, georeference.take_doubts().into_iter().chain(warning).collect()))
}

/// Around a whole body, or around a place of it.
fn orbit_of_body(args: &CourseArgs, database: &Store, globe: &Globe, exaggeration: f64) -> Result<LoadedPath, Failure> {
    let loaded = |path, note: String| LoadedPath { path, notes: vec![note], warnings: Vec::new() };
    let Some(Pair([x, y])) = args.orbit.around else {
        return Ok(loaded(body::around_body(globe), "around the whole body, over both hemispheres".to_owned()));
    };
    let ground = WorldGround::finest(database, database.world(), exaggeration).bounded(database.ranges());
    let Some(height_m) = ground.height_m(x, y) else {
        return Err(Failure::bad_input(anyhow!(
            "--around {x},{y}: expected a longitude from -360 to 360 and a latitude from -90 to 90, in degrees"
        )));
    };
    let metres = |name, value: Option<f64>, usual: f64, low| {
        in_range(name, value.unwrap_or(usual), low, 1e8, "metres, at most 100000000")
    };
    let usual_m = 40.0 * database.world().surface().spacing_m(database.world().surface().rows_level());
    let radius_m = metres("--radius", args.orbit.radius, usual_m, 0.1)?;
    let above_m = metres("--height", args.orbit.height, 0.5 * radius_m, -1e5)?;
    let turns = args.orbit.turns.unwrap_or(1.0);
    in_range("--turns", turns.abs(), 1e-3, 1e4, "a number of rounds from 0.001 to 10000, negative for clockwise")?;
    let path = body::around_place(database.world().surface(), DVec3::new(x, y, height_m), radius_m, above_m, turns);
    Ok(loaded(path, format!("around {x:.3}, {y:.3}, {radius_m:.0} m away and {above_m:.0} m above the ground there")))
}

fn orbit_path(args: &CourseArgs, database: &Store, exaggeration: f64) -> Result<LoadedPath, Failure> {
    if args.agl.agl.is_some() {
        return Err(Failure::bad_input(anyhow!(
            "--agl applies to tracks (GPX, GeoJSON, and those of KML and CZML) and to --eye and --look-at, not to the orbit: \
             --height sets the height of the orbit"
        )));
    }
    if args.pose.lonlat && args.orbit.around.is_none() {
        return Err(only_for_places("--lonlat"));
    }
    let world = database.world();
    if let Some(globe) = world.globe() {
        return orbit_of_body(args, database, globe, exaggeration);
    }
    let spacing = world.plane().end().max_element() / 200.0;
    let coarse = WorldGround::coarse(database, world, exaggeration, spacing).bounded(database.ranges());
    let extent = coarse.extent();
    let georeference = georeference(database);
    let around = args.orbit.around.map(|Pair([x, y])| match args.pose.lonlat {
        true => georeference.from_lonlat()?.position(x, y),
        false => Ok(DVec2::new(x, y)),
    });
    let around = around.transpose().map_err(Failure::bad_input)?;
    if let Some(place) = around.filter(|place| extent.distance(*place) > 0.0) {
        return Err(Failure::bad_input(anyhow!(
            "--around: {:.1}, {:.1} is outside of the world, which reaches from {:.1}, {:.1} to {:.1}, {:.1} ({})",
            place.x,
            place.y,
            extent.low.x,
            extent.low.y,
            extent.high.x,
            extent.high.y,
            georeference.name()
        )));
    }
    let metres = |name, value: Option<f64>, low| {
        value.map(|value| in_range(name, value, low, 1e8, "metres, at most 100000000")).transpose()
    };
    let turns = args.orbit.turns.unwrap_or(1.0);
    in_range("--turns", turns.abs(), 1e-3, 1e4, "a number of rounds from 0.001 to 10000, negative for clockwise")?;
    let wishes = OrbitWishes {
        around,
        radius_m: metres("--radius", args.orbit.radius, 0.1)?,
        height_m: metres("--height", args.orbit.height, -1e5)?,
        turns,
        post_spacing_m: world.elevation_spacing_m(world.finest_elevation_level()),
    };
    // A place that was asked for is the ground as it is drawn.
    let finest = WorldGround::finest(database, world, exaggeration).bounded(database.ranges());
    let ground: &WorldGround<'_> = if around.is_some() { &finest } else { &coarse };
    let Orbit { path, note } = orbit::orbit(&extent, ground, &wishes);
    Ok(LoadedPath { path, notes: vec![note], warnings: georeference.take_doubts() })
}
