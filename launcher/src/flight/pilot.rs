//! The pilot: pushes the camera of every frame, in order, to the generator.

use crate::plan::FlightPlan;
use std::thread::JoinHandle;
use terravision_common::shm::{CameraRecord, Control, Producer, SegmentKind, ShmError};

/// The thread that flies.
#[derive(Debug)]
pub struct Pilot {
    thread: JoinHandle<()>,
}

impl Pilot {
    /// Opens the camera ring and flies. The cameras move out of the plan's place in memory as copies.
    ///
    /// # Errors
    /// [`ShmError`] when the ring or the control block does not open.
    pub fn start(plan: &FlightPlan) -> Result<Self, ShmError> {
        let control = Control::open(&plan.run)?;
        let mut ring: Producer<CameraRecord> = Producer::open(&plan.run, SegmentKind::CameraRing)?;
        let cameras = plan.cameras.clone();
        let first = plan.config.frames[0];
        let thread = std::thread::spawn(move || {
            for (frame, camera) in (first..).zip(cameras) {
                control.publish_camera(&camera);
                if ring.push(&CameraRecord { frame, camera }, &control).is_err() {
                    // The run has ended, or the generator is gone; the supervisor knows which.
                    return;
                }
            }
        });
        Ok(Self { thread })
    }

    /// Waits for its end, which comes with the last camera or the end of the run.
    pub fn join(self) {
        // It has nothing that can panic, and nothing to say.
        drop(self.thread.join());
    }
}
