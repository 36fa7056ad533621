//! The preparer as a stage of a run: for each frame, a tree in and tiles to draw out.

use crate::await_tiles::{AwaitError, TileWait};
use crate::detail_coverage::detail_coverage;
use crate::frame::{FrameCounts, FrameError, FrameMaker, FrameRequest};
use crate::frame_tree::FrameTree;
use crate::loader::TileLoader;
use crate::loader::wanted::WantedTiles;
use crate::ports::Ports;
use crate::resident_tiles::pin_resident;
use crate::rings::{Rings, SLOTS_AT_ONCE};
use crate::truncation::RootMissing;
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::database::{DatabaseError, read_world};
use terravision_common::event::{Event, EventContent, SpanName, monotonic_nanos};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::level::LevelFunction;
use terravision_common::rig::Views;
use terravision_common::run::{DatabaseConfig, RunConfig};
use terravision_common::shm::{Counter, ShmError, Stage, WaitError};
use terravision_common::slot::{Slot, SlotContent};
use terravision_common::stage::{StageError, StageRun};
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;

/// A real-time flight waits at least this long for the root of a database on a server.
const START_PATIENCE: Duration = Duration::from_secs(60);

/// Why the preparer gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PreparerError {
    /// The database cannot be opened.
    #[error(transparent)]
    Database {
        /// Why.
        #[from]
        source: DatabaseError,
    },
    /// A segment cannot be opened.
    #[error(transparent)]
    Shm {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The run ended while a tree was waited for.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
    /// Tiles cannot be read.
    #[error(transparent)]
    Await {
        /// Why.
        #[from]
        source: AwaitError,
    },
    /// A frame cannot be made.
    #[error("frame {frame} cannot be prepared: {source}")]
    Frame {
        /// The frame.
        frame: FrameNumber,
        /// Why.
        #[source]
        source: FrameError,
    },
    /// Nothing can be drawn.
    #[error("frame {frame} cannot be prepared: {source}{advice}")]
    RootMissing {
        /// The frame.
        frame: FrameNumber,
        /// The missing tile.
        #[source]
        source: RootMissing,
        /// What the user can do, after a semicolon; may be empty.
        advice: &'static str,
    },
    /// The generator wrote a header that does not fit the run.
    #[error("the header of the generator's tree for frame {frame} cannot be used: {what}")]
    BadHeader {
        /// The frame that was expected.
        frame: FrameNumber,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The elevation ring does not fit the world.
    #[error("the elevation ring has arrays of {found} numbers, expected {expected}")]
    WrongArrays {
        /// What the ring has.
        found: u64,
        /// What the world needs.
        expected: u64,
    },
}

impl StageError for PreparerError {
    fn is_stopping(&self) -> bool {
        let wait = match self {
            Self::Wait { source }
            | Self::Await { source: AwaitError::Wait { source } }
            | Self::Frame { source: FrameError::Wait { source }, .. } => source,
            _ => return false,
        };
        wait.is_stopping()
    }

    fn is_bad_input(&self) -> bool {
        let too_much = |error: &AwaitError| !matches!(error, AwaitError::Wait { .. });
        matches!(self, Self::Await { source } if too_much(source))
    }
}

/// Prepares frames in order. Once the buffers have grown to their sizes, a frame allocates nothing.
#[derive(Debug)]
pub struct Preparer<L> {
    world: World,
    config: RunConfig,
    loader: L,
    wait: TileWait,
    tree: FrameTree,
    maker: FrameMaker,
    slots: Vec<Slot>,
    next_frame: FrameNumber,
}

impl<L: TileLoader> Preparer<L> {
    /// A preparer of a run over a world. Waits for the top levels of the database.
    ///
    /// # Errors
    /// [`PreparerError`].
    pub fn new(world: &World, config: &RunConfig, loader: L, ports: &mut Ports) -> Result<Self, PreparerError> {
        let expected = world.elevation_values() as u64;
        let found = ports.elevation.array_len();
        if found < expected {
            return Err(PreparerError::WrongArrays { found, expected });
        }
        let nodes = ports.trees.capacity();
        // Frames that are swept have no arrays.
        let most_leaves = if config.render.is_swept() { nodes } else { ports.elevation.capacity() };
        let mut preparer = Self {
            world: *world,
            config: config.clone(),
            loader,
            wait: TileWait::new(world, config.texels, 2 * nodes as usize),
            tree: FrameTree::new(world, nodes, most_leaves),
            maker: FrameMaker::new(world, nodes).with_skirts(config.render.skirt_low_m),
            slots: Vec::with_capacity(SLOTS_AT_ONCE),
            // Frames may have been skipped, but none came twice.
            next_frame: FrameNumber::new(config.frames[0].saturating_add(ports.trees.returned())),
        };
        preparer.resume(ports)?;
        tracing::debug!(next_frame = preparer.next_frame.get(), "waits for the top levels");
        preparer.wait.settle_top_levels(&mut preparer.loader, &ports.control)?;
        if let Some(patience) = start_patience(config) {
            preparer.wait.insist_on_top_levels(&mut preparer.loader, patience, &ports.control)?;
        }
        // Also for frames that show only sky: where no height is known, the camera may be anywhere.
        if let Some(tile) = preparer.wait.missing_of_root(&mut preparer.loader, &ports.control) {
            let (frame, source) = (preparer.next_frame, RootMissing { tile });
            return Err(PreparerError::RootMissing { frame, source, advice: advice(config) });
        }
        Ok(preparer)
    }

    /// Continues after the frames that earlier preparers of the run have completed. A frame that
    /// was begun is made again: its tree was not given back.
    fn resume(&mut self, ports: &mut Ports) -> Result<(), ShmError> {
        match ports.ring.last().as_ref().and_then(Slot::read) {
            // Something that is not a frame of the run does not tell where to continue.
            Some(SlotContent::End(last)) => {
                let last = FrameNumber::new(last.frame);
                if self.config.frame_numbers().contains(&last) {
                    // Killed between the frame and giving back its tree?
                    ports.trees.return_tree_of(last)?;
                    self.next_frame = self.next_frame.max(last.next());
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Waits for the next tree, then for its tiles, and hands the frame over. Gives the tree back
    /// when the frame is in the ring.
    ///
    /// # Errors
    /// [`PreparerError`].
    pub fn frame(&mut self, ports: &mut Ports) -> Result<FrameCounts, PreparerError> {
        let Ports { control, trees, ring, elevation, events } = ports;
        let expected = self.next_frame;
        // Trees and frames are counted in the same way, so that the sequence of a frame is the same
        // in all stages.
        let sequence = Sequence::new(trees.returned() + 1);
        let half = trees.next(control)?;
        let header = *half.header();
        let frame = FrameNumber::new(header.frame);
        let (pose, views) = check_header(&header, expected, &self.config)?;
        let read = self.tree.read(half.nodes());
        read.map_err(|source| PreparerError::Frame { frame, source: source.into() })?;
        self.next_frame = frame.next();
        let started = monotonic_nanos();
        let wanted = self.tree.wanted();
        let is_realtime = self.config.realtime.is_some();
        let unavailable = if is_realtime {
            let missing = pin_resident(wanted, &mut self.loader, frame, sequence, control);
            missing?
        } else {
            self.wait.settle_frame(wanted, &mut self.loader, frame, sequence, control)?
        };
        let settled = events.span(control, SpanName::AwaitTiles, frame, started);
        let RunConfig { exaggeration, measure, .. } = self.config;
        let TreeHeader { r_z_px, r_c_px, .. } = header;
        let level = LevelFunction::for_views(&pose, &views, &self.world, exaggeration, measure, r_z_px, r_c_px);
        let request = FrameRequest { header: &header, pose: &pose, views: &views, level: &level };
        let maker = control.generation_of(Stage::Preparer);
        // Left by a frame that could not be made.
        self.slots.clear();
        let mut output = Rings { ring, elevation, control, slots: &mut self.slots, sequence, maker, waited_nanos: 0 };
        let (tree, loader) = (&self.tree, &self.loader);
        // A sweep reads heights out of the elevation pool.
        let made = if self.config.render.is_swept() {
            self.maker.make_in_place(&request, tree, loader, unavailable, &mut output)
        } else {
            self.maker.make(&request, tree, loader, unavailable, &mut output)
        };
        let waited_nanos = output.waited_nanos;
        let counts = made.map_err(|source| match source {
            FrameError::RootMissing { source } => {
                PreparerError::RootMissing { frame, source, advice: advice(&self.config) }
            }
            source => PreparerError::Frame { frame, source },
        })?;
        drop(half);
        // The renderer makes room in the rings.
        let finished = events.span(control, SpanName::Prepare, frame, settled + waited_nanos);
        control.set_prepare_nanos(finished.saturating_sub(started + waited_nanos));
        if is_realtime {
            let drawn = self.maker.truncation();
            let sharp_share =
                detail_coverage(&self.world, &views, exaggeration, &self.tree, drawn, &self.loader) as f32;
            let lacked = EventContent::FrameLacked { tiles: counts.unavailable, sharp_share };
            events.tell(control, Event::new(lacked).of_frame(frame).at(settled));
        }
        let wanted = EventContent::FrameWanted { tiles: counts.wanted, nodes: counts.nodes };
        events.tell(control, Event::new(wanted).of_frame(frame).at(settled));
        control.count(Counter::TilesWanted, counts.wanted.into());
        control.progress();
        control.heartbeat(Stage::Preparer);
        tracing::trace!(frame = frame.get(), ?counts, "frame is in the ring");
        Ok(counts)
    }

    /// Whether frames of the run are still to come.
    #[must_use]
    pub fn has_next(&self) -> bool {
        self.next_frame < self.config.frame_numbers().end
    }

    /// The loader.
    #[must_use]
    pub fn loader(&self) -> &L {
        &self.loader
    }
}

/// How long a real-time flight waits for the top levels at its start, although they could not be
/// read: a server may be down for longer than a single read may take. `None` in exact mode, where
/// the picture must not depend on when a tile arrives.
fn start_patience(config: &RunConfig) -> Option<Duration> {
    let DatabaseConfig { is_offline, request_timeout_ms, .. } = config.database;
    let may_come = config.realtime.is_some() && config.database.is_remote() && !is_offline;
    may_come.then(|| START_PATIENCE.max(Duration::from_millis(request_timeout_ms).saturating_mul(3)))
}

/// What the user can do when not even the root can be read.
fn advice(config: &RunConfig) -> &'static str {
    match (config.database.is_remote(), config.database.is_offline) {
        (true, true) => "; fly once without --offline, so that the cache has it",
        // The launcher reports what the server answered.
        (true, false) => "",
        (false, _) => "; ingest the world again",
    }
}

/// The camera of a tree, and the views that it carries. In realtime mode frames may be left out.
fn check_header(header: &TreeHeader, frame: FrameNumber, config: &RunConfig) -> Result<(Camera, Views), PreparerError> {
    let bad = |what| Err(PreparerError::BadHeader { frame, what });
    let is_resolution = |px: f64| px.is_finite() && px > 0.0;
    let found = FrameNumber::new(header.frame);
    let is_later = config.realtime.is_some() && (frame..config.frame_numbers().end).contains(&found);
    if found != frame && !is_later {
        return bad("it belongs to another frame");
    }
    let cameras = Camera::new(header.camera).and_then(|pose| Ok((pose, config.views(&pose)?)));
    let Ok(cameras) = cameras else { return bad("one of its cameras is not valid") };
    if !is_resolution(header.r_z_px) || !is_resolution(header.r_c_px) {
        return bad("its screen resolutions are not positive numbers");
    }
    Ok(cameras)
}

/// Prepares all frames of a run.
///
/// # Errors
/// [`PreparerError`].
pub fn run(run: &StageRun) -> Result<(), PreparerError> {
    let mut ports = Ports::open(run)?;
    let config = run.config();
    let world = read_world(&config.world)?;
    let loader = WantedTiles::open(run.id())?;
    let mut preparer = Preparer::new(&world, config, loader, &mut ports)?;
    let mut flown = Ok(());
    while flown.is_ok() && preparer.has_next() {
        flown = preparer.frame(&mut ports).map(drop);
    }
    if flown.is_ok() {
        ports.control.set_last_sequence(Sequence::new(ports.trees.returned()));
    }
    preparer.loader.close();
    flown
}
