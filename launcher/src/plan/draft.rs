//! A plan in the making: what both commands have in common.

use super::FlightPlan;
use super::body;
use super::checks::{DEFAULT_FPS, check_distance, decoder_threads, exaggeration, prefetch, realtime};
use super::course::georeference;
use super::drawing::DrawingQuestion;
use super::light::LightPlan;
use super::picture_choice::{self, PictureChoice};
use super::planes::PlaneFolders;
use super::stereo;
use super::supervision::RestartRules;
use crate::cli::draw::DrawArgs;
use crate::cli::measurements::MeasurementArgs;
use crate::cli::picture::{Edge, Overlay, Quality};
use crate::cli::realtime::RealtimeArgs;
use crate::cli::values::MemorySize;
use crate::cli::vehicles::VehicleArgs;
use crate::failure::Failure;
use crate::fleet::FleetPlan;
use crate::ground::{self, WorldGround};
use crate::machine::bytes_for_people;
use crate::measure::metrics::MetricsSocket;
use crate::output::{FrameFolder, TemporaryFile};
use crate::path::{Ground, PathSettings, Pose, Remarks};
use crate::rig_file::{Pictures, RigFile};
use crate::stream::StreamTarget;
use crate::world;
use anyhow::anyhow;
use glam::DVec3;
use std::path::Path;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::rig::RigView;
use terravision_common::run::{
    LabelsConfig, PlaneTarget, RenderConfig, RunConfig, ShareConfig, SinkConfig, WindowConfig,
};
use terravision_common::shm::{Layout, RunId, ShmError};
use terravision_common::world::World;
use terravision_store::Store;

/// Frames that are recorded or drawn at a time: the renderer, which knows the device, chooses.
const FRAMES_IN_FLIGHT: u32 = 0;

/// A plan in the making.
pub(super) struct Draft<'a> {
    pub(super) run: RunId,
    database: Store,
    settings: PathSettings,
    args: &'a DrawArgs,
    /// The cameras that the pose carries, as they were asked for.
    pub(super) rig: Option<RigFile>,
    pub(super) fps: f64,
    pub(super) frames: [u64; 2],
    pub(super) poses: Vec<Pose>,
    pub(super) notes: Vec<String>,
    pub(super) warnings: Vec<String>,
    pub(super) sink: SinkConfig,
    /// One for each view, or none.
    pub(super) depth: Vec<PlaneTarget>,
    pub(super) ground: Vec<PlaneTarget>,
    pub(super) share: Option<ShareConfig>,
    pub(super) window: Option<WindowConfig>,
    pub(super) labels: Option<LabelsConfig>,
    fleet: Option<FleetPlan>,
    pub(super) planes: PlaneFolders,
    pub(super) files: Vec<TemporaryFile>,
    /// The folder of pictures, or one for each view.
    pub(super) folders: Vec<FrameFolder>,
    stream: Option<StreamTarget>,
    pub(super) destination: String,
    pub(super) realtime: Option<&'a RealtimeArgs>,
    /// The preset if none is asked for.
    pub(super) usual_quality: Quality,
}

impl<'a> Draft<'a> {
    pub(super) fn new(database: Store, args: &'a DrawArgs, settings: PathSettings) -> Result<Self, Failure> {
        Ok(Self {
            run: RunId::new_for_this_process().map_err(Failure::failed)?,
            database,
            settings,
            args,
            rig: None,
            fps: DEFAULT_FPS,
            frames: [0, 1],
            poses: Vec::new(),
            notes: Vec::new(),
            warnings: Vec::new(),
            sink: SinkConfig::Null,
            depth: Vec::new(),
            ground: Vec::new(),
            share: None,
            window: None,
            labels: None,
            fleet: None,
            planes: PlaneFolders::default(),
            files: Vec::new(),
            folders: Vec::new(),
            stream: None,
            destination: String::new(),
            realtime: None,
            usual_quality: Quality::Default,
        })
    }

    /// Which cameras the poses carry.
    ///
    /// # Errors
    /// Bad input: a file of views, or a stereo pair, that cannot be drawn.
    pub(super) fn choose_rig(&mut self) -> Result<(), Failure> {
        self.rig = self.args.picture.views.as_deref().map(RigFile::read).transpose().map_err(Failure::bad_input)?;
        let exaggeration = exaggeration(self.args.picture.exaggeration)?;
        let ground = WorldGround::finest(&self.database, self.database.world(), exaggeration);
        let ground = ground.bounded(self.database.ranges());
        if let Some((rig, note)) = stereo::pair(&self.args.picture.stereo, self.poses.first(), &ground)? {
            self.rig = Some(rig);
            self.notes.push(note);
        }
        Ok(())
    }

