//! Starting stages again: which of those that died, how often, and how soon.

use super::hang::{Hang, HangWatch};
use super::stage::{StageProcess, StartError};
use crate::plan::supervision::RestartRules;
use rustix::process::Signal;
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};
use terravision_common::shm::{Control, Stage};

/// Restarts are counted over this time.
const WINDOW: Duration = Duration::from_secs(60);
/// A stage that gets nothing done between two deaths is started again after this time, then twice
/// that, ...
const FIRST_BACK_OFF: Duration = Duration::from_millis(500);
/// ... and at most this: what it lacks, memory say, may come back.
const LONGEST_BACK_OFF: Duration = Duration::from_secs(10);

/// A stage that died, and what is to become of it.
#[derive(Debug)]
struct Waiting {
    stage: Stage,
    due: Instant,
}

/// What a stage got done before it was started last, and how often it died since without more.
#[derive(Debug, Clone, Copy)]
struct Strikes {
    stage: Stage,
    done: u64,
    count: u32,
}

/// Starts stages again by the rules, and counts.
pub struct Restarts<'a> {
    rules: RestartRules,
    start: &'a mut dyn FnMut(Stage) -> Result<StageProcess, StartError>,
    say: &'a mut dyn FnMut(&str),
    recent: VecDeque<Instant>,
    counts: BTreeMap<&'static str, u32>,
    hangs: HangWatch,
    /// Stages that were killed for it: process ids.
    hung: Vec<(u32, String)>,
    waiting: Vec<Waiting>,
    strikes: Vec<Strikes>,
    /// Frames written at the last restart, and restarts since there were more than these.
    written: u64,
    since_picture: u32,
}

impl std::fmt::Debug for Restarts<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Restarts").field("rules", &self.rules).field("counts", &self.counts).finish_non_exhaustive()
    }
}

impl<'a> Restarts<'a> {
    /// `start` starts a stage, on the calling thread; `say` hears of every restart.
    pub fn new(
        rules: RestartRules,
        start: &'a mut dyn FnMut(Stage) -> Result<StageProcess, StartError>,
        say: &'a mut dyn FnMut(&str),
    ) -> Self {
        Self {
            rules,
            start,
            say,
            recent: VecDeque::new(),
            counts: BTreeMap::new(),
            hangs: HangWatch::new(rules.hang),
            hung: Vec::new(),
            waiting: Vec::new(),
            strikes: Vec::new(),
            written: 0,
            since_picture: 0,
        }
    }

