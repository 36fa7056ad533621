//! Watches the stages of a run: notices one that dies, has it started again or ends them all, and
//! passes on an interruption.

use super::hang::Hang;
use super::restart::Restarts;
use super::stage::StageProcess;
use crate::process::interrupt;
use crate::process::signals::{HUP, INT, TERM, killed_by};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::Signal;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;
use std::time::{Duration, Instant};
use terravision_common::ids::Sequence;
use terravision_common::shm::{Control, RunState, Stage};

/// Longest time between two looks at the stages and their events; the death of a stage wakes
/// sooner.
const TICK: Duration = Duration::from_millis(20);
/// After this time a stage that was told to stop is sent TERM...
const TERM_AFTER: Duration = Duration::from_millis(400);
/// ... and after this KILL. The whole end stays well below two seconds.
const KILL_AFTER: Duration = Duration::from_millis(1000);
/// A stage that was stopped by a signal is taken for a death only when this program hears of no
/// signal within this time: Ctrl-C goes to all processes of a terminal, and a stage may be the
/// quicker one.
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
    Died(Death),
}

/// The death of a stage.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Death {
    /// Which.
    pub stage: Stage,
    /// How: words that follow its name.
    pub how: String,
    /// Its last message; may be empty.
    pub message: String,
    /// Whether it gave up over bad input (exit code 2).
    pub is_bad_input: bool,
    /// Stages that were started again within the minute before.
    pub restarts: u32,
}

/// Watches until all stages have ended, which they do within two seconds of the first death that
/// `restarts` do not mend, or of an interruption. `tick` is called at least every 20 ms while they
/// run, `is_interrupted` tells of Ctrl-C or TERM, `is_output_blocked` of pictures that wait for a
/// program that is not a stage.
pub fn watch(
    stages: &mut [StageProcess],
    control: &Control,
    is_interrupted: &dyn Fn() -> bool,
    is_output_blocked: &dyn Fn() -> bool,
    restarts: &mut Restarts<'_>,
    tick: &mut dyn FnMut(&[StageProcess]),
) -> Ending {
    let mut watch =
        Watch { control, is_interrupted, is_output_blocked, ending: None, deadline: None, first_stopped: None };
    loop {
        let mut ended: Vec<Option<ExitStatus>> = stages.iter_mut().map(StageProcess::poll).collect();
        tick(stages);
        if watch.ending.is_none() {
            watch.mend(stages, &mut ended, restarts);
        }
        let has_unexplained = watch.ending.is_none() && watch.judge(stages, &ended, restarts);
        if ended.iter().all(Option::is_some) && (watch.ending.is_some() || !has_unexplained) {
            return watch.ending.unwrap_or(Ending::Finished);
        }
        watch.hurry(stages, &ended);
        wait_for_an_end(stages);
    }
}

/// A watch over the stages of a run.
struct Watch<'a> {
    control: &'a Control,
    is_interrupted: &'a dyn Fn() -> bool,
    is_output_blocked: &'a dyn Fn() -> bool,
    ending: Option<Ending>,
    /// From here on stages are to end.
    deadline: Option<Instant>,
    /// When a stage was first seen that a signal had stopped.
    first_stopped: Option<Instant>,
}

