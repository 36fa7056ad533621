//! The plan of `terravision view`: a flight against the clock whose frames go into a window, and
//! whose poses come from the person before it.

use super::checks::{self, exaggeration, in_range};
use super::course::PathFrames;
use super::draft::Draft;
use super::drawing::DrawingQuestion;
use super::{FlightPlan, light, live, shown_path, start, supervision};
use crate::cli::picture::Quality;
use crate::cli::realtime::{Mode, RealtimeArgs, Switch};
use crate::cli::stereo::StereoArg;
use crate::cli::values::PictureSize;
use crate::cli::view::ViewArgs;
use crate::failure::Failure;
use crate::input::CameraSource;
use crate::machine::outcome;
use crate::path::PathSettings;
use crate::process::own_folder;
use crate::rig_file::Pictures;
use crate::world::open_world;
use anyhow::anyhow;
use std::path::Path;
use std::process::{Command, Stdio};
use terravision_common::run::{OPEN_END, TechniqueChoice, WindowConfig};
use terravision_common::shm::SharedName;
use terravision_store::Store;

/// Size of a window for which nobody says one.
const FIRST_SIZE: PictureSize = PictureSize { width: 1280, height: 720 };
/// Largest picture: that of a larger window is stretched.
const LARGEST: PictureSize = PictureSize { width: 3840, height: 2160 };
/// Frames per second by a GPU, if nothing else is said.
const GPU_FPS: f64 = 60.0;

/// What the terminal says meanwhile.
const HANDS: &str = "drag holds the ground, right drag turns, the wheel zooms, W A S D and arrows fly; ? shows all keys in the title \
    bar, Ctrl+Q closes the window";

/// Against the clock, everything else as usual.
const REALTIME: RealtimeArgs = RealtimeArgs {
    mode: Mode::Realtime,
    feedback: None,
    coarsest_facet_px: None,
    coarsest_texel_px: None,
    rest_facet_px: None,
    rest_texel_px: None,
    prediction: None,
};

/// The plan of `terravision view`.
///
/// # Errors
/// Bad input, in one sentence: also where there is no display, or the build has no window.
pub fn view(mut args: ViewArgs) -> Result<FlightPlan, Failure> {
    check_window(&own_folder()?)?;
    let scale = in_range("--scale", args.scale, 0.1, 4.0, "a factor from 0.1 to 4")?;
    let size = args.draw.picture.size.unwrap_or(FIRST_SIZE);
    let has_rig = args.draw.picture.views.is_some() || args.draw.picture.stereo.stereo.is_some();
    // Cameras of a rig have one size, and are stretched together: two eyes halve the window.
    let of_rig = match args.draw.picture.stereo.stereo {
        Some(StereoArg::SideBySide) => PictureSize { width: size.width.div_ceil(2), ..size },
        _ => size,
    };
    args.draw.picture.size = Some(if has_rig { of_rig } else { LARGEST });
    let drawing = DrawingQuestion::new(&args.draw.picture, Quality::Default, args.draw.resources.validation)?;
    let database = open_world(&args.draw.world, &args.draw.database)?;
    super::body::check_hands("view", database.world())?;
    let (start, ahead_m) = start::start_pose(&args.draw.picture, &database)?;
    if args.path.is_none() {
        // The poses that will come are not known: pictures of two eyes meet on the ground at the
        // start, as far away as a path's first pose would have them.
        args.draw.picture.stereo.convergence.get_or_insert(ahead_m);
    }
    let args = &args;
    let path = args.path.as_ref().map(|path| {
        let exaggeration = exaggeration(args.draw.picture.exaggeration)?;
        PathFrames::to_play(path.clone(), args.speed, &database, exaggeration)
    });
    let path = path.transpose()?;
    let path_fps = path.as_ref().map(|path| path.fps);
    let world = *database.world();
    let mut draft = draft(args, database, path)?;
    let name = SharedName::parse(&format!("view-{}", std::process::id())).map_err(Failure::failed)?;
    draft.window = Some(WindowConfig {
        name: name.to_string(),
        title: title(&args.draw.world),
        start,
        size: [size.width, size.height],
        is_full_screen: args.full_screen,
        has_vsync: args.vsync == Switch::On,
        scale,
        has_sizes: !has_rig,
        path: None,
    });
    let mut plan = draft.finish(drawing, &args.measurements)?;
    if let (Some(fps), Some(window)) = (path_fps, &mut plan.config.render.window) {
        // The plan has lifted its cameras out of the ground. The window plays them, the flight does not.
        let (first, path, file) = shown_path::share(&std::mem::take(&mut plan.cameras), fps, &world)?;
        (window.start, window.path, plan.shown_path) = (first, Some(path), Some(file));
    }
    let is_open = args.draw.picture.technique.is_none();
    if args.fps.is_none() && is_open && plan.config.render.technique == TechniqueChoice::Mesh {
        plan.config.fps = GPU_FPS;
    }
    plan.live = Some(live::input(&CameraSource::Shared(name), &args.draw, None, &plan.config)?);
    plan.restarts = supervision::restarts(&args.supervision, &plan.config)?;
    Ok(plan)
}

/// The draft of a window, with the poses of its path.
fn draft(args: &ViewArgs, database: Store, path: Option<PathFrames>) -> Result<Draft<'_>, Failure> {
    let settings = path.as_ref().map_or_else(PathSettings::default, |path| path.settings);
    let mut draft = Draft::new(database, &args.draw, settings)?;
    if let Some(path) = path {
        (draft.poses, draft.notes, draft.warnings) = (path.poses, path.notes, path.warnings);
    }
    draft.fps = checks::fps(args.fps)?;
    draft.frames = [0, OPEN_END];
    draft.choose_rig()?;
    if draft.rig.as_ref().is_some_and(|rig| rig.pictures == Pictures::Separate) {
        return Err(Failure::bad_input(anyhow!(
            "a window shows one picture: expected views side by side, or --stereo side-by-side or anaglyph"
        )));
    }
    draft.labels = light::labels(&args.labels);
    draft.choose_vehicles(&args.vehicles)?;
    draft.notes.push(HANDS.to_owned());
    draft.realtime = Some(&REALTIME);
    draft.destination = "the window".into();
    Ok(draft)
}

/// What stands in the title bar: the world's name.
fn title(world: &Path) -> String {
    let name =
        world.file_stem().map_or_else(|| world.display().to_string(), |name| name.to_string_lossy().into_owned());
    format!("{name} · TerraVision")
}

/// Asks the renderer in this folder whether it can open a window.
fn check_window(programs: &Path) -> Result<(), Failure> {
    let program = programs.join("terravision-renderer");
    let mut command = Command::new(&program);
    let asked = command.arg("--window-check").stdin(Stdio::null()).output();
    let output = asked.map_err(|error| Failure::failed(anyhow!("cannot start {}: {error}", program.display())))?;
    outcome(&output).map(drop).map_err(|message| Failure::failed(anyhow!(message)))
}
