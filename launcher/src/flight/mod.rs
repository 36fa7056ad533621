//! Runs the pipeline: starts the four stages, flies the camera, watches, collects, cleans up.
//!
//! ```text
//! segments made ─▶ stages started ─▶ pilot flies ─▶ stages end, renderer last ─▶ files get their names
//!                        │ a stage dies: started again, or Failed ──┐
//!                        │ Ctrl-C: Stopping ────────────────────────┴▶ stages end within 2 s, else TERM, then KILL
//! ```
//!
//! Whatever happens, no process and no segment is left: both belong to values that end them when
//! they are dropped. Only SIGKILL leaves segments; the next start removes them.
//!
//! * [`mod@run`]: the launcher's ends of the segments; starts the stages and watches them.
//!   [`pilot`]: the camera.
//! * [`stage`]: one process; [`supervisor`], [`restart`], [`hang`]: what becomes of one that dies
//!   or hangs.
//! * [`outcome`], [`kept`]: how a flight ended, and what it leaves. [`notices`], [`progress`]: what
//!   the user is told meanwhile.

pub mod hang;
pub mod kept;
mod notices;
mod outcome;
pub mod pilot;
pub mod progress;
pub mod restart;
mod run;
mod segments;
pub mod stage;
pub mod supervisor;
mod telemetry;

use crate::failure::Failure;
use crate::measure::report::network::failure_messages;
use crate::measure::stats::RunStats;
use crate::measure::trace::Phase;
use crate::output::{self, FrameFolder, TemporaryFile};
use crate::plan::FlightPlan;
use crate::process::{interrupt, orphans};
use anyhow::Context;
use kept::Kept;
use progress::Progress;
use run::Run;
use supervisor::Ending;
use terravision_common::event::monotonic_nanos;
use terravision_common::shm::{RunSegments, Stage, reap_dead_runs};

/// Flies a plan.
///
/// # Errors
/// [`Failure`] with the exit code: a stage died, no room in shared memory, interrupted, tiles
/// unavailable.
pub fn run(mut plan: FlightPlan, started_nanos: u64) -> Result<(), Failure> {
    let planned_nanos = monotonic_nanos();
    let mut progress = Progress::new(plan.cameras.len() as u64, plan.is_quiet);
    announce(&plan, &progress);
    interrupt::listen().context("cannot listen for Ctrl-C").map_err(Failure::failed)?;
    orphans::adopt_orphans();

    let ring = segments::frame_ring(&plan)?;
    let segments = RunSegments::create(&plan.run, &plan.layout).map_err(segments::not_created)?;
    segments::guard_against_truncation(&plan, &segments, ring.as_ref());
    let mut run = Run::open(&plan, ring)?;
    run.phases.push(Phase::own("plan", started_nanos, planned_nanos));
    run.phases.push(Phase::own("set up", planned_nanos, monotonic_nanos()));
    // Poses come from its own window, else from a program that the user starts.
    if let Some(live) = plan.live.as_ref().filter(|_| plan.config.render.window.is_none()) {
        progress.say(&format!("waiting for poses at {}", live.input.place()));
    }
    run.serve_metrics(&mut plan, &progress)?;
    let ending = match run.fly(&mut plan, &progress) {
        Ok(ending) => ending,
        Err(failure) => {
            // All stages have ended, and with them their child processes.
            orphans::end_orphans();
            remove_partials(&plan, run.pids());
            return Err(failure);
        }
    };
    let stats = run.close(&plan, started_nanos);
    warn_of_what_was_lacking(&plan, &stats, &progress);
    let truncated = segments.cut_short();
    drop(segments);
    orphans::end_orphans();
    if ending != Ending::Finished || !stats.restarts.is_empty() {
        remove_partials(&plan, &stats.pids);
    }
    progress.finish();
    let kept = Kept::of(&plan);
    if let Err(failure) = kept.list(&plan, &stats, &progress) {
        if ending == Ending::Finished {
            return Err(failure);
        }
        progress.warn(&failure.to_string());
    }
    outcome::conclude(ending, plan, &stats, &kept, truncated.as_deref(), &progress)
}

/// What the user is told before the flight.
fn announce(plan: &FlightPlan, progress: &Progress) {
    let removed = reap_dead_runs();
    if !removed.is_empty() {
        progress.say(&format!("removed {} shared-memory segments of runs that were killed", removed.len()));
    }
    plan.notes.iter().for_each(|note| progress.note(note));
    plan.warnings.iter().for_each(|warning| progress.warn(warning));
}

/// What the user is told after the flight, whatever its end.
fn warn_of_what_was_lacking(plan: &FlightPlan, stats: &RunStats, progress: &Progress) {
    failure_messages(stats).iter().for_each(|message| progress.warn(message));
    if stats.trees_cut_short > 0 && plan.config.realtime.is_none() {
        progress.warn(&format!(
            "{} of {} frames need more of the terrain's tree than there is room for: their facets and colours are coarser than \
             asked; a larger --facet-px or a smaller --size avoids that",
            stats.trees_cut_short,
            plan.config.frames[1].saturating_sub(plan.config.frames[0])
        ));
    }
}

/// Removes half files of stages that were killed.
fn remove_partials(plan: &FlightPlan, pids: &[(Stage, u32)]) {
    let folders = plan.files.iter().map(TemporaryFile::folder).chain(kept::folders(plan).map(FrameFolder::path));
    for folder in folders {
        pids.iter().for_each(|(_, pid)| output::remove_partials(folder, *pid));
    }
}

/// A number of frames, for people.
fn frames(count: u64) -> String {
    if count == 1 { "1 frame".to_owned() } else { format!("{count} frames") }
}
