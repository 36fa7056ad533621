//! Watches the stages of a run: notices one that dies, has it started again or ends them all, and passes on an
//! interruption.

use super::hang::Hang;
use super::restart::Restarts;
use super::stage::StageProcess;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::{Duration, Instant};
use terravision_common::shm::{Control, RunState, Stage};

/// Longest time between two looks at the stages and their events; the death of a stage wakes sooner.
const TICK: Duration = Duration::from_millis(20);
/// After this time a stage that was told to stop is sent TERM...
const TERM_AFTER: Duration = Duration::from_millis(400);
/// ... and after this KILL. The whole end stays well below two seconds.
const KILL_AFTER: Duration = Duration::from_millis(1000);
/// A stage that was stopped by a signal is taken for a death only when this program hears of no signal within this time:
/// Ctrl-C goes to all processes of a terminal, and a stage may be the quicker one.
const SIGNAL_GRACE: Duration = Duration::from_millis(200);
/// How long the rest may take in good order after the renderer is done.
const REST_AFTER: Duration = Duration::from_millis(3000);

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// All stages ended by themselves, in good order.
    Finished,
    /// The user interrupted it.
    Interrupted,
    /// A stage died or gave up.
    Died {
        /// Which.
        stage: Stage,
        /// How, in words.
        how: String,
        /// What it said last; may be empty.
        words: String,
        /// Whether it gave up over bad input (exit code 2).
        is_bad_input: bool,
        /// Stages that were started again within the minute before.
        restarts: u32,
    },
}

/// Watches until all stages have ended, which they do within two seconds of the first death that `restarts` do not mend,
/// or of an interruption. `tick` is called at least every 20 ms while they run, `is_interrupted` tells of Ctrl-C or TERM,
/// `is_output_blocked` of pictures that wait for a program that is no stage.
pub fn watch(
    stages: &mut [StageProcess],
    control: &Control,
    is_interrupted: &dyn Fn() -> bool,
    is_output_blocked: &dyn Fn() -> bool,
    restarts: &mut Restarts<'_>,
    tick: &mut dyn FnMut(&[StageProcess]),
) -> Ending {
    let mut ending: Option<Ending> = None;
    let mut deadline: Option<Instant> = None;
    let mut first_stopped: Option<Instant> = None;
    loop {
        let mut ended: Vec<Option<ExitStatus>> = stages.iter_mut().map(StageProcess::poll).collect();
        tick(stages);
        // With all frames written, whoever dies is not missed where the dead are started again.
        let is_done = stages.iter().zip(&ended).any(|(stage, status)| is_renderer_done(stage, *status));
        let is_flying = control.state() == RunState::Running && !is_interrupted();
        if ending.is_none() && is_flying && !is_done {
            let hang = restarts.kill_what_hangs(stages, control, is_output_blocked);
            // It may take a while to be gone, and those that wait for it may give up meanwhile.
            ending = hang.filter(|_| !restarts.is_on()).map(|Hang { stage, how }| {
                let place = stages.iter().find(|place| place.stage() == stage);
                let words = place.map(StageProcess::last_words).unwrap_or_default();
                Ending::Died { stage, how, words, is_bad_input: false, restarts: 0 }
            });
        }
        if ending.is_none() && is_flying && !is_done {
            ending = revive(stages, &mut ended, control, restarts);
        }
        if ending.is_some() && deadline.is_none() {
            control.set_state(RunState::Failed);
            deadline = Some(Instant::now());
        }
        let mut has_unexplained = false;
        if ending.is_none() {
            let is_over = control.state() == RunState::Finished;
            let death =
                ended.iter().zip(stages.iter()).filter_map(|(status, stage)| death_of(stage, (*status)?, restarts));
            // A stage that leaves when the flight is over says so by the same exit code.
            let death = death.filter(|(weight, _)| *weight > STOPPED || !is_over);
            let death = death.filter(|_| !is_done || !restarts.is_on());
            let death = death.max_by_key(|(weight, _)| *weight);
            has_unexplained = death.is_some();
            let death = death.filter(|(weight, _)| {
                !matches!(*weight, STOPPED | SIGNALLED)
                    || first_stopped.get_or_insert_with(Instant::now).elapsed() > SIGNAL_GRACE
            });
            if is_interrupted() {
                control.set_state(RunState::Stopping);
                ending = Some(Ending::Interrupted);
            } else if let Some((_, death)) = death {
                control.set_state(RunState::Failed);
                ending = Some(death);
            }
            if ending.is_some() {
                deadline = Some(Instant::now());
            }
        }
        if ended.iter().all(Option::is_some) && (ending.is_some() || !has_unexplained) {
            return ending.unwrap_or(Ending::Finished);
        }
        let is_renderer_done = stages.iter().zip(&ended).any(|(s, e)| s.stage() == Stage::Renderer && e.is_some());
        if is_renderer_done && deadline.is_none() {
            // All frames are written. The others are done too, and need no more than a moment.
            deadline = Some(Instant::now() + REST_AFTER);
        }
        if let Some(waited) = deadline.and_then(|deadline| Instant::now().checked_duration_since(deadline)) {
            let signal =
                if waited > KILL_AFTER { Some(Signal::KILL) } else { (waited > TERM_AFTER).then_some(Signal::TERM) };
            if let Some(signal) = signal {
                // A stage that does not end by itself after all frames are written is no reason to lose them.
                ending.get_or_insert(Ending::Finished);
                stages.iter_mut().for_each(|stage| stage.signal(signal));
            }
        }
        wait_for_an_end(stages);
    }
}

