//! What another program, or the system, does to a flight ends it with a sentence: files that are
//! cut, signals, limits.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use rustix::process::Signal;
use std::fs::{self, OpenOptions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};
use terravision_common::shm::{PoseSender, SharedFrame, SharedName};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, left_of, shared_name, step};
use terravision_tests::posed::{assert_over, pids, pose, small_flight, start_of_poses};
use terravision_tests::process::{Finished, Running, Terravision, binary, segments_of_launcher, signal_process};
use terravision_tests::worlds::synth_world;

fn fly(arguments: &[&str]) -> Terravision {
    small_flight().args(arguments)
}

/// A flight of poses that has shown two frames.
fn live_flight(name: &SharedName, more: &[&str]) -> (Running, PoseSender) {
    let (flight, poses, _) = start_of_poses(fly(more), name, 2);
    (flight, poses)
}

fn cut(path: &Path, len: u64) {
    OpenOptions::new().write(true).open(path).unwrap().set_len(len).unwrap();
}

/// A client that opens the frame ring for writing and cuts it, between two frames and against the
/// clock.
#[test]
fn a_frame_ring_that_is_cut_ends_the_flight_with_a_sentence() {
    for (len, more) in [(0, &[][..]), (4096, &["--mode", "realtime", "--fps", "10", "--restarts", "1"][..])] {
        let name = shared_name("cut-ring");
        let (flight, poses) = live_flight(&name, more);
        let all = pids(&flight);
        cut(&Path::new("/dev/shm").join(name.ring_file()), len);
        // The next frame; the segment of poses is whole.
        poses.send(&pose(2));
        let finished = flight.wait();
        assert_over(&finished, &all);
        let told = format!("/dev/shm/{} was cut by another program: it has ", name.ring_file());
        assert!(finished.stderr.contains(&told), "{}", finished.stderr);
        assert!(left_of(&name).is_empty());
    }
}

#[test]
fn a_segment_of_poses_that_is_cut_ends_the_flight_with_a_sentence() {
    for len in [0, 70] {
        let name = shared_name("cut-poses");
        let (flight, poses) = live_flight(&name, &[]);
        let all = pids(&flight);
        // Its mapping would end this process, too.
        drop(poses);
        cut(&Path::new("/dev/shm").join(name.camera_file()), len);
        let finished = flight.wait();
        assert_over(&finished, &all);
        let told = format!("/dev/shm/{} was cut by another program: it has {len} bytes", name.camera_file());
        assert!(finished.stderr.contains(&told), "{}", finished.stderr);
        assert!(left_of(&name).is_empty());
    }
}

/// Of a run's own segments: the stage that dies of it is told of by the launcher, and the launcher
/// by itself.
#[test]
fn segments_of_a_run_that_are_cut_are_told() {
    for kind in ["ring", "color-pool", "ping-pong", "control", "events-renderer"] {
        let folder = TestFolder::new("cut-run");
        let out = folder.join("a/");
        let mut flight = fly(&["--path", "orbit", "--technique", "mesh", "--quality", "best", "-o"]).arg(&out).spawn();
        flight.until("a frame", |_| out.join("frame-000001.png").exists().then_some(()));
        let all = pids(&flight);
        let segments = segments_of_launcher(flight.pid());
        let suffix = format!("-{kind}");
        let is_it = |name: &&String| name.ends_with(&suffix) && (kind != "ring" || !name.ends_with("elevation-ring"));
        cut(&Path::new("/dev/shm").join(segments.iter().find(is_it).unwrap()), 0);
        let finished = flight.wait();
        assert_over(&finished, &all);
        assert!(finished.stderr.contains("truncated by another program"), "{kind}:\n{}", finished.stderr);
    }
}

/// Signals that a terminal sends to all are left to the launcher; TERM to one stage is a death of
/// that stage.
#[test]
fn the_renderer_treats_signals_as_the_other_stages_do() {
    for stage in ["renderer", "preparer"] {
        // Of poses, it lasts until it is ended, however fast it is drawn.
        let name = shared_name("signals");
        let (mut flight, poses, mut ring) = start_of_poses(fly(&[]), &name, 1);
        let mut shared = SharedFrame::default();
        let pid = flight.stage(stage);
        for signal in [Signal::INT, Signal::HUP] {
            signal_process(pid, signal);
        }
        for k in 1..4 {
            step(&mut flight, &poses, &mut ring, &mut shared, &pose(k));
        }
        end(&poses);
        flight.wait().assert_code(0);

        let folder = TestFolder::new("signals-term");
        let out = folder.join("a/");
        let mut flight = fly(&["--path", "orbit", "--technique", "mesh", "--quality", "best", "-o"]).arg(&out).spawn();
        let pid = flight.stage(stage);
        flight.until("a frame", |_| out.join("frame-000001.png").exists().then_some(()));
        let all = pids(&flight);
        signal_process(pid, Signal::TERM);
        let finished = flight.wait();
        assert_over(&finished, &all);
        let told = format!("the {stage} was killed by signal 15 (TERM)");
        assert!(finished.stderr.contains(&told), "{}", finished.stderr);
        for entry in fs::read_dir(&out).unwrap().flatten() {
            image::open(entry.path()).unwrap_or_else(|error| panic!("half a picture is left: {error}"));
        }
    }
}

fn shell(script: &str) -> Finished {
    Terravision::program("bash").args(["-c", script]).run()
}

