//! The plan of `terravision still`.

use super::checks::{exaggeration, has_extension, is_folder_name};
use super::draft::Draft;
use super::drawing::DrawingQuestion;
use super::{FlightPlan, PICTURES, course, light, supervision};
use crate::cli::picture::Quality;
use crate::cli::still::StillArgs;
use crate::cli::supervision::SupervisionArgs;
use crate::failure::Failure;
use crate::output::TemporaryFile;
use crate::path::PathSettings;
use crate::rig_file::{Pictures, view_file};
use crate::world::open_world;
use anyhow::anyhow;
use std::path::{Path, PathBuf};
use terravision_common::run::{PlaneTarget, SinkConfig};

/// The plan of `terravision still`.
///
/// # Errors
/// Bad input, in one sentence.
pub fn still(args: &StillArgs) -> Result<FlightPlan, Failure> {
    let drawing = DrawingQuestion::new(&args.draw.picture, Quality::Finest, args.draw.resources.validation)?;
    let database = open_world(&args.draw.world, &args.draw.database)?;
    let exaggeration = exaggeration(args.draw.picture.exaggeration)?;
    let (pose, warnings) = course::pose(&args.pose, args.agl, &database, exaggeration)?;
    let settings = PathSettings::default();
    let mut draft = Draft::new(database, &args.draw, settings)?;
    draft.poses = vec![pose];
    draft.warnings = warnings;
    draft.labels = light::labels(&args.labels);
    draft.choose_vehicles(&args.vehicles)?;
    draft.choose_rig()?;
    draft.usual_quality = Quality::Finest;
    check_picture(&args.output)?;
    check_plane("--depth", args.depth.as_deref(), "depths are float32")?;
    check_plane("--ground", args.ground.as_deref(), "positions are float64")?;
    let mut outputs = Outputs { run: draft.run.to_string(), named: Vec::new(), files: Vec::new() };
    let names: Option<Vec<String>> = draft.rig.as_ref().map(|rig| rig.names().map(str::to_owned).collect());
    let is_separate = draft.rig.as_ref().is_some_and(|rig| rig.pictures == Pictures::Separate);
    let pictures = files_of(&args.output, names.as_deref().filter(|_| is_separate));
    draft.destination = pictures.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let sinks = pictures.iter().map(|path| Ok(SinkConfig::PngFile(outputs.add(path)?))).collect::<Result<Vec<_>, _>>();
    draft.sink = match sinks? {
        mut sinks if !is_separate => sinks.pop().unwrap_or(SinkConfig::Null),
        sinks => SinkConfig::EachView(sinks),
    };
    let mut planes = |path: &Option<PathBuf>| -> Result<Vec<PlaneTarget>, Failure> {
        let files = path.iter().flat_map(|path| files_of(path, names.as_deref()));
        files.map(|path| Ok(PlaneTarget::File(outputs.add(&path)?))).collect()
    };
    draft.depth = planes(&args.depth)?;
    draft.ground = planes(&args.ground)?;
    draft.files = outputs.files;
    let mut plan = draft.finish(drawing, &args.measurements)?;
    plan.restarts = supervision::restarts(&SupervisionArgs::default(), &plan.config)?;
    Ok(plan)
}

/// The file, or one for each of these views.
fn files_of(path: &Path, names: Option<&[String]>) -> Vec<PathBuf> {
    names.map_or_else(|| vec![path.to_owned()], |names| names.iter().map(|name| view_file(path, name)).collect())
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
