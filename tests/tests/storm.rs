//! Storms over a flight, in their short form; `scripts/storm.sh` has the long one.

#![allow(clippy::print_stdout, reason = "the figures of a run are worth a look")]

use rustix::process::Signal;
use std::time::Duration;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Terravision, signal_process};
use terravision_tests::shot::read_report;
use terravision_tests::storm::{BytesStorm, DeathStorm};
use terravision_tests::worlds::synth_world;

#[test]
fn a_storm_of_death_stops_no_picture() {
    let storm = DeathStorm { seconds: 12.0, every: Duration::from_millis(1500), seed: 1 };
    let report = storm.fly(&synth_world(1024));
    println!("{report}");
    let faults = report.faults();
    assert!(faults.is_empty(), "{faults:?}\n{report}");
    assert!(report.kills.len() == 4 && report.frames_seen > 20, "{report}");
}

#[test]
fn a_storm_of_bytes_crashes_nobody() {
    let storm = BytesStorm { rounds: 5, seconds: 1.5, every: Duration::from_millis(20), seed: 1 };
    let report = storm.fly(&synth_world(1024));
    println!("{report}");
    assert!(report.faults.is_empty(), "{:#?}", report.faults);
    assert!(report.writes > 50 && report.frames_seen > 0, "{report}");
}

const SIZE: [u32; 2] = [320, 180];
const FRAMES: u64 = 40;

/// A flight in exact mode into the folder `frames/`, with a report.
fn exact_flight(folder: &TestFolder) -> Terravision {
    let world = synth_world(1024);
    let at = |k: u64| k as f64 / FRAMES as f64;
    let pose = |k| Pose::new(world.above(0.3 + 0.3 * at(k), 0.4, 400.0), 60.0 + 40.0 * at(k), -20.0);
    write_path(&folder.join("path.json"), &(0..FRAMES).map(pose).collect::<Vec<_>>(), SIZE, 60.0);
    Terravision::verb("fly")
        .arg(world.database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join("frames/"))
        .args(["--facet-px", "4"])
        .arg("--report")
        .arg(folder.join("report.json"))
}

fn pictures(folder: &TestFolder) -> Vec<Vec<u8>> {
    let names = (0..FRAMES).map(|frame| format!("frames/frame-{frame:06}.png"));
    let read = |name: String| std::fs::read(folder.join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    let count = std::fs::read_dir(folder.join("frames")).map_or(0, Iterator::count);
    assert_eq!(count as u64, FRAMES, "nothing else is in the folder");
    names.map(read).collect()
}

#[test]
fn an_exact_flight_has_the_same_bytes_whoever_is_killed_or_lost() {
    let undisturbed = TestFolder::new("storm-exact");
    exact_flight(&undisturbed).succeed();
    let expected = pictures(&undisturbed);

    let folder = TestFolder::new("storm-exact");
    let mut flight = exact_flight(&folder).args(["--restarts", "100"]).spawn();
    // Those that are ahead of the others first: they may be done early.
    let storm =
        [(0, "generator"), (1, "preparer"), (2, "prefetcher"), (3, "preparer"), (8, "renderer"), (20, "renderer")];
    let mut kills = 0;
    for (frame, victim) in storm {
        let picture = folder.join(format!("frames/frame-{frame:06}.png"));
        flight.until("a frame", |_| picture.exists().then_some(()));
        let name = format!("terravision-{victim}");
        if let Some((pid, _)) = flight.children().into_iter().find(|(_, child)| *child == name) {
            signal_process(pid, Signal::KILL);
            kills += 1;
        }
    }
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(pictures(&folder) == expected, "the bytes are others:\n{}", finished.stderr);
    let report = read_report(&folder);
    let restarts: u64 = report["restarts"].as_object().map_or(0, |all| all.values().filter_map(|n| n.as_u64()).sum());
    // Stages that are ahead may be done before their turn comes, or while they are killed; the
    // renderer never is.
    assert!((2..=kills).contains(&restarts), "{kills} kills, {}\n{}", report["restarts"], finished.stderr);

    let mesh = |folder: &TestFolder| exact_flight(folder).args(["--technique", "mesh"]);
    mesh(&undisturbed).succeed();
    let folder = TestFolder::new("storm-exact");
    mesh(&folder).env("TERRAVISION_TEST_LOSE_DEVICE_AT", "20").run().assert_code(0);
    assert!(pictures(&folder) == pictures(&undisturbed), "the bytes are others after a lost device");
}
