//! A run while it goes on: the launcher's ends of its segments, its processes, and what comes out
//! of them.

use super::notices::Notices;
use super::pilot::{Flown, Pilot};
use super::progress::Progress;
use super::restart::Restarts;
use super::stage::{StageProcess, StartError};
use super::supervisor::{self, Ending};
use super::telemetry::Telemetry;
use crate::data_set::FlownFrame;
use crate::failure::Failure;
use crate::measure::metrics::Metrics;
use crate::measure::stats::{PrefetchStats, RunStats, TileStats};
use crate::measure::trace::Phase;
use crate::plan::FlightPlan;
use crate::process::{interrupt, own_folder};
use crate::stream::hang::EncoderWatch;
use crate::stream::{StreamError, StreamKeeper};
use anyhow::Context;
use std::collections::BTreeMap;
use std::path::PathBuf;
use terravision_common::event::monotonic_nanos;
use terravision_common::run::RunConfig;
use terravision_common::shm::{Control, Counter, FrameRing, RunState, Stage};

/// The launcher's ends of the run's segments, and what comes out of them.
pub(super) struct Run {
    control: Control,
    telemetry: Telemetry,
    pids: Vec<(Stage, u32)>,
    restarts: BTreeMap<&'static str, u32>,
    /// Frames that were asked for: by the plan, or by the poses that have come.
    asked_frames: u64,
    /// Cameras of the poses that another program has sent, each a frame.
    poses: Vec<FlownFrame>,
    pub(super) phases: Vec<Phase>,
    ring: Option<FrameRing>,
}

/// How stages are started.
struct Starter {
    programs: PathBuf,
    /// The run, as JSON.
    config: String,
}

impl Starter {
    fn new(config: &RunConfig) -> Result<Self, Failure> {
        let config = serde_json::to_string(config).context("cannot write the run's configuration");
        Ok(Self { config: config.map_err(Failure::failed)?, programs: own_folder()? })
    }

    /// Starts a stage. The renderer's standard output goes into the stream, if there is one.
    fn start(&self, stage: Stage, stream: Option<&StreamKeeper>) -> Result<StageProcess, StartError> {
        let stream = stream.filter(|_| stage == Stage::Renderer);
        let stdout = stream.map(StreamKeeper::pipe).transpose();
        let stdout = stdout.map_err(|source| StartError::no_pipe(stage, &self.programs, source))?;
        StageProcess::start(stage, &self.programs, &self.config, stdout)
    }
}

/// What a flight is flown with.
struct Flight<'p> {
    progress: &'p Progress,
    starter: Starter,
    pilot: Pilot,
    stream: Option<StreamKeeper>,
    /// Another program sends the poses.
    is_live: bool,
    begun_nanos: u64,
}

/// What changes while it is watched.
struct FlightState {
    stages: Vec<StageProcess>,
    encoder_watch: EncoderWatch,
    notices: Notices,
}

impl Flight<'_> {
    /// The pilot ends a live flight in order at the first Ctrl-C, so only the second interrupts it.
    fn is_interrupted(&self) -> bool {
        interrupt::count() > u32::from(self.is_live)
    }

    fn has_stream_failed(&self) -> bool {
        self.stream.as_ref().is_some_and(StreamKeeper::has_failed)
    }
}

impl Run {
    pub(super) fn open(plan: &FlightPlan, ring: Option<FrameRing>) -> Result<Self, Failure> {
        Ok(Self {
            control: Control::open(&plan.run).map_err(Failure::failed)?,
            telemetry: Telemetry::open(plan)?,
            pids: Vec::new(),
            restarts: BTreeMap::new(),
            asked_frames: plan.cameras.len() as u64,
            poses: Vec::new(),
            phases: Vec::new(),
            ring,
        })
    }

    /// Process ids of the stages, of those that were started again behind the first four.
    pub(super) fn pids(&self) -> &[(Stage, u32)] {
        &self.pids
    }

