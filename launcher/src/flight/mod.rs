//! Runs the pipeline: starts the four stages, flies the camera, watches, collects, cleans up.
//!
//! ```text
//! segments made ─▶ stages started ─▶ pilot flies ─▶ stages end, renderer last ─▶ files get their names
//!                        │ a stage dies: started again, or Failed ──┐
//!                        │ Ctrl-C: Stopping ────────────────────────┴▶ stages end within 2 s, else TERM, then KILL
//! ```
//!
//! Whatever happens, no process and no segment is left: both belong to values that end them when they are dropped. Only
//! SIGKILL leaves segments; the next start removes them.

pub mod hang;
pub mod kept;
pub mod pilot;
pub mod progress;
pub mod restart;
pub mod stage;
pub mod supervisor;

use crate::data_set::FlownFrame;
use crate::failure::{ExitStatus, Failure};
use crate::measure::collector::Collector;
use crate::measure::memory::MemoryPeaks;
use crate::measure::metrics::{FrameTally, Metrics};
use crate::measure::report::network::{PrefetchFigures, WindowSpan, failure_sentences, main_failure};
use crate::measure::report::{Report, RunFigures};
use crate::measure::trace::{self, Phase};
use crate::output::{self, FrameFolder, TemporaryFile};
use crate::plan::FlightPlan;
use crate::process::{interrupt, own_folder};
use crate::stream::hang::EncoderWatch;
use crate::stream::{StreamError, StreamKeeper};
use anyhow::{Context, anyhow};
use kept::Kept;
use pilot::{Flown, Pilot};
use progress::Progress;
use restart::Restarts;
use stage::{StageProcess, StartError};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};
use supervisor::Ending;
use terravision_common::event::{Event, monotonic_nanos};
use terravision_common::run::{RaysChoice, RunConfig, TechniqueChoice};
use terravision_common::shm::{
    Consumer, Control, Counter, FrameRing, FrameShape, RunSegments, SharedName, ShmError, Stage, end_on_bus_error,
    reap_dead_runs,
};
use terravision_store::Cause;

/// Flies a plan.
///
/// # Errors
/// [`Failure`] with the exit code: a stage died, no room in shared memory, interrupted, tiles unavailable.
pub fn run(mut plan: FlightPlan, started_nanos: u64) -> Result<(), Failure> {
    let planned_nanos = monotonic_nanos();
    let mut progress = Progress::new(plan.cameras.len() as u64, plan.is_quiet);
    let removed = reap_dead_runs();
    if !removed.is_empty() {
        progress.say(&format!("removed {} shared-memory segments of runs that were killed", removed.len()));
    }
    for note in &plan.notes {
        progress.say(&format!("note: {note}"));
    }
    for warning in &plan.warnings {
        progress.warn(warning);
    }
    interrupt::listen().context("cannot listen for Ctrl-C").map_err(Failure::failed)?;
    supervisor::adopt_orphans();

    let ring = frame_ring(&plan)?;
    let segments = RunSegments::create(&plan.run, &plan.layout).map_err(no_segments)?;
    guard_against_truncation(&plan, &segments, ring.as_ref());
    let mut run = Run::open(&plan, ring)?;
    run.phases.push(Phase::own("plan", started_nanos, planned_nanos));
    run.phases.push(Phase::own("set up", planned_nanos, monotonic_nanos()));
    run.collector.note_told(&plan.warnings);
    if let Some(live) = &plan.live {
        progress.say(&format!("waiting for poses at {}", live.input.place()));
    }
    if let Some(socket) = plan.metrics.take() {
        progress.say(&format!("figures of the run: http://{}/metrics", socket.address()));
        socket.warning().iter().for_each(|warning| progress.warn(warning));
        let tally = Arc::new(Mutex::new(FrameTally::new(&plan.config)));
        run.metrics = Some(Metrics::start(socket, &plan, tally).map_err(Failure::failed)?);
    }
    let ending = match run.fly(&mut plan, &progress) {
        Ok(ending) => ending,
        Err(failure) => {
            // All stages have ended, and with them whoever they had started.
            supervisor::end_orphans();
            remove_partials(&plan, &run.pids);
            return Err(failure);
        }
    };
    let figures = run.close(&plan, started_nanos);
    for sentence in failure_sentences(&figures) {
        progress.warn(&sentence);
    }
    let cut = segments.cut_short();
    if figures.trees_cut_short > 0 && plan.config.realtime.is_none() {
        progress.warn(&format!(
            "{} of {} frames need more of the terrain's tree than there is room for: their facets and colours are coarser than \
             asked; a larger --facet-px or a smaller --size avoids that",
            figures.trees_cut_short,
            plan.config.frames[1].saturating_sub(plan.config.frames[0])
        ));
    }
    drop(segments);
    supervisor::end_orphans();
    if ending != Ending::Finished || !figures.restarts.is_empty() {
        remove_partials(&plan, &figures.pids);
    }
    progress.finish();
    let kept = Kept::of(&plan);
    if let Err(failure) = kept.list(&plan, &figures, &progress) {
        if ending == Ending::Finished {
            return Err(failure);
        }
        progress.warn(&failure.to_string());
    }

    match ending {
        Ending::Finished => {}
        Ending::Interrupted => {
            return Err(Failure {
                status: ExitStatus::Interrupted,
                error: anyhow!("{}", interrupted(&plan, &figures, &kept)),
            });
        }
        Ending::Died { stage, how, words, is_bad_input, restarts } => {
            let mut sentence = restart::sentence(stage, &how, &words);
            if let Some(name) = cut {
                sentence += &format!(" (its shared memory, /dev/shm/{name}, was truncated by another program)");
            } else if how.contains("bus error") {
                sentence += " (is /dev/shm full, or was its shared memory truncated?)";
            }
            let rest = kept.clause(&plan);
            if let Some(why) = main_failure(&figures).filter(|_| stage == Stage::Preparer && !is_bad_input) {
                sentence += &format!(" ({why})");
            }
            if restarts > 0 {
                let times = if restarts == 1 { "once".to_owned() } else { format!("{restarts} times") };
                sentence += &format!(" (stages were started again {times} within a minute)");
                // What is known of so troubled a flight is worth having; that it is not complete stands in it.
                let report = Report::new(&plan.config, &figures);
                let write = |file: TemporaryFile| file.finish_with(|writer| report.write(writer));
                if let Some(Err(error)) = plan.report.map(write) {
                    progress.warn(&error.to_string());
                }
            }
            let error = anyhow!("{sentence}{rest}");
            return Err(if is_bad_input { Failure::bad_input(error) } else { Failure::failed(error) });
        }
    }
    conclude(plan, &figures, &progress)
}

