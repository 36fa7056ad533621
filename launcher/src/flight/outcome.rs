//! How a flight ended: its results get their names, or a sentence says why not, and what is left.

use super::frames;
use super::kept::Kept;
use super::progress::Progress;
use super::restart::death_message;
use super::supervisor::{Death, Ending};
use crate::failure::{ExitStatus, Failure};
use crate::measure::report::network::main_failure;
use crate::measure::report::{self, report, summary};
use crate::measure::stats::RunStats;
use crate::measure::trace;
use crate::output::TemporaryFile;
use crate::plan::FlightPlan;
use anyhow::anyhow;
use terravision_common::shm::Stage;

/// Ends a flight. `truncated` is a segment that another program has truncated.
///
/// # Errors
/// Every ending but that of a flight all of whose frames are as its mode promises.
pub(super) fn conclude(
    ending: Ending,
    plan: FlightPlan,
    stats: &RunStats,
    kept: &Kept,
    truncated: Option<&str>,
    progress: &Progress,
) -> Result<(), Failure> {
    match ending {
        Ending::Finished => finished(plan, stats, progress),
        Ending::Interrupted => {
            // Of files those count that are there: more may have been written than the renderer had
            // time to tell.
            let written = kept.count().unwrap_or(stats.written_frames);
            let (asked, rest) = (frames(stats.asked_frames), kept.clause(&plan));
            let error = anyhow!("interrupted after {written} of {asked}{rest}");
            Err(Failure { status: ExitStatus::Interrupted, error })
        }
        Ending::Died(death) => {
            let error = anyhow!("{}{}", what_died(&death, stats, truncated), kept.clause(&plan));
            if death.restarts > 0 {
                write_report_of_troubled_flight(plan, stats, progress);
            }
            Err(if death.is_bad_input { Failure::bad_input(error) } else { Failure::failed(error) })
        }
    }
}

/// Which stage died and how, and what may be behind it.
fn what_died(death: &Death, stats: &RunStats, truncated: Option<&str>) -> String {
    let Death { stage, how, message, is_bad_input, restarts } = death;
    let mut text = death_message(*stage, how, message);
    if let Some(name) = truncated {
        text += &format!(" (its shared memory, /dev/shm/{name}, was truncated by another program)");
    } else if how.contains("bus error") {
        text += " (is /dev/shm full, or was its shared memory truncated?)";
    }
    if let Some(why) = main_failure(stats).filter(|_| *stage == Stage::Preparer && !is_bad_input) {
        text += &format!(" ({why})");
    }
    if *restarts > 0 {
        let times = if *restarts == 1 { "once".to_owned() } else { format!("{restarts} times") };
        text += &format!(" (stages were started again {times} within a minute)");
    }
    text
}

/// Also of a flight that failed after restarts: the report says that it is not complete.
fn write_report_of_troubled_flight(plan: FlightPlan, stats: &RunStats, progress: &Progress) {
    let report = report(&plan.config, stats);
    let write = |file: TemporaryFile| file.finish_with(|writer| report::write(&report, writer));
    if let Some(Err(error)) = plan.report.map(write) {
        progress.warn(&error.to_string());
    }
}

/// Gives the results their names, writes report and trace, says how it went.
fn finished(plan: FlightPlan, stats: &RunStats, progress: &Progress) -> Result<(), Failure> {
    let asked = stats.asked_frames;
    // Who closes a window before the first picture has seen enough.
    if asked == 0 && plan.config.render.window.is_none() {
        return Err(Failure::failed(anyhow!("no pose came before the end of the flight")));
    }
    if stats.written_frames < asked {
        return Err(Failure::failed(anyhow!("the flight ended after {} of {}", stats.written_frames, frames(asked))));
    }
    let report = report(&plan.config, stats);
    for file in plan.files {
        file.finish().map_err(Failure::failed)?;
    }
    if let Some(file) = plan.report {
        file.finish_with(|writer| report::write(&report, writer)).map_err(Failure::failed)?;
    }
    if let Some(file) = plan.trace {
        file.finish_with(|writer| trace::write(writer, stats)).map_err(Failure::failed)?;
    }
    summary::network_summary(&report).iter().for_each(|summary| progress.say(summary));
    let has_sizes = plan.config.render.window.as_ref().is_some_and(|window| window.has_sizes);
    let summary = summary::summary(&report, stats.collector.forgotten(), has_sizes);
    progress.say(&format!("{summary} → {}", plan.destination));
    if report.is_as_promised() {
        return Ok(());
    }
    let told = summary::unavailable(&report).unwrap_or_else(|| "not every frame has all of its tiles".to_owned());
    Err(Failure { status: ExitStatus::TilesUnavailable, error: anyhow!("{told}") })
}
