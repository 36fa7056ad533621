//! A fast flight over a database behind a slow link, against the clock: what prediction gains, and
//! what it costs.

use crate::cli::{LinkArgs, Options};
use crate::findings::Findings;
use crate::launch::{self, Launched};
use crate::measurement::{Measurement, Target};
use crate::plot::{self, TimeRow};
use crate::session::Scratch;
use crate::world;
use anyhow::{Context, bail, ensure};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::Duration;
use terravision_common::database::{Database, TileScratch};
use terravision_common::ground::ground_height;
use terravision_common::report::{DrawnFrames, NetworkReport, RealtimeReport};
use terravision_common::run::Prediction;
use terravision_testkit::fault_server::{FaultServer, Link};

/// Speed of the flight: this share of the world's shorter side in a second, and at most this many
/// metres.
const SPEED_SHARE: f64 = 0.0125;
const FASTEST_M_PER_S: f64 = 300.0;
/// Height above the highest ground around.
const HEIGHT_M: f64 = 200.0;
/// How far around, seconds of the flight.
const AROUND_S: f64 = 2.0;
/// Where the flight begins, as shares of the world, and its heading, degrees.
const START: [f64; 2] = [0.25, 0.2];
const HEADING_DEG: f64 = 25.0;
const PITCH_DEG: f64 = -17.0;
const TURN_DEG_PER_S: f64 = 20.0;
/// Shares of the flight: it is straight until here, turns until there, then stops.
const STRAIGHT: f64 = 1.0 / 3.0;
const TURNS: f64 = 0.75;
/// Steps of the path's integration in a second.
const STEPS_PER_S: f64 = 100.0;

/// One flight.
struct PredictedFlight {
    prediction: Prediction,
    realtime: RealtimeReport,
    network: NetworkReport,
}

/// Flies once with each prediction, each time from a cold cache; draws `link.svg` when plots are
/// wanted.
///
/// # Errors
/// When a flight fails.
pub fn run(args: &LinkArgs, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    ensure!(args.seconds >= 4.0 && args.fps > 0.0, "a flight takes 4 s at least, and has frames");
    let world = world::database(options)?;
    let scratch = Scratch::new("link")?;
    let poses = poses(&Database::open(&world)?, args)?;
    let path = launch::write_path(scratch.path(), &poses, args.fps, options)?;
    let mut flights = Vec::new();
    for prediction in &args.predictions {
        flights.push(fly(*prediction, &world, &path, args, options, scratch.path())?);
    }
    findings.facts.push(("database", world.display().to_string()));
    findings.facts.push(("link", format!("{} Mbit/s, {} ms", args.mbit_per_s, args.latency_ms)));
    findings.measurements.extend(measurements(&flights));
    if let Some(folder) = &options.output {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        findings.drawn.push("link");
        draw(&folder.join("link.svg"), &flights, args)?;
    }
    Ok(())
}

/// The poses of all frames: straight ahead, turns to either side, a stop and a rest.
fn poses(database: &Database, args: &LinkArgs) -> anyhow::Result<Vec<serde_json::Value>> {
    let world = *database.world();
    let extent = world.extent_m();
    let speed = (SPEED_SHARE * extent[0].min(extent[1])).min(FASTEST_M_PER_S);
    let (straight, turns) = (STRAIGHT * args.seconds, TURNS * args.seconds);
    let turn = (turns - straight) / 3.0;
    // Turns swing in and out within a second, as anything that flies does.
    let swing = |t: f64, begin: f64| (t - begin).clamp(0.0, 1.0).min((begin + turn - t).clamp(0.0, 1.0));
    let rate = |t: f64| swing(t, straight) - swing(t, straight + turn) + swing(t, straight + 2.0 * turn);
    let stopping = (0.05 * args.seconds).max(0.5);
    let mut at = [START[0] * extent[0], START[1] * extent[1]];
    let mut heading = HEADING_DEG;
    let mut scratch = TileScratch::default();
    let mut track = Vec::new();
    let frames = (args.seconds * args.fps) as u64;
    let mut step = 0u64;
    for frame in 0..frames {
        let end = (frame as f64 / args.fps * STEPS_PER_S) as u64;
        while step < end {
            let t = step as f64 / STEPS_PER_S;
            heading += TURN_DEG_PER_S * rate(t) / STEPS_PER_S;
            let pace = speed * ((turns + stopping - t) / stopping).clamp(0.0, 1.0) / STEPS_PER_S;
            at = [at[0] + heading.to_radians().sin() * pace, at[1] + heading.to_radians().cos() * pace];
            step += 1;
        }
        let ground = ground_height(database, &world, at[0], at[1], &mut scratch).context("cannot read the ground")?;
        let Some(ground) = ground else { bail!("the world is too small for the flight, which leaves it at {at:?}") };
        track.push((at, heading, ground));
    }
    let around = (AROUND_S * args.fps) as usize;
    let window = |k: usize| k.saturating_sub(around)..(k + around + 1).min(track.len());
    let tops: Vec<f64> = (0..track.len())
        .map(|k| track[window(k)].iter().map(|(.., ground)| *ground).fold(f64::MIN, f64::max))
        .collect();
    let origin = world.fields().origin;
    let pose = |(k, (at, heading, _)): (usize, &([f64; 2], f64, f64))| {
        let tops = &tops[window(k)];
        let z = tops.iter().sum::<f64>() / tops.len() as f64 + HEIGHT_M;
        json!({"x": origin[0] + at[0], "y": origin[1] + at[1], "z": z, "heading": heading, "pitch": PITCH_DEG, "roll": 0})
    };
    Ok(track.iter().enumerate().map(pose).collect())
}

