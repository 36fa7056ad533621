//! What is to be flown: the validated plan that is made of the command line, the path file and the world. Nothing in it
//! is left to interpret.

mod checks;
mod compression;
mod course;
mod film;
mod live;
mod planes;
mod pose;

pub use checks::{FAR_FROM_WORLD, frame_range, pace, vfov_of_path};
pub use course::{LoadedPath, georeference, load_path};

use crate::cli::database::DatabaseArgs;
use crate::cli::supervision::SupervisionArgs;
use crate::cli::values::{PictureSize, Rgb};
use crate::cli::{
    Edge, FlyArgs, MeasurementArgs, Mode, Overlay, PictureArgs, PredictionChoice, Quality, RealtimeArgs, ResourceArgs,
    StillArgs,
};
use crate::data_set::DataSet;
use crate::failure::Failure;
use crate::flight::restart::RestartRules;
use crate::ground::{self, WorldGround};
use crate::input::LiveCamera;
use crate::machine::bytes_for_people;
use crate::metrics::MetricsSocket;
use crate::output::{self, FrameFolder, TemporaryFile};
use crate::path::{self, Pose};
use crate::stream::StreamTarget;
use crate::stream::film::Container;
use crate::world::{self, open_world};
use anyhow::anyhow;
use checks::{
    DEFAULT_FPS, check_distance, decoder_threads, exaggeration, has_extension, in_range, is_folder_name, prefetch,
    realtime,
};
use compression::TexelQuestion;
use planes::PlaneFolders;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use terravision_common::camera::Camera;
use terravision_common::film::even;
use terravision_common::run::{
    OPEN_END, PlaneTarget, RaysChoice, RenderConfig, RunConfig, ShareConfig, SinkConfig, TechniqueChoice,
};
use terravision_common::shm::{Layout, RunId, ShmError};
use terravision_store::Store;

/// Names of pictures end with one of these.
const PICTURES: [&str; 7] = ["png", "jpg", "jpeg", "tif", "tiff", "webp", "bmp"];
/// Size of a picture for which neither the command line nor the path says one.
pub const DEFAULT_SIZE: PictureSize = PictureSize { width: 1280, height: 720 };
const DEFAULT_SKY: [u8; 3] = [150, 190, 235];

/// The sky that a body has unless the user says: dust on Mars, haze on Venus and Titan, none where there is no air.
fn sky_of(body: &str) -> [u8; 3] {
    match body {
        "Mars" => [210, 170, 125],
        "Venus" => [215, 180, 110],
        "Titan" => [190, 140, 60],
        "Moon" | "Mercury" | "Ceres" | "Vesta" => [0, 0, 0],
        _ => DEFAULT_SKY,
    }
}
/// Frames that are recorded or drawn at a time: the renderer, which knows the device, chooses.
const FRAMES_IN_FLIGHT: u32 = 0;

/// A run of the pipeline, ready to start.
#[derive(Debug)]
pub struct FlightPlan {
    /// The run's name.
    pub run: RunId,
    /// What the stages are told.
    pub config: RunConfig,
    /// The run's shared memory.
    pub layout: Layout,
    /// The camera of each frame, from the first; none when another program sends them.
    pub cameras: Vec<Camera>,
    /// Where poses come from in place of `cameras`.
    pub live: Option<LiveCamera>,
    /// Files that get their final names at the end.
    pub files: Vec<TemporaryFile>,
    /// Depth and ground of every frame, if they go into files. Before the folder of frames, in which its folders may be.
    pub data_set: Option<DataSet>,
    /// The folder of frames, if that is where they go.
    pub folder: Option<FrameFolder>,
    /// The stream, if that is where frames go.
    pub stream: Option<StreamTarget>,
    /// The report, if one is wanted.
    pub report: Option<TemporaryFile>,
    /// The trace, if one is wanted.
    pub trace: Option<TemporaryFile>,
    /// Where figures are served while the run goes on, if they are wanted.
    pub metrics: Option<MetricsSocket>,
    /// What is good to know of the flight, a sentence each.
    pub notes: Vec<String>,
    /// What is done differently than asked, a sentence each.
    pub warnings: Vec<String>,
    /// Whether several samples a pixel, if it has them, were asked for: what draws may not have them.
    pub asks_for_samples: bool,
    /// Whether the run says nothing but warnings and errors.
    pub is_quiet: bool,
    /// The world. The stages use its index as long as it is open.
    pub database: Store,
    /// Where the pictures go, for people.
    pub destination: String,
    /// Which deaths of stages the run survives.
    pub restarts: RestartRules,
}

