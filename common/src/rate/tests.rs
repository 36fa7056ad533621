//! The controller against a simulated renderer: step, ramp, noise, pause, rest; and against
//! nonsense.

use super::simulation::{Cost, Simulation};
use super::*;
use proptest::prelude::*;

const TARGET: f64 = 40e6;

fn settings() -> RateSettings {
    RateSettings { target_nanos: TARGET, wanted_px: [5.0, 1.0], coarsest_px: [160.0, 8.0], rest_px: [2.0, 0.5] }
}

fn controller() -> RateController {
    RateController::new(settings()).unwrap()
}

/// A frame of the target at r_z = 10, so the controller settles a little above that.
fn simulation(share: f64) -> Simulation {
    Simulation::new(Cost::of_frame(TARGET, 10.0, share), controller(), true)
}

fn fly(simulation: &mut Simulation, frames: usize, load: f64) {
    for _ in 0..frames {
        simulation.frame(load, true);
    }
}

/// Largest over smallest r_z of some frames.
fn variation(frames: &[simulation::SimulatedFrame]) -> f64 {
    let r_z = || frames.iter().map(|frame| frame.resolutions.r_z_px);
    r_z().fold(0.0, f64::max) / r_z().fold(f64::INFINITY, f64::min) - 1.0
}

fn late(frames: &[simulation::SimulatedFrame]) -> usize {
    frames.iter().filter(|frame| frame.nanos > TARGET).count()
}

#[test]
fn a_step_in_load_is_over_after_a_few_frames_and_overshoots_little() {
    for delay in 1..=4 {
        for share in [0.5, 0.8, 1.0] {
            let mut simulation = simulation(share).with_delay(delay);
            fly(&mut simulation, 120, 1.0);
            assert_eq!(late(&simulation.frames()[60..]), 0, "delay {delay}, share {share}");
            fly(&mut simulation, 120, 1.6);
            let after = &simulation.frames()[120..];
            // Each round of the loop takes the delay and two frames of the median; five rounds are
            // enough.
            let settled = 5 * (delay + 2) + 2;
            assert_eq!(late(&after[settled..]), 0, "delay {delay}, share {share}: {after:?}");
            let (last, worst) = (after[119].resolutions.r_z_px, after.iter().map(|f| f.resolutions.r_z_px));
            let worst = worst.fold(0.0, f64::max);
            assert!(worst <= 1.15 * last, "delay {delay}, share {share}: {worst} above {last}");
            assert!(variation(&after[80..]) < 0.1, "delay {delay}, share {share}");
        }
    }
}

#[test]
fn when_the_load_goes_the_picture_comes_back() {
    for share in [0.4, 0.8, 1.0] {
        let mut simulation = simulation(share);
        fly(&mut simulation, 150, 1.0);
        fly(&mut simulation, 150, 1.5);
        fly(&mut simulation, 250, 1.0);
        let back = &simulation.frames()[300..];
        assert_eq!(late(back), 0, "share {share}");
        // The dead band is reached from below, wherever the load had driven r_z.
        assert!(back[249].nanos > (BAND[0] - 0.01) * TARGET, "share {share}: {:?}", back[249]);
        // Once the loaded frames are out of the median only ever finer: no swing to the other side.
        assert!(back[20..].windows(2).all(|pair| pair[1].resolutions.r_z_px <= pair[0].resolutions.r_z_px));
    }
}

#[test]
fn a_ramp_is_followed() {
    let mut simulation = simulation(0.8);
    fly(&mut simulation, 100, 1.0);
    for step in 0..400 {
        simulation.frame(1.0 + f64::from(step) / 400.0, true);
    }
    assert!(late(&simulation.frames()[100..]) <= 8, "{}", late(&simulation.frames()[100..]));
    for step in 0..400 {
        simulation.frame(2.0 - f64::from(step) / 400.0, true);
    }
    assert!(late(&simulation.frames()[520..]) <= 4, "{}", late(&simulation.frames()[520..]));
    let last = simulation.frames()[899];
    assert!(last.nanos > 0.6 * TARGET, "what the ramp gave back is used: {last:?}");
}

