//! The pilot: flies the camera. In exact mode it pushes the camera of every frame, in order, to the generator; in realtime
//! mode it publishes where the camera is now, several times a frame, whether anybody looks or not.

use crate::plan::FlightPlan;
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::event::monotonic_nanos;
use terravision_common::shm::{CameraRecord, Control, Producer, SegmentKind, ShmError};

/// Cameras that are published per frame in realtime mode: a frame that begins late has a camera that is this much of a
/// frame old at most.
const CAMERAS_PER_FRAME: u64 = 4;
/// Fewer when frames are so short that this many nanoseconds would pass between two.
const LEAST_STEP_NANOS: f64 = 2e6;
/// How often the pilot looks whether the first frame is there, or the run over.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Longest sleep before it looks whether the run goes on.
const LONGEST_SLEEP: Duration = Duration::from_millis(100);
/// A step this many times as long as those before and after is a cut of the path.
const CUT: f64 = 8.0;

/// The thread that flies.
#[derive(Debug)]
pub struct Pilot {
    thread: JoinHandle<()>,
}

impl Pilot {
    /// Opens what it needs and flies. The cameras move out of the plan's place in memory as copies.
    ///
    /// # Errors
    /// [`ShmError`] when the ring or the control block does not open.
    pub fn start(plan: &FlightPlan) -> Result<Self, ShmError> {
        let control = Control::open(&plan.run)?;
        let mut ring: Producer<CameraRecord> = Producer::open(&plan.run, SegmentKind::CameraRing)?;
        let cameras = plan.cameras.clone();
        let first = plan.config.frames[0];
        let period_nanos = plan.config.realtime.as_ref().map(|_| plan.config.period_nanos());
        let thread = std::thread::spawn(move || match period_nanos {
            Some(period_nanos) => fly_by_the_clock(&cameras, period_nanos, &control),
            None => {
                for (frame, camera) in (first..).zip(cameras) {
                    control.publish_camera(&camera);
                    if ring.push(&CameraRecord { frame, camera }, &control).is_err() {
                        // The run has ended, or the generator is gone; the supervisor knows which.
                        return;
                    }
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

/// Publishes the camera of now. The clock starts when the first frame is drawn, so that the start of the stages is no part
/// of the flight.
fn fly_by_the_clock(cameras: &[Camera], period_nanos: f64, control: &Control) {
    let Some(first) = cameras.first() else { return };
    control.publish_camera(&Camera { timestamp_nanos: monotonic_nanos(), ..*first });
    while control.completed_sequence() == 0 {
        if control.check_running().is_err() {
            return;
        }
        std::thread::sleep(LOOK_EVERY);
    }
    let start = monotonic_nanos();
    control.start_clock(start);
    let steps = CAMERAS_PER_FRAME.min((period_nanos / LEAST_STEP_NANOS) as u64).max(1);
    let last = (cameras.len() as u64 - 1) * steps;
    let step_nanos = period_nanos / steps as f64;
    let mut step = 0;
    while step < last {
        // Steps that were slept through are left out.
        let passed = ((monotonic_nanos() - start) as f64 / step_nanos).floor() as u64;
        step = passed.max(step + 1).min(last);
        let moment = start + (step as f64 * step_nanos).ceil() as u64;
        if !sleep_until(moment, control) {
            return;
        }
        let (frame, part) = (step / steps, step % steps);
        let camera = camera_at(cameras, frame as usize, part as f64 / steps as f64);
        control.publish_camera(&Camera { timestamp_nanos: moment, ..camera });
    }
}

/// Sleeps; `false` when the run ended.
fn sleep_until(moment: u64, control: &Control) -> bool {
    loop {
        if control.check_running().is_err() {
            return false;
        }
        let rest = Duration::from_nanos(moment.saturating_sub(monotonic_nanos()));
        if rest.is_zero() {
            return true;
        }
        std::thread::sleep(rest.min(LONGEST_SLEEP));
    }
}

/// The camera a part of the way from a frame's to the next one's. At a cut it stays until the next frame.
fn camera_at(cameras: &[Camera], frame: usize, part: f64) -> Camera {
    let at = |index: usize| cameras[index.min(cameras.len() - 1)];
    let (from, to) = (at(frame), at(frame + 1));
    let step = |a: Camera, b: Camera| a.eye().distance(b.eye());
    let around = step(at(frame.saturating_sub(1)), from).max(step(to, at(frame + 2)));
    if step(from, to) > CUT * around + 1.0 && cameras.len() > 3 { from } else { from.toward(&to, part) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(x: f64) -> Camera {
        Camera {
            eye_in_world: [x, 0.0, 100.0],
            heading_rad: 0.01 * x,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 64,
            height: 36,
            timestamp_nanos: 0,
        }
    }

    #[test]
    fn between_frames_the_camera_is_between_but_not_at_a_cut() {
        let cameras: Vec<Camera> = [0.0, 10.0, 20.0, 5000.0, 5010.0, 5020.0].map(camera).into();
        let x = |frame, part| camera_at(&cameras, frame, part).eye_in_world[0];
        assert_eq!((x(0, 0.0), x(0, 0.5), x(1, 0.25)), (0.0, 5.0, 12.5));
        assert_eq!((x(2, 0.0), x(2, 0.75), x(3, 0.5)), (20.0, 20.0, 5005.0));
        assert_eq!((x(5, 0.0), x(5, 0.5), x(9, 0.5)), (5020.0, 5020.0, 5020.0));
    }
}