fn fly(
    prediction: Prediction,
    world: &Path,
    path: &Path,
    args: &LinkArgs,
    options: &Options,
    scratch: &Path,
) -> anyhow::Result<PredictedFlight> {
    let (Some(root), Some(name)) = (world.parent(), world.file_name()) else {
        bail!("{} is not a folder", world.display())
    };
    let server = FaultServer::serve(root);
    server.set_link(Link {
        latency: Duration::from_millis(args.latency_ms),
        bits_per_s: Some((args.mbit_per_s * 1e6) as u64),
    });
    let file = |ending: &str| -> PathBuf { scratch.join(format!("{}{ending}", prediction.name())) };
    let report = file(".json");
    let mut command = launch::command(server.url(&name.to_string_lossy()), &report, options)?;
    command.args(["--mode", "realtime", "--feedback", "off", "--prediction", prediction.name(), "--path"]).arg(path);
    command.arg("--samples").arg(options.samples.to_string()).arg("--cache").arg(file(".cache"));
    let report = Launched::start(command, report)?.wait()?;
    let realtime = report.realtime.context("the report is not of a flight against the clock")?;
    let network = report.network.context("the report does not say what the server sent")?;
    Ok(PredictedFlight { prediction, realtime, network })
}

impl PredictedFlight {
    /// Mean of what was on screen from one share of the flight to another: a picture stays until
    /// the next one.
    fn sharp(&self, from: f64, to: f64) -> f64 {
        let RealtimeReport { frames, drawn, .. } = &self.realtime;
        let ends = drawn.frame.iter().skip(1).copied().chain([*frames]);
        let (mut sum, mut time) = (0.0, 0.0);
        for ((frame, end), sharp) in drawn.frame.iter().zip(ends).zip(&drawn.sharp) {
            let part = |at: u64| (at as f64 / *frames as f64).clamp(from, to);
            let shown = part(end) - part(*frame);
            sum += shown * sharp;
            time += shown;
        }
        if time > 0.0 { sum / time } else { 0.0 }
    }
}

fn measurements(flights: &[PredictedFlight]) -> Vec<Measurement> {
    let mut found = Vec::new();
    let mut add = |name: String, value: f64, unit: &'static str, target: Option<Target>, samples: u64| {
        found.push(Measurement { target, ..Measurement::new("link", name, value, unit, samples) });
    };
    for flight in flights {
        let PredictedFlight { realtime, network, .. } = flight;
        let (name, drawn) = (flight.prediction.name(), realtime.drawn.frame.len() as u64);
        for (part, from, to) in [
            ("all of it", 0.0, 1.0),
            ("straight ahead", 0.0, STRAIGHT),
            ("turns", STRAIGHT, TURNS),
            ("stop", TURNS, 1.0),
        ] {
            add(format!("{name}: drawn as wanted, {part}"), flight.sharp(from, to), "share", None, drawn);
        }
        let last = realtime.drawn.sharp.last().copied().unwrap_or(0.0);
        add(format!("{name}: drawn as wanted, at the end"), last, "share", Some(Target::AtLeast(1.0)), 1);
        add(format!("{name}: fetched"), network.bytes as f64 / 1e6, "MB", None, network.requests);
        add(format!("{name}: frames on time"), realtime.on_time_share, "share", None, realtime.frames);
    }
    let of = |prediction| flights.iter().find(|flight| flight.prediction == prediction);
    let Some(oracle) = of(Prediction::Oracle) else { return found };
    for flight in flights.iter().filter(|flight| flight.prediction != Prediction::Oracle) {
        let is_judged = flight.prediction == Prediction::Linear;
        let name = flight.prediction.name();
        let mut add = |what: &str, value: f64, target| {
            let target = Some(target).filter(|_| is_judged);
            found.push(Measurement { target, ..Measurement::new("link", format!("{name}{what}"), value, "ratio", 1) });
        };
        add(" against oracle: drawn as wanted", flight.sharp(0.0, 1.0) / oracle.sharp(0.0, 1.0), Target::AtLeast(0.9));
        let bytes = |flight: &PredictedFlight| flight.network.bytes.max(1) as f64;
        add(" against oracle: fetched", bytes(flight) / bytes(oracle), Target::AtMost(1.5));
        if let Some(off) = of(Prediction::Off).filter(|_| flight.prediction != Prediction::Off) {
            let lack = |flight: &PredictedFlight| 1.0 - flight.sharp(0.0, 1.0);
            add(" against off: not as wanted", lack(flight) / lack(off).max(1e-9), Target::AtMost(0.75));
        }
    }
    found
}