/// A launcher that dies of segments that were truncated under it leaves a sentence, and nothing else.
fn guard_against_truncation(plan: &FlightPlan, segments: &RunSegments, ring: Option<&FrameRing>) {
    const SENTENCE: &str = "terravision: the flight is broken off: a file of its shared memory, /dev/shm/tv-…, was truncated by \
                            another program (bus error)";
    let mut files = segments.paths();
    files.extend(ring.map(FrameRing::path));
    files.extend(plan.live.as_ref().and_then(|live| live.input.shared_file()));
    let temporary = plan.files.iter().chain(&plan.report).chain(&plan.trace);
    files.extend(temporary.filter_map(TemporaryFile::to_remove).map(Path::to_owned));
    // Where the system refuses, it dies without a sentence, and the next start removes what it left.
    end_on_bus_error(SENTENCE, files, ExitStatus::Failed as u8).ok();
}

/// Gives the results their names, writes report and trace, says how it went.
fn conclude(plan: FlightPlan, figures: &RunFigures, progress: &Progress) -> Result<(), Failure> {
    let wanted = figures.asked_frames;
    if wanted == 0 {
        return Err(Failure::failed(anyhow!("no pose came before the end of the flight")));
    }
    if figures.written_frames < wanted {
        return Err(Failure::failed(anyhow!(
            "the flight ended after {} of {}",
            figures.written_frames,
            frames(wanted)
        )));
    }
    let report = Report::new(&plan.config, figures);
    for file in plan.files {
        file.finish().map_err(Failure::failed)?;
    }
    if let Some(file) = plan.report {
        file.finish_with(|writer| report.write(writer)).map_err(Failure::failed)?;
    }
    if let Some(file) = plan.trace {
        file.finish_with(|writer| trace::write(writer, figures)).map_err(Failure::failed)?;
    }
    report.network_summary().iter().for_each(|summary| progress.say(summary));
    progress.say(&format!("{} → {}", report.summary(), plan.destination));
    if report.is_as_expected() {
        return Ok(());
    }
    let count = report.unavailable_count();
    Err(Failure {
        status: ExitStatus::TilesUnavailable,
        error: anyhow!(
            "{count} {} could not be had and {} drawn from coarser ones; {}",
            if count == 1 { "tile" } else { "tiles" },
            if count == 1 { "was" } else { "were" },
            report.first_unavailable()
        ),
    })
}