/// The plan of `terravision fly`.
///
/// # Errors
/// Bad input, in one sentence.
pub fn fly(args: &FlyArgs) -> Result<FlightPlan, Failure> {
    let texels = TexelQuestion::new(&args.picture, Quality::Default)?;
    let database = open_world(&args.world, &args.database)?;
    let exaggeration = exaggeration(args.picture.exaggeration)?;
    if args.live.camera.is_some() && args.realtime.prediction == Some(PredictionChoice::Oracle) {
        return Err(Failure::bad_input(anyhow!(
            "--prediction oracle and --camera: an oracle knows the path, and nobody knows that of another program; \
             expected off, linear or quadratic"
        )));
    }
    let mut draft = if args.live.camera.is_some() {
        let mut draft =
            Draft::new(database, &args.database, &args.picture, &args.resources, path::PathSettings::default())?;
        draft.fps = checks::fps(args.course.fps)?;
        draft.frames = [0, OPEN_END];
        draft
    } else {
        let LoadedPath { path, notes, warnings } = load_path(&args.course, &database, exaggeration)?;
        let (fps, speed) = pace(&args.course, &path)?;
        let frames = frame_range(args.course.frames, &path.course, fps, speed)?;
        let poses: Option<Vec<Pose>> =
            (frames[0]..frames[1]).map(|frame| path.course.pose(frame, fps, speed)).collect();
        let poses = poses.ok_or_else(|| Failure::bad_input(anyhow!("the path ends before frame {}", frames[1])))?;
        let mut draft = Draft::new(database, &args.database, &args.picture, &args.resources, path.settings)?;
        draft.fps = fps;
        draft.frames = frames;
        draft.poses = poses;
        (draft.notes, draft.warnings) = (notes, warnings);
        draft
    };

    let run = draft.run.to_string();
    draft.share = live::share(args)?;
    draft.realtime = Some(&args.realtime);
    let is_film = !is_folder_name(&args.output) && has_extension(&args.output, &Container::EXTENSIONS);
    if !is_film {
        film::refuse(&args.film, &args.output)?;
    }
    if live::shared_name(&args.output).is_some() || args.output == Path::new("/dev/null") {
        draft.sink = SinkConfig::Null;
    } else if args.output == Path::new("-") {
        if std::io::stdout().is_terminal() {
            return Err(Failure::bad_input(anyhow!(
                "-o - writes a film to standard output, which is a terminal; send it to a program or a file, \
                 e.g. terravision fly … -o - | ffmpeg -i - film.webm"
            )));
        }
        draft.stream_into(StreamTarget::Stdout);
        if output::is_stdout_closed() {
            draft
                .warnings
                .push("-o -: standard output is closed, or the null device; the film goes nowhere".to_owned());
        }
        draft.destination = "standard output".into();
    } else if is_folder_name(&args.output) {
        let folder = FrameFolder::create(&args.output, &run).map_err(Failure::bad_input)?;
        draft.sink = SinkConfig::PngFolder(folder.path().to_owned());
        draft.folder = Some(folder);
    } else if let Some(format) = film::format(&args.output, &args.film)? {
        let file = TemporaryFile::create(&args.output, &run).map_err(Failure::bad_input)?;
        let temporary = file.temporary().to_owned();
        draft.stream_into(StreamTarget::Film { path: args.output.clone(), temporary, format });
        draft.files.push(file);
    } else {
        return Err(no_output(&args.output));
    }
    draft.planes = PlaneFolders::create(args, &run)?;
    [draft.depth, draft.ground] = draft.planes.targets();
    if draft.destination.is_empty() {
        draft.destination = args.output.display().to_string();
    }
    let mut plan = draft.finish(texels, &args.measurements)?;
    plan.live = live::camera(args, &plan.config)?;
    plan.restarts = checks::restarts(&args.supervision, &plan.config)?;
    plan.notes.extend(of_odd_sides(&plan));
    Ok(plan)
}

