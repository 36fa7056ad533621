//! The supervision of stages, with shell scripts in their place.
#![expect(clippy::unwrap_used, reason = "a test that finds nothing to unwrap has failed")]

use rustix::process::Signal;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use terravision_common::ids::Sequence;
use terravision_common::shm::{Activity, Control, Layout, RunId, RunSegments, RunState, Stage};
use terravision_launcher::flight::restart::Restarts;
use terravision_launcher::flight::stage::{StageProcess, StartError};
use terravision_launcher::flight::supervisor::{Death, Ending, watch};
use terravision_launcher::plan::supervision::{HangRules, RestartRules};

/// A folder of stage programs, removed at the end.
struct Programs(PathBuf);

impl Programs {
    /// Each stage is a shell script.
    fn new(scripts: [(Stage, &str); 4]) -> Self {
        static SERIAL: AtomicU32 = AtomicU32::new(0);
        let serial = SERIAL.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("terravision-stages-{}-{serial}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        for (stage, script) in scripts {
            let path = folder.join(format!("terravision-{stage}"));
            fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        }
        Self(folder)
    }

    fn start(&self) -> Vec<StageProcess> {
        Stage::ALL.into_iter().map(|stage| start(stage, &self.0)).collect()
    }
}

impl Drop for Programs {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

fn start(stage: Stage, folder: &Path) -> StageProcess {
    loop {
        match StageProcess::start(stage, folder, "{}", None) {
            // Another test's fork holds the script open for writing for a moment.
            Err(StartError::Spawn { source, .. }) if source.kind() == std::io::ErrorKind::ExecutableFileBusy => {}
            started => return started.unwrap(),
        }
    }
}

/// A run that ends within the deadline of a test, and leaves no stage behind.
struct Flight {
    run: RunId,
    segments: RunSegments,
    control: Control,
}

impl Flight {
    fn new() -> Self {
        let run = RunId::unique_for_tests();
        let segments = RunSegments::create(&run, &Layout::small()).unwrap();
        let control = Control::open(&run).unwrap();
        Self { run, segments, control }
    }

    fn watch(
        &self,
        stages: Vec<StageProcess>,
        is_interrupted: impl Fn() -> bool,
        tick: impl FnMut(&[StageProcess]),
    ) -> Ending {
        let mut never = |stage| panic!("the {stage} is started again");
        let mut silent = |sentence: &str| panic!("{sentence}");
        let mut restarts = Restarts::new(RestartRules::NONE, &mut never, &mut silent);
        self.watch_with(&mut restarts, stages, is_interrupted, tick)
    }

    fn watch_with(
        &self,
        restarts: &mut Restarts<'_>,
        mut stages: Vec<StageProcess>,
        is_interrupted: impl Fn() -> bool,
        mut tick: impl FnMut(&[StageProcess]),
    ) -> Ending {
        let mut pids: Vec<u32> = stages.iter().map(StageProcess::pid).collect();
        let end = Instant::now() + Duration::from_secs(60);
        let ending = watch(&mut stages, &self.control, &is_interrupted, &|| false, restarts, &mut |stages| {
            assert!(Instant::now() < end, "the stages do not end");
            tick(stages);
        });
        pids.extend(stages.iter().map(StageProcess::pid));
        for pid in pids {
            assert!(!Path::new(&format!("/proc/{pid}")).exists(), "process {pid} is left");
        }
        ending
    }

