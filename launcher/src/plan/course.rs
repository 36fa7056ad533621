//! The path that a command line means, in the world's CRS.

use super::checks::in_range;
use crate::cli::{CourseArgs, Rests};
use crate::failure::Failure;
use crate::ground::WorldGround;
use crate::path::crs::Georeference;
use crate::path::{self, CameraPath, CourseOptions, Remarks, orbit};
use anyhow::anyhow;
use std::path::Path;
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

/// The CRS of a world, for paths in other coordinates.
#[must_use]
pub fn georeference(database: &Store) -> Georeference {
    let (manifest, world) = (database.manifest(), database.world());
    let crs = &manifest.crs;
    let middle = [0, 1].map(|axis| world.fields().origin[axis] + 0.5 * world.extent_m()[axis]);
    Georeference::new(crs.name.clone(), crs.epsg, crs.proj4.as_deref()).with_table(manifest.lonlat.clone(), middle)
}

/// The path that `--path` means.
///
/// # Errors
/// Bad input: the file cannot be read or is no path.
pub fn load_path(args: &CourseArgs, database: &Store, exaggeration: f64) -> Result<LoadedPath, Failure> {
    let agl = |agl| in_range("--agl", agl, 1.0, 1e6, "metres from 1 to 1000000");
    let agl_m = args.agl.map(agl).transpose()?;
    let world = database.world();
    if args.path == Path::new(ORBIT) {
        if agl_m.is_some() {
            return Err(Failure::bad_input(anyhow!(
                "--agl is the height above ground of a track (GPX, or a line or track of KML); the orbit has a height of \
                 its own: leave --agl out, or name a track with --path"
            )));
        }
        let spacing = world.extent_m()[0].max(world.extent_m()[1]) / 200.0;
        let ground = WorldGround::coarse(database, world, exaggeration, spacing);
        let path = orbit::orbit(&ground.extent(), &ground);
        return Ok(LoadedPath { path, notes: Vec::new(), warnings: Vec::new() });
    }
    let ground = WorldGround::finest(database, world, exaggeration);
    let options = CourseOptions { agl_m, keeps_rests: args.rests == Rests::Keep };
    let mut remarks = Remarks::default();
    let georeference = georeference(database);
    let path = path::load(&args.path, &georeference, &ground, options, &mut remarks).map_err(Failure::bad_input)?;
    let Remarks { notes, mut warnings } = remarks;
    warnings.extend(georeference.take_doubts());
    Ok(LoadedPath { path, notes, warnings })
}