/// What a film of odd sides becomes.
fn of_odd_sides(plan: &FlightPlan) -> Option<String> {
    let size = [plan.config.width, plan.config.height];
    let [width, height] = even(size);
    let is_padded = matches!(plan.stream, Some(StreamTarget::Film { .. })) && size != [width, height];
    is_padded.then(|| {
        format!(
            "a film has even sides: {}x{} becomes {width}x{height}, its last column or row is repeated",
            size[0], size[1]
        )
    })
}

/// What can be written in place of what was asked for.
fn no_output(output: &Path) -> Failure {
    if has_extension(output, &PICTURES) {
        return Failure::bad_input(anyhow!(
            "-o {0}: a flight has many frames; expected a folder for them, e.g. -o {1}/ (PNG files), or a film (.{2}); \
             terravision still makes one picture",
            output.display(),
            output.with_extension("").display(),
            Container::EXTENSIONS.join(", .")
        ));
    }
    Failure::bad_input(anyhow!(
        "-o {}: expected a film (.{}), a folder that ends with a slash, - for standard output, or shared:NAME",
        output.display(),
        Container::EXTENSIONS.join(", .")
    ))
}

/// The plan of `terravision still`.
///
/// # Errors
/// Bad input, in one sentence.
pub fn still(args: &StillArgs) -> Result<FlightPlan, Failure> {
    let texels = TexelQuestion::new(&args.picture, Quality::Finest)?;
    let database = open_world(&args.world, &args.database)?;
    let exaggeration = exaggeration(args.picture.exaggeration)?;
    let (pose, warnings) = course::pose(&args.pose, args.agl, &database, exaggeration)?;
    let mut draft =
        Draft::new(database, &args.database, &args.picture, &args.resources, path::PathSettings::default())?;
    draft.poses = vec![pose];
    draft.warnings = warnings;
    draft.usual_quality = Quality::Finest;
    let run = draft.run.to_string();
    let is_device = args.output.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir());
    if !is_device && (is_folder_name(&args.output) || !has_extension(&args.output, &["png"])) {
        let is_other = !is_folder_name(&args.output) && has_extension(&args.output, &PICTURES);
        let advice = if is_other {
            "; JPEG and the like are made of it by other programs, e.g. ffmpeg -i a.png a.jpg"
        } else {
            ""
        };
        return Err(Failure::bad_input(anyhow!(
            "-o {}: expected a PNG file, e.g. a.png{advice}",
            args.output.display()
        )));
    }
    for (flag, path, values) in
        [("--depth", &args.depth, "depths are float32"), ("--ground", &args.ground, "positions are float64")]
    {
        if let Some(path) = path
            && !path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir())
            && (is_folder_name(path) || !has_extension(path, &["tif", "tiff"]))
        {
            return Err(Failure::bad_input(anyhow!(
                "{flag} {}: expected a TIFF file, e.g. {}.tif: {values}, which other kinds of pictures do not hold",
                path.display(),
                flag.trim_start_matches('-')
            )));
        }
    }
    let mut named: Vec<PathBuf> = Vec::new();
    let mut temporary = |path: &Path| -> Result<PathBuf, Failure> {
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        if named.contains(&absolute) && !is_device {
            return Err(Failure::bad_input(anyhow!(
                "{} is asked for twice: every output needs its own file",
                path.display()
            )));
        }
        named.push(absolute);
        let file = TemporaryFile::create(path, &run).map_err(Failure::bad_input)?;
        let name = file.temporary().to_owned();
        draft.files.push(file);
        Ok(name)
    };
    let picture = temporary(&args.output)?;
    let depth = args.depth.as_deref().map(&mut temporary).transpose()?;
    let ground = args.ground.as_deref().map(&mut temporary).transpose()?;
    draft.sink = SinkConfig::PngFile(picture);
    draft.depth = depth.map(PlaneTarget::File);
    draft.ground = ground.map(PlaneTarget::File);
    draft.destination = args.output.display().to_string();
    let mut plan = draft.finish(texels, &args.measurements)?;
    plan.restarts = checks::restarts(&SupervisionArgs::default(), &plan.config)?;
    Ok(plan)
}