    fn assert_no_segment_is_left(self) {
        let Self { run, segments, control } = self;
        drop((segments, control));
        let left: Vec<_> = fs::read_dir("/dev/shm")
            .unwrap()
            .filter_map(|entry| entry.unwrap().file_name().into_string().ok())
            .filter(|name| name.starts_with(&format!("{run}-")))
            .collect();
        assert!(left.is_empty(), "{left:?} are left");
    }
}

const WAIT: &str = "exec sleep 600";
use Stage::{Generator, Prefetcher, Preparer, Renderer};

#[test]
fn stages_that_end_in_good_order_are_a_finished_run() {
    let programs = Programs::new([
        (Generator, "exit 0"),
        (Preparer, "exit 0"),
        (Renderer, "sleep 0.2; exit 0"),
        (Prefetcher, "exit 0"),
    ]);
    let flight = Flight::new();
    assert_eq!(flight.watch(programs.start(), || false, |_| ()), Ending::Finished);
    assert_eq!(flight.control.state(), RunState::Running);
    flight.assert_no_segment_is_left();
}

#[test]
fn a_killed_stage_is_named_and_the_others_are_ended() {
    for victim in 0..Stage::ALL.len() {
        let programs = Programs::new([(Generator, WAIT), (Preparer, WAIT), (Renderer, WAIT), (Prefetcher, WAIT)]);
        let flight = Flight::new();
        let stages = programs.start();
        let pid = rustix::process::Pid::from_raw(stages[victim].pid().cast_signed()).unwrap();
        rustix::process::kill_process(pid, Signal::KILL).unwrap();
        let Ending::Died(Death { stage, how, is_bad_input, .. }) = flight.watch(stages, || false, |_| ()) else {
            panic!("not noticed")
        };
        assert_eq!(stage, Stage::ALL[victim]);
        assert!(how.contains("signal 9") && !is_bad_input, "{how}");
        assert_eq!(flight.control.state(), RunState::Failed);
        flight.assert_no_segment_is_left();
    }
}

#[test]
fn a_stage_that_gives_up_is_quoted() {
    let says = "echo 'loading'; echo 'warming up' >&2; echo 'there is no room for the picture' >&2; exit 1";
    let programs = Programs::new([(Generator, WAIT), (Preparer, WAIT), (Renderer, says), (Prefetcher, WAIT)]);
    let ending = Flight::new().watch(programs.start(), || false, |_| ());
    let Ending::Died(Death { stage, how, message, is_bad_input, .. }) = ending else { panic!("not noticed") };
    assert_eq!((stage, is_bad_input), (Renderer, false));
    assert_eq!((how.as_str(), message.as_str()), ("ended with exit code 1", "there is no room for the picture"));
}

#[test]
fn a_stage_that_finds_bad_input_says_so_by_its_exit_code() {
    let programs = Programs::new([
        (Generator, WAIT),
        (Preparer, WAIT),
        (Renderer, "echo 'too large' >&2; exit 2"),
        (Prefetcher, WAIT),
    ]);
    let ending = Flight::new().watch(programs.start(), || false, |_| ());
    assert!(matches!(ending, Ending::Died(Death { stage: Renderer, is_bad_input: true, .. })), "{ending:?}");
}

#[test]
fn a_stage_that_was_killed_is_blamed_before_those_that_gave_up_over_it() {
    for kill in ["kill -9 $$", "kill -15 $$"] {
        let programs = Programs::new([
            (Generator, "echo 'the preparer is gone' >&2; exit 1"),
            (Preparer, kill),
            (Renderer, "echo 'the preparer is gone' >&2; exit 1"),
            (Prefetcher, "echo 'the preparer is gone' >&2; exit 1"),
        ]);
        let stages = programs.start();
        // All four are dead before the first look.
        let end = Instant::now() + Duration::from_secs(60);
        while stages.iter().any(|stage| !is_zombie(stage.pid())) {
            assert!(Instant::now() < end, "they do not end");
            std::thread::sleep(Duration::from_millis(5));
        }
        let ending = Flight::new().watch(stages, || false, |_| ());
        assert!(matches!(ending, Ending::Died(Death { stage: Preparer, .. })), "{kill}: {ending:?}");
    }
}

fn is_zombie(pid: u32) -> bool {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with('Z'))
}

