//! The generator as a stage of a run: for each frame, a camera in and a tree out.

use crate::error::GeneratorError;
use crate::ports::Ports;
use crate::realtime::{self, Pace};
use bytemuck::Zeroable;
use terravision_common::camera::Camera;
use terravision_common::database::Index;
use terravision_common::event::{SpanName, monotonic_nanos};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::level::LevelFunction;
use terravision_common::run::RunConfig;
use terravision_common::shm::{CameraRecord, Layout, ShmError, Stage, WaitError};
use terravision_common::stage::StageRun;
use terravision_common::traversal::{HeightRanges, Traversal, TreeLimits, TreeStats};
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;

/// Searches the trees of frames; allocates nothing after construction.
#[derive(Debug)]
pub struct Generator<R> {
    world: World,
    ranges: R,
    traversal: Traversal,
    config: RunConfig,
    next_frame: FrameNumber,
    pace: Pace,
}

impl<R: HeightRanges> Generator<R> {
    /// A generator for a run over a world whose nodes have these ranges of height.
    #[must_use]
    pub fn new(world: &World, ranges: R, config: &RunConfig, limits: TreeLimits) -> Self {
        Self {
            world: *world,
            ranges,
            traversal: Traversal::new(world, limits),
            config: config.clone(),
            next_frame: config.frame_numbers().start,
            pace: Pace::new(config),
        }
    }

    /// Continues after the trees that earlier generators of the run have published.
    ///
    /// # Errors
    /// The ring of cameras is corrupt.
    pub fn resume(&mut self, Ports { cameras, trees, .. }: &mut Ports) -> Result<(), ShmError> {
        let Some(last) = trees.last_header() else { return Ok(()) };
        // It is impossible to continue after something that is not a frame of the run.
        let last_frame = FrameNumber::new(last.frame);
        if self.config.frame_numbers().contains(&last_frame) {
            self.next_frame = last_frame.next();
        }
        self.pace.resume(Sequence::new(trees.published()));
        // Killed between the tree and giving back its camera?
        if cameras.try_take()?.is_some_and(|record| record.frame == last.frame) {
            cameras.give_back(cameras.position());
        } else {
            cameras.put_back();
        }
        Ok(())
    }

    /// Whether frames of the run are still to come.
    #[must_use]
    pub fn has_next(&self) -> bool {
        self.next_frame < self.config.frame_numbers().end
    }

    /// Waits for the next camera (in realtime mode, for the moment of the next frame), searches its
    /// tree, and hands it over.
    ///
    /// # Errors
    /// [`GeneratorError`].
    pub fn frame(&mut self, ports: &mut Ports) -> Result<TreeStats, GeneratorError> {
        let Ports { control, cameras, trees, events } = ports;
        let RunConfig { exaggeration, measure, mut r_z_px, mut r_c_px, .. } = self.config;
        let (frame, camera) = if self.config.realtime.is_some() {
            let due = self.pace.next(&self.config, self.next_frame, control)?;
            (r_z_px, r_c_px) = (due.resolutions.r_z_px, due.resolutions.r_c_px);
            (due.frame, due.camera)
        } else {
            // The camera stays in its ring until the tree is published.
            let CameraRecord { frame, camera } = cameras.take(control)?;
            let frame = FrameNumber::new(frame);
            if frame != self.next_frame {
                return Err(GeneratorError::WrongFrame { found: frame, expected: self.next_frame });
            }
            (frame, Camera::new(camera).map_err(|source| GeneratorError::BadCamera { frame, source })?)
        };
        let views = self.config.views(&camera).map_err(|source| GeneratorError::BadCamera { frame, source })?;
        self.next_frame = frame.next();
        let mut half = trees.begin(control)?;
        let started_nanos = monotonic_nanos();
        let level = LevelFunction::for_views(&camera, &views, &self.world, exaggeration, measure, r_z_px, r_c_px);
        let stats = self.traversal.build(&views, &level, &self.ranges, half.nodes_mut());
        let header = TreeHeader {
            frame: frame.get(),
            camera: *camera.fields(),
            r_z_px,
            r_c_px,
            node_count: stats.node_count,
            is_cut_short: stats.is_cut_short.into(),
            started_nanos,
            finished_nanos: monotonic_nanos(),
            ..TreeHeader::zeroed()
        };
        half.publish(&header).map_err(WaitError::from)?;
        cameras.give_back(cameras.position());
        control.progress();
        let finished_nanos = events.span(control, SpanName::Generate, frame, started_nanos);
        if self.config.realtime.is_some() {
            self.pace.generated(finished_nanos - started_nanos);
            events.tell(control, realtime::frame_camera(&header));
        }
        control.heartbeat(Stage::Generator);
        tracing::trace!(frame = frame.get(), nodes = stats.node_count, r_z_px, r_c_px, "tree");
        Ok(stats)
    }
}

/// Generates all frames of a run.
///
/// # Errors
/// [`GeneratorError`].
pub fn run(run: &StageRun) -> Result<(), GeneratorError> {
    let mut ports = Ports::open(run)?;
    let config = run.config();
    let index = Index::open(&config.world)?;
    let world = index.world();
    // Memory bounds the pools, not the elevation ring.
    let layout = Layout::for_run(world, u64::MAX >> 8, config.texels)?;
    let layout = layout.for_picture(world, config.pixels(), config.r_z_px);
    let limits = TreeLimits { nodes: ports.trees.capacity(), elevation_leaves: layout.elevation_arrays() };
    let mut generator = Generator::new(world, index.ranges(), config, limits);
    generator.resume(&mut ports)?;
    tracing::debug!(next_frame = generator.next_frame.get(), nodes = limits.nodes, "generates trees");
    while generator.has_next() {
        generator.frame(&mut ports)?;
    }
    Ok(())
}
