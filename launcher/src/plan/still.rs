//! The plan of `terravision still`.

use super::checks::{exaggeration, has_extension, is_folder_name};
use super::compression::TexelQuestion;
use super::draft::Draft;
use super::{FlightPlan, PICTURES, course, supervision};
use crate::cli::picture::Quality;
use crate::cli::still::StillArgs;
use crate::cli::supervision::SupervisionArgs;
use crate::failure::Failure;
use crate::output::TemporaryFile;
use crate::path::PathSettings;
use crate::world::open_world;
use anyhow::anyhow;
use std::path::{Path, PathBuf};
use terravision_common::run::{PlaneTarget, SinkConfig};

/// The plan of `terravision still`.
///
/// # Errors
/// Bad input, in one sentence.
pub fn still(args: &StillArgs) -> Result<FlightPlan, Failure> {
    let texels = TexelQuestion::new(&args.picture, Quality::Finest)?;
    let database = open_world(&args.world, &args.database)?;
    let exaggeration = exaggeration(args.picture.exaggeration)?;
    let (pose, warnings) = course::pose(&args.pose, args.agl, &database, exaggeration)?;
    let settings = PathSettings::default();
    let mut draft = Draft::new(database, &args.database, &args.picture, &args.resources, settings)?;
    draft.poses = vec![pose];
    draft.warnings = warnings;
    draft.usual_quality = Quality::Finest;
    check_picture(&args.output)?;
    check_plane("--depth", args.depth.as_deref(), "depths are float32")?;
    check_plane("--ground", args.ground.as_deref(), "positions are float64")?;
    let mut outputs = Outputs { run: draft.run.to_string(), named: Vec::new(), files: Vec::new() };
    draft.sink = SinkConfig::PngFile(outputs.add(&args.output)?);
    draft.depth = args.depth.as_deref().map(|path| outputs.add(path)).transpose()?.map(PlaneTarget::File);
    draft.ground = args.ground.as_deref().map(|path| outputs.add(path)).transpose()?.map(PlaneTarget::File);
    draft.files = outputs.files;
    draft.destination = args.output.display().to_string();
    let mut plan = draft.finish(texels, &args.measurements)?;
    plan.restarts = supervision::restarts(&SupervisionArgs::default(), &plan.config)?;
    Ok(plan)
}

/// A device or a pipe: it is written to as it is, whatever its name.
fn is_device(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir())
}

fn check_picture(path: &Path) -> Result<(), Failure> {
    if is_device(path) || (!is_folder_name(path) && has_extension(path, &["png"])) {
        return Ok(());
    }
    let is_other = !is_folder_name(path) && has_extension(path, &PICTURES);
    let advice =
        if is_other { "; other programs make JPEG and the like of it, e.g. ffmpeg -i a.png a.jpg" } else { "" };
    Err(Failure::bad_input(anyhow!("-o {}: expected a PNG file, e.g. a.png{advice}", path.display())))
}

/// `values`: what only a TIFF file holds.
fn check_plane(flag: &str, path: Option<&Path>, values: &str) -> Result<(), Failure> {
    let Some(path) = path else { return Ok(()) };
    if is_device(path) || (!is_folder_name(path) && has_extension(path, &["tif", "tiff"])) {
        return Ok(());
    }
    Err(Failure::bad_input(anyhow!(
        "{flag} {}: expected a TIFF file, e.g. {}.tif: {values}, which other kinds of pictures do not hold",
        path.display(),
        flag.trim_start_matches('-')
    )))
}

/// The files of a still.
struct Outputs {
    run: String,
    named: Vec<PathBuf>,
    files: Vec<TemporaryFile>,
}

impl Outputs {
    /// The name under which a file is written.
    fn add(&mut self, path: &Path) -> Result<PathBuf, Failure> {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        if self.named.contains(&absolute) && !is_device(path) {
            return Err(Failure::bad_input(anyhow!(
                "{} is asked for twice: every output needs its own file",
                path.display()
            )));
        }
        self.named.push(absolute);
        let file = TemporaryFile::create(path, &self.run).map_err(Failure::bad_input)?;
        let name = file.temporary().to_owned();
        self.files.push(file);
        Ok(name)
    }
}