#[test]
fn an_interruption_ends_stages_that_will_not_listen() {
    let deaf = "trap '' TERM INT; while :; do sleep 0.05; done";
    let programs = Programs::new([(Generator, WAIT), (Preparer, deaf), (Renderer, WAIT), (Prefetcher, WAIT)]);
    let flight = Flight::new();
    let ticks = std::cell::Cell::new(0);
    let ending = flight.watch(programs.start(), || ticks.get() > 3, |_| ticks.set(ticks.get() + 1));
    assert_eq!(ending, Ending::Interrupted);
    assert_eq!(flight.control.state(), RunState::Stopping);
    flight.assert_no_segment_is_left();
}

#[test]
fn a_stage_that_hears_of_an_interruption_first_is_not_blamed() {
    let programs = Programs::new([(Generator, WAIT), (Preparer, "exit 130"), (Renderer, WAIT), (Prefetcher, WAIT)]);
    let ticks = std::cell::Cell::new(0);
    let ending = Flight::new().watch(programs.start(), || ticks.get() > 3, |_| ticks.set(ticks.get() + 1));
    assert_eq!(ending, Ending::Interrupted);
    let alone = Flight::new().watch(programs.start(), || false, |_| ());
    assert!(matches!(&alone, Ending::Died(Death { stage: Preparer, how, .. }) if how.contains("signal")), "{alone:?}");
}

#[test]
fn a_stage_that_lingers_after_the_renderer_is_ended_without_harm() {
    let programs = Programs::new([(Generator, WAIT), (Preparer, "exit 0"), (Renderer, "exit 0"), (Prefetcher, WAIT)]);
    assert_eq!(Flight::new().watch(programs.start(), || false, |_| ()), Ending::Finished);
}

#[test]
fn a_panic_is_quoted_whole() {
    let panics = "echo \"thread 'main' panicked at a.rs:1:2:\" >&2; echo 'out of tiles' >&2; \
                  echo 'note: run with RUST_BACKTRACE=1' >&2; exit 101";
    let programs = Programs::new([(Generator, panics), (Preparer, WAIT), (Renderer, WAIT), (Prefetcher, WAIT)]);
    let Ending::Died(Death { message, .. }) = Flight::new().watch(programs.start(), || false, |_| ()) else {
        panic!("not noticed")
    };
    assert_eq!(message, "thread 'main' panicked at a.rs:1:2: out of tiles");
}

#[test]
fn a_stage_that_is_not_there_is_named() {
    let folder = std::env::temp_dir().join("terravision-no-such-folder");
    let error = StageProcess::start(Generator, &folder, "{}", None).unwrap_err();
    let text = error.to_string();
    assert!(text.contains("the program of the generator") && text.contains("is missing"), "{text}");
}

const RULES: RestartRules = RestartRules { limit: 5, hang: HangRules::NEVER };

/// A flight of these scripts by these rules: its ending, what was said of restarts, and how many
/// there were.
fn fly_again(rules: RestartRules, scripts: [(Stage, &str); 4], flight: &Flight) -> (Ending, Vec<String>, u32) {
    let programs = Programs::new(scripts);
    let mut said = Vec::new();
    let mut say = |sentence: &str| said.push(sentence.to_owned());
    let mut start_again = |stage| Ok(start(stage, &programs.0));
    let mut restarts = Restarts::new(rules, &mut start_again, &mut say);
    let ending = flight.watch_with(&mut restarts, programs.start(), || false, |_| ());
    let count = restarts.counts().values().sum();
    (ending, said, count)
}

