//! Processes that are killed: the others notice, say so and leave nothing behind.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use std::path::Path;
use std::time::{Duration, Instant};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Running, Terravision, is_alive, segments_of_launcher, signal_process};
use terravision_tests::worlds::synth_world;

/// A flight of minutes, started and seen to write frames.
fn long_flight(folder: &TestFolder) -> Running {
    let world = synth_world(1024);
    let out = folder.join("a/");
    let mut running = Terravision::verb("fly")
        .arg(world.database())
        .arg("-o")
        .arg(&out)
        .args(["--path", "orbit", "--size", "640x360", "--quality", "best"])
        .deadline(Duration::from_secs(120))
        .spawn();
    running.until("the third frame", |_| Path::exists(&out.join("frame-000002.png")).then_some(()));
    running
}

fn assert_nothing_left(launcher: u32, stages: &[u32]) {
    let until = Instant::now() + Duration::from_secs(60);
    while stages.iter().any(|pid| is_alive(*pid)) && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(5));
    }
    let alive: Vec<_> = stages.iter().filter(|pid| is_alive(**pid)).collect();
    assert!(alive.is_empty(), "processes {alive:?} outlive their launcher");
    let left = segments_of_launcher(launcher);
    assert!(left.is_empty(), "{left:?} stay in /dev/shm");
}

fn kill_stage(stage: &str) {
    let folder = TestFolder::new(&format!("kill-{stage}"));
    let mut running = long_flight(&folder);
    let stages: Vec<u32> = running.children().into_iter().map(|(pid, _)| pid).collect();
    assert_eq!(stages.len(), 4, "four stages run: {:?}", running.children());
    assert!(!segments_of_launcher(running.pid()).is_empty(), "the run has segments");
    let victim = running.stage(stage);
    let killed = Instant::now();
    signal_process(victim, Signal::KILL);
    let finished = running.wait();
    println!("{stage}: the launcher ended {:?} after the kill", killed.elapsed());
    finished.assert_told(1);
    assert!(finished.stderr.contains(stage), "it says which stage died:\n{}", finished.stderr);
    assert_nothing_left(finished.pid, &stages);
}

#[test]
fn a_killed_generator_ends_the_run_with_a_message() {
    kill_stage("generator");
}

#[test]
fn a_killed_preparer_ends_the_run_with_a_message() {
    kill_stage("preparer");
}

#[test]
fn a_killed_prefetcher_ends_the_run_with_a_message() {
    kill_stage("prefetcher");
}

#[test]
fn a_killed_renderer_ends_the_run_with_a_message() {
    kill_stage("renderer");
}

#[test]
fn stages_end_with_a_killed_launcher_and_the_next_run_removes_its_segments() {
    let folder = TestFolder::new("kill-launcher");
    let running = long_flight(&folder);
    let launcher = running.pid();
    let stages: Vec<u32> = running.children().into_iter().map(|(pid, _)| pid).collect();
    running.signal(Signal::KILL);
    let finished = running.wait();
    assert_eq!(finished.code(), None);
    // Nobody is left to remove the segments; the next start does. Another test's run may have been
    // quicker.
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("-o")
        .arg(folder.join("b/"))
        .args(["--frames", "0..1", "--size", "320x180"])
        .run()
        .assert_code(0);
    assert_nothing_left(launcher, &stages);
}

#[test]
fn an_interrupt_ends_the_run_in_order() {
    for signal in [Signal::INT, Signal::TERM] {
        let folder = TestFolder::new("interrupt");
        let running = long_flight(&folder);
        let stages: Vec<u32> = running.children().into_iter().map(|(pid, _)| pid).collect();
        running.signal(signal);
        let finished = running.wait();
        finished.assert_told(130);
        assert_nothing_left(finished.pid, &stages);
        for entry in std::fs::read_dir(folder.join("a")).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            assert!(name.starts_with("frame-") && name.ends_with(".png"), "{name} is left behind");
            image::open(&path).unwrap_or_else(|error| panic!("{name} is half a picture: {error}"));
        }
    }
}
