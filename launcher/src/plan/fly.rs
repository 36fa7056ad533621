//! The plan of `terravision fly`.

use super::checks::{self, exaggeration, has_extension, is_folder_name};
use super::course::PathFrames;
use super::draft::Draft;
use super::drawing::DrawingQuestion;
use super::planes::PlaneFolders;
use super::{FlightPlan, PICTURES, film, light, live, supervision};
use crate::cli::fly::FlyArgs;
use crate::cli::picture::Quality;
use crate::cli::realtime::PredictionChoice;
use crate::failure::Failure;
use crate::output::{self, FrameFolder, TemporaryFile};
use crate::path::PathSettings;
use crate::rig_file::{Pictures, RigFile, view_folder};
use crate::stream::StreamTarget;
use crate::stream::film::Container;
use crate::world::open_world;
use anyhow::anyhow;
use std::io::IsTerminal;
use std::path::Path;
use terravision_common::film::even;
use terravision_common::run::{OPEN_END, SinkConfig};
use terravision_store::Store;

/// The plan of `terravision fly`.
///
/// # Errors
/// Bad input, in one sentence.
pub fn fly(args: &FlyArgs) -> Result<FlightPlan, Failure> {
    let drawing = DrawingQuestion::new(&args.draw.picture, Quality::Default, args.draw.resources.validation)?;
    let database = open_world(&args.draw.world, &args.draw.database)?;
    let mut draft =
        if args.live.camera.is_some() { draft_of_poses(args, database)? } else { draft_of_path(args, database)? };
    draft.choose_rig()?;
    draft.share = live::share(args)?;
    draft.realtime = Some(&args.realtime);
    draft.labels = light::labels(&args.labels);
    draft.choose_vehicles(&args.vehicles)?;
    choose_output(&mut draft, args)?;
    if draft.labels.is_some() && draft.sink == SinkConfig::Null {
        return Err(Failure::bad_input(anyhow!(
            "-o {}: labels are burnt into films and pictures, and this is neither; expected one of them, e.g. -o film.mp4, or no labels",
            args.output.display()
        )));
    }
    draft.planes = PlaneFolders::create(args, draft.rig.as_ref(), &draft.run.to_string())?;
    [draft.depth, draft.ground] = draft.planes.targets();
    if draft.destination.is_empty() {
        draft.destination = args.output.display().to_string();
    }
    let mut plan = draft.finish(drawing, &args.measurements)?;
    plan.live = live::camera(args, &plan.config)?;
    plan.restarts = supervision::restarts(&args.supervision, &plan.config)?;
    plan.notes.extend(of_odd_sides(&plan));
    Ok(plan)
}

/// Of a flight whose poses another program sends.
fn draft_of_poses(args: &FlyArgs, database: Store) -> Result<Draft<'_>, Failure> {
    if args.realtime.prediction == Some(PredictionChoice::Oracle) {
        return Err(Failure::bad_input(anyhow!(
            "--prediction oracle needs a path that is known in advance, and with --camera another program sends the poses: \
             expected off, linear or quadratic"
        )));
    }
    let settings = PathSettings::default();
    let mut draft = Draft::new(database, &args.draw, settings)?;
    draft.fps = checks::fps(args.course.fps)?;
    draft.frames = [0, OPEN_END];
    Ok(draft)
}

fn draft_of_path(args: &FlyArgs, database: Store) -> Result<Draft<'_>, Failure> {
    let path = PathFrames::load(&args.course, &database, exaggeration(args.draw.picture.exaggeration)?)?;
    let mut draft = Draft::new(database, &args.draw, path.settings)?;
    (draft.fps, draft.frames, draft.poses) = (path.fps, path.frames, path.poses);
    (draft.notes, draft.warnings) = (path.notes, path.warnings);
    Ok(draft)
}