    /// Whether any death is mended.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.rules.limit > 0
    }

    /// How often each stage was started again.
    #[must_use]
    pub fn counts(&self) -> &BTreeMap<&'static str, u32> {
        &self.counts
    }

    /// Restarts within the last minute.
    #[must_use]
    pub fn recent(&self) -> u32 {
        self.recent.len() as u32
    }

    /// Whether a dead stage waits to be started again.
    #[must_use]
    pub fn is_waiting(&self, stage: Stage) -> bool {
        self.waiting.iter().any(|waiting| waiting.stage == stage)
    }

    /// A stage died `how`: it is started again in a moment, if the rules allow it, but not before
    /// `least` has passed. Whether it is.
    pub fn take_up(&mut self, place: &StageProcess, how: &str, least: Duration, control: &Control) -> bool {
        let (stage, now) = (place.stage(), Instant::now());
        self.recent.retain(|at| now.duration_since(*at) < WINDOW);
        let written = control.written_frames();
        if written > self.written {
            (self.written, self.since_picture) = (written, 0);
        }
        let limit = self.rules.limit;
        if self.recent() >= limit || self.since_picture >= limit {
            return false;
        }
        self.recent.push_back(now);
        self.since_picture += 1;
        let back_off = self.back_off(stage, control.progress_of(stage));
        let soon = if back_off.is_zero() { String::new() } else { format!(" in {} s", back_off.as_secs_f64()) };
        tracing::warn!(%stage, how, ?back_off, restarts = self.recent.len(), "stage is to be started again");
        (self.say)(&format!("{}; it is started again{soon}", death_message(stage, how, &place.last_message())));
        self.waiting.push(Waiting { stage, due: now + back_off.max(least) });
        true
    }

    /// How long a stage has to wait; `done`: what it and those before it have done in all.
    fn back_off(&mut self, stage: Stage, done: u64) -> Duration {
        let Some(strikes) = self.strikes.iter_mut().find(|strikes| strikes.stage == stage) else {
            self.strikes.push(Strikes { stage, done, count: 0 });
            return Duration::ZERO;
        };
        strikes.count = if done > strikes.done { 0 } else { strikes.count + 1 };
        strikes.done = done;
        match strikes.count {
            0 => Duration::ZERO,
            count => FIRST_BACK_OFF.saturating_mul(1 << (count - 1).min(20)).min(LONGEST_BACK_OFF),
        }
    }

    /// Starts a stage that was taken up, if its time has come; whether it did.
    ///
    /// # Errors
    /// The system does not start it.
    pub fn revive(&mut self, place: &mut StageProcess) -> Result<bool, StartError> {
        let (stage, now) = (place.stage(), Instant::now());
        let Some(at) = self.waiting.iter().position(|waiting| waiting.stage == stage && waiting.due <= now) else {
            return Ok(false);
        };
        self.waiting.swap_remove(at);
        *place = (self.start)(stage)?;
        *self.counts.entry(stage.name()).or_insert(0) += 1;
        Ok(true)
    }

    /// Kills a stage that hangs, and says which. Called once a tick; `is_output_blocked` as in
    /// [`HangWatch::look`].
    pub fn kill_what_hangs(
        &mut self,
        stages: &mut [StageProcess],
        control: &Control,
        is_output_blocked: &dyn Fn() -> bool,
    ) -> Option<Hang> {
        // Nobody can blame those that wait for one that is about to be started.
        if !self.waiting.is_empty() {
            return None;
        }
        let hang = self.hangs.look(stages, control, is_output_blocked)?;
        let place = stages.iter_mut().find(|place| place.stage() == hang.stage)?;
        self.hung.push((place.pid(), hang.how.clone()));
        place.signal(Signal::KILL);
        Some(hang)
    }

    /// How a stage died that was killed because it hung.
    pub(super) fn hang_of(&self, place: &StageProcess) -> Option<String> {
        self.hung.iter().find(|(pid, _)| *pid == place.pid()).map(|(_, how)| how.clone())
    }
}

/// What happened to a stage: how it died, and its last message.
#[must_use]
pub fn death_message(stage: Stage, how: &str, message: &str) -> String {
    match message {
        "" => format!("the {stage} {how}; it left no message"),
        message if how.contains("was ") => format!("the {stage} {how}; its last message: {message}"),
        message => format!("the {stage} gave up: {message}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_gets_nothing_done_waits_longer_each_time() {
        let mut start = |stage| panic!("the {stage} is started");
        let mut say = |_: &str| ();
        let mut restarts = Restarts::new(RestartRules::NONE, &mut start, &mut say);
        let mut waits = |stage, done: &[u64]| {
            done.iter().map(|done| restarts.back_off(stage, *done).as_millis()).collect::<Vec<_>>()
        };
        assert_eq!(waits(Stage::Renderer, &[7, 7, 7, 7, 7, 7, 7, 7]), [0, 500, 1000, 2000, 4000, 8000, 10_000, 10_000]);
        assert_eq!(waits(Stage::Preparer, &[0, 0]), [0, 500]);
        assert_eq!(waits(Stage::Renderer, &[9, 9, 12]), [0, 500, 0]);
    }

    #[test]
    fn a_death_is_one_sentence() {
        let told = |how: &str, message: &str| death_message(Stage::Preparer, how, message);
        assert_eq!(
            told("was killed by signal 9 (KILL)", ""),
            "the preparer was killed by signal 9 (KILL); it left no message"
        );
        assert_eq!(told("ended with exit code 1", "no room"), "the preparer gave up: no room");
        assert!(told("was killed by signal 11", "oh").ends_with("; its last message: oh"));
    }
}