impl Watch<'_> {
    fn end(&mut self, state: RunState, ending: Ending) {
        self.control.set_state(state);
        self.ending = Some(ending);
        self.deadline = Some(Instant::now());
    }

    /// Kills what hangs, and has the dead started again where the rules allow it.
    fn mend(&mut self, stages: &mut [StageProcess], ended: &mut [Option<ExitStatus>], restarts: &mut Restarts<'_>) {
        let is_flying = self.control.state() == RunState::Running && !(self.is_interrupted)();
        // With all frames written, a death no longer matters where stages are restarted.
        if !is_flying || is_done(stages, ended) {
            return;
        }
        let hang = restarts.kill_what_hangs(stages, self.control, self.is_output_blocked);
        // It may take a while to be gone, and those that wait for it may give up meanwhile.
        let death = hang.filter(|_| !restarts.is_on()).map(|Hang { stage, how }| {
            let place = stages.iter().find(|place| place.stage() == stage);
            let message = place.map(StageProcess::last_message).unwrap_or_default();
            Death { stage, how, message, is_bad_input: false, restarts: 0 }
        });
        if let Some(death) = death.or_else(|| revive(stages, ended, self.control, restarts)) {
            self.end(RunState::Failed, Ending::Died(death));
        }
    }

    /// Ends the run over an interruption, or over the death that tells most. Whether there is a
    /// death that may yet turn out to be an interruption.
    fn judge(&mut self, stages: &[StageProcess], ended: &[Option<ExitStatus>], restarts: &Restarts<'_>) -> bool {
        let is_over = self.control.state() == RunState::Finished;
        let is_missed = !is_done(stages, ended) || !restarts.is_on();
        let deaths = ended.iter().zip(stages).filter_map(|(status, stage)| death_of(stage, (*status)?, restarts));
        // A stage that leaves when the flight is over says so by the same exit code.
        let deaths = deaths.filter(|(weight, _)| (*weight > STOPPED || !is_over) && is_missed);
        let Some((weight, death)) = deaths.max_by_key(|(weight, _)| *weight) else {
            if (self.is_interrupted)() {
                self.end(RunState::Stopping, Ending::Interrupted);
            }
            return false;
        };
        let is_sure = !matches!(weight, STOPPED | SIGNALLED)
            || self.first_stopped.get_or_insert_with(Instant::now).elapsed() > SIGNAL_GRACE;
        if (self.is_interrupted)() || is_told_to_end(weight) {
            self.end(RunState::Stopping, Ending::Interrupted);
        } else if is_sure {
            self.end(RunState::Failed, Ending::Died(death));
        }
        true
    }

    /// Sends signals to stages that are to have ended.
    fn hurry(&mut self, stages: &mut [StageProcess], ended: &[Option<ExitStatus>]) {
        let has_renderer_ended = stages.iter().zip(ended).any(|(s, e)| s.stage() == Stage::Renderer && e.is_some());
        if has_renderer_ended && self.deadline.is_none() {
            // All frames are written. The others are done too, and need no more than a moment.
            self.deadline = Some(Instant::now() + REST_AFTER);
        }
        let waited = self.deadline.and_then(|deadline| Instant::now().checked_duration_since(deadline));
        let signal = match waited {
            Some(waited) if waited > KILL_AFTER => Signal::KILL,
            Some(waited) if waited > TERM_AFTER => Signal::TERM,
            _ => return,
        };
        // All frames are written: a stage that does not end by itself must not lose them.
        self.ending.get_or_insert(Ending::Finished);
        stages.iter_mut().for_each(|stage| stage.signal(signal));
    }
}

/// Whether the renderer has written all frames.
fn is_done(stages: &[StageProcess], ended: &[Option<ExitStatus>]) -> bool {
    stages
        .iter()
        .zip(ended)
        .any(|(stage, status)| stage.stage() == Stage::Renderer && status.is_some_and(|status| status.success()))
}

/// Has the dead started again, as far as that may help. The death of one that does not start.
fn revive(
    stages: &mut [StageProcess],
    ended: &mut [Option<ExitStatus>],
    control: &Control,
    restarts: &mut Restarts<'_>,
) -> Option<Death> {
    for (place, ended) in stages.iter_mut().zip(ended) {
        let Some(status) = *ended else { continue };
        if restarts.is_waiting(place.stage()) {
            // The longest wait for it is over soon; meanwhile it is not missed.
            *ended = None;
            if let Err(error) = restarts.revive(place) {
                let (stage, how, message) = (place.stage(), "was not started again".to_owned(), error.to_string());
                return Some(Death { stage, how, message, is_bad_input: false, restarts: restarts.recent() });
            }
            continue;
        }
        let Some((weight, Death { how, is_bad_input: false, .. })) = death_of(place, status, restarts) else {
            continue;
        };
        // A stage that gives up before there is a picture would give up again; so would one that
        // was told to stop.
        let is_given_up =
            status.code().is_some_and(|code| code != PANICKED) && control.completed_sequence() == Sequence::NONE;
        if weight == STOPPED || is_given_up || is_told_to_end(weight) {
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

/// Whether an end of this weight is that of a whole group of processes that were told to end, as
/// service managers do: this program, too.
fn is_told_to_end(weight: u32) -> bool {
    matches!(weight, STOPPED | SIGNALLED) && interrupt::is_interrupted()
}

/// The death that the end of a stage is, unless it ended in good order, and how much it tells: when
/// several stages are dead at once, one that was killed brought down those that gave up.
fn death_of(stage: &StageProcess, status: ExitStatus, restarts: &Restarts<'_>) -> Option<(u32, Death)> {
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
    let (stage, message, restarts) = (stage.stage(), stage.last_message(), restarts.recent());
    Some((weight, Death { stage, how, message, is_bad_input, restarts }))
}
