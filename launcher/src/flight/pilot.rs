//! The pilot: flies the camera. In exact mode it pushes the camera of every frame, in order, to the
//! generator; cameras are those of the plan, or come from another program while it flies. In
//! realtime mode it publishes where the camera is now: several times a frame along a path, or
//! whenever a pose comes, whether anybody looks or not.

use crate::data_set::FlownFrame;
use crate::fleet::Driver;
use crate::ground::WorldGround;
use crate::input::{Incoming, LiveCamera};
use crate::path::MAX_FRAMES;
use crate::plan::FlightPlan;
use crate::process::interrupt;
use crate::process::thread::in_thread;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terravision_common::camera::{Camera, is_cut};
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::run::Prediction;
use terravision_common::shm::{
    CameraRecord, Control, PoseTimes, Producer, RunState, SegmentKind, ShmError, VehicleTableWriter,
};

/// Between two looks at the end of the run, while no pose comes.
const TICK: Duration = Duration::from_millis(20);

/// Cameras that are published per frame in realtime mode: a frame that begins late has a camera
/// that is this much of a frame old at most.
const CAMERAS_PER_FRAME: u64 = 4;
/// Fewer when frames are so short that this many nanoseconds would pass between two.
const LEAST_STEP_NANOS: f64 = 2e6;
/// How often the pilot looks whether the first frame is there, or the run over.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Longest sleep before it looks whether the run goes on.
const LONGEST_SLEEP: Duration = Duration::from_millis(100);
/// Between two cameras that are foretold.
const FORETOLD_NANOS: f64 = 1e8;

/// The thread that flies.
#[derive(Debug)]
pub struct Pilot {
    thread: JoinHandle<Flown>,
    messages: Receiver<String>,
    failure: Arc<OnceLock<ShmError>>,
}

/// What a pilot has flown of poses that another program sent.
#[derive(Debug, Default)]
pub struct Flown {
    /// Frames, where each pose is one.
    pub frames: Option<u64>,
    /// Their cameras, up to as many as a path may have.
    pub poses: Vec<FlownFrame>,
}

/// How a pilot ended.
#[derive(Debug)]
pub struct Landing {
    /// Of a live input: what it has flown.
    pub flown: Flown,
    /// What it had to say and was not asked for.
    pub messages: Vec<String>,
    /// Why no pose could come any more, if that broke it off.
    pub failure: Option<ShmError>,
}

/// What the pilot flies with.
struct Cockpit {
    control: Control,
    ring: Producer<CameraRecord>,
    first: u64,
    /// Where times of poses are noted, for the frame ring.
    times: Option<PoseTimes>,
    /// Where the cameras to come are told, for a prefetcher that shall know them.
    path: Option<Producer<CameraRecord>>,
    /// Why no pose can come any more.
    failure: Arc<OnceLock<ShmError>>,
}

/// Maximum number of queued messages; further ones are dropped.
const MOST_MESSAGES: usize = 64;

impl Pilot {
    /// Opens what it needs and flies. The cameras move out of the plan's place in memory as copies;
    /// a live input moves out of the plan.
    ///
    /// # Errors
    /// The ring or the control block does not open, or there is no thread for it.
    pub fn start(plan: &mut FlightPlan, times: Option<PoseTimes>) -> anyhow::Result<Self> {
        let control = Control::open(&plan.run)?;
        let ring = Producer::open(&plan.run, SegmentKind::CameraRing)?;
        let is_told = plan.config.prefetch.prediction == Prediction::Oracle;
        let path = is_told.then(|| Producer::open(&plan.run, SegmentKind::PathRing)).transpose()?;
        let failure = Arc::new(OnceLock::new());
        let first = plan.config.frames[0];
        let cockpit = Cockpit { control, ring, first, times, path, failure: Arc::clone(&failure) };
        let (tell, messages) = sync_channel(MOST_MESSAGES);
        let period_nanos = plan.config.realtime.as_ref().map(|_| plan.config.period_nanos());
        let (fleet, fps) = (plan.fleet.take(), plan.config.fps);
        let table = fleet.as_ref().map(|_| VehicleTableWriter::open(&plan.run)).transpose()?;
        let thread = match plan.live.take() {
            Some(live) => in_thread("pilot", move || {
                let driver = fleet.as_ref().zip(table).map(|(fleet, table)| Driver::new(fleet, table, first, fps));
                cockpit.fly_live(live, period_nanos, driver, &tell)
            }),
            None => {
                let cameras = plan.cameras.clone();
                in_thread("pilot", move || {
                    let driver = fleet.as_ref().zip(table).map(|(fleet, table)| Driver::new(fleet, table, first, fps));
                    match period_nanos {
                        Some(period_nanos) => {
                            let foretold = cockpit.path.map(|ring| Foretold::new(ring, period_nanos));
                            fly_by_the_clock(&cameras, (period_nanos, first), &cockpit.control, foretold, driver);
                        }
                        None => cockpit.fly_all(cameras, driver),
                    }
                    Flown::default()
                })
            }
        }?;
        Ok(Self { thread, messages, failure })
    }

