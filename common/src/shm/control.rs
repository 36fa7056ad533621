//! The control block: the state of the run, live stages, completed frames; and the end of every
//! wait.

use super::activity::Activity;
use super::bell::{Bell, Slept};
use super::control_words::{CAMERA_WORDS, COUNTERS, ControlWords, TIMING_WORDS};
pub use super::control_words::{Counter, FAILURE_CAUSES, Gauge, RunState};
use super::error::{ShmError, WaitError};
use super::header::Segment;
use super::kind::{SegmentKind, Stage};
use super::process::{ProcessId, Watch};
use super::run_id::RunId;
use super::segments::open_segment;
use crate::camera::{Camera, CameraFields};
use crate::event::monotonic_nanos;
use crate::ids::Sequence;
use crate::rate::FrameTiming;
use crate::sync::{AtomicU32, Ordering};
use crossbeam::utils::Backoff;
use std::sync::Arc;
use std::time::Duration;

/// Longest sleep of a wait before it checks again whether the run goes on.
pub const WAIT_BOUND: Duration = Duration::from_millis(100);
/// For this many sleeps a dead peer is left to the launcher, which reports it; if the launcher
/// restarts stages, there is no limit.
const PEER_GRACE: u32 = 10;

/// A handle on the control block. Any process has one or several; all methods may be called from
/// any thread.
#[derive(Debug)]
pub struct Control {
    segment: Arc<Segment>,
    launcher: Watch,
    /// The stage that this process has registered as, plus 1; 0 before. Waits send its heartbeats.
    own: AtomicU32,
}

