//! Realtime mode: which frame comes next, with which camera, and at which resolution.
//!
//! Frame k of a flight is due at `start + k / fps`. The generator begins it at that moment, with
//! the newest camera. While [`IN_FLIGHT`] frames are in the pipeline it waits for one of them to
//! finish, so that pictures never queue. If that took longer than a frame, the frames whose moments
//! have passed are skipped: the flight is never slowed down. The last frame is never skipped.

use crate::error::GeneratorError;
use terravision_common::camera::Camera;
use terravision_common::event::{Event, EventContent, monotonic_nanos};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::rate::{RateController, Resolutions};
use terravision_common::run::RunConfig;
use terravision_common::shm::Control;
use terravision_common::tree::TreeHeader;

/// Frames between the generator and the end of read-back: one is drawn while another is prepared.
const IN_FLIGHT: u64 = 2;
/// How long to wait for a camera after a frame's moment, as a share of the frame time; then the
/// newest one is used.
const CAMERA_PATIENCE: f64 = 0.25;

/// The frame to make.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Due {
    pub(crate) frame: FrameNumber,
    pub(crate) camera: Camera,
    pub(crate) resolutions: Resolutions,
}

/// The pace of a realtime flight; not used in exact mode.
#[derive(Debug)]
pub(crate) struct Pace {
    controller: Option<RateController>,
    /// The last frame that was begun.
    begun: Sequence,
    /// The last frame of which the time is known.
    measured: Sequence,
    last: Option<Camera>,
    generate_nanos: u64,
}

impl Pace {
    pub(crate) fn new(config: &RunConfig) -> Self {
        // Invalid settings are reported when the first frame is due.
        let controller = config.rate_settings().and_then(|settings| RateController::new(settings).ok());
        Self { controller, begun: Sequence::NONE, measured: Sequence::NONE, last: None, generate_nanos: 0 }
    }

    /// The last frame that generators before this one have begun.
    pub(crate) fn resume(&mut self, begun: Sequence) {
        self.begun = begun;
    }

    /// Takes the time that the generator needed for its newest frame.
    pub(crate) fn generated(&mut self, nanos: u64) {
        self.generate_nanos = nanos;
    }

    /// Waits until the next frame is due, which is `next` or a later one.
    pub(crate) fn next(
        &mut self,
        config: &RunConfig,
        next: FrameNumber,
        control: &Control,
    ) -> Result<Due, GeneratorError> {
        if let (Some(settings), None) = (config.rate_settings(), &self.controller) {
            self.controller = Some(RateController::new(settings)?);
        }
        let (frame, camera) = if self.begun == Sequence::NONE {
            (next, control.wait_camera(0, 0)?)
        } else {
            if self.begun.get() >= IN_FLIGHT {
                control.wait_completed(self.begun.next().saturating_sub(IN_FLIGHT))?;
            }
            let clock = Clock { start_nanos: control.wait_clock_start()?, period_nanos: config.period_nanos() };
            let due = clock.moment(next.get() - config.frames[0]);
            let camera = control.wait_camera(due, due + (CAMERA_PATIENCE * clock.period_nanos) as u64)?;
            let now = config.frames[0] + clock.frame_at(monotonic_nanos());
            let now = FrameNumber::new(now.min(config.frames[1].saturating_sub(1)));
            (now.max(next), camera)
        };
        self.begun = self.begun.next();
        self.measure(control);
        let is_moving = self.last.replace(camera).is_none_or(|last| !last.is_same_view(&camera));
        let wanted = Resolutions { r_z_px: config.r_z_px, r_c_px: config.r_c_px };
        let resolutions = self.controller.as_mut().map_or(wanted, |controller| controller.next(is_moving));
        control.set_resolutions(resolutions.r_z_px, resolutions.r_c_px);
        Ok(Due { frame, camera, resolutions })
    }

    /// Takes the time of the newest finished frame: that of the slowest stage, because the stages
    /// work in parallel.
    fn measure(&mut self, control: &Control) {
        let (Some(controller), Some(timing)) = (&mut self.controller, control.timing()) else { return };
        let sequence = Sequence::new(timing.sequence);
        if sequence > self.measured {
            self.measured = sequence;
            let work = timing.work_nanos.max(control.prepare_nanos()).max(self.generate_nanos);
            controller.measured(timing.r_z_px, work as f64);
        }
    }
}

/// The clock of a flight.
#[derive(Debug, Clone, Copy)]
struct Clock {
    start_nanos: u64,
    period_nanos: f64,
}

impl Clock {
    /// The moment of frame `index` of the flight, counted from 0.
    fn moment(&self, index: u64) -> u64 {
        self.start_nanos + (index as f64 * self.period_nanos).ceil() as u64
    }

    /// The newest frame whose moment has come.
    fn frame_at(&self, nanos: u64) -> u64 {
        (nanos.saturating_sub(self.start_nanos) as f64 / self.period_nanos).floor() as u64
    }
}

/// The event with a frame's camera and resolutions.
pub(crate) fn frame_camera(header: &TreeHeader) -> Event {
    let (r_z_px, r_c_px) = (header.r_z_px as f32, header.r_c_px as f32);
    let event = Event::new(EventContent::FrameCamera { r_z_px, r_c_px });
    event.of_frame(FrameNumber::new(header.frame)).at(header.camera.timestamp_nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_due_from_its_moment_to_the_next_ones() {
        for fps in [7.0, 29.97, 30.0, 1000.0] {
            let clock = Clock { start_nanos: 5_000_000_000, period_nanos: 1e9 / fps };
            for index in [0, 1, 2, 3, 999, 123_456] {
                let moment = clock.moment(index);
                assert_eq!(clock.frame_at(moment), index, "{fps}");
                assert!(index == 0 || clock.frame_at(moment - 2) == index - 1, "{fps}");
            }
            assert_eq!(clock.frame_at(0), 0);
        }
    }
}