    /// Why no pose can come any more, if none can: the run is to be broken off.
    #[must_use]
    pub fn failure(&self) -> Option<&ShmError> {
        self.failure.get()
    }

    /// What it has to say since it was asked last.
    pub fn messages(&self) -> impl Iterator<Item = String> {
        self.messages.try_iter()
    }

    /// Waits for its end, which comes with the last camera or the end of the run.
    #[must_use]
    pub fn join(self) -> Landing {
        // It has nothing that can panic.
        let flown = self.thread.join().unwrap_or_default();
        let failure = Arc::into_inner(self.failure).and_then(OnceLock::into_inner);
        Landing { flown, messages: self.messages.try_iter().collect(), failure }
    }
}

impl Cockpit {
    fn fly_all(mut self, cameras: Vec<Camera>, mut driver: Option<Driver<'_>>) {
        for (frame, camera) in (self.first..).zip(cameras) {
            if !self.push(frame, camera, &mut driver) {
                return;
            }
        }
    }

    /// A frame's camera, behind its vehicles. Whether the run goes on: else it has ended, or the generator is gone, and the supervisor
    /// knows which.
    fn push(&mut self, frame: u64, camera: Camera, driver: &mut Option<Driver<'_>>) -> bool {
        if driver.as_mut().is_some_and(|driver| driver.drive(frame, &self.control).is_err()) {
            return false;
        }
        self.control.publish_camera(&camera);
        self.ring.push(&CameraRecord { frame, camera: *camera.fields() }, &self.control).is_ok()
    }

    /// Flies poses as they come, until the sender, the user or the clock ends it, and ends the run.
    /// In exact mode each pose is a frame: waits for them all and returns their number. In realtime
    /// mode the newest is the camera of now.
    fn fly_live(
        mut self,
        live: LiveCamera,
        period_nanos: Option<f64>,
        mut driver: Option<Driver<'_>>,
        tell: &SyncSender<String>,
    ) -> Flown {
        let is_realtime = period_nanos.is_some();
        let LiveCamera { mut input, database, exaggeration, idle_timeout } = live;
        let ground = WorldGround::finest(&database, database.world(), exaggeration).bounded(database.ranges());
        // When the run has ended, the receiver is gone. The sender of poses determines the number
        // of messages, so this never waits.
        let mut say = |sentence: String| drop(tell.try_send(sentence));
        let mut poses = 0;
        let mut flown = Vec::new();
        let mut newest_nanos = 0;
        let mut last_work = Instant::now();
        while interrupt::count() == 0 && self.control.check_running().is_ok() {
            if is_realtime && self.control.clock_start().is_none() && self.control.completed_sequence() > Sequence::NONE
            {
                self.control.start_clock(monotonic_nanos());
            }
            if let Some((driver, period_nanos)) = driver.as_mut().zip(period_nanos) {
                let since = |start| monotonic_nanos().saturating_sub(start) as f64 / period_nanos;
                driver.drive_by_the_clock(self.first + self.control.clock_start().map_or(0.0, since) as u64);
            }
            // Until its first frame is there, the clock waits for nothing but that.
            let tick = if is_realtime && self.control.clock_start().is_none() { LOOK_EVERY } else { TICK };
            let incoming = match input.next(tick, &ground, &mut say) {
                Ok(incoming) => incoming,
                Err(error) => {
                    self.failure.get_or_init(|| error);
                    return Flown::default();
                }
            };
            match incoming {
                Incoming::Pose { camera, time_s } => {
                    // Frames know their pose by its moment.
                    newest_nanos = camera.timestamp_nanos().max(newest_nanos + 1);
                    let camera = camera.made_at(newest_nanos);
                    if let Some(times) = &mut self.times {
                        // That the ring was cut is told by the renderer, whose frames go into it.
                        times.note(newest_nanos, time_s).ok();
                    }
                    if is_realtime {
                        self.control.publish_camera(&camera);
                    } else if !self.push(self.first + poses, camera, &mut driver) {
                        break;
                    } else if flown.len() < MAX_FRAMES as usize {
                        flown.push(FlownFrame { frame: FrameNumber::new(self.first + poses), time_s, camera });
                    }
                    poses += 1;
                    last_work = Instant::now();
                }
                Incoming::End => break,
                // A sender that waits for its frame is not idle.
                Incoming::Nothing if !is_realtime && self.control.written_frames() < poses => {
                    last_work = Instant::now()
                }
                Incoming::Nothing => {}
            }
            if idle_timeout.is_some_and(|timeout| last_work.elapsed() >= timeout) {
                break;
            }
        }
        if is_realtime || self.control.wait_written(poses).is_ok() {
            self.control.set_state(RunState::Finished);
        }
        input.summary().into_iter().for_each(say);
        Flown { frames: (!is_realtime).then_some(poses), poses: flown }
    }
}

