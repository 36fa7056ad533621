//! A flight against the clock, from end to end: every frame of it is accounted for, has a picture,
//! and was drawn within what is allowed. How many are on time is for benches: a test machine may
//! have no time at all.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use serde_json::Value;
use terravision_tests::findings::Findings;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Terravision, binary};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [320, 180];

fn column<'a>(report: &'a Value, name: &str) -> &'a Vec<Value> {
    report["realtime"]["drawn"][name].as_array().unwrap_or_else(|| panic!("no column {name}: {report}"))
}

fn numbers(report: &Value, name: &str) -> Vec<f64> {
    column(report, name).iter().map(|value| value.as_f64().unwrap()).collect()
}

/// What holds for any flight against the clock, however slow the machine.
fn check(report: &Value, frames: u64, [finest, coarsest]: [f64; 2]) {
    let realtime = &report["realtime"];
    let count = |name: &str| realtime[name].as_u64().unwrap();
    assert_eq!((&report["mode"], count("frames"), &report["frames"]), (&"realtime".into(), frames, &frames.into()));
    assert_eq!(count("on_time") + count("late") + count("skipped"), frames);
    let drawn = numbers(report, "frame");
    assert_eq!(drawn.len() as u64, frames - count("skipped"));
    assert!(drawn.windows(2).all(|pair| pair[0] < pair[1]), "in order");
    assert_eq!((drawn[0], drawn[drawn.len() - 1]), (0.0, frames as f64 - 1.0), "neither end is left out");
    let columns = realtime["drawn"].as_object().unwrap();
    assert!(columns.values().all(|column| column.as_array().unwrap().len() == drawn.len()));
    for (name, [low, high]) in [("r_z_px", [finest, coarsest]), ("r_c_px", [1.0, 4.0])] {
        let values = numbers(report, name);
        assert!(values.iter().all(|r| (low - 1e-4..=high + 1e-4).contains(r)), "{name}: {values:?}");
    }
    // 0 is of a frame that shows the camera of the one before.
    let latencies = numbers(report, "latency_ms");
    assert!(latencies[0] > 0.0 && latencies.iter().all(|latency| *latency >= 0.0));
    assert!(numbers(report, "sharp").iter().all(|share| (0.0..=1.0).contains(share)));
    let tiles = numbers(report, "tiles_resident").into_iter().zip(numbers(report, "tiles_wanted"));
    assert!(tiles.into_iter().all(|(resident, wanted)| resident > 0.0 && resident <= wanted));
}

fn pose(t: f64) -> Pose {
    Pose::new(synth_world(1024).above(0.3 + 0.3 * t, 0.4, 400.0), 60.0 + 40.0 * t, -20.0)
}

#[test]
fn every_moment_has_a_picture_and_every_frame_is_accounted_for() {
    const FRAMES: u64 = 40;
    let folder = TestFolder::new("realtime-pictures");
    let poses: Vec<Pose> = (0..FRAMES).map(|k| pose(k as f64 / FRAMES as f64)).collect();
    write_path(&folder.join("path.json"), &poses, SIZE, 60.0);
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .args(["--facet-px", "10", "--mode", "realtime", "--path"])
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join("frames/"))
        .arg("--report")
        .arg(folder.join("report.json"))
        .succeed();
    check(&read_report(&folder), FRAMES, [10.0, 40.0]);
    let pictures = std::fs::read_dir(folder.join("frames")).unwrap().count();
    assert_eq!(pictures as u64, FRAMES);
}

#[test]
fn a_camera_that_rests_gets_no_coarser_picture_than_one_that_moves() {
    const FRAMES: u64 = 60;
    let folder = TestFolder::new("realtime-rest");
    write_path(&folder.join("path.json"), &vec![pose(0.5); FRAMES as usize], SIZE, 60.0);
    let fly = |flags: &[&str]| {
        Terravision::verb("fly")
            .arg(synth_world(1024).database())
            .args(["--facet-px", "10", "--mode", "realtime", "--fps", "10", "-o", "/dev/null", "--path"])
            .arg(folder.join("path.json"))
            .arg("--report")
            .arg(folder.join("report.json"))
            .args(flags)
            .succeed();
        read_report(&folder)
    };
    let report = fly(&["--rest-facet-px", "4"]);
    check(&report, FRAMES, [4.0, 40.0]);
    // It refines step by step; a machine that has no time at all for it at this size would have
    // other troubles.
    let r_z = numbers(&report, "r_z_px");
    assert!(r_z[r_z.len() - 1] < 9.0 && r_z[0] >= 9.99, "{r_z:?}");
    // Without feedback nothing changes.
    let report = fly(&["--feedback", "off", "--frames", "0..20"]);
    check(&report, 20, [10.0, 10.0]);
}

