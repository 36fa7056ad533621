//! The generator's ends of a run's segments.

use std::sync::Arc;
use terravision_common::shm::{CameraRecord, Consumer, Control, SegmentKind, ShmError, Stage, TreeWriter};
use terravision_common::stage::{Events, StageRun};

/// The generator's ends of the segments.
#[derive(Debug)]
pub struct Ports {
    /// The control block.
    pub control: Arc<Control>,
    /// Cameras, one per frame, in order.
    pub cameras: Consumer<CameraRecord>,
    /// The ping-pong buffer.
    pub trees: TreeWriter,
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
        control.register(Stage::Generator)?;
        Ok(Self {
            control: Arc::new(control),
            cameras: Consumer::open(run.id(), SegmentKind::CameraRing)?,
            trees: TreeWriter::open(run.id())?,
            events: Events::open(run.id(), Stage::Generator)?,
        })
    }
}
