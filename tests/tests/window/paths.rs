//! A path that Space plays.

use super::screen::{Screen, has_server};
use super::{Flight, view};
use std::fs;
use std::time::Duration;
use terravision_common::shm::PoseRecord;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

const SPACE: u32 = 0x20;
const W: u32 = 0x77;

/// Two keyframes over the middle of the world, seconds apart.
fn keyframes(seconds: f64) -> String {
    let world = synth_world(1024);
    let [from, to] = [0.4, 0.6].map(|share| world.above(share, share, 900.0));
    let key = |t: f64, [x, y, z]: [f64; 3]| {
        format!("{{\"t\":{t},\"x\":{x},\"y\":{y},\"z\":{z},\"heading\":45,\"pitch\":-30}}")
    };
    format!("{{\"vfov_deg\":50,\"keyframes\":[{},{}]}}", key(0.0, from), key(seconds, to))
}

#[test]
fn space_plays_and_pauses_the_path_that_fly_flies() {
    if !has_server() {
        return;
    }
    let folder = TestFolder::new("window-path");
    let path = folder.join("path.json");
    fs::write(&path, keyframes(4.0)).unwrap();
    let flight = Flight::start(&["--path", path.to_str().unwrap()]);
    let place = |pose: &PoseRecord| [pose.position[0], pose.position[1], pose.position[2]];
    // It begins at the first pose.
    let poses = Terravision::verb("path").arg(synth_world(1024).database()).arg("--path").arg(&path).succeed();
    let poses: serde_json::Value = serde_json::from_slice(&poses.stdout).unwrap();
    let flown: Vec<[f64; 3]> = poses["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pose| ["x", "y", "z"].map(|axis| pose[axis].as_f64().unwrap()))
        .collect();
    let away = |a: [f64; 3], b: [f64; 3]| (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt();
    let start = flight.pose();
    assert!(away(place(&start), flown[0]) < 0.1 && (start.vfov_deg - 50.0).abs() < 1e-6, "{start:?}");
    flight.moves("a flight along the path", |screen| screen.tap(SPACE));
    flight
        .screen
        .until("the time in the title bar", || flight.screen.title(flight.window).contains(" of 0:04").then_some(()));
    std::thread::sleep(Duration::from_millis(500));
    flight.screen.tap(SPACE);
    std::thread::sleep(Duration::from_millis(200));
    let paused = flight.pose();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(flight.pose().position, paused.position);
    // On the spline of `fly`: between two of its frames, less than a step from either.
    let step = flown.windows(2).map(|pair| away(pair[0], pair[1])).fold(0.0, f64::max);
    let nearest = flown.iter().map(|at| away(*at, place(&paused))).fold(f64::INFINITY, f64::min);
    assert!(nearest <= step, "{nearest} m from the path of steps of {step} m");
    assert!(away(place(&paused), flown[0]) > step && away(place(&paused), flown[flown.len() - 1]) > step);
    // Hands take the camera, and Space goes on where the path was.
    flight.moves("a flight by hand", |screen| screen.hold(W, Duration::from_millis(300)));
    flight.screen.tap(SPACE);
    let end = flown[flown.len() - 1];
    flight.screen.until("the end of the path", || (away(place(&flight.pose()), end) < 1e-3).then_some(()));
    flight.ends(|flight| flight.screen.close(flight.window));
}

#[test]
fn a_path_without_times_is_played_as_fast_as_asked_for() {
    if !has_server() {
        return;
    }
    // 240 frames, 30 a second.
    for (speed, length) in [("1", " of 0:07"), ("2", " of 0:03")] {
        let flight = Flight::start(&["--path", "orbit", "--speed", speed]);
        flight.screen.tap(SPACE);
        flight.screen.until(length, || flight.screen.title(flight.window).contains(length).then_some(()));
        flight.ends(|flight| flight.screen.close(flight.window));
    }
}

#[test]
fn paths_with_errors_are_told_in_a_sentence() {
    if !has_server() {
        return;
    }
    let screen = Screen::start([640, 480]);
    let folder = TestFolder::new("window-bad-path");
    let told = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).unwrap();
        let finished = view(&["--path", path.to_str().unwrap()]).env("DISPLAY", &screen.name).run();
        finished.assert_code(2);
        let said = finished.stderr.trim().to_owned();
        assert!(said.starts_with("terravision: ") && said.lines().count() == 1, "{said}");
        said
    };
    assert!(told("a.json", "{\"keyframes\":[{\"t\":0,\"x\":1}]}").contains("a.json"));
    assert!(told("b.kml", "<kml>\n<a></kml>").contains("line 2"));
    assert!(told("c.txt", "hello").contains("found \"hello\""));
    let far = "{\"keyframes\":[{\"t\":0,\"x\":-9e6,\"y\":0,\"z\":9,\"heading\":0,\"pitch\":0}]}";
    assert!(told("d.json", far).contains("nowhere near the world"));
    let stopped = view(&["--path", "orbit", "--speed", "0"]).env("DISPLAY", &screen.name).run();
    stopped.assert_code(2);
    assert_eq!(stopped.stderr.trim(), "terravision: --speed 0: expected a factor from 0.001 to 10000");
    let missing = view(&["--path", "/nowhere/a.json"]).env("DISPLAY", &screen.name).run();
    missing.assert_code(2);
    assert!(
        missing.stderr.contains("/nowhere/a.json") && missing.stderr.trim().lines().count() == 1,
        "{}",
        missing.stderr
    );
}