/// A sentence and an exit code, whatever the system refuses.
fn assert_sentence(finished: &Finished) {
    let code = finished.code().unwrap_or_else(|| panic!("ended by a signal: {}\n{}", finished.status, finished.stderr));
    assert!(matches!(code, 1 | 2), "{code}\n{}", finished.stderr);
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
    assert!(finished.stderr.lines().any(|line| line.starts_with("terravision: ")), "{}", finished.stderr);
    assert!(segments_of_launcher(finished.pid).is_empty());
}

#[test]
fn a_file_that_may_not_grow_is_a_sentence() {
    let (folder, world) = (TestFolder::new("file-limit"), synth_world(1024));
    let (program, database) = (binary("terravision"), world.database());
    let (program, database) = (program.display(), database.display());
    let out = folder.path().display();
    // 1024 bytes each: the first is less than a segment, the second is more than all segments and
    // less than the ground.
    let still = format!("still '{database}' --eye 500,500,3000 --pitch -60 -o '{out}/a.png' --memory 64MiB");
    for script in [
        format!("ulimit -f 16; exec '{program}' {still} --size 320x180"),
        format!("ulimit -f 200000; exec '{program}' {still} --ground '{out}/g.tif' --size 4000x3000"),
        format!("ulimit -f 8; exec '{program}' synth --size 512 -o '{out}/synth'"),
        format!("ulimit -f 8; exec '{program}' ingest --elevation '{}' -o '{out}/w.tv'", world.dem().display()),
    ] {
        let finished = shell(&script);
        assert_sentence(&finished);
    }
}

/// As another user, for whom limits hold; not where this is not root's to do.
#[test]
fn threads_that_cannot_be_started_are_a_sentence() {
    if !rustix::process::getuid().is_root() {
        return;
    }
    let (folder, world) = (TestFolder::new("threads"), synth_world(1024));
    fs::set_permissions(folder.path(), fs::Permissions::from_mode(0o777)).unwrap();
    let user = 60_000 + std::process::id() % 5000;
    let (program, database, out) = (binary("terravision"), world.database(), folder.path().to_owned());
    for most in [1, 2, 3, 5, 8, 12, 16, 20, 24, 28] {
        let finished = Terravision::program("setpriv")
            .args([format!("--reuid={user}"), "--clear-groups".into(), "--".into(), "prlimit".into()])
            .args([format!("--nproc={most}"), "--".into()])
            .arg(&program)
            .args(["fly".as_ref(), database.as_os_str()])
            .args(["--technique", "rays", "--size", "64x36", "--frames", "0..2", "-o"])
            .arg(out.join("a/"))
            .env("HOME", &out)
            .run();
        assert!(!finished.stderr.contains("panicked"), "{most}:\n{}", finished.stderr);
        if finished.code() != Some(0) {
            assert_sentence(&finished);
        }
        let left: Vec<_> = segments_of_launcher(finished.pid);
        assert!(left.is_empty(), "{most}: {left:?}");
    }
}

#[test]
fn a_standard_output_that_is_closed_is_no_panic_and_one_that_breaks_is_told() {
    let (program, database) = (binary("terravision"), synth_world(1024).database());
    let (program, database) = (program.display(), database.display());
    let commands = ["--help", "--version", "doctor", &format!("info '{database}'"), &format!("path '{database}'")];
    for command in commands {
        let closed = shell(&format!("exec '{program}' {command} >&-"));
        assert!(
            matches!(closed.code(), Some(0..=2)) && !closed.stderr.contains("panicked"),
            "{command}: {}",
            closed.stderr
        );
        // No client reads.
        let script = format!("exec 3> >(exec true); sleep 0.3; '{program}' {command} >&3");
        let broken = shell(&script);
        assert!(!broken.stderr.contains("panicked"), "{command}: {}", broken.stderr);
        assert!(matches!(broken.code(), Some(1 | 2)), "{command}: {}\n{}", broken.status, broken.stderr);
        assert!(broken.stderr.contains("terravision: "), "{command}: {}", broken.stderr);
    }
    let film = shell(&format!("exec '{program}' fly '{database}' --path orbit --frames 0..2 --size 64x36 -o - >&-"));
    film.assert_code(0);
    assert!(film.stderr.contains("standard output is closed"), "{}", film.stderr);
}

#[test]
fn figures_for_everybody_are_warned_of() {
    let folder = TestFolder::new("metrics-all");
    let flight = |address: &str| {
        fly(&["--path", "orbit", "--frames", "0..2", "--metrics", address, "-o"]).arg(folder.join("a/")).run()
    };
    let all = flight("0.0.0.0:0");
    all.assert_code(0);
    assert!(all.stderr.contains("warning: --metrics 0.0.0.0:") && all.stderr.contains("everybody"), "{}", all.stderr);
    assert!(!flight("0").stderr.contains("warning"));
}

#[test]
fn a_report_goes_into_a_fifo_that_is_read() {
    let folder = TestFolder::new("fifo");
    let script = format!(
        "mkfifo '{out}/r' && (cat '{out}/r' > '{out}/report.json' &) && exec '{}' fly '{}' --path orbit --frames 0..2 \
         --size 64x36 -o '{out}/a/' --report '{out}/r'",
        binary("terravision").display(),
        synth_world(1024).database().display(),
        out = folder.path().display()
    );
    shell(&script).assert_code(0);
    let end = Instant::now() + Duration::from_secs(20);
    while !fs::read_to_string(folder.join("report.json")).is_ok_and(|text| text.contains("\"settled\"")) {
        assert!(Instant::now() < end, "no report came");
        std::thread::sleep(Duration::from_millis(10));
    }
}