impl Control {
    /// Opens a run's control block; waits a short time for it to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, SegmentKind::Control)?, run.launcher())
    }

    pub(crate) fn attach(segment: &Arc<Segment>, launcher: ProcessId) -> Result<Self, ShmError> {
        if segment.kind() != SegmentKind::Control {
            return Err(ShmError::WrongKind { name: segment.kind().name().to_owned(), kind: segment.kind() });
        }
        Ok(Self { segment: Arc::clone(segment), launcher: Watch::of(launcher)?, own: AtomicU32::new(0) })
    }

    pub(super) fn words(&self) -> &ControlWords {
        self.segment.words()
    }

    /// The state of the run.
    #[must_use]
    pub fn state(&self) -> RunState {
        // Acquire: SYNC control.state, everything that led to it comes before.
        match self.words().state.0.load(Ordering::Acquire) {
            0 | 1 => RunState::Running,
            2 => RunState::Finished,
            3 => RunState::Stopping,
            // Any invalid number too: no healthy process wrote it.
            _ => RunState::Failed,
        }
    }

    /// Moves the run forward to `state` and wakes waits for frames and cameras; waits on other
    /// segments see it within [`WAIT_BOUND`]. A run never moves back.
    pub fn set_state(&self, state: RunState) {
        let words = self.words();
        // Release: SYNC control.state.
        words.state.0.fetch_max(state as u32, Ordering::AcqRel);
        for bell in [&words.completed_bell, &words.written_bell, &words.camera_bell] {
            bell.0.ring();
        }
    }

    /// Whether the run goes on.
    ///
    /// # Errors
    /// [`WaitError::Finished`], [`WaitError::Stopping`] or [`WaitError::Failed`]. For loops that do
    /// not wait for anything.
    pub fn check_running(&self) -> Result<(), WaitError> {
        match self.state() {
            RunState::Running => Ok(()),
            RunState::Finished => Err(WaitError::Finished),
            RunState::Stopping => Err(WaitError::Stopping),
            RunState::Failed => Err(WaitError::Failed),
        }
    }

    /// Whether the launcher is alive. Costs a system call.
    #[must_use]
    pub fn is_launcher_alive(&self) -> bool {
        self.launcher.is_alive()
    }

    /// Records that the launcher restarts dead stages: from now on a dead peer does not mean the
    /// end of the run.
    pub fn set_supervised(&self) {
        // Release: SYNC control.supervised; stages are started later anyway.
        self.words().is_supervised.0.store(1, Ordering::Release);
    }

    /// Whether dead stages are restarted.
    #[must_use]
    pub fn is_supervised(&self) -> bool {
        // Acquire: SYNC control.supervised.
        self.words().is_supervised.0.load(Ordering::Acquire) != 0
    }

    /// Records that all frames of the run are prepared; `sequence` is that of the last one.
    pub fn set_last_sequence(&self, sequence: Sequence) {
        // Release: SYNC control.last, the frame is in the ring.
        self.words().last_sequence.0.store(sequence.get(), Ordering::Release);
    }

    /// Whether all frames of the run are prepared, and completed.
    #[must_use]
    pub fn is_all_completed(&self) -> bool {
        // Acquire: SYNC control.last.
        let last = self.words().last_sequence.0.load(Ordering::Acquire);
        last != 0 && self.completed_sequence().get() >= last
    }

    /// Registers this process as the stage. From now on peers that wait for it notice its death.
    /// Also sends the first heartbeat; every wait sends more.
    ///
    /// # Errors
    /// [`ShmError::Os`] when `/proc` cannot be read.
    pub fn register(&self, stage: Stage) -> Result<(), ShmError> {
        let own = ProcessId::own()?;
        let words = &self.words().stages[stage as usize];
        words.start_time.store(own.start_time, Ordering::Relaxed);
        words.generation.fetch_add(1, Ordering::Relaxed);
        // Left by the previous process.
        words.activity.store(0, Ordering::Relaxed);
        // Release: SYNC control.stage, the start time comes before.
        words.pid.store(own.pid.into(), Ordering::Release);
        // Relaxed: used only by this process.
        self.own.store(stage as u32 + 1, Ordering::Relaxed);
        self.heartbeat(stage);
        Ok(())
    }

    /// The process id of a stage that has registered.
    #[must_use]
    pub fn pid_of(&self, stage: Stage) -> Option<u32> {
        self.process_of(stage).map(|process| process.pid)
    }

    /// How often the stage was started.
    #[must_use]
    pub fn generation_of(&self, stage: Stage) -> u64 {
        // Relaxed: a count.
        self.words().stages[stage as usize].generation.load(Ordering::Relaxed)
    }

    fn process_of(&self, stage: Stage) -> Option<ProcessId> {
        let words = &self.words().stages[stage as usize];
        // Acquire: SYNC control.stage.
        let pid = u32::try_from(words.pid.load(Ordering::Acquire)).ok().filter(|&pid| pid != 0)?;
        Some(ProcessId { pid, start_time: words.start_time.load(Ordering::Relaxed) })
    }

    /// Sends a heartbeat of a stage.
    pub fn heartbeat(&self, stage: Stage) {
        // Relaxed: a time, without other data.
        self.words().stages[stage as usize].heartbeat_nanos.store(monotonic_nanos(), Ordering::Relaxed);
    }

    /// The stage that this process is, if it is one.
    pub(super) fn own_stage(&self) -> Option<Stage> {
        let own = self.own.load(Ordering::Relaxed);
        Stage::ALL.into_iter().find(|stage| *stage as u32 + 1 == own)
    }

    /// Sends a heartbeat of the stage of this process, if it is one.
    fn beat(&self) {
        if let Some(stage) = self.own_stage() {
            self.heartbeat(stage);
        }
    }

    /// Time of the last heartbeat of a stage, nanoseconds of the monotonic clock; `None` before the
    /// first.
    #[must_use]
    pub fn heartbeat_of(&self, stage: Stage) -> Option<u64> {
        Some(self.words().stages[stage as usize].heartbeat_nanos.load(Ordering::Relaxed)).filter(|&nanos| nanos != 0)
    }

    /// Records that the renderer and its device have completed all frames up to `sequence`: the
    /// pool slots that they used may be reused.
    pub fn set_completed_sequence(&self, sequence: Sequence) {
        let words = self.words();
        // Release: SYNC control.completed, our reads of the pools come before.
        words.completed_sequence.0.fetch_max(sequence.get(), Ordering::Release);
        words.completed_bell.0.ring();
    }

    /// All frames up to this one are completed.
    #[must_use]
    pub fn completed_sequence(&self) -> Sequence {
        // Acquire: SYNC control.completed.
        Sequence::new(self.words().completed_sequence.0.load(Ordering::Acquire))
    }

    /// Waits until the completed sequence is at least `sequence`, and returns it. One waiter at a
    /// time.
    ///
    /// # Errors
    /// The run ended.
    pub fn wait_completed(&self, sequence: Sequence) -> Result<Sequence, WaitError> {
        self.wait_for(&self.words().completed_bell.0, Some(Stage::Renderer), || {
            let completed = self.completed_sequence();
            Ok((completed >= sequence).then_some(completed))
        })
    }

    /// Records that `count` frames of the run have left the sink.
    pub fn set_written_frames(&self, count: u64) {
        let words = self.words();
        // Release: SYNC control.written, all work on the frames comes before.
        words.written_frames.0.fetch_max(count, Ordering::Release);
        words.written_bell.0.ring();
    }

    /// Frames of the run that have left the sink.
    #[must_use]
    pub fn written_frames(&self) -> u64 {
        // Acquire: SYNC control.written.
        self.words().written_frames.0.load(Ordering::Acquire)
    }

    /// Waits until at least `count` frames have left the sink, and returns how many have. One
    /// waiter at a time.
    ///
    /// # Errors
    /// The run ended.
    pub fn wait_written(&self, count: u64) -> Result<u64, WaitError> {
        self.wait_for(&self.words().written_bell.0, Some(Stage::Renderer), || {
            let written = self.written_frames();
            Ok((written >= count).then_some(written))
        })
    }

    /// Replaces the newest camera. One process (the pilot) does this.
    pub fn publish_camera(&self, camera: &Camera) {
        let words: [u64; CAMERA_WORDS] = bytemuck::cast(*camera.fields());
        self.words().camera.0.write(&words);
        self.words().camera_bell.0.ring();
    }

    /// The newest camera; `None` before the first, and when the content is not a camera.
    #[must_use]
    pub fn camera(&self) -> Option<Camera> {
        let words = self.words().camera.0.read()?;
        let fields: CameraFields = bytemuck::cast(words);
        Camera::new(fields).ok()
    }

    /// Waits for a camera that was made at `made_nanos` or later, until `deadline_nanos` of the
    /// monotonic clock; after that, returns the newest camera, if there is one. Never returns an
    /// invalid one. One waiter at a time.
    ///
    /// # Errors
    /// The run ended.
    pub fn wait_camera(&self, made_nanos: u64, deadline_nanos: u64) -> Result<Camera, WaitError> {
        loop {
            self.check_running()?;
            let newest = self.camera();
            let now = monotonic_nanos();
            if let Some(camera) = newest
                && (camera.timestamp_nanos() >= made_nanos || now >= deadline_nanos)
            {
                self.progress();
                return Ok(camera);
            }
            self.awaits(Activity::AwaitsCamera);
            let rest = Duration::from_nanos(deadline_nanos.saturating_sub(now));
            let bound = if rest.is_zero() { WAIT_BOUND } else { rest.min(WAIT_BOUND) };
            self.beat();
            let is_new = || self.camera().is_some_and(|camera| camera.timestamp_nanos() >= made_nanos);
            let slept = self.words().camera_bell.0.sleep_unless(bound, || Ok::<_, ShmError>(is_new().then_some(())))?;
            if matches!(slept, Slept::Fully) && !self.launcher.is_alive() {
                return Err(WaitError::LauncherGone);
            }
        }
    }

    /// Starts the clock of the flight: its first frame is due at `nanos` of the monotonic clock.
    /// Wakes waits for a camera and for the clock.
    pub fn start_clock(&self, nanos: u64) {
        // Release: SYNC control.clock.
        self.words().clock_start.0.store(nanos, Ordering::Release);
        self.words().camera_bell.0.ring();
    }

    /// Moment of the first frame, nanoseconds of the monotonic clock; `None` before the clock has
    /// started.
    #[must_use]
    pub fn clock_start(&self) -> Option<u64> {
        // Acquire: SYNC control.clock.
        Some(self.words().clock_start.0.load(Ordering::Acquire)).filter(|&nanos| nanos != 0)
    }

    /// Waits until the clock has started, and returns the moment of the first frame. One waiter at
    /// a time, with [`Control::wait_camera`].
    ///
    /// # Errors
    /// The run ended.
    pub fn wait_clock_start(&self) -> Result<u64, WaitError> {
        // The clock starts with the first picture.
        self.wait_for(&self.words().camera_bell.0, Some(Stage::Renderer), || Ok(self.clock_start()))
    }

    /// Replaces the timing of the newest finished frame. Only one process (the renderer) does this.
    pub fn publish_timing(&self, timing: &FrameTiming) {
        let words: [u64; TIMING_WORDS] = bytemuck::cast(*timing);
        self.words().timing.0.write(&words);
    }

    /// Timing of the newest finished frame; `None` before the first. Its numbers are not checked.
    #[must_use]
    pub fn timing(&self) -> Option<FrameTiming> {
        self.words().timing.0.read().map(bytemuck::cast)
    }

    /// Sets the time of the preparer for its newest frame, without waits.
    pub fn set_prepare_nanos(&self, nanos: u64) {
        // Relaxed: an independent number.
        self.words().prepare_nanos.0.store(nanos, Ordering::Relaxed);
    }

    /// The time of the preparer for its newest frame; 0 before the first.
    #[must_use]
    pub fn prepare_nanos(&self) -> u64 {
        self.words().prepare_nanos.0.load(Ordering::Relaxed)
    }

    /// Sets the wanted screen resolutions of facets and texels, pixels.
    pub fn set_resolutions(&self, r_z_px: f64, r_c_px: f64) {
        // Relaxed: each of the two numbers is valid on its own; a frame may use an old and a new
        // one.
        self.words().r_z_bits.0.store(r_z_px.to_bits(), Ordering::Relaxed);
        self.words().r_c_bits.0.store(r_c_px.to_bits(), Ordering::Relaxed);
    }

    /// The wanted screen resolution of facets, pixels; `None` when it was not set or is not a
    /// positive number.
    #[must_use]
    pub fn r_z_px(&self) -> Option<f64> {
        positive(self.words().r_z_bits.0.load(Ordering::Relaxed))
    }

    /// The wanted screen resolution of texels, pixels; `None` when it was not set or is not a
    /// positive number.
    #[must_use]
    pub fn r_c_px(&self) -> Option<f64> {
        positive(self.words().r_c_bits.0.load(Ordering::Relaxed))
    }

    /// Adds to a counter.
    pub fn count(&self, counter: Counter, by: u64) {
        // Relaxed: a sum.
        self.words().counters[counter as usize].fetch_add(by, Ordering::Relaxed);
    }

    /// A counter's value.
    #[must_use]
    pub fn counter(&self, counter: Counter) -> u64 {
        self.words().counters[counter as usize].load(Ordering::Relaxed)
    }

    /// All counters, by [`Counter`] as a number.
    #[must_use]
    pub fn counters(&self) -> [u64; COUNTERS] {
        std::array::from_fn(|i| self.words().counters[i].load(Ordering::Relaxed))
    }

    /// Adds to the failures of a cause, by its number; ignores unknown numbers.
    pub fn count_failures(&self, cause: usize, by: u64) {
        if let Some(failures) = self.words().failures.get(cause) {
            // Relaxed: a sum.
            failures.fetch_add(by, Ordering::Relaxed);
        }
    }

    /// Failures while the database was read, by the number of the cause.
    #[must_use]
    pub fn failures(&self) -> [u64; FAILURE_CAUSES] {
        std::array::from_fn(|cause| self.words().failures[cause].load(Ordering::Relaxed))
    }

    /// Sets a gauge.
    pub fn set_gauge(&self, gauge: Gauge, value: u64) {
        // Relaxed: a number for displays.
        self.words().gauges[gauge as usize].store(value, Ordering::Relaxed);
    }

    /// The value of a gauge.
    #[must_use]
    pub fn gauge(&self, gauge: Gauge) -> u64 {
        self.words().gauges[gauge as usize].load(Ordering::Relaxed)
    }

    /// Whether the stage has registered and is dead. Costs one or more system calls.
    #[must_use]
    pub fn is_stage_dead(&self, stage: Stage) -> bool {
        self.process_of(stage).is_some_and(|process| !process.is_alive())
    }

    /// Sleeps on `bell` once, at most for `bound` and [`WAIT_BOUND`], unless `attempt` succeeds;
    /// returns `None` if it did not. Checks the state of the run first, and after a full sleep also
    /// the launcher.
    pub(crate) fn wait_once<R>(
        &self,
        bell: &Bell,
        bound: Duration,
        attempt: impl FnOnce() -> Result<Option<R>, ShmError>,
    ) -> Result<Option<R>, WaitError> {
        self.check_running()?;
        self.beat();
        match bell.sleep_unless(bound.min(WAIT_BOUND), attempt)? {
            Slept::NotAtAll(found) => Ok(Some(found)),
            Slept::Fully if !self.launcher.is_alive() => Err(WaitError::LauncherGone),
            Slept::Fully | Slept::UntilRung => Ok(None),
        }
    }

    /// Waits until `attempt` succeeds: first a short backoff, then sleeps on `bell` of at most
    /// [`WAIT_BOUND`] each. After every sleep it checks the state of the run, and after a full
    /// sleep also launcher and peer. Allocates nothing.
    pub(crate) fn wait_for<R>(
        &self,
        bell: &Bell,
        peer: Option<Stage>,
        mut attempt: impl FnMut() -> Result<Option<R>, ShmError>,
    ) -> Result<R, WaitError> {
        if let Some(found) = attempt()? {
            return Ok(found);
        }
        let backoff = Backoff::new();
        while !backoff.is_completed() {
            backoff.snooze();
            if let Some(found) = attempt()? {
                self.progress();
                return Ok(found);
            }
        }
        self.awaits(peer.map_or(Activity::AwaitsCamera, Activity::Awaits));
        let found = self.sleep_until(bell, peer, attempt)?;
        self.progress();
        Ok(found)
    }

    /// The sleeps of [`Control::wait_for`].
    fn sleep_until<R>(
        &self,
        bell: &Bell,
        peer: Option<Stage>,
        mut attempt: impl FnMut() -> Result<Option<R>, ShmError>,
    ) -> Result<R, WaitError> {
        let mut sleeps_with_dead_peer = 0;
        loop {
            self.check_running()?;
            self.beat();
            match bell.sleep_unless(WAIT_BOUND, &mut attempt)? {
                Slept::NotAtAll(found) => return Ok(found),
                Slept::UntilRung => {}
                Slept::Fully => {
                    if !self.launcher.is_alive() {
                        return Err(WaitError::LauncherGone);
                    }
                    let peer = peer.filter(|_| !self.is_supervised());
                    if let Some((stage, process)) = peer.and_then(|stage| Some((stage, self.process_of(stage)?))) {
                        sleeps_with_dead_peer = if process.is_alive() { 0 } else { sleeps_with_dead_peer + 1 };
                        if sleeps_with_dead_peer >= PEER_GRACE {
                            return Err(WaitError::PeerGone { stage });
                        }
                    }
                }
            }
            if let Some(found) = attempt()? {
                return Ok(found);
            }
        }
    }
}

fn positive(bits: u64) -> Option<f64> {
    Some(f64::from_bits(bits)).filter(|value| value.is_finite() && *value > 0.0)
}