/// Removes half files of stages that were killed.
fn remove_partials(plan: &FlightPlan, pids: &[(Stage, u32)]) {
    let folders = plan.files.iter().map(TemporaryFile::folder).chain(kept::folders(plan).map(FrameFolder::path));
    for folder in folders {
        pids.iter().for_each(|(_, pid)| output::remove_partials(folder, *pid));
    }
}

fn interrupted(plan: &FlightPlan, figures: &RunFigures, kept: &Kept) -> String {
    // Of files those count that are there: more may have been written than the renderer had time to tell.
    let written = kept.count().unwrap_or(figures.written_frames);
    format!("interrupted after {written} of {}{}", frames(figures.asked_frames), kept.clause(plan))
}

fn frames(count: u64) -> String {
    if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") }
}

fn no_segments(error: ShmError) -> Failure {
    match error {
        ShmError::NotEnoughSpace { needed, available } => Failure::failed(anyhow!(
            "shared memory is too small: the run needs {} in /dev/shm, which has {} free; give it more \
             (mount -o remount,size=2g /dev/shm, or docker run --shm-size=2g), or ask for less with --memory",
            crate::machine::bytes_for_people(needed),
            crate::machine::bytes_for_people(available)
        )),
        other => Failure::failed(other),
    }
}

/// The frame ring that other programs shall read, if one is asked for.
fn frame_ring(plan: &FlightPlan) -> Result<Option<FrameRing>, Failure> {
    let RunConfig { width, height, render, .. } = &plan.config;
    let Some(share) = &render.share else { return Ok(None) };
    let shape = FrameShape { size: [*width, *height], has_depth: share.has_depth, has_ground: share.has_ground };
    let ring = SharedName::parse(&share.name).and_then(|name| FrameRing::create(&name, shape));
    ring.map(Some).map_err(|error| match error {
        ShmError::NameTaken { .. } | ShmError::NotOurs { .. } => Failure::bad_input(error),
        error => no_segments(error),
    })
}

/// The launcher's ends of the run's segments, and what comes out of them.
struct Run {
    control: Control,
    events: Vec<(Stage, Consumer<Event>)>,
    collector: Collector,
    memory: MemoryPeaks,
    pids: Vec<(Stage, u32)>,
    restarts: BTreeMap<&'static str, u32>,
    /// Frames that were asked for: by the plan, or so far by who sends the poses.
    asked_frames: u64,
    /// Cameras of the poses that another program has sent, each a frame.
    poses: Vec<FlownFrame>,
    phases: Vec<Phase>,
    ring: Option<FrameRing>,
    window: WindowSpan,
    metrics: Option<Metrics>,
}

impl Run {
    fn open(plan: &FlightPlan, ring: Option<FrameRing>) -> Result<Self, Failure> {
        let events: Result<Vec<_>, ShmError> =
            Stage::ALL.into_iter().map(|stage| Ok((stage, Consumer::open(&plan.run, stage.events())?))).collect();
        Ok(Self {
            control: Control::open(&plan.run).map_err(Failure::failed)?,
            events: events.map_err(Failure::failed)?,
            collector: Collector::new(plan.config.frames[0], plan.cameras.len(), plan.trace.is_some())
                .open_ended(plan.live.is_some()),
            memory: MemoryPeaks::default(),
            pids: Vec::new(),
            restarts: BTreeMap::new(),
            asked_frames: plan.cameras.len() as u64,
            poses: Vec::new(),
            phases: Vec::new(),
            ring,
            window: WindowSpan::default(),
            metrics: None,
        })
    }

