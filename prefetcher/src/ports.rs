//! The prefetcher's ends of a run's segments.

use std::sync::Arc;
use terravision_common::outcome::TileOutcome;
use terravision_common::run::Prediction;
use terravision_common::shm::{
    CameraRecord, Consumer, Control, PoolWriter, Producer, SegmentKind, ShmError, Stage, WantListReader,
};
use terravision_common::stage::{Events, StageRun};

/// The prefetcher's ends of the segments.
#[derive(Debug)]
pub struct Ports {
    /// The control block.
    pub control: Arc<Control>,
    /// What frames want.
    pub wants: WantListReader,
    /// Outcomes of wanted tiles.
    pub outcomes: Producer<TileOutcome>,
    /// The elevation pool.
    pub elevation: PoolWriter,
    /// The colour pool.
    pub color: PoolWriter,
    /// The future cameras, if the launcher sends them.
    pub path: Option<Consumer<CameraRecord>>,
    /// Events for the launcher.
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
