//! Stages that hang: which one is to blame when nothing gets done any more.
//!
//! ```text
//! no sign of life ────────────────────────────────────────────────▶ this stage
//! signs of life, nothing done: follow what each waits for, from the renderer on
//!     renderer ─awaits─▶ preparer ─awaits─▶ generator ─awaits─▶ camera: is one due? ─▶ the stage that has all it needs
//!         ▲                 └── one of them made progress meanwhile: none hangs            and does not move
//!         └──────────────── two wait for each other: their shared memory was overwritten
//! ```
//!
//! Time counts as this process sees it: a tick is a second at most, so a launcher that was stopped
//! itself (Ctrl-Z) has seen no silence. A stage that computes, or waits for a disk, is slow and
//! does not hang: it has [`BUSY`] times as long; and everybody has ten times as long as the slowest
//! thing that it got done so far.

use super::stage::StageProcess;
use crate::plan::supervision::HangRules;
use crate::process::vitals::{BUSY, LONGEST_TICK, MARK_AFTER, Mark};
use std::time::{Duration, Instant};
use terravision_common::shm::{Activity, Control, Stage};

/// A stage that opens a device or a database gives no sign of life; it may take this long over its
/// start.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// Everybody has this many times as long as the slowest thing that it got done.
const SLOWEST: u32 = 10;

/// A stage that hangs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hang {
    /// Which.
    pub stage: Stage,
    /// How, in words that follow its name.
    pub how: String,
}

/// Watches the stages of a run.
#[derive(Debug)]
pub struct HangWatch {
    rules: HangRules,
    pulses: Vec<Pulse>,
}

impl HangWatch {
    /// By these rules.
    #[must_use]
    pub fn new(rules: HangRules) -> Self {
        Self { rules, pulses: Vec::new() }
    }

    /// Takes a look, once a tick. `is_output_blocked`: pictures wait for a program that is not
    /// ours. The stage that hangs, if one does; it is to be killed, and the others have all their
    /// time again.
    pub fn look(
        &mut self,
        stages: &mut [StageProcess],
        control: &Control,
        is_output_blocked: &dyn Fn() -> bool,
    ) -> Option<Hang> {
        let now = Instant::now();
        for place in stages.iter_mut() {
            let is_running = place.poll().is_none();
            self.feel(place, is_running, control, now);
        }
        let mut blame = self.silent(is_output_blocked);
        if blame.is_none() && self.pulses.iter().any(|pulse| pulse.is_running && pulse.still >= self.rules.after) {
            blame = self.stuck(control, is_output_blocked);
        }
        if blame.is_some() {
            self.pulses.iter_mut().for_each(Pulse::restart);
        }
        blame
    }

    fn feel(&mut self, place: &StageProcess, is_running: bool, control: &Control, now: Instant) {
        let (stage, pid) = (place.stage(), place.pid());
        let (beat, done) = (control.heartbeat_of(stage), control.progress_of(stage));
        let is_working = !matches!(control.activity_of(stage), Activity::Awaits(_) | Activity::AwaitsCamera);
        match self.pulses.iter_mut().find(|pulse| pulse.stage == stage) {
            // Signs of the process before say nothing of this one.
            Some(pulse) if pulse.pid != pid => *pulse = Pulse { beat, done, ..Pulse::new(stage, pid, now) },
            Some(pulse) => {
                pulse.is_running = is_running;
                pulse.feel(beat, done, now);
                pulse.is_working = is_working;
            }
            None => self.pulses.push(Pulse::new(stage, pid, now)),
        }
    }

    fn pulse(&self, stage: Stage) -> Option<&Pulse> {
        self.pulses.iter().find(|pulse| pulse.stage == stage && pulse.is_running)
    }

    /// A stage that gives no sign of life.
    fn silent(&self, is_output_blocked: &dyn Fn() -> bool) -> Option<Hang> {
        let after = self.rules.after;
        let is_silent = |pulse: &&Pulse| {
            let least = if pulse.is_starting() { after.max(START_PATIENCE) } else { after };
            pulse.is_running
                && pulse.silence >= least
                && pulse.silence >= pulse.patience(least, pulse.silence, pulse.silence_mark)
                && !(pulse.stage == Stage::Renderer && is_output_blocked())
        };
        let pulse = self.pulses.iter().find(is_silent)?;
        let how = format!("gave no sign of life for {:.0} s and was killed", pulse.silence.as_secs_f64());
        Some(Hang { stage: pulse.stage, how })
    }