#[test]
fn a_stage_that_is_killed_twice_is_started_twice_and_the_run_ends_well() {
    // Each process leaves a file behind, and the third one ends in good order.
    let twice = "cd \"$(dirname \"$0\")\" && if [ -e b ]; then exit 0; elif [ -e a ]; then touch b; else touch a; fi; \
                 echo 'I fall' >&2; kill -9 $$";
    for (at, victim) in Stage::ALL.into_iter().enumerate() {
        let mut scripts = Stage::ALL.map(|stage| (stage, if stage == Renderer { "sleep 1; exit 0" } else { "exit 0" }));
        scripts[at] = (victim, twice);
        let flight = Flight::new();
        let (ending, said, count) = fly_again(RULES, scripts, &flight);
        assert_eq!((ending, count, said.len()), (Ending::Finished, 2, 2), "{victim}");
        // Nothing was done in between: the second has to wait.
        let expected =
            format!("the {victim} was killed by signal 9 (KILL); its last message: I fall; it is started again");
        assert_eq!(said, [expected.clone(), format!("{expected} in 0.5 s")]);
        flight.assert_no_segment_is_left();
    }
}

#[test]
fn after_five_restarts_in_a_minute_the_run_ends_with_the_last_message() {
    let falls = "echo 'no more' >&2; kill -11 $$";
    let scripts = [(Generator, WAIT), (Preparer, falls), (Renderer, WAIT), (Prefetcher, WAIT)];
    let flight = Flight::new();
    let (ending, said, count) = fly_again(RULES, scripts, &flight);
    let Ending::Died(Death { stage, how, message, restarts, .. }) = ending else { panic!("not noticed") };
    assert_eq!((stage, message.as_str(), restarts, count, said.len()), (Preparer, "no more", 5, 5, 5));
    assert!(how.contains("signal 11"), "{how}");
    assert_eq!(flight.control.state(), RunState::Failed);
    flight.assert_no_segment_is_left();
}

#[test]
fn what_would_happen_again_is_not_tried_again() {
    let bad_input = "echo 'too large' >&2; exit 2";
    let gives_up = "echo 'no device' >&2; exit 1";
    for script in [bad_input, gives_up] {
        let scripts = [(Generator, WAIT), (Preparer, WAIT), (Renderer, script), (Prefetcher, WAIT)];
        let (ending, said, _) = fly_again(RULES, scripts, &Flight::new());
        assert!(matches!(&ending, Ending::Died(Death { stage: Renderer, restarts: 0, .. })), "{ending:?}");
        assert!(said.is_empty(), "{said:?}");
    }
    // Once there was a picture, a stage that gives up may have a better day.
    let flight = Flight::new();
    flight.control.set_completed_sequence(Sequence::FIRST);
    let scripts = [(Generator, WAIT), (Preparer, WAIT), (Renderer, gives_up), (Prefetcher, WAIT)];
    let (ending, said, _) = fly_again(RULES, scripts, &flight);
    assert!(matches!(&ending, Ending::Died(Death { stage: Renderer, restarts: 5, .. })), "{ending:?}");
    let told = |sentence: &String| sentence.starts_with("the renderer gave up: no device; it is started again");
    assert!(said.iter().all(told), "{said:?}");
}

/// Who is killed when the stages wait so, all of them being well, and what is said of it. Nobody,
/// when they still wait after a multiple of the time in which a stage hangs.
fn blamed(rules: HangRules, waits: [(Stage, Activity); 4]) -> Option<(Stage, String)> {
    let flight = Flight::new();
    let handles = waits.map(|(stage, activity)| {
        let control = Control::open(&flight.run).unwrap();
        control.register(stage).unwrap();
        control.awaits(activity);
        (stage, control)
    });
    let programs = Programs::new([(Generator, WAIT), (Preparer, WAIT), (Renderer, WAIT), (Prefetcher, WAIT)]);
    let mut never = |stage| panic!("the {stage} is started again");
    let mut silent = |sentence: &str| panic!("{sentence}");
    let mut restarts = Restarts::new(RestartRules { limit: 0, hang: rules }, &mut never, &mut silent);
    let start = Instant::now();
    let ending = flight.watch_with(
        &mut restarts,
        programs.start(),
        || start.elapsed() > Duration::from_secs(5),
        |_| handles.iter().for_each(|(stage, control)| control.heartbeat(*stage)),
    );
    match ending {
        Ending::Died(Death { stage, how, .. }) => Some((stage, how)),
        _ => None,
    }
}