/// Publishes the camera of now. The clock starts when the first frame is drawn, so that the start
/// of the stages is no part of the flight.
fn fly_by_the_clock(
    cameras: &[Camera],
    (period_nanos, first_frame): (f64, u64),
    control: &Control,
    mut foretold: Option<Foretold>,
    mut driver: Option<Driver<'_>>,
) {
    let Some(first) = cameras.first() else { return };
    let mut drive = |frame: u64| driver.iter_mut().for_each(|driver| driver.drive_by_the_clock(first_frame + frame));
    drive(0);
    control.publish_camera(&first.made_at(monotonic_nanos()));
    let mut foretell = || foretold.iter_mut().for_each(|foretold| foretold.tell(cameras));
    foretell();
    while control.completed_sequence() == Sequence::NONE {
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
        drive(frame);
        let camera = camera_at(cameras, frame as usize, part as f64 / steps as f64);
        control.publish_camera(&camera.made_at(moment));
        foretell();
    }
}

/// Tells the cameras to come, as far ahead as the ring holds them; their times count from the first
/// frame's moment.
struct Foretold {
    ring: Producer<CameraRecord>,
    period_nanos: f64,
    /// The frame that is told next, and how many are passed over between two.
    next: usize,
    step: usize,
}

impl Foretold {
    fn new(ring: Producer<CameraRecord>, period_nanos: f64) -> Self {
        let step = (FORETOLD_NANOS / period_nanos).max(1.0) as usize;
        Self { ring, period_nanos, next: 0, step }
    }

    fn tell(&mut self, cameras: &[Camera]) {
        while let Some(camera) = cameras.get(self.next) {
            let camera = camera.made_at((self.next as f64 * self.period_nanos) as u64);
            let record = CameraRecord { frame: self.next as u64, camera: *camera.fields() };
            if self.ring.try_push(record).is_err() {
                return;
            }
            // The last camera is told too: there the flight rests.
            let last = cameras.len() - 1;
            self.next = if self.next < last { (self.next + self.step).min(last) } else { cameras.len() };
        }
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

/// The camera a part of the way from a frame's to the next one's. At a cut it stays until the next
/// frame.
fn camera_at(cameras: &[Camera], frame: usize, part: f64) -> Camera {
    let at = |index: usize| cameras[index.min(cameras.len() - 1)];
    let (from, to) = (at(frame), at(frame + 1));
    let step = |a: Camera, b: Camera| a.eye().distance(b.eye());
    let around = [step(at(frame.saturating_sub(1)), from), step(to, at(frame + 2))];
    if cameras.len() > 3 && is_cut(step(from, to), around) { from } else { from.toward(&to, part) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::CameraFields;

    fn camera(x: f64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: [x, 0.0, 100.0],
            heading_rad: 0.01 * x,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 64,
            height: 36,
            timestamp_nanos: 0,
        })
        .expect("valid")
    }

    #[test]
    fn between_frames_the_camera_is_between_but_not_at_a_cut() {
        let cameras: Vec<Camera> = [0.0, 10.0, 20.0, 5000.0, 5010.0, 5020.0].map(camera).into();
        let x = |frame, part| camera_at(&cameras, frame, part).fields().eye_in_world[0];
        assert_eq!((x(0, 0.0), x(0, 0.5), x(1, 0.25)), (0.0, 5.0, 12.5));
        assert_eq!((x(2, 0.0), x(2, 0.75), x(3, 0.5)), (20.0, 20.0, 5005.0));
        assert_eq!((x(5, 0.0), x(5, 0.5), x(9, 0.5)), (5020.0, 5020.0, 5020.0));
    }
}
