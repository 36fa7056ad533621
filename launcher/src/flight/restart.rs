//! Starting stages again: which of those that died, how often, and which of those that live hang.

use super::stage::{StageProcess, StartError};
use rustix::process::Signal;
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};
use terravision_common::shm::{Control, Stage};

/// Restarts are counted over this time.
const WINDOW: Duration = Duration::from_secs(60);
/// A stage that opens a device or a database gives no sign of life; it may take this long over its start.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// Time that passes unseen is no silence of a stage: this program was stopped itself.
const LONGEST_TICK: Duration = Duration::from_secs(1);

/// How stages of a run are started again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RestartRules {
    /// Most restarts within a minute, of all stages together; 0 for none at all.
    pub limit: u32,
    /// A stage that is silent for so long hangs.
    pub hang_after: Duration,
}

impl RestartRules {
    /// The first death ends the run.
    pub const NONE: Self = Self { limit: 0, hang_after: Duration::MAX };
}

/// Starts stages again by the rules, and counts.
pub struct Restarts<'a> {
    rules: RestartRules,
    start: &'a mut dyn FnMut(Stage) -> Result<StageProcess, StartError>,
    say: &'a mut dyn FnMut(&str),
    recent: VecDeque<Instant>,
    counts: BTreeMap<&'static str, u32>,
    pulses: Vec<Pulse>,
}

impl std::fmt::Debug for Restarts<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Restarts").field("rules", &self.rules).field("counts", &self.counts).finish_non_exhaustive()
    }
}

impl<'a> Restarts<'a> {
    /// `start` starts a stage, on the calling thread; `say` hears of every restart, in a sentence.
    pub fn new(
        rules: RestartRules,
        start: &'a mut dyn FnMut(Stage) -> Result<StageProcess, StartError>,
        say: &'a mut dyn FnMut(&str),
    ) -> Self {
        Self { rules, start, say, recent: VecDeque::new(), counts: BTreeMap::new(), pulses: Vec::new() }
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

    /// Starts a stage that died `how` again, if the rules allow it; whether it did.
    ///
    /// # Errors
    /// The system does not start it.
    pub fn revive(&mut self, place: &mut StageProcess, how: &str) -> Result<bool, StartError> {
        let (stage, now) = (place.stage(), Instant::now());
        self.recent.retain(|at| now.duration_since(*at) < WINDOW);
        if self.recent.len() >= self.rules.limit as usize {
            return Ok(false);
        }
        (self.say)(&format!("{}; it is started again", sentence(stage, how, &place.last_words())));
        *place = (self.start)(stage)?;
        self.recent.push_back(now);
        *self.counts.entry(stage.name()).or_insert(0) += 1;
        Ok(true)
    }

    /// Kills stages that hang. Called once a tick.
    pub fn kill_what_hangs(&mut self, stages: &mut [StageProcess], control: &Control) {
        if !self.is_on() {
            return;
        }
        let now = Instant::now();
        for place in stages.iter_mut() {
            if place.poll().is_some() {
                continue;
            }
            let beat = control.heartbeat_of(place.stage());
            let pulse = match self.pulses.iter_mut().find(|pulse| pulse.stage == place.stage()) {
                Some(pulse) => pulse,
                None => {
                    self.pulses.push(Pulse::of(place, now));
                    continue;
                }
            };
            if pulse.pid != place.pid() {
                *pulse = Pulse { beat, ..Pulse::of(place, now) };
            } else if pulse.feel(beat, now, self.rules.hang_after) {
                place.signal(Signal::KILL);
            }
        }
    }

    /// How a stage died that was killed for its silence.
    pub(super) fn silence_of(&self, place: &StageProcess) -> Option<String> {
        let pulse = self.pulses.iter().find(|pulse| pulse.pid == place.pid() && pulse.is_silent)?;
        Some(format!("gave no sign of life for {:.0} s and was killed", pulse.silence.as_secs_f64()))
    }
}

/// The signs of life of a stage.
#[derive(Debug)]
struct Pulse {
    stage: Stage,
    pid: u32,
    /// The last sign: of this process, or before its first of the process before.
    beat: Option<u64>,
    /// Signs that were seen. The first says that the process has come, the second that it is through with its start.
    beats: u32,
    silence: Duration,
    seen: Instant,
    is_silent: bool,
}

impl Pulse {
    fn of(place: &StageProcess, now: Instant) -> Self {
        let (stage, pid) = (place.stage(), place.pid());
        Self { stage, pid, beat: None, beats: 0, silence: Duration::ZERO, seen: now, is_silent: false }
    }

    /// Takes a look; whether the stage has just been silent for too long.
    fn feel(&mut self, beat: Option<u64>, now: Instant, hang_after: Duration) -> bool {
        let passed = now.duration_since(self.seen).min(LONGEST_TICK);
        self.seen = now;
        if beat != self.beat {
            (self.beat, self.silence) = (beat, Duration::ZERO);
            self.beats += 1;
            return false;
        }
        self.silence += passed;
        let patience = if self.beats < 2 { hang_after.max(START_PATIENCE) } else { hang_after };
        let was_silent = std::mem::replace(&mut self.is_silent, self.silence >= patience);
        self.is_silent && !was_silent
    }
}

/// What happened to a stage, in words.
#[must_use]
pub fn sentence(stage: Stage, how: &str, words: &str) -> String {
    match words {
        "" => format!("the {stage} {how}, without a word"),
        words if how.contains("was ") => format!("the {stage} {how}; it said last: {words}"),
        words => format!("the {stage} gave up: {words}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_is_silent_when_its_signs_stop_and_has_longer_over_its_start() {
        let start = Instant::now();
        let mut pulse = Pulse {
            stage: Stage::Renderer,
            pid: 7,
            beat: None,
            beats: 0,
            silence: Duration::ZERO,
            seen: start,
            is_silent: false,
        };
        let mut second = 0;
        let mut feel = |beat: Option<u64>| {
            second += 1;
            pulse.feel(beat, start + Duration::from_secs(second), Duration::from_secs(5))
        };
        // It comes, and opens its device.
        assert!((0..59).all(|_| !feel(Some(1))));
        assert!((0..20).all(|k| !feel(Some(2 + k))));
        let silent: Vec<bool> = (0..8).map(|_| feel(Some(21))).collect();
        assert_eq!(silent, [false, false, false, false, true, false, false, false]);
        // A minute that this program did not see is no silence.
        let mut pulse = Pulse { beats: 2, beat: Some(1), silence: Duration::ZERO, is_silent: false, ..pulse };
        let later = pulse.seen + Duration::from_secs(60);
        assert!(!pulse.feel(Some(1), later, Duration::from_secs(5)));
    }

    #[test]
    fn deaths_are_told_in_a_sentence() {
        let told = |how: &str, words: &str| sentence(Stage::Preparer, how, words);
        assert_eq!(
            told("was killed by signal 9 (KILL)", ""),
            "the preparer was killed by signal 9 (KILL), without a word"
        );
        assert_eq!(told("ended with exit code 1", "no room"), "the preparer gave up: no room");
        assert!(told("was killed by signal 11", "oh").ends_with("; it said last: oh"));
    }
}