#[test]
fn every_prediction_flies_and_the_picture_is_as_wanted_where_the_camera_rests() {
    const FRAMES: u64 = 40;
    let folder = TestFolder::new("realtime-prediction");
    // It flies for a while, then rests.
    let poses: Vec<Pose> = (0..FRAMES).map(|k| pose((k as f64 / 15.0).min(1.0))).collect();
    write_path(&folder.join("path.json"), &poses, SIZE, 60.0);
    for prediction in ["off", "linear", "quadratic", "oracle"] {
        Terravision::verb("fly")
            .arg(synth_world(1024).database())
            .args([
                "--facet-px",
                "10",
                "--mode",
                "realtime",
                "--fps",
                "10",
                "--feedback",
                "off",
                "--prediction",
                prediction,
                "--path",
            ])
            .arg(folder.join("path.json"))
            .args(["-o", "/dev/null", "--report"])
            .arg(folder.join("report.json"))
            .succeed();
        let report = read_report(&folder);
        check(&report, FRAMES, [10.0, 10.0]);
        assert_eq!(report["prefetch"]["prediction"], prediction);
        let count = |name: &str| report["prefetch"][name].as_u64().unwrap();
        assert!(count("requested") >= count("received") && count("received") > 0 && count("bytes") > 0);
        assert!(report["network"].is_null(), "a folder");
        assert!(column(&report, "sharp").len() > 1);
    }
}

#[test]
fn the_bench_flies_with_and_without_feedback() {
    assert!(binary("terravision-bench").is_file());
    let folder = TestFolder::new("realtime-bench");
    let bench = Terravision::verb("bench")
        .args(["realtime", "--json", "--seconds", "6", "--load-seconds", "2", "--size", "320x180", "--world"])
        .arg(synth_world(1024).database())
        .arg("-o")
        .arg(folder.join("plots"))
        .succeed();
    let found = Findings::of(&bench.stdout);
    let value = |name: &str| found.value(name);
    let ratio = value("against the clock") / value("without a clock");
    assert!((0.55..0.65).contains(&ratio), "{ratio}");
    for name in ["feedback", "no feedback"] {
        for share in ["on time, outside 2 s after each step", "on time, all frames"] {
            assert!((0.0..=1.0).contains(&value(&format!("{name}: {share}"))));
        }
        assert!(value(&format!("{name}: load")) > 0.0);
    }
    assert_eq!(value("no feedback: r_z: largest swing in a steady state"), 0.0);
    let plot = std::fs::read_to_string(folder.join("plots/realtime.svg")).unwrap();
    assert!(plot.contains("no feedback") && plot.contains("camera to read-back, ms") && plot.contains("polyline"));
}

#[test]
fn flags_of_real_time_are_refused_in_exact_mode_and_when_they_contradict() {
    let folder = TestFolder::new("realtime-flags");
    for (flags, expected) in [
        (&["--feedback", "off"][..], "--feedback applies to --mode realtime"),
        (&["--rest-facet-px", "2"], "--rest-facet-px applies to --mode realtime"),
        (&["--mode", "realtime", "--coarsest-facet-px", "2"], "no less than what is wanted"),
        (&["--mode", "realtime", "--rest-texel-px", "2"], "what is wanted"),
        (&["--prediction", "linear"], "--prediction applies to --mode realtime"),
        (&["--prediction", "oracle", "--camera", "udp:127.0.0.1:0"], "needs a path that is known in advance"),
    ] {
        let ended = Terravision::verb("fly")
            .arg(synth_world(1024).database())
            .args(["-o", "/dev/null"])
            .args(flags)
            .current_dir(folder.path())
            .run();
        ended.assert_code(2);
        assert!(ended.stderr.contains(expected), "{}", ended.stderr);
    }
}
