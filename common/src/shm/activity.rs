//! What a stage does, and how far it has come: what tells one that hangs from one that waits for
//! it.
//!
//! A sign of life ([`Control::heartbeat`]) says that a process runs; it does not say that it gets
//! anywhere. So each stage counts what it gets done, and notes what it waits for. The note stands
//! until the next thing is done: a stage that looks ten times a second whether there is something
//! to do has not moved by that.

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
    /// Requests to the database are out, or rest until they are made again.
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

    /// Of a number that no stage writes: it works, as far as anybody knows.
    fn of(number: u32) -> Self {
        let others = [Self::AwaitsCamera, Self::AwaitsStorage, Self::AwaitsDevice, Self::AwaitsSink];
        let stages = Stage::ALL.map(Self::Awaits);
        others.into_iter().chain(stages).find(|activity| activity.number() == number).unwrap_or(Self::Works)
    }
}

impl Control {
    /// The stage that this process is has got something done: input has come, a tree, a frame or a
    /// picture is made, a request has ended. Whatever it waited for, it does not any more.
    pub fn progress(&self) {
        let Some(stage) = self.own_stage() else { return };
        let words = &self.words().stages[stage as usize];
        // Relaxed, here and below: numbers for the launcher to watch, nothing hangs on their order.
        words.progress.fetch_add(1, Ordering::Relaxed);
        words.activity.store(Activity::Works.number(), Ordering::Relaxed);
    }

    /// The stage that this process is, if it is one, waits for something from now on.
    pub fn awaits(&self, activity: Activity) {
        if let Some(stage) = self.own_stage() {
            self.words().stages[stage as usize].activity.store(activity.number(), Ordering::Relaxed);
        }
    }

    /// How often a stage got something done; of all its processes.
    #[must_use]
    pub fn progress_of(&self, stage: Stage) -> u64 {
        self.words().stages[stage as usize].progress.load(Ordering::Relaxed)
    }

    /// What a stage has waited for since it got something done.
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