#[test]
fn noise_moves_nothing() {
    // 15 % to both sides is a standard deviation of 9 %.
    for delay in 1..=4 {
        let mut simulation = simulation(0.7).with_noise(0.15).with_delay(delay);
        fly(&mut simulation, 2000, 1.0);
        let steady = &simulation.frames()[200..];
        assert!(variation(steady) < 0.1, "delay {delay}: {}", variation(steady));
        assert!(late(steady) * 50 < steady.len(), "delay {delay}: {}", late(steady));
    }
}

/// The largest way there and back of r_z within this many frames, as a share: the smaller one of
/// the two moves.
fn swing(frames: &[simulation::SimulatedFrame], within: usize) -> f64 {
    let u: Vec<f64> = frames.iter().map(|frame| frame.resolutions.r_z_px.log2()).collect();
    let mut worst: f64 = 0.0;
    for from in 0..u.len() {
        let (mut high, mut low, mut back) = (u[from], u[from], [0.0f64; 2]);
        for to in from..(from + within).min(u.len()) {
            (high, low) = (high.max(u[to]), low.min(u[to]));
            back = [back[0].max((high - u[from]).min(high - u[to])), back[1].max((u[from] - low).min(u[to] - low))];
        }
        worst = worst.max(back[0]).max(back[1]);
    }
    worst.exp2() - 1.0
}

#[test]
fn cores_that_others_use_too_make_no_swing() {
    for target in [33e6, 62e6, 125e6] {
        for share in [0.2, 0.5, 0.8, 1.0] {
            for load in [0.8, 1.0, 1.2] {
                let settings = RateSettings { target_nanos: target, ..settings() };
                let controller = RateController::new(settings).unwrap();
                let mut simulation =
                    Simulation::new(Cost::of_frame(target, 10.0, share), controller, true).with_contention();
                let seconds = |seconds: f64| (seconds * 1e9 / target) as usize;
                fly(&mut simulation, seconds(100.0), load);
                let about = format!("{} ms, {share} triangles, load {load}", target / 1e6);
                let steady = &simulation.frames()[seconds(10.0)..];
                let swing = swing(steady, seconds(5.0));
                assert!(swing < 0.1, "{about}: r_z swings by {swing}");
                // A frame has its own time and that of the stages before it. Where pixels alone
                // take too long nothing helps.
                let late = steady.iter().filter(|frame| frame.nanos > 1.9 * target).count();
                assert!(late * 20 < steady.len(), "{about}: {late} of {} frames", steady.len());
            }
        }
    }
}

#[test]
fn a_step_in_load_is_noticed_on_cores_that_others_use_too() {
    for target in [33e6, 62e6, 125e6] {
        let settings = RateSettings { target_nanos: target, ..settings() };
        let controller = RateController::new(settings).unwrap();
        let mut simulation = Simulation::new(Cost::of_frame(target, 10.0, 0.8), controller, true).with_contention();
        let seconds = |seconds: f64| (seconds * 1e9 / target) as usize;
        fly(&mut simulation, seconds(20.0), 1.0);
        fly(&mut simulation, seconds(20.0), 1.7);
        fly(&mut simulation, seconds(60.0), 1.0);
        let middle = |from: f64, to: f64| {
            let mut times: Vec<f64> =
                simulation.frames()[seconds(from)..seconds(to) - 3].iter().map(|frame| frame.nanos / target).collect();
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        };
        assert!(middle(22.0, 40.0) < 0.95, "{target}: {}", middle(22.0, 40.0));
        // What the load gave back is used, if slowly.
        assert!(middle(70.0, 100.0) > 0.68, "{target}: {}", middle(70.0, 100.0));
    }
}

#[test]
fn one_slow_frame_and_a_pause_move_nothing() {
    let mut simulation = simulation(0.7);
    fly(&mut simulation, 200, 1.0);
    let before = simulation.frames()[199].resolutions;
    for k in 0..300 {
        // A hiccup every second or so, and once a stop of a minute.
        let load = if k == 150 {
            1500.0
        } else if k % 25 == 7 {
            8.0
        } else {
            1.0
        };
        assert_eq!(simulation.frame(load, true).resolutions, before, "frame {k}");
    }
}

