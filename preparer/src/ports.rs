//! The preparer's ends of a run's segments, except for those of the loader.

use std::sync::Arc;
use terravision_common::shm::{Control, ElevationWriter, Producer, SegmentKind, ShmError, Stage, TreeReader};
use terravision_common::slot::Slot;
use terravision_common::stage::{Events, StageRun};

/// The preparer's ends of the segments, except for those of the loader.
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
