//! The prefetcher as a stage of a run.

use crate::accounts::Accounts;
use crate::crew::{CrewError, Workers};
use crate::desk::{CYCLE_NANOS, Desk, News};
use crate::lookahead::{Lookahead, Resolution};
use crate::oracle::Oracle;
use crate::source::PayloadSource;
use crate::track::{CameraTrack, widened_views};
use bytemuck::Zeroable;
use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::database::{Layer, Tile};
use terravision_common::event::{Event, EventKind, SpanName, monotonic_nanos};
use terravision_common::node::NodeId;
use terravision_common::outcome::{TileOutcome, layer_number};
use terravision_common::rig::Views;
use terravision_common::run::{Prediction, RunConfig};
use terravision_common::shm::{
    CameraRecord, Consumer, Control, Gauge, PoolWriter, Producer, SegmentKind, ShmError, Stage, WaitError,
    WantListReader,
};
use terravision_common::stage::{Events, StageError, StageRun};
use terravision_common::traversal::{HeightRanges, TreeLimits};
use terravision_common::world::World;
use terravision_store::{Location, LocationError, Store, StoreError, StoreOptions};

/// Requests are shown on tracks of their own in a trace, from this number on.
const FIRST_LANE: u32 = 1000;
/// Tracks that requests are spread over.
const LANES: u64 = 64;
/// Trees of predicted views: what the generator's may have.
const LIMITS: TreeLimits = TreeLimits { nodes: 65536, elevation_leaves: 65536 };
/// The view is predicted this far ahead at least, and at most.
const AHEAD_SECS: [f64; 2] = [0.4, 4.0];