    /// Which vehicles there are.
    ///
    /// # Errors
    /// Bad input: a file or a model that cannot be read.
    pub(super) fn choose_vehicles(&mut self, args: &VehicleArgs) -> Result<(), Failure> {
        let exaggeration = exaggeration(self.args.picture.exaggeration)?;
        let world = (self.args.world.as_path(), &self.args.database);
        let mut remarks = Remarks::default();
        self.fleet = FleetPlan::load(args, world, &georeference(&self.database), exaggeration, &mut remarks)?;
        self.notes.append(&mut remarks.notes);
        self.warnings.append(&mut remarks.warnings);
        Ok(())
    }

    pub(super) fn stream_into(&mut self, target: StreamTarget) {
        self.sink = SinkConfig::Stream(target.encoding());
        self.stream = Some(target);
    }

    /// The plan.
    ///
    /// # Errors
    /// Bad input: a number out of range, a path that does not go with the world, an output that
    /// cannot be written.
    pub(super) fn finish(
        mut self,
        drawing: DrawingQuestion,
        measurements: &MeasurementArgs,
    ) -> Result<FlightPlan, Failure> {
        let world = *self.database.world();
        let rig = self.rig.as_ref();
        let drawing = drawing.over(&world)?;
        body::check(self.args, &world)?;
        let mut choice =
            PictureChoice::new(&self.args.picture, rig, &self.settings, self.usual_quality, drawing, &world)?;
        self.warnings.extend(choice.warning.take());
        let exaggeration = exaggeration(self.args.picture.exaggeration)?;
        let layout = layout(&world, &choice, self.args.resources.memory)?;
        let cameras = self.cameras(&choice, exaggeration)?;
        self.warnings.extend(self.database.errors().take_news());
        let mut light = LightPlan::new(&self.args.picture.light, self.database.manifest())?;
        self.notes.append(&mut light.notes);
        let config = self.config(&choice, &light, exaggeration)?;
        let layout = match &config.render.sink {
            SinkConfig::Stream(encoding) => layout.for_stream(encoding.frame_bytes(config.output_size())),
            _ => layout,
        };
        let layout = layout.for_vehicles(self.fleet.as_ref().map_or(0, |plan| plan.fleet.len() as u32));
        let run = self.run.to_string();
        let temporary = |path: &Path| TemporaryFile::create(path, &run).map_err(Failure::bad_input);
        Ok(FlightPlan {
            data_sets: self.planes.into_data_sets(&config, &self.database),
            config,
            report: measurements.report.as_deref().map(temporary).transpose()?,
            trace: measurements.trace.as_deref().map(temporary).transpose()?,
            metrics: measurements.metrics.map(MetricsSocket::open).transpose()?,
            run: self.run,
            layout,
            cameras,
            live: None,
            fleet: self.fleet,
            files: self.files,
            folders: self.folders,
            stream: self.stream,
            notes: self.notes,
            warnings: self.warnings,
            is_quiet: self.args.resources.quiet,
            database: self.database,
            destination: self.destination,
            shown_path: None,
            restarts: RestartRules::NONE,
        })
    }

    /// The cameras of all poses, none of them in the ground.
    fn cameras(&mut self, choice: &PictureChoice, exaggeration: f64) -> Result<Vec<Camera>, Failure> {
        let world = self.database.world();
        let ground = WorldGround::finest(&self.database, world, exaggeration).bounded(self.database.ranges());
        if !self.poses.is_empty() {
            check_distance(&self.poses, &ground.extent(), &mut self.warnings)?;
        }
        let mut lifted = 0;
        let mut cameras = Vec::with_capacity(self.poses.len());
        for (frame, mut pose) in (self.frames[0]..).zip(std::mem::take(&mut self.poses)) {
            lifted += usize::from(ground::lift(&mut pose, &ground));
            let camera = Camera::new(CameraFields {
                eye_in_world: world.surface().named(world.crs_frame().position(pose.position)).to_array(),
                heading_rad: pose.heading_rad,
                pitch_rad: pose.pitch_rad,
                roll_rad: pose.roll_rad,
                vfov_rad: choice.vfov_rad,
                width: choice.size.width,
                height: choice.size.height,
                timestamp_nanos: 0,
            });
            let Ok(camera) = camera else {
                let position = pose.position;
                return Err(Failure::bad_input(anyhow!(
                    "frame {frame} has no valid camera: expected a position within 10^12 m of the world's origin and finite \
                     angles, found {position} and heading {}, pitch {}, roll {} rad",
                    pose.heading_rad,
                    pose.pitch_rad,
                    pose.roll_rad
                )));
            };
            cameras.push(camera);
        }
        self.warnings.extend(views_in_the_ground(choice, &cameras, &ground, world));
        if lifted > 0 {
            self.warnings.push(format!(
                "{lifted} of {} frames were lifted: their poses were less than {} m above the ground",
                cameras.len(),
                ground::CLEARANCE_M
            ));
        }
        Ok(cameras)
    }

