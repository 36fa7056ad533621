//! The activity and progress of a stage, which distinguish a stage that hangs from a stage that
//! waits for it.
//!
//! A heartbeat ([`Control::heartbeat`]) shows that a process runs, not that it makes progress. So
//! each stage counts its finished work, and records what it waits for. The record remains until the
//! next piece of work is finished: polling ten times a second is not progress.

use super::control::Control;
use super::kind::Stage;
use crate::sync::Ordering;

/// What a stage does, or waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Activity {
    /// It has all that it needs.
    Works,
    /// It waits for what another stage makes, or for room that another one gives back.
    Awaits(Stage),
    /// It waits for a camera: of a path, of another program, or of the next moment.
    AwaitsCamera,
    /// Requests to the database are in flight, or wait to be repeated.
    AwaitsStorage,
    /// The device draws.
    AwaitsDevice,
    /// Pictures are being written.
    AwaitsSink,
}

impl Activity {
    fn number(self) -> u32 {
        match self {
            Self::Works => 0,
            Self::AwaitsCamera => 1,
            Self::AwaitsStorage => 2,
            Self::AwaitsDevice => 3,
            Self::AwaitsSink => 4,
            Self::Awaits(stage) => 16 + stage as u32,
        }
    }

    /// For an invalid number, it is assumed to work.
    fn of(number: u32) -> Self {
        let others = [Self::AwaitsCamera, Self::AwaitsStorage, Self::AwaitsDevice, Self::AwaitsSink];
        let stages = Stage::ALL.map(Self::Awaits);
        others.into_iter().chain(stages).find(|activity| activity.number() == number).unwrap_or(Self::Works)
    }
}

impl Control {
    /// Records that the stage of this process has made progress: input has arrived, a tree, a frame
    /// or a picture is finished, a request has ended. It no longer waits.
    pub fn progress(&self) {
        let Some(stage) = self.own_stage() else { return };
        let words = &self.words().stages[stage as usize];
        // Relaxed, here and below: numbers that the launcher watches; their order does not matter.
        words.progress.fetch_add(1, Ordering::Relaxed);
        words.activity.store(Activity::Works.number(), Ordering::Relaxed);
    }

    /// Records that the stage of this process, if it is one, waits for something from now on.
    pub fn awaits(&self, activity: Activity) {
        if let Some(stage) = self.own_stage() {
            self.words().stages[stage as usize].activity.store(activity.number(), Ordering::Relaxed);
        }
    }

    /// How often a stage made progress, summed over all its processes.
    #[must_use]
    pub fn progress_of(&self, stage: Stage) -> u64 {
        self.words().stages[stage as usize].progress.load(Ordering::Relaxed)
    }

    /// What a stage has waited for since its last progress.
    #[must_use]
    pub fn activity_of(&self, stage: Stage) -> Activity {
        Activity::of(self.words().stages[stage as usize].activity.load(Ordering::Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shm::memory;

    #[test]
    fn what_a_stage_awaits_stands_until_it_gets_something_done() {
        let control = memory::control().unwrap();
        control.progress();
        assert_eq!(Stage::ALL.map(|stage| control.progress_of(stage)), [0; 4], "it is not a stage yet");
        control.register(Stage::Preparer).unwrap();
        let all = Stage::ALL.map(Activity::Awaits).into_iter().chain([
            Activity::Works,
            Activity::AwaitsCamera,
            Activity::AwaitsStorage,
            Activity::AwaitsDevice,
            Activity::AwaitsSink,
        ]);
        for activity in all {
            control.awaits(activity);
            assert_eq!(control.activity_of(Stage::Preparer), activity);
            assert_eq!(control.activity_of(Stage::Renderer), Activity::Works);
        }
        control.progress();
        assert_eq!((control.activity_of(Stage::Preparer), control.progress_of(Stage::Preparer)), (Activity::Works, 1));
        assert_eq!(Activity::of(15), Activity::Works, "a number that no stage writes");
    }
}