    /// Begins to serve metrics, if they are asked for.
    pub(super) fn serve_metrics(&mut self, plan: &mut FlightPlan, progress: &Progress) -> Result<(), Failure> {
        let Some(socket) = plan.metrics.take() else { return Ok(()) };
        progress.say(&format!("metrics of the run: http://{}/metrics", socket.address()));
        socket.warning().iter().for_each(|warning| progress.warn(warning));
        let metrics = Metrics::start(socket, &plan.run, &plan.config, &plan.layout);
        self.telemetry.metrics = Some(metrics.map_err(Failure::failed)?);
        Ok(())
    }

    /// From the start of the stages to the end of the last.
    pub(super) fn fly(&mut self, plan: &mut FlightPlan, progress: &Progress) -> Result<Ending, Failure> {
        let (flight, mut state) = self.start(plan, progress)?;
        let flying_nanos = monotonic_nanos();
        let ending = self.watch(&flight, &mut state, plan);
        let landed_nanos = monotonic_nanos();
        tracing::info!(?ending, written = self.control.written_frames(), "flight ends");
        self.phases.push(Phase::own("fly", flying_nanos, landed_nanos));
        self.land(flight, state, ending, landed_nanos)
    }

    fn start<'p>(
        &mut self,
        plan: &mut FlightPlan,
        progress: &'p Progress,
    ) -> Result<(Flight<'p>, FlightState), Failure> {
        let begun_nanos = monotonic_nanos();
        let starter = Starter::new(&plan.config)?;
        let stream = StreamKeeper::start(&plan.run, &plan.config, plan.stream.as_ref()).map_err(Failure::failed)?;
        if plan.restarts.limit > 0 {
            self.control.set_supervised();
        }
        let ([first, end], size) = (plan.config.frames, [plan.config.width, plan.config.height]);
        tracing::info!(run = %plan.run, first, end, ?size, destination = plan.destination, "flight begins");
        let mut stages = Vec::new();
        for stage in Stage::ALL {
            stages.push(starter.start(stage, stream.as_ref()).map_err(Failure::failed)?);
        }
        self.pids = stages.iter().map(|stage| (stage.stage(), stage.pid())).collect();
        self.phases.push(Phase::own("start stages", begun_nanos, monotonic_nanos()));
        self.control.set_resolutions(plan.config.r_z_px, plan.config.r_c_px);
        let (is_live, notices) = (plan.live.is_some(), Notices::new(plan));
        let times = self.ring.as_ref().map(FrameRing::pose_times);
        let pilot = Pilot::start(plan, times).map_err(Failure::failed)?;
        let encoder_watch = EncoderWatch::new(plan.restarts.hang.after);
        let flight = Flight { progress, starter, pilot, stream, is_live, begun_nanos };
        Ok((flight, FlightState { stages, encoder_watch, notices }))
    }

    /// Watches the flight until all stages have ended.
    fn watch(&mut self, flight: &Flight<'_>, state: &mut FlightState, plan: &FlightPlan) -> Ending {
        let FlightState { stages, encoder_watch, notices } = state;
        let Self { control, telemetry, pids, .. } = self;
        let stream = flight.stream.as_ref();
        let encoder = stream.and_then(StreamKeeper::encoder_pid);
        let mut start_again = |stage| {
            let started = flight.starter.start(stage, stream)?;
            pids.push((stage, started.pid()));
            Ok(started)
        };
        let mut say = |message: &str| flight.progress.warn(message);
        let mut restarts = Restarts::new(plan.restarts, &mut start_again, &mut say);
        let is_broken_off =
            || flight.is_interrupted() || flight.has_stream_failed() || flight.pilot.failure().is_some();
        let is_output_blocked = || stream.is_some_and(StreamKeeper::is_blocked);
        let look = &mut |stages: &[StageProcess]| {
            if let Some(stream) = stream {
                encoder_watch.look(stream, false);
            }
            telemetry.drain(control);
            notices.look(&mut telemetry.collector, control, flight.progress);
            telemetry.sample(control, stages, encoder);
            flight.progress.show(control.written_frames());
            flight.pilot.messages().for_each(|message| flight.progress.warn(&message));
        };
        let ending = supervisor::watch(stages, control, &is_broken_off, &is_output_blocked, &mut restarts, look);
        self.restarts = restarts.counts().clone();
        ending
    }

    /// The stages have ended: takes what is left of their events, and what the pilot has flown;
    /// completes the stream.
    fn land(
        &mut self,
        flight: Flight<'_>,
        state: FlightState,
        ending: Ending,
        landed_nanos: u64,
    ) -> Result<Ending, Failure> {
        let has_stream_failed = flight.has_stream_failed();
        let Flight { progress, pilot, stream, is_live, begun_nanos, .. } = flight;
        let FlightState { stages, mut encoder_watch, mut notices } = state;
        // The pilot's wait ends with the run.
        if ending == Ending::Finished {
            self.control.set_state(RunState::Stopping);
        }
        let landing = pilot.join();
        landing.messages.iter().for_each(|message| progress.warn(message));
        self.telemetry.drain(&self.control);
        notices.finish(&self.telemetry.collector, progress);
        self.note_flown(landing.flown, is_live);
        if ending == Ending::Finished {
            for stage in &stages {
                stage.lines().iter().for_each(|line| progress.warn(&format!("{}: {line}", stage.stage())));
            }
        }
        if let Some(error) = landing.failure {
            return Err(Failure::failed(error));
        }
        let Some(stream) = stream.filter(|_| ending == Ending::Finished || has_stream_failed) else {
            return Ok(ending);
        };
        let encoder = stream.encoder_pid();
        let is_interrupted = || interrupt::count() > u32::from(is_live);
        let finished = stream.finish(&is_interrupted, &mut encoder_watch);
        let completed_nanos = monotonic_nanos();
        self.phases.push(Phase::own("complete", landed_nanos, completed_nanos));
        self.phases.extend(encoder.map(|pid| Phase::encoder(pid, begun_nanos, completed_nanos)));
        match finished {
            Ok(()) => Ok(ending),
            Err(StreamError::Interrupted) => Ok(Ending::Interrupted),
            Err(error) => Err(Failure::failed(error)),
        }
    }

    /// Notes how many frames a live flight had, and from which poses.
    fn note_flown(&mut self, flown: Flown, is_live: bool) {
        // Against the clock, a flight of poses has the frames that were drawn until it was ended.
        let drawn = (is_live && flown.frames.is_none()).then(|| self.control.written_frames());
        if let Some(drawn) = drawn {
            self.telemetry.collector.end_after(drawn);
        }
        self.asked_frames = flown.frames.or(drawn).unwrap_or(self.asked_frames);
        self.telemetry.collector.note_poses(&flown.poses);
        self.poses = flown.poses;
    }

    /// All that is known, when the run has ended.
    pub(super) fn close(self, plan: &FlightPlan, started_nanos: u64) -> RunStats {
        let Self { control, telemetry, .. } = self;
        let counter = |counter| control.counter(counter);
        let mut window = telemetry.window;
        window.sample(&control);
        RunStats {
            started_nanos,
            ended_nanos: monotonic_nanos(),
            asked_frames: self.asked_frames,
            written_frames: control.written_frames(),
            tiles: TileStats::of(&control),
            frames_unsettled: counter(Counter::FramesUnsettled),
            events_dropped: counter(Counter::EventsDropped),
            trees_cut_short: counter(Counter::TreesCutShort),
            clock_start_nanos: control.clock_start(),
            shared_memory_bytes: plan.layout.total_bytes() + self.ring.as_ref().map_or(0, FrameRing::total_bytes),
            prefetch: PrefetchStats::of(&control, window),
            collector: telemetry.collector,
            memory: telemetry.memory,
            pids: self.pids,
            restarts: self.restarts,
            poses: self.poses,
            phases: self.phases,
        }
    }
}