/// A plan in the making.
struct Draft<'a> {
    run: RunId,
    database: Store,
    access: &'a DatabaseArgs,
    settings: path::PathSettings,
    picture: &'a PictureArgs,
    resources: &'a ResourceArgs,
    fps: f64,
    frames: [u64; 2],
    poses: Vec<Pose>,
    notes: Vec<String>,
    warnings: Vec<String>,
    sink: SinkConfig,
    depth: Option<PlaneTarget>,
    ground: Option<PlaneTarget>,
    share: Option<ShareConfig>,
    planes: PlaneFolders,
    files: Vec<TemporaryFile>,
    folder: Option<FrameFolder>,
    stream: Option<StreamTarget>,
    destination: String,
    realtime: Option<&'a RealtimeArgs>,
    /// The preset if none is asked for.
    usual_quality: Quality,
}

impl<'a> Draft<'a> {
    fn new(
        database: Store,
        access: &'a DatabaseArgs,
        picture: &'a PictureArgs,
        resources: &'a ResourceArgs,
        settings: path::PathSettings,
    ) -> Result<Self, Failure> {
        Ok(Self {
            run: RunId::new_for_this_process().map_err(Failure::failed)?,
            database,
            access,
            settings,
            picture,
            resources,
            fps: DEFAULT_FPS,
            frames: [0, 1],
            poses: Vec::new(),
            notes: Vec::new(),
            warnings: Vec::new(),
            sink: SinkConfig::Null,
            depth: None,
            ground: None,
            share: None,
            planes: PlaneFolders::default(),
            files: Vec::new(),
            folder: None,
            stream: None,
            destination: String::new(),
            realtime: None,
            usual_quality: Quality::Default,
        })
    }

    fn stream_into(&mut self, target: StreamTarget) {
        self.sink = SinkConfig::Stream(target.encoding());
        self.stream = Some(target);
    }