    /// From the start of the stages to the end of the last.
    fn fly(&mut self, plan: &mut FlightPlan, progress: &Progress) -> Result<Ending, Failure> {
        let json = serde_json::to_string(&plan.config).context("cannot write the run's configuration");
        let json = json.map_err(Failure::failed)?;
        let programs = own_folder()?;
        let begun_nanos = monotonic_nanos();
        let stream = StreamKeeper::start(&plan.config, plan.stream.as_ref()).map_err(Failure::failed)?;
        // What the renderer's standard output is connected with.
        let stdout_of = |stage: Stage| match &stream {
            Some(stream) if stage == Stage::Renderer => stream.pipe().map(Some),
            _ => Ok(None),
        };
        let start = |stage| {
            let stdout = stdout_of(stage).map_err(|source| StartError::no_pipe(stage, &programs, source))?;
            StageProcess::start(stage, &programs, &json, stdout)
        };
        if plan.restarts.limit > 0 {
            self.control.set_supervised();
        }
        let mut stages = Vec::new();
        for stage in Stage::ALL {
            stages.push(start(stage).map_err(Failure::failed)?);
        }
        let flying_nanos = monotonic_nanos();
        self.phases.push(Phase::own("start stages", begun_nanos, flying_nanos));
        self.control.set_resolutions(plan.config.r_z_px, plan.config.r_c_px);
        self.pids = stages.iter().map(|stage| (stage.stage(), stage.pid())).collect();
        let pids = &mut self.pids;
        let mut start_again = |stage| {
            let started = start(stage)?;
            pids.push((stage, started.pid()));
            Ok(started)
        };
        let mut say = |sentence: &str| progress.warn(sentence);
        let mut restarts = Restarts::new(plan.restarts, &mut start_again, &mut say);
        let is_live = plan.live.is_some();
        let is_waiting = plan.config.realtime.is_some();
        // What draws is left to the renderer, who knows the devices; that it is not the usual is worth a word.
        let mut may_tell_of_rays = plan.config.render.technique == TechniqueChoice::Auto;
        // So is, in real time, what casts rays.
        let samples = if plan.asks_for_samples { plan.config.render.samples } else { 1 };
        let mut may_tell_of_choice = plan.config.render.rays == RaysChoice::Auto && plan.config.realtime.is_some();
        let times = self.ring.as_ref().map(FrameRing::pose_times);
        let pilot = Pilot::start(plan, times).map_err(Failure::failed)?;
        let Self { control, events, collector, memory, window, metrics, .. } = self;
        // The pilot ends a live flight in order at the first Ctrl-C.
        let is_interrupted = || interrupt::count() > u32::from(is_live);
        let has_stream_failed = || stream.as_ref().is_some_and(StreamKeeper::has_failed);
        let is_broken_off = || is_interrupted() || has_stream_failed() || pilot.failure().is_some();
        let is_output_blocked = || stream.as_ref().is_some_and(StreamKeeper::is_blocked);
        let mut encoder_watch = EncoderWatch::new(plan.restarts.hang.after);
        let encoder = stream.as_ref().and_then(StreamKeeper::encoder_pid);
        let look = &mut |stages: &[StageProcess]| {
            if let Some(stream) = &stream {
                encoder_watch.look(stream, false);
            }
            drain(events, collector, metrics.as_ref(), control);
            may_tell_of_rays = may_tell_of_rays && !tell_of_rays(collector, samples, progress);
            if let Some(Ok(words)) = collector.rays().filter(|_| may_tell_of_choice) {
                may_tell_of_choice = false;
                tell_of_choice(collector, &words, progress);
            }
            tell_of_failures(collector, is_waiting && control.clock_start().is_none(), progress);
            memory.sample(stages, encoder);
            window.sample(control);
            progress.show(control.written_frames());
            pilot.words().for_each(|sentence| progress.warn(&sentence));
        };
        let ending = supervisor::watch(&mut stages, control, &is_broken_off, &is_output_blocked, &mut restarts, look);
        self.restarts = restarts.counts().clone();
        let landed_nanos = monotonic_nanos();
        self.phases.push(Phase::own("fly", flying_nanos, landed_nanos));
        let has_stream_failed = has_stream_failed();
        // The pilot's wait ends with the run.
        if ending == Ending::Finished {
            control.set_state(terravision_common::shm::RunState::Stopping);
        }
        let (Flown { frames: flown, poses }, words, pilot_failure) = pilot.join();
        words.iter().for_each(|sentence| progress.warn(sentence));
        drain(&mut self.events, &mut self.collector, self.metrics.as_ref(), &self.control);
        if may_tell_of_rays {
            tell_of_rays(&self.collector, samples, progress);
        }
        if let Some(Ok(words) | Err(words)) = self.collector.rays().filter(|_| may_tell_of_choice) {
            tell_of_choice(&self.collector, &words, progress);
        }
        // Against the clock, a flight of poses has the frames that were drawn until it was ended.
        let drawn = (is_live && flown.is_none()).then(|| self.control.written_frames());
        if let Some(drawn) = drawn {
            self.collector.frames.truncate(usize::try_from(drawn).unwrap_or(usize::MAX));
        }
        self.asked_frames = flown.or(drawn).unwrap_or(self.asked_frames);
        self.collector.note_poses(&poses);
        self.poses = poses;
        if ending == Ending::Finished {
            for stage in &stages {
                for line in stage.lines() {
                    progress.warn(&format!("{}: {line}", stage.stage()));
                }
            }
        }
        if let Some(error) = pilot_failure {
            return Err(Failure::failed(error));
        }
        if let Some(stream) = stream.filter(|_| ending == Ending::Finished || has_stream_failed) {
            let finished = stream.finish(&is_interrupted, &mut encoder_watch);
            let completed_nanos = monotonic_nanos();
            self.phases.push(Phase::own("complete", landed_nanos, completed_nanos));
            self.phases.extend(encoder.map(|pid| Phase::encoder(pid, begun_nanos, completed_nanos)));
            match finished {
                Err(StreamError::Interrupted) => return Ok(Ending::Interrupted),
                finished => finished.map_err(Failure::failed)?,
            }
        }
        Ok(ending)
    }

