//! The renderer's ends of a run's segments.

use crate::source::{LiveSource, SourceError};
use std::sync::Arc;
use terravision_common::event::Event;
use terravision_common::shm::{Consumer, Control, ElevationReader, PoolReader, Producer, SegmentKind, Stage};
use terravision_common::slot::Slot;
use terravision_common::stage::StageRun;
use terravision_common::world::World;

/// The renderer's ends of the segments.
#[derive(Debug)]
pub struct Ports {
    /// The control block.
    pub control: Arc<Control>,
    /// The ring.
    pub ring: Consumer<Slot>,
    /// The elevation ring.
    pub elevation: ElevationReader,
    /// The colour pool.
    pub colors: PoolReader,
    /// The elevation pool, in runs that read heights out of it.
    pub elevation_pool: Option<PoolReader>,
    /// What the launcher is told.
    pub events: Producer<Event>,
}

impl Ports {
    /// Opens a run's segments.
    ///
    /// # Errors
    /// One is missing, or of another build.
    pub fn open(run: &StageRun) -> Result<Self, SourceError> {
        let control = Control::open(run.id())?;
        control.register(Stage::Renderer)?;
        let reads_pool = run.config().render.is_swept();
        let elevation_pool = reads_pool.then(|| PoolReader::open(run.id(), SegmentKind::ElevationPool)).transpose()?;
        Ok(Self {
            control: Arc::new(control),
            ring: Consumer::open(run.id(), SegmentKind::Ring)?,
            elevation: ElevationReader::open(run.id())?,
            colors: PoolReader::open(run.id(), SegmentKind::ColorPool)?,
            elevation_pool,
            events: Producer::open(run.id(), SegmentKind::EventsRenderer)?,
        })
    }

    /// The frames that come through them, of this world.
    ///
    /// # Errors
    /// They do not fit the world.
    pub fn into_source(self, run: &StageRun, world: World) -> Result<LiveSource, SourceError> {
        let Self { control, ring, elevation, colors, elevation_pool, events } = self;
        let config = run.config();
        let colors = (colors, config.texels);
        let source = LiveSource::new(control, ring, elevation, colors, Some(events), world, config.frames)?;
        let source = source.with_gaps(config.realtime.is_some());
        match elevation_pool {
            Some(pool) => source.with_elevation_pool(pool),
            None => Ok(source),
        }
    }
}
