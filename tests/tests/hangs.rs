//! What hangs is found, killed and told: a stage that was stopped, an encoder that sleeps, shared
//! memory that was written over.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use rustix::process::Signal;
use std::fs::{self, OpenOptions};
use std::os::unix::fs::{FileExt, PermissionsExt};
use std::path::Path;
use std::time::Duration;
use terravision_common::shm::{FrameRingReader, PoseSender, SharedFrame, SharedName};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, left_of, shared_name, step};
use terravision_tests::posed::{assert_over, pids, pose, small_flight, start_of_poses};
use terravision_tests::process::{Finished, Running, Terravision, segments_of_launcher, signal_process};
use terravision_tests::shot::read_report;

const STAGES: [&str; 4] = ["generator", "preparer", "renderer", "prefetcher"];
/// Short, so that a test is; long enough for a machine with other work.
const HANG_AFTER: &str = "6";

fn fly(arguments: &[&str]) -> Terravision {
    fly_with_patience(HANG_AFTER, arguments)
}

fn fly_with_patience(hang_after: &str, arguments: &[&str]) -> Terravision {
    small_flight().args(["--hang-after", hang_after]).args(arguments).deadline(Duration::from_secs(240))
}

/// An exact flight of minutes that has written a few frames. However fast a machine is, it has
/// rounds left when a stage is stopped.
fn long_flight(folder: &TestFolder) -> Running {
    let out = folder.join("a/");
    let mut running = fly(&["--path", "orbit", "--frames", "0..100000", "--quality", "best", "-o"]).arg(&out).spawn();
    running.until("the third frame", |_| Path::exists(&out.join("frame-000002.png")).then_some(()));
    running
}

#[test]
fn a_stage_that_is_stopped_ends_an_exact_flight_with_its_name() {
    for stage in STAGES {
        let folder = TestFolder::new("hang-stopped");
        let mut running = long_flight(&folder);
        let all = pids(&running);
        signal_process(running.stage(stage), Signal::STOP);
        let finished = running.wait();
        assert_over(&finished, &all);
        let said = &finished.stderr;
        assert!(said.contains(&format!("the {stage} gave no sign of life for")), "{stage}:\n{said}");
    }
}

/// A flight of poses; its third frame is there.
fn flight_of_poses(name: &SharedName, hang_after: &str, more: &[&str]) -> (Running, PoseSender, FrameRingReader) {
    start_of_poses(fly_with_patience(hang_after, more), name, 3)
}

#[test]
fn a_stage_that_is_stopped_is_started_again_where_restarts_are_on() {
    let (folder, name) = (TestFolder::new("hang-again"), shared_name("hang-again"));
    let report = folder.join("report.json").display().to_string();
    let (mut flight, poses, mut ring) = flight_of_poses(&name, HANG_AFTER, &["--restarts", "3", "--report", &report]);
    signal_process(flight.stage("preparer"), Signal::STOP);
    for k in 3..6 {
        step(&mut flight, &poses, &mut ring, &mut SharedFrame::default(), &pose(k));
    }
    end(&poses);
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(finished.stderr.contains("the preparer gave no sign of life for"), "{}", finished.stderr);
    let report = read_report(&folder);
    assert_eq!(report["restarts"], serde_json::json!({ "preparer": 1 }));
    assert_eq!(report["frames"], 6);
}

#[test]
fn a_flight_that_is_stopped_as_a_whole_goes_on_afterwards() {
    let name = shared_name("hang-paused");
    let (mut flight, poses, mut ring) = flight_of_poses(&name, "3", &[]);
    // As Ctrl-Z does it: the whole group, with work to do, longer than a stage may hang.
    let all: Vec<u32> = pids(&flight).into_iter().chain([flight.pid()]).collect();
    all.iter().rev().for_each(|pid| signal_process(*pid, Signal::STOP));
    poses.send(&pose(3));
    std::thread::sleep(Duration::from_secs(7));
    all.iter().for_each(|pid| signal_process(*pid, Signal::CONT));
    for k in 4..6 {
        step(&mut flight, &poses, &mut ring, &mut SharedFrame::default(), &pose(k));
    }
    end(&poses);
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(!finished.stderr.contains("no sign of life"), "{}", finished.stderr);
}

