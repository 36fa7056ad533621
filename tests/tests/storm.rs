//! Storms over a flight, in their short form; `scripts/storm.sh` has the long one.

#![allow(clippy::print_stdout, reason = "the figures of a run are worth a look")]

use std::time::Duration;
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
