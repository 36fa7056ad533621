//! The gain of prediction over a slow link: a fast straight flight, turns, and a stop, in simulated
//! time.
#![allow(clippy::print_stdout, reason = "the figures are what one wants to see")]

mod support;

use std::thread;
use support::MS;
use support::link::{Flown, Foresight, LinkFields, fly};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::run::Prediction;

/// 20 Mbit/s and 80 ms.
const LINK: LinkFields = LinkFields { latency_nanos: 80 * MS, bytes_per_sec: 2_500_000, loses_one_in: 0 };

const SECS: u64 = 60;

/// 0 to 20 s straight ahead at 300 m/s, to 45 s turns of 20 degrees a second to either side, then a
/// stop within 3 s.
fn path(time: f64) -> Camera {
    let speed = |t: f64| if t < 45.0 { 300.0 } else { 300.0 * ((48.0 - t) / 3.0).clamp(0.0, 1.0) };
    let rate = |t: f64| {
        // Turns swing in and out within a second, as anything that flies does.
        let swing = |begin: f64, end: f64| (t - begin).clamp(0.0, 1.0).min((end - t).clamp(0.0, 1.0));
        20f64.to_radians() * (swing(20.0, 29.0) - swing(30.0, 38.0) + swing(39.0, 45.0))
    };
    let (mut east, mut north, mut heading) = (30_000.0, 8_000.0, 0.3f64);
    let step = 0.02;
    for k in 0..(time / step) as u64 {
        let t = k as f64 * step;
        heading += rate(t) * step;
        east += heading.sin() * speed(t) * step;
        north += heading.cos() * speed(t) * step;
    }
    Camera::new(CameraFields {
        eye_in_world: [east, north, 600.0],
        heading_rad: heading,
        pitch_rad: -0.3,
        roll_rad: 0.0,
        vfov_rad: 0.9,
        width: 1280,
        height: 720,
        timestamp_nanos: 0,
    })
    .expect("valid")
}

fn all(link: LinkFields) -> [(&'static str, Flown); 4] {
    let kinds = [
        ("off", Foresight::None),
        ("linear", Foresight::Predicted(Prediction::Linear)),
        ("quadratic", Foresight::Predicted(Prediction::Quadratic)),
        ("oracle", Foresight::Oracle),
    ];
    thread::scope(|scope| {
        kinds
            .map(|(name, foresight)| (name, scope.spawn(move || fly(link, SECS, &path, foresight))))
            .map(|(name, flight)| (name, flight.join().expect("no panic")))
    })
}

fn print(flown: &[(&'static str, Flown)]) {
    for (name, flight) in flown {
        let part =
            |from: usize, to: usize| flight.sharp[from * 30..to * 30].iter().sum::<f64>() / ((to - from) * 30) as f64;
        println!(
            "{name:>9}: sharp {:.4} (straight {:.4}, turns {:.4}, stop {:.4}); {:.1} MB, {} given up, N {:?}, {} missing",
            flight.mean(),
            part(3, 20),
            part(20, 45),
            part(45, 60),
            flight.bytes as f64 / 1e6,
            flight.cancelled,
            flight.n.iter().step_by(25).collect::<Vec<_>>(),
            flight.missing_at_end,
        );
    }
}

#[test]
fn prediction_pays_over_a_slow_link() {
    let flown = all(LINK);
    print(&flown);
    let [(_, off), (_, linear), (_, quadratic), (_, oracle)] = &flown;
    for predicted in [linear, quadratic] {
        assert!(predicted.mean() >= 0.9 * oracle.mean());
        // Prediction at least halves the share that is not drawn as wanted.
        assert!(1.0 - predicted.mean() < 0.5 * (1.0 - off.mean()));
        assert!(predicted.bytes as f64 <= 1.5 * oracle.bytes as f64);
    }
    // After the stop all wanted tiles arrive, whatever was predicted.
    assert!(flown.iter().all(|(_, flight)| flight.missing_at_end == 0 && flight.sharp.last() == Some(&1.0)));
}

#[test]
fn prediction_pays_over_a_link_that_carries_little_more_than_what_is_wanted() {
    // 4 Mbit/s and 250 ms.
    let flown = all(LinkFields { latency_nanos: 250 * MS, bytes_per_sec: 500_000, ..LINK });
    print(&flown);
    let [(_, off), (_, linear), (_, quadratic), (_, oracle)] = &flown;
    for predicted in [linear, quadratic] {
        assert!(predicted.mean() >= 0.9 * oracle.mean() && predicted.mean() > off.mean());
        assert!(predicted.bytes as f64 <= 1.5 * oracle.bytes as f64);
    }
    assert!(flown.iter().all(|(_, flight)| flight.missing_at_end == 0));
}

#[test]
fn a_third_of_requests_lost_costs_sharpness_for_a_while_and_nothing_for_ever() {
    let flown = all(LinkFields { loses_one_in: 3, ..LINK });
    print(&flown);
    for (name, flight) in &flown {
        assert_eq!(flight.missing_at_end, 0, "{name}");
        assert!(flight.n.iter().all(|n| *n <= 64), "{name}: N does not grow while requests are lost: {:?}", flight.n);
    }
}