    /// What the stages are told.
    fn config(&mut self, choice: &PictureChoice, light: &LightPlan, exaggeration: f64) -> Result<RunConfig, Failure> {
        let index = self.database.index().path();
        let ([r_z_px, r_c_px], [width, height]) = (choice.wanted_px, choice.picture_size());
        Ok(RunConfig {
            run_id: self.run.to_string(),
            // The stages run in this folder too, but an absolute name reads better in messages.
            world: std::path::absolute(index).unwrap_or_else(|_| index.to_owned()),
            database: world::config(self.database.location(), &self.args.database),
            width,
            height,
            fps: self.fps,
            frames: self.frames,
            r_z_px,
            r_c_px,
            measure: self.args.picture.measure.into(),
            exaggeration,
            texels: choice.texels,
            decoder_threads: decoder_threads(self.args.resources.threads)?,
            prefetch: prefetch(self.realtime),
            realtime: self.realtime.map_or(Ok(None), |args| realtime(args, choice.wanted_px, choice.rest_facet_px))?,
            light: light.light,
            render: self.render_config(choice, light, exaggeration),
            rig: choice.rig.clone(),
        })
    }

    fn render_config(&mut self, choice: &PictureChoice, light: &LightPlan, exaggeration: f64) -> RenderConfig {
        let (picture, database) = (&self.args.picture, &self.database);
        let low = database.ranges().range(database.world().root()).map(|[low, _]| exaggeration * f64::from(low));
        RenderConfig {
            technique: choice.decision.technique,
            technique_reason: choice.decision.reason.to_owned(),
            rays: choice.decision.rays,
            sky_rgb: picture_choice::sky(picture, &self.settings, database),
            skirt_low_m: low.filter(|_| picture.edge == Edge::Skirt),
            air: light.air,
            samples: choice.samples,
            has_tree_overlay: picture.overlay == Some(Overlay::Tree),
            has_validation: self.args.resources.validation,
            frames_in_flight: FRAMES_IN_FLIGHT,
            sink: std::mem::replace(&mut self.sink, SinkConfig::Null),
            depth: std::mem::take(&mut self.depth),
            ground: std::mem::take(&mut self.ground),
            share: self.share.take(),
            window: self.window.take(),
            labels: self.labels.take(),
            vehicles: self.fleet.as_ref().map(|plan| plan.fleet.config()),
            made_up: picture.made_up.into(),
            anaglyph: self.rig.as_ref().is_some_and(|rig| rig.pictures == Pictures::Anaglyph),
        }
    }
}

/// A pose is lifted out of the ground; a camera that it carries stays where it is on its rig, which
/// is worth a warning.
fn views_in_the_ground(choice: &PictureChoice, cameras: &[Camera], ground: &impl Ground, world: &World) -> Vec<String> {
    let is_below = |eye: DVec3| {
        let DVec3 { x, y, z } = world.crs_frame().place(eye);
        // The ground may be in a database far away, as for poses.
        let may_be = ground.bound_m(x, y).is_none_or(|bound| z < bound);
        may_be && ground.height_m(x, y).is_some_and(|height| z < height)
    };
    let of_view = |view: &RigView| {
        let below = cameras.iter().filter(|pose| view.camera(pose).is_ok_and(|camera| is_below(camera.eye()))).count();
        (below > 0).then(|| format!("view {} is below ground in {below} of {} frames", view.name, cameras.len()))
    };
    choice.rig.iter().flat_map(|rig| rig.views()).filter_map(of_view).collect()
}

/// The run's shared memory.
fn layout(world: &World, choice: &PictureChoice, memory: MemorySize) -> Result<Layout, Failure> {
    let layout = Layout::for_run(world, memory.0, choice.texels);
    let layout = layout.map(|layout| layout.for_picture(world, choice.pixels(), choice.wanted_px[0]));
    let layout = layout.map(|layout| if choice.decision.is_swept() { layout.without_arrays() } else { layout });
    layout.map_err(|error| match error {
        ShmError::MemoryTooSmall { needed, .. } => Failure::bad_input(anyhow!(
            "--memory {}: the tile pools of this world need at least {}",
            bytes_for_people(memory.0),
            bytes_for_people(needed)
        )),
        other => Failure::failed(other),
    })
}
