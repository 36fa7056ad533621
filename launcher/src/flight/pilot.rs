//! The pilot: pushes the camera of every frame, in order, to the generator. Cameras are those of the plan, or come from
//! another program while it flies.

use super::interrupt;
use crate::ground::WorldGround;
use crate::input::{Incoming, LiveCamera};
use crate::plan::FlightPlan;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terravision_common::camera::Camera;
use terravision_common::shm::{CameraRecord, Control, PoseTimes, Producer, RunState, SegmentKind, ShmError};

/// Between two looks at the end of the run, while no pose comes.
const TICK: Duration = Duration::from_millis(20);

/// The thread that flies.
#[derive(Debug)]
pub struct Pilot {
    thread: JoinHandle<Option<u64>>,
    words: Receiver<String>,
}

/// What the pilot flies with.
struct Cockpit {
    control: Control,
    ring: Producer<CameraRecord>,
    first: u64,
    /// Where times of poses are noted, for the frame ring.
    times: Option<PoseTimes>,
}

impl Pilot {
    /// Opens the camera ring and flies. The cameras move out of the plan's place in memory as copies; a live input moves
    /// out of the plan.
    ///
    /// # Errors
    /// [`ShmError`] when the ring or the control block does not open.
    pub fn start(plan: &mut FlightPlan, times: Option<PoseTimes>) -> Result<Self, ShmError> {
        let control = Control::open(&plan.run)?;
        let ring = Producer::open(&plan.run, SegmentKind::CameraRing)?;
        let cockpit = Cockpit { control, ring, first: plan.config.frames[0], times };
        let (tell, words) = channel();
        let thread = match plan.live.take() {
            Some(live) => std::thread::spawn(move || Some(cockpit.fly_live(live, &tell))),
            None => {
                let cameras = plan.cameras.clone();
                std::thread::spawn(move || {
                    cockpit.fly_all(cameras);
                    None
                })
            }
        };
        Ok(Self { thread, words })
    }

    /// What it has to say since it was asked last.
    pub fn words(&self) -> impl Iterator<Item = String> {
        self.words.try_iter()
    }

    /// Waits for its end, which comes with the last camera or the end of the run. Of a live input: how many frames it
    /// has flown; and its last words.
    pub fn join(self) -> (Option<u64>, Vec<String>) {
        // It has nothing that can panic.
        let flown = self.thread.join().unwrap_or_default();
        (flown, self.words.try_iter().collect())
    }
}

impl Cockpit {
    fn fly_all(mut self, cameras: Vec<Camera>) {
        for (frame, camera) in (self.first..).zip(cameras) {
            if !self.push(frame, camera) {
                return;
            }
        }
    }

    /// Whether the run goes on: else it has ended, or the generator is gone, and the supervisor knows which.
    fn push(&mut self, frame: u64, camera: Camera) -> bool {
        self.control.publish_camera(&camera);
        self.ring.push(&CameraRecord { frame, camera }, &self.control).is_ok()
    }

    /// Flies poses as they come, until the sender, the user or the clock ends it; waits for their frames and ends the
    /// run. Returns their number.
    fn fly_live(mut self, live: LiveCamera, tell: &Sender<String>) -> u64 {
        let LiveCamera { mut input, database, exaggeration, idle_timeout } = live;
        let ground = WorldGround::finest(&database, database.world(), exaggeration);
        // Nobody listens any more when the run has ended.
        let mut say = |sentence: String| drop(tell.send(sentence));
        let mut frame = self.first;
        let mut last_work = Instant::now();
        while interrupt::count() == 0 && self.control.check_running().is_ok() {
            match input.next(TICK, &ground, &mut say) {
                Incoming::Pose { camera, time_s } => {
                    if let Some(times) = &self.times {
                        times.note(frame, time_s);
                    }
                    if !self.push(frame, camera) {
                        break;
                    }
                    frame += 1;
                    last_work = Instant::now();
                }
                Incoming::End => break,
                // A sender that waits for its frame is not idle.
                Incoming::Nothing if self.control.written_frames() < frame - self.first => last_work = Instant::now(),
                Incoming::Nothing => {}
            }
            if idle_timeout.is_some_and(|timeout| last_work.elapsed() >= timeout) {
                break;
            }
        }
        let flown = frame - self.first;
        if self.control.wait_written(flown).is_ok() {
            self.control.set_state(RunState::Finished);
        }
        input.summary().into_iter().for_each(say);
        flown
    }
}
