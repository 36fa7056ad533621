//! The preparer as a stage of a run: segments on both sides, frame after frame.

use crate::await_tiles::{AwaitError, TileWait};
use crate::frame::{FrameCounts, FrameError, FrameMaker, FrameOutput};
use crate::frame_tree::FrameTree;
use crate::heights::TileVanished;
use crate::loader::local::LocalLoader;
use crate::loader::{LoadError, Loaded, TileLoader};
use crate::there::ThereTiles;
use bytemuck::Zeroable;
use std::io::Write;
use std::sync::Arc;
use terravision_common::database::Layer;
use terravision_common::event::{Event, EventKind, SpanName, monotonic_nanos};
use terravision_common::level::LevelFunction;
use terravision_common::run::RunConfig;
use terravision_common::shm::{
    Control, Counter, ElevationWriter, PoolWriter, Producer, SegmentKind, ShmError, Stage, TreeReader, WaitError,
};
use terravision_common::slot::{Slot, SlotContent};
use terravision_common::stage::{Events, StageError, StageRun};
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;
use terravision_store::{Location, LocationError, Store, StoreError, StoreOptions};

/// Slots that are kept before they go into the ring together.
const SLOTS_AT_ONCE: usize = 1024;

/// Why the preparer gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PreparerError {
    /// The database is nowhere.
    #[error(transparent)]
    Location(#[from] LocationError),
    /// The database cannot be opened.
    #[error(transparent)]
    Database(#[from] StoreError),
    /// A segment cannot be opened.
    #[error(transparent)]
    Shm(#[from] ShmError),
    /// The run ended while a tree was waited for.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// Tiles cannot be had.
    #[error(transparent)]
    Await(#[from] AwaitError),
    /// The loader cannot be started.
    #[error(transparent)]
    Load(#[from] LoadError),
    /// A frame cannot be made.
    #[error("frame {frame} cannot be prepared: {source}")]
    Frame {
        /// The frame.
        frame: u64,
        /// Why.
        #[source]
        source: FrameError,
    },
    /// The generator wrote what cannot be.
    #[error("the tree of frame {frame} has a header that cannot be: {what}")]
    BadHeader {
        /// The frame that was expected.
        frame: u64,
        /// What is wrong with it.
        what: &'static str,
    },
    /// The elevation ring is not of this world.
    #[error("the elevation ring has arrays of {found} numbers, expected {expected}")]
    WrongArrays {
        /// What the ring has.
        found: u32,
        /// What the world needs.
        expected: u32,
    },
}

impl StageError for PreparerError {
    fn is_stopping(&self) -> bool {
        let wait = match self {
            Self::Wait(wait)
            | Self::Load(LoadError::Wait(wait))
            | Self::Await(AwaitError::Load(LoadError::Wait(wait)))
            | Self::Frame { source: FrameError::Wait(wait), .. } => wait,
            _ => return false,
        };
        wait.is_stopping()
    }

    fn is_bad_input(&self) -> bool {
        let too_much = |error: &AwaitError| !matches!(error, AwaitError::Load(_));
        matches!(self, Self::Await(error) if too_much(error))
    }
}

/// The preparer's ends of the segments, but for the pools, which are the loader's.
#[derive(Debug)]
pub struct Ports {
    /// The control block.
    pub control: Arc<Control>,
    /// The ping-pong buffer.
    pub trees: TreeReader,
    /// The ring.
    pub ring: Producer<Slot>,
    /// The elevation ring.
    pub elevation: ElevationWriter,
    /// What the launcher is told.
    pub events: Events,
}

impl Ports {
    /// Opens a run's segments.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &StageRun) -> Result<Self, ShmError> {
        let control = Control::open(run.id())?;
        control.register(Stage::Preparer)?;
        Ok(Self {
            control: Arc::new(control),
            trees: TreeReader::open(run.id())?,
            ring: Producer::open(run.id(), SegmentKind::Ring)?,
            elevation: ElevationWriter::open(run.id())?,
            events: Events::open(run.id(), Stage::Preparer)?,
        })
    }
}

/// Prepares frames in their order. Once the buffers have their sizes a frame allocates nothing.
#[derive(Debug)]
pub struct Preparer<L> {
    world: World,
    config: RunConfig,
    loader: L,
    wait: TileWait,
    tree: FrameTree,
    maker: FrameMaker,
    slots: Vec<Slot>,
    sequence: u64,
    next_frame: u64,
    there: ThereTiles,
}

impl<L: TileLoader> Preparer<L> {
    /// A preparer of a run over a world, with the top levels of the database loaded and locked.
    ///
    /// # Errors
    /// [`PreparerError`].
    pub fn new(world: &World, config: &RunConfig, loader: L, ports: &mut Ports) -> Result<Self, PreparerError> {
        let expected = world.elevation_posts() * world.elevation_posts();
        let found = ports.elevation.array_f32();
        if found < expected {
            return Err(PreparerError::WrongArrays { found, expected });
        }
        let nodes = ports.trees.capacity();
        let mut preparer = Self {
            world: *world,
            config: config.clone(),
            loader,
            wait: TileWait::new(world, 2 * nodes as usize),
            tree: FrameTree::new(world, nodes, ports.elevation.capacity()),
            maker: FrameMaker::new(world, nodes),
            slots: Vec::with_capacity(SLOTS_AT_ONCE),
            sequence: 0,
            next_frame: config.frames[0],
            there: ThereTiles::new(2 * nodes as usize),
        };
        let Ports { control, events, .. } = ports;
        let tell = |loaded: &Loaded| tell_loaded(control, events, loaded);
        preparer.wait.lock_top_levels(&mut preparer.loader, control, tell)?;
        Ok(preparer)
    }

    /// Waits for the next tree, then for its tiles, and hands the frame over.
    ///
    /// # Errors
    /// [`PreparerError`].
    pub fn frame(&mut self, ports: &mut Ports) -> Result<FrameCounts, PreparerError> {
        let Ports { control, trees, ring, elevation, events } = ports;
        let expected = self.next_frame;
        self.next_frame += 1;
        self.sequence += 1;
        let header = {
            let half = trees.next(control)?;
            let header = *half.header();
            check_header(&header, expected, &self.config)?;
            let read = self.tree.read(half.nodes());
            let frame = header.frame;
            read.map_err(|source| PreparerError::Frame { frame, source: source.into() })?;
            header
        };
        let frame = header.frame;
        self.next_frame = frame + 1;
        let started = monotonic_nanos();
        let (wanted, tell) = (self.tree.wanted(), |loaded: &Loaded| tell_loaded(control, events, loaded));
        let is_realtime = self.config.realtime.is_some();
        let unavailable = if is_realtime {
            self.there.look(wanted, &mut self.loader, frame, self.sequence, control, tell)
        } else {
            self.wait.settle_frame(wanted, &mut self.loader, frame, self.sequence, control, tell)?
        };
        let settled = events.span(control, SpanName::AwaitTiles, frame, started);
        let RunConfig { exaggeration, measure, .. } = self.config;
        let TreeHeader { camera, r_z_px, r_c_px, .. } = header;
        let level = LevelFunction::new(&camera, &self.world, exaggeration, measure, r_z_px, r_c_px);
        let mut output = Rings { ring, elevation, control, slots: &mut self.slots };
        let made = if is_realtime {
            let tiles = self.there.of(&self.loader);
            self.maker.make(&header, &level, &self.tree, &tiles, unavailable, &mut output)
        } else {
            self.maker.make(&header, &level, &self.tree, &self.loader, unavailable, &mut output)
        };
        let counts = made.map_err(|source| PreparerError::Frame { frame, source })?;
        let finished = events.span(control, SpanName::Prepare, frame, settled);
        control.set_prepare_nanos(finished.saturating_sub(started));
        if is_realtime {
            let kind = EventKind::FrameLacked as u32;
            let value = counts.unavailable.into();
            events.tell(control, Event { kind, frame, start_nanos: settled, value, ..Event::zeroed() });
        }
        events.tell(
            control,
            Event {
                kind: EventKind::FrameWanted as u32,
                frame,
                start_nanos: settled,
                value: u64::from(counts.wanted) | u64::from(counts.nodes) << 32,
                ..Event::zeroed()
            },
        );
        control.count(Counter::TilesWanted, counts.wanted.into());
        control.heartbeat(Stage::Preparer);
        Ok(counts)
    }

    /// Whether frames of the run are still to come.
    #[must_use]
    pub fn has_next(&self) -> bool {
        self.next_frame < self.config.frames[1]
    }

    /// The loader.
    #[must_use]
    pub fn loader(&self) -> &L {
        &self.loader
    }
}

/// In realtime mode frames may be left out.
fn check_header(header: &TreeHeader, frame: u64, config: &RunConfig) -> Result<(), PreparerError> {
    let bad = |what| Err(PreparerError::BadHeader { frame, what });
    let is_resolution = |px: f64| px.is_finite() && px > 0.0;
    let is_later = config.realtime.is_some() && (frame..config.frames[1]).contains(&header.frame);
    if header.frame != frame && !is_later {
        return bad("it is of another frame");
    }
    if !header.camera.is_valid() {
        return bad("its camera is none");
    }
    if !is_resolution(header.r_z_px) || !is_resolution(header.r_c_px) {
        return bad("its screen resolutions are no positive numbers");
    }
    Ok(())
}

fn tell_loaded(control: &Control, events: &mut Events, loaded: &Loaded) {
    let node = loaded.tile.node.pack();
    let span = Event {
        kind: EventKind::Span as u32,
        thread: loaded.thread,
        frame: loaded.frame,
        start_nanos: loaded.start_nanos,
        duration_nanos: loaded.duration_nanos,
        value: SpanName::LoadTile as u64,
        node,
    };
    events.tell(control, span);
    let Some(code) = loaded.code else {
        control.count(Counter::TilesLoaded, 1);
        return;
    };
    let layer = match loaded.tile.layer {
        Layer::Elevation => 0,
        Layer::Color => 1,
    };
    let kind = EventKind::TileUnavailable as u32;
    events.tell(control, Event { kind, value: layer + 256 * u64::from(code), duration_nanos: 0, thread: 0, ..span });
    control.count(Counter::TilesUnavailable, 1);
}

/// The rings as a frame's output.
struct Rings<'a> {
    ring: &'a mut Producer<Slot>,
    elevation: &'a mut ElevationWriter,
    control: &'a Control,
    slots: &'a mut Vec<Slot>,
}

impl FrameOutput for Rings<'_> {
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError> {
        let mut array = self.elevation.begin(self.control)?;
        fill(array.values_mut())?;
        Ok(array.publish())
    }

    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError> {
        if self.slots.len() == SLOTS_AT_ONCE {
            self.finish()?;
        }
        self.slots.push(Slot::new(slot));
        Ok(())
    }

    fn next_position(&self) -> u64 {
        self.elevation.next_position()
    }

    fn finish(&mut self) -> Result<(), FrameError> {
        self.ring.push_all(self.slots, self.control)?;
        self.slots.clear();
        Ok(())
    }
}

/// Prepares all frames of a run.
///
/// # Errors
/// [`PreparerError`].
pub fn run(run: &StageRun) -> Result<(), PreparerError> {
    let mut ports = Ports::open(run)?;
    let config = run.config();
    let elevation = PoolWriter::open(run.id(), SegmentKind::ElevationPool)?;
    let color = PoolWriter::open(run.id(), SegmentKind::ColorPool)?;
    let database = Arc::new(open_database(config)?);
    let world = *database.world();
    let loader = LocalLoader::new(Arc::clone(&database) as _, elevation, color, config.loader_threads)?;
    let mut preparer = Preparer::new(&world, config, loader, &mut ports)?;
    let mut flown = Ok(());
    while flown.is_ok() && preparer.has_next() {
        flown = preparer.frame(&mut ports).map(drop);
    }
    for news in database.errors().take_news() {
        // Standard error is the launcher's; without a launcher there is nobody to tell.
        drop(writeln!(std::io::stderr(), "{news}"));
    }
    flown
}

/// The run's database: its index is here already, and checked.
fn open_database(config: &RunConfig) -> Result<Store, PreparerError> {
    let location = Location::parse(&config.database.location)?;
    let options = StoreOptions { index: Some(config.world.clone()), ..StoreOptions::of(&config.database) };
    Ok(Store::open(&location, &options)?)
}
