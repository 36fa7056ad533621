//! Flights against the clock over a database behind a slow link: what they become when the camera
//! rests, and the bench.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::fs;
use std::time::Duration;
use terravision_testkit::fault_server::{FaultServer, Link};
use terravision_tests::findings::Findings;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Terravision, binary};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

/// Frames in which the camera moves.
const MOVING: u64 = 15;

#[test]
fn when_the_camera_rests_the_picture_becomes_that_of_exact_mode_byte_for_byte() {
    let world = synth_world(1024).database();
    let server = FaultServer::serve(world.parent().unwrap());
    server.set_link(Link { latency: Duration::from_millis(80), bits_per_s: Some(20_000_000) });
    // How long what is missing takes depends on the machine, too: longer rests follow when it was
    // too short.
    for frames in [60, 200, 600] {
        let folder = TestFolder::new("link-settled");
        let pose = |k: u64| {
            let t = (k as f64 / MOVING as f64).min(1.0);
            Pose::new(synth_world(1024).above(0.3 + 0.3 * t, 0.35, 350.0), 60.0 + 50.0 * t, -20.0)
        };
        write_path(&folder.join("path.json"), &(0..frames).map(pose).collect::<Vec<_>>(), [320, 180], 60.0);
        let fly = |world: &str, name: &str, flags: &[&str]| {
            Terravision::verb("fly")
                .args([world, "--fps", "10", "--path"])
                .arg(folder.join("path.json"))
                .arg("-o")
                .arg(folder.join(format!("{name}/")))
                .arg("--cache")
                .arg(folder.join("cache"))
                .args(flags)
                .run()
                .assert_code(0);
        };
        let report = folder.join("report.json").display().to_string();
        fly(&server.url("world.tv"), "live", &["--mode", "realtime", "--feedback", "off", "--report", &report]);
        let report = read_report(&folder);
        let last = |name: &str| report["realtime"]["drawn"][name].as_array().unwrap().last().unwrap().clone();
        assert_eq!(last("frame"), frames - 1);
        if last("tiles_resident") != last("tiles_wanted") {
            continue;
        }
        assert_eq!(last("sharp"), 1.0);
        fly(&world.display().to_string(), "exact", &["--frames", &format!("{}..{frames}", frames - 1)]);
        let picture = |name: &str| fs::read(folder.join(format!("{name}/frame-{:06}.png", frames - 1))).unwrap();
        assert!(picture("live") == picture("exact"), "the settled picture is another one");
        return;
    }
    panic!("the picture did not settle within a minute of rest");
}

#[test]
fn the_bench_flies_with_each_prediction() {
    assert!(binary("terravision-bench").is_file());
    let folder = TestFolder::new("link-bench");
    let bench = Terravision::verb("bench")
        .args(["link", "--json", "--seconds", "4", "--predictions", "off,linear,oracle", "--size", "160x90", "--world"])
        .arg(synth_world(1024).database())
        .arg("-o")
        .arg(folder.join("plots"))
        .succeed();
    let found = Findings::of(&bench.stdout);
    let value = |name: &str| found.value(name);
    for prediction in ["off", "linear", "oracle"] {
        for part in ["all of it", "straight ahead", "turns", "stop", "at the end"] {
            let share = value(&format!("{prediction}: drawn as wanted, {part}"));
            assert!((0.0..=1.0).contains(&share), "{prediction}, {part}: {share}");
        }
        assert!(value(&format!("{prediction}: fetched")) > 0.1);
    }
    assert!(value("linear against oracle: fetched") > 0.0 && value("linear against off: not as wanted") >= 0.0);
    let plot = fs::read_to_string(folder.join("plots/link.svg")).unwrap();
    assert!(plot.contains("oracle") && plot.contains("tiles missing") && plot.contains("polyline"));
}

#[test]
fn the_bench_of_long_flights_looks_at_memory_and_files() {
    assert!(binary("terravision-bench").is_file());
    let folder = TestFolder::new("long-run");
    let bench = Terravision::verb("bench")
        .args(["long-run", "--json", "--seconds", "8", "--size", "160x90", "--memory-mib", "256", "--world"])
        .arg(synth_world(1024).database())
        .arg("-o")
        .arg(folder.join("plots"))
        .succeed();
    let found = Findings::of(&bench.stdout);
    let value = |name: &str| found.get(name);
    assert!(value("memory with the pools, all processes") > Some(20.0), "{found:?}");
    assert!(value("open files") > Some(20.0) && value("tiles loaded") > Some(20.0), "{found:?}");
    assert!(value("memory of their own, last quarter against second") > Some(0.5), "{found:?}");
    assert!(fs::read_to_string(folder.join("plots/long-run.svg")).unwrap().contains("all processes"));
}