/// A folder with a program of this name.
fn program(folder: &TestFolder, name: &str, script: &str) -> String {
    let path = folder.join(name);
    fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    format!("{}:{}", folder.path().display(), std::env::var("PATH").unwrap())
}

fn film(name: &str, script: &str, arguments: &[&str]) -> (Finished, Vec<u32>) {
    let (programs, folder) = (TestFolder::new(&format!("{name}-programs")), TestFolder::new(name));
    let path = program(&programs, "ffmpeg", script);
    let mut running =
        fly(&["--path", "orbit", "-o"]).arg(folder.join("a.mp4")).args(arguments).env("PATH", path).spawn();
    let mut all = Vec::new();
    while !running.has_ended() {
        all.extend(pids(&running));
        std::thread::sleep(Duration::from_millis(10));
    }
    let finished = running.wait();
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().map(|entry| entry.file_name()).collect();
    assert!(left.is_empty(), "{left:?} are left");
    (finished, all)
}

#[test]
fn an_encoder_that_sleeps_ends_the_flight_with_its_name() {
    // At once, and when it has all pictures; and a sleep in it that inherits its pipes.
    for (script, frames) in [("exec sleep 600", "0..20"), ("cat > /dev/null; sleep 600", "0..2")] {
        let (finished, all) = film("hang-encoder", script, &["--frames", frames, "--restarts", "5"]);
        assert_over(&finished, &all);
        assert!(finished.stderr.contains("ffmpeg took nothing of"), "{script}:\n{}", finished.stderr);
        assert!(!finished.stderr.contains("started again"), "{}", finished.stderr);
    }
}

#[test]
fn an_encoder_that_ends_well_and_makes_no_film_is_told() {
    for (script, told) in [("exec cat > /dev/null", "wrote nothing"), ("exit 0", "exit code 0")] {
        let (finished, all) = film("idle-encoder", script, &["--frames", "0..30"]);
        assert_over(&finished, &all);
        let said = &finished.stderr;
        assert!(said.contains("ffmpeg could not make") && said.contains(told), "{script}:\n{said}");
    }
}

/// Writer and reader of the ping-pong buffer both wait for the other, and both are well.
#[test]
fn stages_that_wait_for_each_other_are_told() {
    const WRITTEN: u64 = 256;
    const GIVEN_BACK: u64 = WRITTEN + 128;
    let name = shared_name("hang-scribble");
    let (mut flight, poses, mut ring) = flight_of_poses(&name, HANG_AFTER, &[]);
    let mut shared = SharedFrame::default();
    let segments = segments_of_launcher(flight.pid());
    let buffer = segments.iter().find(|name| name.ends_with("ping-pong")).unwrap();
    let file = OpenOptions::new().read(true).write(true).open(Path::new("/dev/shm").join(buffer)).unwrap();
    let all = pids(&flight);
    for k in 3.. {
        // No tree was given back, as far as the generator will see. It looks when it needs a half,
        // at the second tree at the latest.
        let mut written = [0; 8];
        file.read_exact_at(&mut written, WRITTEN).unwrap();
        file.write_all_at(&(u64::from_ne_bytes(written) - 2).to_ne_bytes(), GIVEN_BACK).unwrap();
        poses.send(&pose(k));
        while !flight.has_ended() && shared.info.is_none_or(|info| info.pose_time_s != k as f64) {
            ring.read(&mut shared).unwrap();
            std::thread::sleep(Duration::from_millis(5));
        }
        if flight.has_ended() {
            break;
        }
    }
    let finished = flight.wait();
    assert_over(&finished, &all);
    let said = &finished.stderr;
    assert!(said.contains("made no progress for") && said.contains("waited for each other"), "{said}");
    assert!(left_of(&name).is_empty());
}

#[test]
fn a_sender_that_rests_longer_than_a_stage_may_hang_ends_nothing() {
    let name = shared_name("hang-rest");
    let (mut flight, poses, mut ring) = flight_of_poses(&name, "3", &[]);
    for k in 3..6 {
        std::thread::sleep(Duration::from_secs(5));
        step(&mut flight, &poses, &mut ring, &mut SharedFrame::default(), &pose(k));
    }
    end(&poses);
    flight.wait().assert_code(0);
}