#[test]
fn who_does_not_move_is_blamed_and_not_those_that_wait_for_it() {
    let rules = HangRules {
        after: Duration::from_secs(1),
        camera: Duration::from_secs(1),
        has_path: false,
        ..HangRules::NEVER
    };
    let awaits = Activity::Awaits;
    let idle = (Prefetcher, awaits(Preparer));
    let table = [
        // Nobody sends a pose, or the database is slow: that is no hang.
        (
            [(Renderer, awaits(Preparer)), (Preparer, awaits(Generator)), (Generator, Activity::AwaitsCamera), idle],
            None,
        ),
        (
            [
                (Renderer, awaits(Preparer)),
                (Preparer, awaits(Prefetcher)),
                (Generator, awaits(Preparer)),
                (Prefetcher, Activity::AwaitsStorage),
            ],
            None,
        ),
        (
            [(Renderer, awaits(Preparer)), (Preparer, awaits(Generator)), (Generator, Activity::Works), idle],
            Some((Generator, "although it had all that it needed")),
        ),
        (
            [(Renderer, Activity::AwaitsDevice), (Preparer, awaits(Renderer)), (Generator, awaits(Preparer)), idle],
            Some((Renderer, "while the device drew")),
        ),
        (
            [(Renderer, awaits(Preparer)), (Preparer, awaits(Generator)), (Generator, awaits(Preparer)), idle],
            Some((Generator, "while it and the preparer waited for each other")),
        ),
        (
            [(Renderer, awaits(Preparer)), (Preparer, awaits(Prefetcher)), (Generator, awaits(Preparer)), idle],
            Some((Prefetcher, "while it and the preparer waited for each other")),
        ),
    ];
    for (waits, expected) in table {
        let found = blamed(rules, waits);
        assert_eq!(found.as_ref().map(|(stage, _)| *stage), expected.map(|(stage, _)| stage), "{found:?}");
        if let (Some((_, how)), Some((_, told))) = (found, expected) {
            assert!(how.starts_with("made no progress for") && how.contains(told), "{how}");
        }
    }
    // Of a path the launcher has every camera.
    let waits =
        [(Renderer, awaits(Preparer)), (Preparer, awaits(Generator)), (Generator, Activity::AwaitsCamera), idle];
    let found = blamed(HangRules { has_path: true, ..rules }, waits);
    assert!(found.as_ref().is_some_and(|(stage, how)| *stage == Generator && how.contains("camera")), "{found:?}");
}

#[test]
fn a_stage_that_falls_silent_is_killed_and_started_again() {
    let hang = HangRules { after: Duration::from_secs(1), ..HangRules::NEVER };
    let rules = RestartRules { limit: 1, hang };
    let programs = Programs::new([(Generator, WAIT), (Preparer, WAIT), (Renderer, WAIT), (Prefetcher, WAIT)]);
    let (flight, mut said) = (Flight::new(), Vec::new());
    let mut say = |sentence: &str| said.push(sentence.to_owned());
    let mut start_again = |stage| Ok(start(stage, &programs.0));
    let mut restarts = Restarts::new(rules, &mut start_again, &mut say);
    let (beats, is_over) = (std::cell::Cell::new(0), std::cell::Cell::new(false));
    let stages = programs.start();
    let first = stages[1].pid();
    let ending = flight.watch_with(
        &mut restarts,
        stages,
        || is_over.get(),
        |stages| {
            // The scripts have no voice: this is theirs. The preparer's fails after a while.
            beats.set(beats.get() + 1);
            for stage in Stage::ALL {
                if stage != Preparer || beats.get() < 5 || stages[1].pid() != first {
                    flight.control.heartbeat(stage);
                }
            }
            is_over.set(stages[1].pid() != first);
        },
    );
    assert_eq!(ending, Ending::Interrupted);
    assert_eq!(
        said,
        ["the preparer gave no sign of life for 1 s and was killed; it left no message; it is started again"]
    );
}
