//! Draws how the rate control answers to a simulated renderer (a step, a ramp, noise, pauses, a
//! rest), with feedback and without: `cargo run -p terravision-bench --example rate --
//! docs/images/rate.svg`.

use anyhow::Context;
use std::path::Path;
use terravision_bench::plot::{TimeRow, over_time};
use terravision_common::rate::simulation::{Cost, SimulatedFrame, Simulation};
use terravision_common::rate::{RateController, RateSettings};

const TARGET_NANOS: f64 = 40e6;
/// What is simulated, seconds: a step, a ramp up and down, a rest.
const STEP_S: [f64; 2] = [10.0, 20.0];
const RAMP_S: [f64; 2] = [30.0, 50.0];
const REST_S: [f64; 2] = [55.0, 65.0];
const END_S: f64 = 75.0;

/// How many times as slow a frame at this moment is as usual.
fn load(at_s: f64, frame: usize) -> f64 {
    let pause = if frame % 97 == 50 { 6.0 } else { 1.0 };
    let middle = 0.5 * (RAMP_S[0] + RAMP_S[1]);
    let ramp = (1.0 - (at_s - middle).abs() / (middle - RAMP_S[0])).max(0.0);
    let step = if (STEP_S[0]..STEP_S[1]).contains(&at_s) { 0.7 } else { 0.0 };
    pause * (1.0 + step + ramp)
}

fn fly(has_feedback: bool) -> anyhow::Result<Vec<(f64, SimulatedFrame)>> {
    let settings = RateSettings {
        target_nanos: TARGET_NANOS,
        wanted_px: [10.0, 1.0],
        coarsest_px: [60.0, 4.0],
        rest_px: [5.0, 1.0],
    };
    // Uncontrolled, a frame takes 60 % of the target; half of it are triangles.
    let cost = Cost::of_frame(0.6 * TARGET_NANOS, 10.0, 0.5);
    let mut simulation = Simulation::new(cost, RateController::new(settings)?, has_feedback).with_noise(0.1);
    let frames = (END_S * 1e9 / TARGET_NANOS) as usize;
    Ok((0..frames)
        .map(|frame| {
            let at_s = frame as f64 * TARGET_NANOS / 1e9;
            let is_moving = !(REST_S[0]..REST_S[1]).contains(&at_s);
            (at_s, simulation.frame(load(at_s, frame), is_moving))
        })
        .collect())
}

fn main() -> anyhow::Result<()> {
    let path = std::env::args().nth(1).context("expected the file to draw into, e.g. docs/images/rate.svg")?;
    let flights = [("feedback", fly(true)?), ("no feedback", fly(false)?)];
    let row = |unit: &str, marks: Vec<f64>, highest: Option<f64>, of: fn(&SimulatedFrame) -> f64| TimeRow {
        unit: unit.to_owned(),
        curves: (flights.iter())
            .map(|(name, frames)| ((*name).to_owned(), frames.iter().map(|(at, frame)| (*at, of(frame))).collect()))
            .collect(),
        marks,
        highest,
    };
    let rows = [
        row("frame, ms", vec![TARGET_NANOS / 1e6], Some(80.0), |frame| frame.nanos / 1e6),
        row("r_z, px", vec![], None, |frame| frame.resolutions.r_z_px),
        row("r_c, px", vec![], None, |frame| frame.resolutions.r_c_px),
    ];
    let title = "simulated renderer: a step in load, a ramp, single slow frames throughout; at the end a rest";
    over_time(Path::new(&path), title, &rows, &[STEP_S, RAMP_S, REST_S])
}