    fn close(self, plan: &FlightPlan, started_nanos: u64) -> RunFigures {
        let counter = |counter| self.control.counter(counter);
        let mut window = self.window;
        window.sample(&self.control);
        RunFigures {
            started_nanos,
            ended_nanos: monotonic_nanos(),
            asked_frames: self.asked_frames,
            written_frames: self.control.written_frames(),
            tiles_wanted: counter(Counter::TilesWanted),
            tiles_loaded: counter(Counter::TilesLoaded),
            tiles_evicted: counter(Counter::TilesEvicted),
            tiles_uploaded: counter(Counter::TilesUploaded),
            tiles_unavailable: counter(Counter::TilesUnavailable),
            frames_unsettled: counter(Counter::FramesUnsettled),
            events_dropped: counter(Counter::EventsDropped),
            trees_cut_short: counter(Counter::TreesCutShort),
            clock_start_nanos: self.control.clock_start(),
            shared_memory_bytes: plan.layout.total_bytes() + self.ring.as_ref().map_or(0, FrameRing::total_bytes),
            prefetch: PrefetchFigures::of(&self.control),
            window,
            collector: self.collector,
            memory: self.memory,
            pids: self.pids,
            restarts: self.restarts,
            poses: self.poses,
            phases: self.phases,
        }
    }
}

/// Tells the user when rays are cast because there is no device. Whether it is known what draws.
fn tell_of_rays(collector: &Collector, samples: u32, progress: &Progress) -> bool {
    let Some(technique) = collector.technique() else { return false };
    if technique == TechniqueChoice::Rays.name() {
        progress.warn(&format!(
            "no Vulkan device can be used here; the ground is drawn by rays, on the processor ({}); --technique mesh says \
             what is missing",
            collector.device()
        ));
        if samples > 1 {
            progress.warn(&format!("one ray is cast per pixel, in place of {samples} samples; a mesh has them"));
        }
    }
    true
}

/// Tells the user what was chosen to cast rays, where that was left open.
fn tell_of_choice(collector: &Collector, words: &str, progress: &Progress) {
    progress.say(&format!("--rays auto: {}, {words}", collector.device()));
}

/// Tells of what goes wrong when it happens for the first time; how often it did is told at the end. `is_waiting`: no picture can be
/// drawn yet.
fn tell_of_failures(collector: &mut Collector, is_waiting: bool, progress: &Progress) {
    for (cause, sentence) in collector.take_untold_failures() {
        let then = match Cause::from_name(&cause) {
            // What asking again does not change.
            None | Some(Cause::Cache | Cause::Touched | Cause::Offline | Cause::Changed | Cause::Closed) => "",
            Some(_) if is_waiting => "; the flight begins when the coarsest tiles are there",
            Some(cause) if cause.is_passing() => "; it is asked again",
            Some(_) => "",
        };
        progress.warn(&format!("{sentence}{then}"));
    }
}

fn drain(
    events: &mut [(Stage, Consumer<Event>)],
    collector: &mut Collector,
    metrics: Option<&Metrics>,
    control: &Control,
) {
    let mut tally = metrics.map(Metrics::tally);
    let clock_start = control.clock_start();
    for (stage, ring) in events {
        // At most a ring full at a time, so that a stage that floods its ring cannot keep the launcher from watching.
        for _ in 0..ring.capacity() {
            match ring.try_pop() {
                Ok(Some(event)) => {
                    tally.iter_mut().for_each(|tally| tally.take(&event, clock_start));
                    collector.take(*stage, event);
                }
                Ok(None) => break,
                Err(_corrupt) => {
                    collector.strange_events += 1;
                    break;
                }
            }
        }
    }
}