    /// The stage for which all others wait, and which does not move.
    fn stuck(&self, control: &Control, is_output_blocked: &dyn Fn() -> bool) -> Option<Hang> {
        // What a stage noted before it fell silent says nothing of now, and its silence began after
        // the last thing that was done: whether it hangs is soon known of itself, and nobody who
        // waits for it is blamed before.
        if self.pulses.iter().any(|pulse| pulse.is_falling_silent(self.rules.after)) {
            return None;
        }
        // Whatever hangs, in the end the renderer gets nothing.
        let mut chain = vec![Stage::Renderer];
        loop {
            let stage = *chain.last()?;
            let pulse = self.pulse(stage)?;
            if pulse.still < self.rules.after {
                return None;
            }
            // A process that starts has noted nothing yet: what stands there is of the one before.
            let activity = if pulse.is_starting() { Activity::Works } else { control.activity_of(stage) };
            let (patience, what) = match activity {
                Activity::Awaits(next) if self.pulses.iter().any(|pulse| pulse.stage == next && !pulse.is_running) => {
                    (self.rules.after, format!("while it waited for the {next}, which has ended"))
                }
                Activity::Awaits(next) if chain.contains(&next) => {
                    let told =
                        format!("while it and the {next} waited for each other (was their shared memory overwritten?)");
                    (self.rules.after, told)
                }
                Activity::Awaits(next) => {
                    chain.push(next);
                    continue;
                }
                // Against the clock the newest camera will do.
                Activity::AwaitsCamera if self.rules.has_path || control.clock_start().is_some() => {
                    (self.rules.camera, "while it waited for a camera that was due".to_owned())
                }
                // Nobody has sent a pose.
                Activity::AwaitsCamera => return None,
                Activity::AwaitsStorage => (self.rules.storage, "while it waited for the database".to_owned()),
                Activity::AwaitsDevice => (pulse.still_patience(self.rules.after), "while the device drew".to_owned()),
                Activity::AwaitsSink if is_output_blocked() => return None,
                Activity::AwaitsSink => {
                    (pulse.still_patience(self.rules.after), "while its pictures were written".to_owned())
                }
                Activity::Works if stage == Stage::Renderer && is_output_blocked() => return None,
                Activity::Works => {
                    (pulse.still_patience(self.rules.after), "although it had all that it needed".to_owned())
                }
            };
            let how = || format!("made no progress for {:.0} s, {what}, and was killed", pulse.still.as_secs_f64());
            return (pulse.still >= patience).then(|| Hang { stage, how: how() });
        }
    }
}

/// The signs of life of a stage, and what it gets done.
#[derive(Debug)]
struct Pulse {
    stage: Stage,
    pid: u32,
    is_running: bool,
    /// The last sign: of this process, or before its first of the process before.
    beat: Option<u64>,
    /// Signs that were seen. The first says that the process has come, the second that it is
    /// through with its start.
    beats: u32,
    silence: Duration,
    silence_mark: Option<Mark>,
    done: u64,
    /// Since something was done last.
    still: Duration,
    still_mark: Option<Mark>,
    /// At the last look it did not wait for another stage or a camera.
    is_working: bool,
    /// The longest time between two signs of life, or between two things that were done without
    /// waiting for others.
    slowest: Duration,
    seen: Instant,
}

impl Pulse {
    fn new(stage: Stage, pid: u32, now: Instant) -> Self {
        Self {
            stage,
            pid,
            is_running: true,
            beat: None,
            beats: 0,
            silence: Duration::ZERO,
            silence_mark: None,
            done: 0,
            still: Duration::ZERO,
            still_mark: None,
            is_working: false,
            slowest: Duration::ZERO,
            seen: now,
        }
    }

    /// It has all its time again.
    fn restart(&mut self) {
        (self.silence, self.silence_mark) = (Duration::ZERO, None);
        (self.still, self.still_mark) = (Duration::ZERO, None);
    }

    fn feel(&mut self, beat: Option<u64>, done: u64, now: Instant) {
        let passed = now.duration_since(self.seen).min(LONGEST_TICK);
        self.seen = now;
        if beat == self.beat {
            self.silence += passed;
        } else {
            self.slowest = self.slowest.max(self.silence);
            (self.beat, self.silence, self.silence_mark) = (beat, Duration::ZERO, None);
            self.beats = self.beats.saturating_add(1);
        }
        if done == self.done {
            self.still += passed;
        } else {
            if self.is_working {
                self.slowest = self.slowest.max(self.still);
            }
            (self.done, self.still, self.still_mark) = (done, Duration::ZERO, None);
        }
        for (still, mark) in [(self.silence, &mut self.silence_mark), (self.still, &mut self.still_mark)] {
            if still >= MARK_AFTER && mark.is_none() {
                *mark = Mark::of(self.pid, still);
            }
        }
    }

    /// It opens a device or a database.
    fn is_starting(&self) -> bool {
        self.beats < 2
    }

    /// It has given no sign of life for a good part of the time after which it hangs.
    fn is_falling_silent(&self, after: Duration) -> bool {
        self.is_running && !self.is_starting() && self.silence >= after / 2
    }

    /// How long it may be still: longer while it is busy, or when it is known to be slow.
    fn patience(&self, least: Duration, still: Duration, mark: Option<Mark>) -> Duration {
        let known = least.max(self.slowest.saturating_mul(SLOWEST));
        let longest = known.saturating_mul(BUSY);
        // Without a look at the process as long as that does not matter.
        let is_busy = still >= known && still < longest && mark.is_some_and(|mark| mark.is_busy(self.pid, still));
        if is_busy { longest } else { known }
    }

    fn still_patience(&self, least: Duration) -> Duration {
        let least = if self.is_starting() { least.max(START_PATIENCE) } else { least };
        self.patience(least, self.still, self.still_mark)
    }
}