/// Why the prefetcher gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PrefetcherError {
    /// The database is nowhere.
    #[error(transparent)]
    Location(#[from] LocationError),
    /// The database cannot be opened.
    #[error(transparent)]
    Database(#[from] StoreError),
    /// A segment cannot be opened, or what is in it cannot be.
    #[error(transparent)]
    Shm(#[from] ShmError),
    /// The run ended.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The threads cannot be started.
    #[error(transparent)]
    Crew(#[from] CrewError),
    /// A thread has died.
    #[error("a thread that decodes tiles has died; this is a bug in the decoder of a tile")]
    ThreadDied,
}

impl StageError for PrefetcherError {
    fn is_stopping(&self) -> bool {
        matches!(self, Self::Wait(wait) if wait.is_stopping())
    }
}

/// The prefetcher's ends of the segments.
#[derive(Debug)]
pub struct Ports {
    /// The control block.
    pub control: Arc<Control>,
    /// What frames want.
    pub wants: WantListReader,
    /// What becomes of it.
    pub outcomes: Producer<TileOutcome>,
    /// The elevation pool.
    pub elevation: PoolWriter,
    /// The colour pool.
    pub color: PoolWriter,
    /// The cameras to come, where they are told.
    pub path: Option<Consumer<CameraRecord>>,
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
        control.register(Stage::Prefetcher)?;
        let is_told = run.config().prefetch.prediction == Prediction::Oracle;
        Ok(Self {
            control: Arc::new(control),
            wants: WantListReader::open(run.id())?,
            outcomes: Producer::open(run.id(), SegmentKind::TileOutcomes)?,
            elevation: PoolWriter::open(run.id(), SegmentKind::ElevationPool)?,
            color: PoolWriter::open(run.id(), SegmentKind::ColorPool)?,
            path: is_told.then(|| Consumer::open(run.id(), SegmentKind::PathRing)).transpose()?,
            events: Events::open(run.id(), Stage::Prefetcher)?,
        })
    }
}

/// Serves the frames of a run until the last is prepared, with tiles from `source`.
///
/// # Errors
/// [`PrefetcherError`].
pub fn serve<S: PayloadSource>(
    world: &World,
    ranges: impl HeightRanges,
    config: &RunConfig,
    source: S,
    ports: Ports,
) -> Result<(), PrefetcherError> {
    let Ports { control, mut wants, mut outcomes, elevation, color, path, mut events } = ports;
    let mut crew = Workers::new(source, world, config.texels, config.decoder_threads, wants.bell())?;
    let has_ended = crew.has_ended();
    let mut desk = Desk::new(world, elevation, color, config.prefetch.has_retries);
    let mut ahead = Ahead::new(world, ranges, config, path);
    desk.show(&control);
    let mut accounts = Accounts::default();
    let mut tiles = Vec::new();
    let mut cycle_end = monotonic_nanos() + CYCLE_NANOS;
    let mut serve_one = |events: &mut Events, accounts: &mut Accounts, crew: &mut Workers<S>| {
        let now = monotonic_nanos();
        if let Some(head) = wants.read(&mut tiles)? {
            if head.is_last {
                return Ok(false);
            }
            desk.want(head, &tiles, now, &control, crew);
        }
        ahead.see(&control, now);
        if now >= cycle_end {
            cycle_end = now + CYCLE_NANOS;
            desk.end_cycle(now, &control, crew);
            if let Some(tiles) = ahead.look(&desk, &control, now)? {
                desk.expect(tiles.iter().copied(), now, &control, crew);
            }
            accounts.publish(crew.source(), &control, events);
            control.heartbeat(Stage::Prefetcher);
            if !crew.is_whole() {
                return Err(PrefetcherError::ThreadDied);
            }
        }
        desk.step(now, &control, crew);
        for outcome in desk.outcomes.drain(..) {
            // One that finds the ring full is told again for a later list.
            outcomes.try_push(outcome).ok();
        }
        if !desk.news.is_empty() {
            control.progress();
        }
        for news in desk.news.drain(..) {
            tell(&control, events, news);
        }
        control.awaits(desk.activity());
        let bound = Duration::from_nanos(cycle_end.saturating_sub(monotonic_nanos()));
        wants.wait(&control, bound, &has_ended)?;
        Ok(true)
    };
    let served = loop {
        match serve_one(&mut events, &mut accounts, &mut crew) {
            Ok(true) => {}
            Ok(false) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    accounts.publish(crew.source(), &control, &mut events);
    served
}

/// The view that is going to be, and what it wants.
struct Ahead<R> {
    prediction: Prediction,
    config: RunConfig,
    track: CameraTrack,
    oracle: Option<Oracle>,
    lookahead: Option<Lookahead<R>>,
    tiles: Vec<Tile>,
}

impl<R: HeightRanges> Ahead<R> {
    fn new(world: &World, ranges: R, config: &RunConfig, path: Option<Consumer<CameraRecord>>) -> Self {
        let prediction = config.prefetch.prediction;
        let lookahead = (prediction != Prediction::Off).then(|| Lookahead::new(world, ranges, LIMITS));
        let track = CameraTrack::default();
        let oracle = path.map(Oracle::new);
        Self { prediction, config: config.clone(), track, oracle, lookahead, tiles: Vec::new() }
    }

    fn see(&mut self, control: &Control, now: u64) {
        if let (Some(_), Some(camera)) = (&self.lookahead, control.camera()) {
            self.track.see(&camera, now);
        }
    }

    fn look(&mut self, desk: &Desk, control: &Control, now: u64) -> Result<Option<&[Tile]>, ShmError> {
        let Some(lookahead) = &mut self.lookahead else { return Ok(None) };
        let ahead_secs = ahead_secs(desk.latency_nanos());
        let ahead_nanos = (ahead_secs * 1e9) as u64;
        control.set_gauge(Gauge::PredictedAheadNanos, ahead_nanos);
        let cameras: Vec<Camera> = match &mut self.oracle {
            // Before the clock has started the camera waits for the first frame.
            Some(oracle) => oracle.cameras(now.saturating_sub(control.clock_start().unwrap_or(now)), ahead_nanos)?,
            None => self.track.predict(now, ahead_secs, self.prediction).into_iter().collect(),
        };
        if cameras.is_empty() {
            return Ok(None);
        }
        let resolution = Resolution {
            r_z_px: control.r_z_px().unwrap_or(self.config.r_z_px),
            r_c_px: control.r_c_px().unwrap_or(self.config.r_c_px),
            exaggeration: self.config.exaggeration,
            measure: self.config.measure,
        };
        self.tiles.clear();
        let mut seen = HashSet::new();
        // A path is known, and so are its views; a prediction may be wrong.
        let unsure_secs = if self.oracle.is_some() { 0.0 } else { ahead_secs };
        for camera in &cameras {
            let views = match &self.config.rig {
                Some(rig) => widened_views(&rig.views(camera), unsure_secs),
                None => Views::single(camera),
            };
            let of_view = lookahead.tiles(camera, &views, &resolution).iter().copied();
            self.tiles.extend(of_view.filter(|tile| cameras.len() == 1 || seen.insert(*tile)));
        }
        Ok(Some(&self.tiles))
    }
}

/// How far ahead the view is predicted when a tile takes so long: until a tile that is asked for at the end of the next
/// cycle is there.
#[must_use]
pub fn ahead_secs(latency_nanos: Option<u64>) -> f64 {
    let latency = latency_nanos.unwrap_or(0) as f64 / 1e9;
    (2.0 * latency + CYCLE_NANOS as f64 / 1e9).clamp(AHEAD_SECS[0], AHEAD_SECS[1])
}

fn tell(control: &Control, events: &mut Events, news: News) {
    let span = |tile: Tile, frame, thread, start_nanos, duration_nanos, name: SpanName| {
        let (kind, node) = (EventKind::Span as u32, tile.node.pack());
        Event { kind, thread, frame, start_nanos, duration_nanos, value: name as u64, node }
    };
    let event = match news {
        News::Fetched { tile, frame, start_nanos, duration_nanos } => {
            let lane = FIRST_LANE + (start_nanos / 1000 % LANES) as u32;
            span(tile, frame, lane, start_nanos, duration_nanos, SpanName::FetchTile)
        }
        News::Decoded { tile, frame, thread, start_nanos, duration_nanos } => {
            span(tile, frame, thread, start_nanos, duration_nanos, SpanName::LoadTile)
        }
        News::Unavailable { tile, frame, code, at_nanos } => Event {
            kind: EventKind::TileUnavailable as u32,
            frame,
            start_nanos: at_nanos,
            value: layer_number(tile.layer) + 256 * u64::from(code),
            node: tile.node.pack(),
            ..Event::zeroed()
        },
        News::Came { tile, at_nanos } => Event {
            kind: EventKind::TileCame as u32,
            start_nanos: at_nanos,
            value: layer_number(tile.layer),
            node: tile.node.pack(),
            ..Event::zeroed()
        },
    };
    events.tell(control, event);
}

/// Ranges of height of a database that others read, too.
#[derive(Debug)]
struct SharedRanges(Arc<Store>);

impl HeightRanges for SharedRanges {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        self.0.ranges().range(node)
    }

    fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        self.0.ranges().has_children(layer, node)
    }
}

/// Serves a run.
///
/// # Errors
/// [`PrefetcherError`].
pub fn run(run: &StageRun) -> Result<(), PrefetcherError> {
    let ports = Ports::open(run)?;
    let config = run.config();
    let store = Arc::new(open_database(config)?);
    let world = *store.world();
    serve(&world, SharedRanges(Arc::clone(&store)), config, store, ports)
}

/// The run's database: its index is here already, and checked.
fn open_database(config: &RunConfig) -> Result<Store, PrefetcherError> {
    let location = Location::parse(&config.database.location)?;
    let options = StoreOptions { index: Some(config.world.clone()), ..StoreOptions::of(&config.database) };
    Ok(Store::open(&location, &options)?)
}