#[test]
fn at_rest_the_picture_becomes_finer_and_never_misses() {
    for share in [0.3, 0.8, 1.0] {
        // Light enough that what is wanted leaves time over.
        let cost = Cost::of_frame(0.45 * TARGET, 5.0, share);
        let mut simulation = Simulation::new(cost, controller(), true);
        fly(&mut simulation, 100, 1.0);
        let moving = simulation.frames()[99].resolutions;
        assert_eq!(moving, Resolutions { r_z_px: 5.0, r_c_px: 1.0 });
        for _ in 0..100 {
            simulation.frame(1.0, false);
        }
        let rest = &simulation.frames()[100..];
        assert_eq!(late(rest), 0, "share {share}");
        assert!(rest.windows(2).all(|pair| pair[1].resolutions.r_z_px <= pair[0].resolutions.r_z_px));
        let steps = rest.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!(steps >= 3, "step by step: {steps}");
        let last = rest[99];
        assert!(last.nanos > 0.8 * TARGET || last.resolutions.r_z_px < 2.0 + 1e-9, "share {share}: {last:?}");
        assert!(last.resolutions.r_c_px < 1.0);
        // The first frame that moves is as before the rest, and nothing is missed.
        assert_eq!(simulation.frame(1.0, true).resolutions, moving, "share {share}");
        fly(&mut simulation, 50, 1.0);
        assert_eq!(late(&simulation.frames()[200..]), 0, "share {share}");
    }
}

#[test]
fn a_short_stop_is_no_rest() {
    let cost = Cost::of_frame(0.3 * TARGET, 5.0, 0.9);
    let mut simulation = Simulation::new(cost, controller(), true);
    for k in 0..200 {
        assert_eq!(simulation.frame(1.0, k % 6 == 0).resolutions.r_z_px, 5.0, "frame {k}");
    }
}

#[test]
fn texels_wait_until_facets_are_twice_as_large() {
    let mut controller = controller();
    for (r_z, r_c) in [(5.0, 1.0), (10.0, 1.0), (40.0, 2.0), (160.0, 4.0)] {
        controller.u = f64::log2(r_z);
        let got = controller.resolutions();
        assert!((got.r_z_px - r_z).abs() < 1e-9 && (got.r_c_px - r_c).abs() < 1e-9, "{got:?}");
    }
}

#[test]
fn settings_that_contradict_themselves_are_refused() {
    let refused = |change: fn(&mut RateSettings)| {
        let mut settings = settings();
        change(&mut settings);
        RateController::new(settings).unwrap_err().to_string()
    };
    assert!(refused(|s| s.coarsest_px[0] = 4.0).contains("coarsest resolution of the rate control is 4"));
    assert!(refused(|s| s.rest_px[1] = 2.0).contains("at rest"));
    assert!(refused(|s| s.target_nanos = 0.0).contains("frame time"));
    assert!(refused(|s| s.wanted_px[0] = f64::NAN).contains("wanted"));
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(0.0),
        Just(f64::MIN_POSITIVE),
        0.1f64..200.0,
        1e5f64..1e9,
    ]
}

proptest! {
    #[test]
    fn whatever_is_measured_the_choice_is_allowed(
        samples in proptest::collection::vec((any_number(), any_number(), any::<bool>()), 1..200),
    ) {
        let mut controller = controller();
        for (r_z, nanos, is_moving) in samples {
            controller.measured(r_z, nanos);
            let Resolutions { r_z_px, r_c_px } = controller.next(is_moving);
            let finest = if controller.is_resting() { 2.0 } else { 5.0 };
            prop_assert!((finest - 1e-9..=160.0).contains(&r_z_px), "{r_z_px}");
            prop_assert!((0.5..=8.0).contains(&r_c_px), "{r_c_px}");
        }
    }

    #[test]
    fn any_renderer_is_held_where_it_can_be(
        share in 0.05f64..1.0,
        nanos in 0.2f64..6.0,
        delay in 1usize..5,
        load in 0.3f64..3.0,
    ) {
        let cost = Cost::of_frame(nanos * TARGET, 10.0, share);
        let mut simulation = Simulation::new(cost, controller(), true).with_delay(delay);
        fly(&mut simulation, 800, load);
        let end = &simulation.frames()[700..];
        prop_assert!(variation(end) < 0.1);
        let is_possible = cost.nanos(160.0) * load < 0.8 * TARGET;
        prop_assert!(!is_possible || late(end) == 0, "{:?}", end.last());
    }
}