/// Where the frames go.
fn choose_output(draft: &mut Draft<'_>, args: &FlyArgs) -> Result<(), Failure> {
    let (output, run) = (&args.output, draft.run.to_string());
    check_views(draft.rig.as_ref(), args)?;
    if is_folder_name(output) || !has_extension(output, &Container::EXTENSIONS) {
        film::refuse(&args.film, output)?;
    }
    if live::shared_name(output).is_some() || output == Path::new("/dev/null") {
        draft.sink = SinkConfig::Null;
    } else if output == Path::new("-") {
        stream_to_stdout(draft)?;
    } else if is_folder_name(output) {
        let folder = |path: &Path| FrameFolder::create(path, &run).map_err(Failure::bad_input);
        let sink = |folder: &FrameFolder| SinkConfig::PngFolder(folder.path().to_owned());
        match draft.rig.as_ref().filter(|rig| rig.pictures == Pictures::Separate) {
            Some(rig) => {
                draft.folders = rig.names().map(|name| folder(&view_folder(output, name))).collect::<Result<_, _>>()?;
                draft.sink = SinkConfig::EachView(draft.folders.iter().map(sink).collect());
            }
            None => {
                let folder = folder(output)?;
                draft.sink = sink(&folder);
                draft.folders.push(folder);
            }
        }
    } else if let Some(format) = film::format(output, &args.film)? {
        let file = TemporaryFile::create(output, &run).map_err(Failure::bad_input)?;
        let temporary = file.temporary().to_owned();
        draft.stream_into(StreamTarget::Film { path: output.clone(), temporary, format });
        draft.files.push(file);
    } else {
        return Err(no_output(output));
    }
    Ok(())
}

/// What takes one picture a frame cannot take views apart, and other programs know of one camera,
/// or of the two eyes of a stereo pair, whose pose is between them.
fn check_views(rig: Option<&RigFile>, args: &FlyArgs) -> Result<(), Failure> {
    let Some(rig) = rig else { return Ok(()) };
    let is_pair =
        args.draw.picture.stereo.stereo.is_some() && rig.pictures != Pictures::Separate && args.planes.ground.is_none();
    if !is_pair && (args.live.share.is_some() || live::shared_name(&args.output).is_some()) {
        return Err(Failure::bad_input(anyhow!(
            "{0} and shared frames: a shared frame has one camera; write the views into a folder or a film, or leave out {0}",
            rig.asked()
        )));
    }
    let is_whole = is_folder_name(&args.output) || args.output == Path::new("/dev/null");
    if rig.pictures == Pictures::Separate && !is_whole {
        return Err(Failure::bad_input(anyhow!(
            "-o {0}: {1} makes a picture of each view, and this takes one picture a frame; expected a folder, e.g. -o frames/, \
             or views side by side",
            args.output.display(),
            rig.asked()
        )));
    }
    Ok(())
}

fn stream_to_stdout(draft: &mut Draft<'_>) -> Result<(), Failure> {
    if std::io::stdout().is_terminal() {
        return Err(Failure::bad_input(anyhow!(
            "-o - writes a film to standard output, which is a terminal; send it to a program or a file, \
             e.g. terravision fly … -o - | ffmpeg -i - film.webm"
        )));
    }
    draft.stream_into(StreamTarget::Stdout);
    draft.destination = "standard output".into();
    if output::is_stdout_closed() {
        let warning = "-o -: standard output is closed or the null device, so the film is lost";
        draft.warnings.push(warning.to_owned());
    }
    Ok(())
}

/// What a film of odd sides becomes.
fn of_odd_sides(plan: &FlightPlan) -> Option<String> {
    let size = plan.config.output_size();
    let [width, height] = even(size);
    let is_padded = matches!(plan.stream, Some(StreamTarget::Film { .. })) && size != [width, height];
    is_padded.then(|| {
        format!(
            "a film has even sides: {}x{} becomes {width}x{height} by repeating the last column or row",
            size[0], size[1]
        )
    })
}

/// What can be written in place of what was asked for.
fn no_output(output: &Path) -> Failure {
    if has_extension(output, &PICTURES) {
        return Failure::bad_input(anyhow!(
            "-o {0} names one picture, and a flight has many frames: expected a folder for them, e.g. -o {1}/ (PNG files), or a \
             film (.{2}); terravision still makes one picture",
            output.display(),
            output.with_extension("").display(),
            Container::EXTENSIONS.join(", .")
        ));
    }
    Failure::bad_input(anyhow!(
        "-o {}: expected the name of a film (.{}), a folder that ends with a slash, - for standard output, or shared:NAME",
        output.display(),
        Container::EXTENSIONS.join(", .")
    ))
}