fn is_renderer_done(stage: &StageProcess, status: Option<ExitStatus>) -> bool {
    stage.stage() == Stage::Renderer && status.is_some_and(|status| status.success())
}

/// Has the dead started again, as far as that may help. The ending, when one does not start.
fn revive(
    stages: &mut [StageProcess],
    ended: &mut [Option<ExitStatus>],
    control: &Control,
    restarts: &mut Restarts<'_>,
) -> Option<Ending> {
    for (place, ended) in stages.iter_mut().zip(ended) {
        let Some(status) = *ended else { continue };
        if restarts.is_waiting(place.stage()) {
            // The longest wait for it is over soon; meanwhile it is not missed.
            *ended = None;
            if let Err(error) = restarts.revive(place) {
                let (stage, how, words) = (place.stage(), "was not started again".to_owned(), error.to_string());
                return Some(Ending::Died { stage, how, words, is_bad_input: false, restarts: restarts.recent() });
            }
            continue;
        }
        let Some((weight, Ending::Died { how, is_bad_input: false, .. })) = death_of(place, status, restarts) else {
            continue;
        };
        // A stage that gives up before there is a picture would give up again; so would one that was told to stop.
        let is_given_up = status.code().is_some_and(|code| code != PANICKED) && control.completed_sequence() == 0;
        if weight == STOPPED || is_given_up {
            continue;
        }
        // A signal that a terminal sends may come to this program in a moment, too.
        let least = if weight == SIGNALLED { SIGNAL_GRACE } else { Duration::ZERO };
        if restarts.take_up(place, &how, least, control) {
            *ended = None;
        }
    }
    None
}

/// Sleeps until a stage ends, but no longer than a tick.
fn wait_for_an_end(stages: &[StageProcess]) {
    let mut fds: Vec<PollFd<'_>> =
        stages.iter().filter_map(StageProcess::pidfd).map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)).collect();
    let tick = Timespec { tv_sec: 0, tv_nsec: TICK.subsec_nanos().into() };
    if fds.is_empty() || poll(&mut fds, Some(&tick)).is_err() {
        std::thread::sleep(TICK);
    }
}