    fn finish(self, texels: TexelQuestion, measurements: &MeasurementArgs) -> Result<FlightPlan, Failure> {
        let Self { database, access, picture, resources, settings, .. } = self;
        let world = &database.world().clone();
        let size = picture.size.unwrap_or(PictureSize {
            width: settings.width.unwrap_or(DEFAULT_SIZE.width),
            height: settings.height.unwrap_or(DEFAULT_SIZE.height),
        });
        let of_path = settings.vfov_of(size.width, size.height);
        let vfov_rad = checks::vfov_rad(picture, of_path, size)?;
        let is_realtime = self.realtime.is_some_and(|args| args.mode != Mode::Exact);
        let (asked, rays) = checks::technique(picture, is_realtime)?;
        let (texels, technique) = texels.decide(asked)?;
        let (facet_px, samples) = match picture.quality.unwrap_or(self.usual_quality) {
            // What rays through voxels cost grows with pixels: facets of half the area make up for what sampling loses.
            Quality::Default if technique == TechniqueChoice::Rays && rays == RaysChoice::Coherent => (7.0, 1),
            Quality::Default => (10.0, 1),
            Quality::Best => (3.0, 4),
            Quality::Finest => (Layout::finest_facet_px(world, u64::from(size.width) * u64::from(size.height)), 4),
        };
        let r_z_px =
            in_range("--facet-px", picture.facet_px.unwrap_or(facet_px), 0.5, 1e4, "pixels from 0.5 to 10000")?;
        let r_c_px = in_range("--texel-px", picture.texel_px.unwrap_or(1.0), 0.25, 1e4, "pixels from 0.25 to 10000")?;
        let realtime = self.realtime.and_then(|args| realtime(args, [r_z_px, r_c_px]).transpose()).transpose()?;
        let samples = if asked == TechniqueChoice::Rays { 1 } else { samples };
        let exaggeration = exaggeration(picture.exaggeration)?;
        let decoder_threads = decoder_threads(resources.threads)?;
        let layout = Layout::for_run(world, resources.memory.0, texels);
        let layout =
            layout.map(|layout| layout.for_picture(world, u64::from(size.width) * u64::from(size.height), r_z_px));
        let layout = layout.map_err(|error| match error {
            ShmError::MemoryTooSmall { needed, .. } => Failure::bad_input(anyhow!(
                "--memory {}: the tile pools of this world need at least {}",
                bytes_for_people(resources.memory.0),
                bytes_for_people(needed)
            )),
            other => Failure::failed(other),
        })?;

        let ground = WorldGround::finest(&database, world, exaggeration).bounded(database.ranges());
        let mut warnings = self.warnings;
        if !self.poses.is_empty() {
            check_distance(&self.poses, &ground.extent(), &mut warnings)?;
        }
        let origin = glam::DVec2::from_array(world.fields().origin);
        let mut lifted = 0;
        let mut cameras = Vec::with_capacity(self.poses.len());
        for (i, mut pose) in self.poses.into_iter().enumerate() {
            lifted += usize::from(ground::lift(&mut pose, &ground));
            let camera = Camera {
                eye_in_world: (pose.position - origin.extend(0.0)).to_array(),
                heading_rad: pose.heading_rad,
                pitch_rad: pose.pitch_rad,
                roll_rad: pose.roll_rad,
                vfov_rad,
                width: size.width,
                height: size.height,
                timestamp_nanos: 0,
            };
            if !camera.is_valid() {
                let frame = self.frames[0] + i as u64;
                return Err(Failure::bad_input(anyhow!("frame {frame}: the pose is out of all bounds: {pose:?}")));
            }
            cameras.push(camera);
        }
        if lifted > 0 {
            warnings.push(format!(
                "{lifted} of {} frames were below ground + {} m and were lifted",
                cameras.len(),
                ground::CLEARANCE_M
            ));
        }
        warnings.extend(database.errors().take_news());
        let index = database.index().path();
        let run = self.run.to_string();
        let temporary = |path: &Path| TemporaryFile::create(path, &run).map_err(Failure::bad_input);
        let config = RunConfig {
            run_id: run.clone(),
            // The stages run in this folder too, but an absolute name reads better in messages.
            world: std::path::absolute(index).unwrap_or_else(|_| index.to_owned()),
            database: world::config(database.location(), access),
            width: size.width,
            height: size.height,
            fps: self.fps,
            frames: self.frames,
            r_z_px,
            r_c_px,
            measure: picture.measure.into(),
            exaggeration,
            texels,
            decoder_threads,
            prefetch: prefetch(self.realtime),
            render: RenderConfig {
                technique,
                rays,
                sky_rgb: picture
                    .sky
                    .map(|Rgb(rgb)| rgb)
                    .or(settings.sky_rgb)
                    .unwrap_or_else(|| sky_of(&database.manifest().body.name)),
                skirt_low_m: (picture.edge == Edge::Skirt)
                    .then(|| database.ranges().range(world.root()).map(|[low, _]| exaggeration * f64::from(low)))
                    .flatten(),
                samples: picture.samples.unwrap_or(samples),
                has_tree_overlay: picture.overlay == Some(Overlay::Tree),
                has_validation: resources.validation,
                frames_in_flight: FRAMES_IN_FLIGHT,
                sink: self.sink,
                depth: self.depth.into_iter().collect(),
                ground: self.ground.into_iter().collect(),
                share: self.share,
                made_up: picture.made_up.into(),
            },
            realtime,
            rig: None,
        };
        Ok(FlightPlan {
            data_set: self.planes.into_data_set(&config, &database),
            config,
            report: measurements.report.as_deref().map(temporary).transpose()?,
            trace: measurements.trace.as_deref().map(temporary).transpose()?,
            metrics: measurements.metrics.map(MetricsSocket::open).transpose()?,
            run: self.run,
            layout,
            cameras,
            live: None,
            files: self.files,
            folder: self.folder,
            stream: self.stream,
            notes: self.notes,
            warnings,
            is_quiet: resources.quiet,
            asks_for_samples: picture.samples.is_some() || picture.quality.is_some(),
            database,
            destination: self.destination,
            restarts: RestartRules::NONE,
        })
    }
}
