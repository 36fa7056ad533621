//! The prefetcher as a stage of a run.

use crate::executor::{ExecutorError, Workers};
use crate::light::Lighting;
use crate::ports::Ports;
use crate::prediction::Ahead;
use crate::scheduler::{CYCLE_NANOS, Scheduler};
use crate::source::PayloadSource;
use crate::store_usage::StoreUsage;
use std::sync::Arc;
use std::time::Duration;
use terravision_common::database::Layer;
use terravision_common::event::monotonic_nanos;
use terravision_common::node::NodeId;
use terravision_common::outcome::TileOutcome;
use terravision_common::run::RunConfig;
use terravision_common::shm::{Control, Producer, ShmError, Stage, WaitError, WantListReader};
use terravision_common::stage::{Events, StageError, StageRun};
use terravision_common::traversal::HeightRanges;
use terravision_common::world::World;
use terravision_store::{FailedTiles, Location, LocationError, Store, StoreError, StoreOptions};

/// Why the prefetcher gave up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PrefetcherError {
    /// The location of the database is not valid.
    #[error(transparent)]
    Location {
        /// Why.
        #[from]
        source: LocationError,
    },
    /// The database cannot be opened.
    #[error(transparent)]
    Database {
        /// Why.
        #[from]
        source: StoreError,
    },
    /// A segment cannot be opened, or has invalid content.
    #[error(transparent)]
    Shm {
        /// Why.
        #[from]
        source: ShmError,
    },
    /// The run ended.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
    /// The threads cannot be started.
    #[error(transparent)]
    Executor {
        /// Why.
        #[from]
        source: ExecutorError,
    },
    /// A decoding thread has died.
    #[error("a thread that decodes tiles has died; this is a bug in the decoder of a tile")]
    ThreadDied,
}

impl StageError for PrefetcherError {
    fn is_stopping(&self) -> bool {
        matches!(self, Self::Wait { source } if source.is_stopping())
    }
}

/// Serves the frames of a run with tiles from `source`, until the last one is prepared.
///
/// # Errors
/// [`PrefetcherError`].
pub fn serve<S: PayloadSource>(
    world: &World,
    ranges: impl HeightRanges + Clone + Send + Sync + 'static,
    config: &RunConfig,
    source: S,
    ports: Ports,
) -> Result<(), PrefetcherError> {
    let Ports { control, wants, outcomes, elevation, color, path, events } = ports;
    let lighting = config.light.map(|light| Lighting::new(world, &light, config.exaggeration));
    let (known, threads) = ((world, ranges.clone()), config.decoder_threads);
    let executor = Workers::new(source, known, config.texels, lighting, threads, wants.bell())?;
    let scheduler = Scheduler::new(world, elevation, color);
    scheduler.show(&control);
    tracing::debug!(prediction = config.prefetch.prediction.name(), threads = config.decoder_threads, "serves tiles");
    let ahead = Ahead::new(world, ranges, config, path);
    let cycle_end = monotonic_nanos() + CYCLE_NANOS;
    let usage = StoreUsage::default();
    let mut service = Service { control, wants, outcomes, events, executor, scheduler, ahead, usage, cycle_end };
    let served = service.run();
    service.usage.publish(service.executor.source(), &service.control, &mut service.events);
    served
}

/// State of a serving prefetcher.
struct Service<S, R> {
    control: Arc<Control>,
    wants: WantListReader,
    outcomes: Producer<TileOutcome>,
    events: Events,
    executor: Workers<S>,
    scheduler: Scheduler,
    ahead: Ahead<R>,
    usage: StoreUsage,
    /// Nanoseconds of the monotonic clock.
    cycle_end: u64,
}

impl<S: PayloadSource, R: HeightRanges> Service<S, R> {
    fn run(&mut self) -> Result<(), PrefetcherError> {
        let has_ended = self.executor.has_ended();
        let mut tiles = Vec::new();
        loop {
            let now = monotonic_nanos();
            if let Some(head) = self.wants.read(&mut tiles)? {
                if head.is_last {
                    return Ok(());
                }
                tracing::trace!(tiles = tiles.len(), "frame wants");
                self.scheduler.want(head, &tiles, now, &self.control, &mut self.executor);
            }
            self.ahead.see(&self.control, now);
            if now >= self.cycle_end {
                self.cycle_end = now + CYCLE_NANOS;
                self.end_cycle(now)?;
            }
            self.scheduler.step(now, &self.control, &mut self.executor);
            self.tell();
            self.control.awaits(self.scheduler.activity());
            let bound = Duration::from_nanos(self.cycle_end.saturating_sub(monotonic_nanos()));
            self.wants.wait(&self.control, bound, &has_ended)?;
        }
    }

    fn end_cycle(&mut self, now: u64) -> Result<(), PrefetcherError> {
        self.scheduler.end_cycle(&self.control);
        if let Some(tiles) = self.ahead.look(&self.scheduler, &self.control, now)? {
            tracing::trace!(tiles = tiles.len(), "predicted view wants");
            self.scheduler.expect(tiles.iter().copied(), &self.control, &mut self.executor);
        }
        self.usage.publish(self.executor.source(), &self.control, &mut self.events);
        self.control.heartbeat(Stage::Prefetcher);
        if self.executor.is_whole() { Ok(()) } else { Err(PrefetcherError::ThreadDied) }
    }

    /// Sends the scheduler's outcomes to the preparer, and its events to the launcher.
    fn tell(&mut self) {
        for outcome in self.scheduler.outcomes.drain(..) {
            // An outcome that finds the ring full is sent again for a later list.
            self.outcomes.try_push(outcome).ok();
        }
        if !self.scheduler.events.is_empty() {
            self.control.progress();
        }
        for event in self.scheduler.events.drain(..) {
            self.events.tell(&self.control, event.to_event());
        }
    }
}

/// The ranges of height of a shared database.
#[derive(Debug, Clone)]
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

/// Opens the database of the run. The launcher has already fetched and checked its index.
fn open_database(config: &RunConfig) -> Result<Store, PrefetcherError> {
    let location = Location::parse(&config.database.location)?;
    let options = StoreOptions {
        index: Some(config.world.clone()),
        is_hasty: true,
        failed_tiles: if config.prefetch.has_retries { FailedTiles::Rest } else { FailedTiles::Final },
        ..StoreOptions::of(&config.database)
    };
    Ok(Store::open(&location, &options)?)
}