/// Weight of the end of a stage that was told to stop.
const STOPPED: u32 = 0;
/// Weight of the death of a stage that gave up: maybe over one that is gone.
const GAVE_UP: u32 = 1;
/// Weight of the death of a stage by a signal that a whole group gets.
const SIGNALLED: u32 = 2;
/// Exit code of a Rust program that panicked.
const PANICKED: i32 = 101;

/// The death that this end of a stage is, if it is none in good order, and how much it tells: when several stages are
/// dead at once, one that was killed brought down those that gave up.
fn death_of(stage: &StageProcess, status: ExitStatus, restarts: &Restarts<'_>) -> Option<(u32, Ending)> {
    let (weight, how) = match (status.code(), status.signal()) {
        (Some(0), _) => return None,
        (Some(2), _) => (3, "found bad input".to_owned()),
        (Some(130 | 143), _) => (STOPPED, "was stopped by a signal".to_owned()),
        (Some(code), _) => (GAVE_UP, format!("ended with exit code {code}")),
        (None, Some(signal @ (HUP | INT | TERM))) => (SIGNALLED, killed_by(signal)),
        (None, Some(signal)) => (4, killed_by(signal)),
        (None, None) => (GAVE_UP, "ended".to_owned()),
    };
    let is_bad_input = status.code() == Some(2);
    let how = restarts.hang_of(stage).unwrap_or(how);
    let (stage, words, restarts) = (stage.stage(), stage.last_words(), restarts.recent());
    Some((weight, Ending::Died { stage, how, words, is_bad_input, restarts }))
}

const HUP: i32 = 1;
const INT: i32 = 2;
const TERM: i32 = 15;

fn killed_by(signal: i32) -> String {
    format!("was killed by signal {signal}{}", signal_name(signal))
}

/// What a signal means, in brackets, for those that a person may wonder at.
#[must_use]
pub fn signal_name(signal: i32) -> &'static str {
    match signal {
        HUP => " (HUP)",
        INT => " (INT)",
        4 => " (illegal instruction)",
        6 => " (aborted)",
        7 => " (bus error)",
        9 => " (KILL)",
        11 => " (segmentation fault)",
        13 => " (PIPE)",
        TERM => " (TERM)",
        24 => " (XCPU: the limit of processor time, ulimit -t)",
        25 => " (XFSZ: the limit of a file's size, ulimit -f)",
        31 => " (SYS: a system call that is not allowed)",
        _ => "",
    }
}

/// Kills what the stages have left behind: with this process as the reaper of its descendants, an orphan of a stage (an
/// encoder, say) is now a child of it.
pub fn end_orphans() {
    let end = Instant::now() + Duration::from_millis(300);
    while let Some(children) = own_children().filter(|children| !children.is_empty()) {
        let is_late = Instant::now() > end;
        for pid in children {
            if is_late {
                kill_process(pid, Signal::KILL).ok();
            }
            waitpid(Some(pid), WaitOptions::NOHANG).ok();
        }
        if Instant::now() > end + Duration::from_millis(300) {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Makes this process the parent of orphans below it, so that nothing that a stage started outlives the run unseen.
pub fn adopt_orphans() {
    // Where it is refused, orphans end by themselves when their pipes close.
    rustix::process::set_child_subreaper(Some(rustix::process::getpid())).ok();
}

fn own_children() -> Option<Vec<Pid>> {
    children_of(std::process::id())
        .map(|children| children.into_iter().filter_map(|pid| Pid::from_raw(pid.cast_signed())).collect())
}

/// Process ids of the children of a process; `None` where the kernel does not tell.
#[must_use]
pub fn children_of(pid: u32) -> Option<Vec<u32>> {
    let mut children = Vec::new();
    for task in std::fs::read_dir(format!("/proc/{pid}/task")).ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("children")).ok()?;
        children.extend(text.split_whitespace().filter_map(|word| word.parse::<u32>().ok()));
    }
    Some(children)
}