fn draw(path: &Path, flights: &[PredictedFlight], args: &LinkArgs) -> anyhow::Result<()> {
    let row = |unit: &str, of: &dyn Fn(&DrawnFrames) -> Vec<f64>| TimeRow {
        unit: unit.to_owned(),
        curves: (flights.iter())
            .map(|flight| {
                let drawn = &flight.realtime.drawn;
                (flight.prediction.name().to_owned(), drawn.done_s.iter().copied().zip(of(drawn)).collect())
            })
            .collect(),
        ..TimeRow::default()
    };
    let missing = |drawn: &DrawnFrames| -> Vec<f64> {
        let tiles = drawn.tiles_wanted.iter().zip(&drawn.tiles_resident);
        tiles.map(|(wanted, resident)| f64::from(wanted.saturating_sub(*resident))).collect()
    };
    let rows = [row("ground drawn as wanted", &|drawn| drawn.sharp.clone()), row("tiles missing", &missing)];
    let title =
        format!("over {} Mbit/s and {} ms: straight ahead, turns (shaded), a stop", args.mbit_per_s, args.latency_ms);
    plot::over_time(path, &title, &rows, &[[STRAIGHT * args.seconds, TURNS * args.seconds]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(prediction: Prediction, frame: Vec<u64>, sharp: Vec<f64>, bytes: u64) -> PredictedFlight {
        let n = frame.len();
        let drawn = DrawnFrames {
            done_s: frame.iter().map(|frame| *frame as f64).collect(),
            tiles_wanted: vec![10; n],
            tiles_resident: vec![8; n],
            frame,
            sharp,
            ..DrawnFrames::default()
        };
        let realtime = RealtimeReport { frames: 10, on_time_share: 1.0, drawn, ..RealtimeReport::default() };
        let network = NetworkReport { bytes, requests: 7, ..NetworkReport::default() };
        PredictedFlight { prediction, realtime, network }
    }

    #[test]
    fn a_picture_counts_as_long_as_it_is_shown() {
        // Frames 0 to 4 show the first picture.
        let flight = flight(Prediction::Off, vec![0, 5, 6], vec![0.2, 0.6, 1.0], 1);
        assert!((flight.sharp(0.0, 1.0) - (0.5 * 0.2 + 0.1 * 0.6 + 0.4)).abs() < 1e-9);
        assert!((flight.sharp(0.7, 1.0) - 1.0).abs() < 1e-9);
        assert!((flight.sharp(0.4, 0.6) - 0.4).abs() < 1e-9);
    }

    #[test]
    fn linear_is_judged_against_the_oracle_and_against_none() {
        let frames = || (0..10).collect::<Vec<u64>>();
        let flights = [
            flight(Prediction::Off, frames(), vec![0.5; 10], 900),
            flight(Prediction::Linear, frames(), vec![0.8; 10], 1200),
            flight(Prediction::Oracle, frames(), vec![0.9; 10], 1000),
        ];
        let found = measurements(&flights);
        let judged: Vec<(&str, f64)> = (found.iter().filter(|m| m.unit == "ratio" && m.target.is_some()))
            .map(|m| (m.name.as_str(), (m.value * 1e3).round() / 1e3))
            .collect();
        assert_eq!(
            judged,
            [
                ("linear against oracle: drawn as wanted", 0.889),
                ("linear against oracle: fetched", 1.2),
                ("linear against off: not as wanted", 0.4),
            ]
        );
    }
}
