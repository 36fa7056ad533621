//! A flight against the clock, with feedback and without, side by side: how many frames are on time
//! when a core goes away.

use crate::cli::{Options, RealtimeArgs};
use crate::findings::Findings;
use crate::launch::{self, Launched};
use crate::measurement::{Measurement, Target};
use crate::plot::{self, TimeRow};
use crate::session::{Scratch, sibling};
use crate::world;
use anyhow::{Context, ensure};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use terravision_common::event::monotonic_nanos;
use terravision_common::report::{DrawnFrames, RealtimeReport};

/// What follows a step within this time is not judged.
const AFTER_STEP_S: f64 = 2.0;
/// From here on after a step the state is a steady one.
const STEADY_AFTER_S: f64 = 5.0;
/// Slower changes are not oscillations: they follow the terrain.
const OSCILLATION_S: f64 = 5.0;
/// Most frames of the flight that finds out what can be reached; the first half of them loads
/// tiles.
const FREE_FRAMES: u64 = 480;

/// Takes a measurement: name, value, unit, target, samples.
type Add<'a> = dyn FnMut(&str, f64, &'static str, Option<Target>, u64) + 'a;

/// One flight against the clock.
struct LoadedFlight {
    report: RealtimeReport,
    /// When the core was away, seconds of the flight.
    load_s: [f64; 2],
    /// How much of a core the load got.
    load_cores: f64,
}

/// Flies, measures, draws `realtime.svg` when plots are wanted.
///
/// # Errors
/// When a flight fails.
pub fn run(args: &RealtimeArgs, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    ensure!(args.seconds >= 1.0 && args.load_seconds < args.seconds, "the load does not fit into the flight");
    let world = world::database(options)?;
    let scratch = Scratch::new("realtime")?;
    let free_frames = FREE_FRAMES.min((10.0 * args.seconds) as u64);
    let free = fly(&world, options, scratch.path(), &format!("0..{free_frames}"), &[])?.wait()?;
    let steady = free.frame_ms.get(free.frame_ms.len() / 2..).unwrap_or_default();
    let rate = 1e3 * steady.len() as f64 / steady.iter().sum::<f64>();
    // Frame rates with a decimal, as people write them.
    let fps = ((args.share * rate * 10.0).round() / 10.0).max(0.1);
    let frames = ((args.seconds * fps).round() as u64).max(2);
    let mut flights = Vec::new();
    for feedback in ["on", "off"] {
        let fps = fps.to_string();
        let flags = ["--mode", "realtime", "--fps", &fps, "--feedback", feedback];
        let flight = fly(&world, options, scratch.path(), &format!("0..{frames}"), &flags)?;
        flights.push(under_load(flight, args, frames as f64 / fps.parse::<f64>()?)?);
    }
    findings.facts.push(("database", world.display().to_string()));
    let mut add = |name: &str, value: f64, unit: &'static str, target: Option<Target>, samples: u64| {
        findings.measurements.push(Measurement { target, ..Measurement::new("realtime", name, value, unit, samples) });
    };
    add("without a clock", rate, "frames/s", None, steady.len() as u64);
    add("against the clock", fps, "frames/s", None, frames);
    for (flight, name) in flights.iter().zip(["feedback", "no feedback"]) {
        flight.measure(name, name == "feedback", &mut add);
    }
    if let Some(folder) = &options.output {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        findings.drawn.push("realtime");
        draw(&folder.join("realtime.svg"), &flights)?;
    }
    Ok(())
}

/// Keeps the last core that this process may use busy for so long, then prints how much of it it
/// got. An ordinary program, of the same priority as the flight: they share that core, or the
/// flight goes elsewhere.
///
/// # Errors
/// Standard output cannot be written.
pub fn load(seconds: f64, out: &mut impl Write) -> anyhow::Result<()> {
    let mut core = CpuSet::new();
    let all = sched_getaffinity(None).context("cannot tell which cores there are")?;
    if let Some(last) = (0..CpuSet::MAX_CPU).rev().find(|core| all.is_set(*core)) {
        core.set(last);
        sched_setaffinity(None, &core).context("cannot stay on one core")?;
    }
    let cpu_seconds = || {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
    };
    let start = Instant::now();
    let mut sum = 0u64;
    while start.elapsed().as_secs_f64() < seconds {
        sum = std::hint::black_box((0..10_000).fold(sum, u64::wrapping_add));
    }
    writeln!(out, "{}", cpu_seconds() / start.elapsed().as_secs_f64()).context("standard output")
}

fn fly(world: &Path, options: &Options, scratch: &Path, frames: &str, flags: &[&str]) -> anyhow::Result<Launched> {
    let report = scratch.join("report.json");
    let mut command = launch::command(world, &report, options)?;
    command.args(["--path", "orbit", "--frames", frames]).args(flags);
    command.arg("--size").arg(format!("{}x{}", options.size[0], options.size[1]));
    command.arg("--samples").arg(options.samples.to_string());
    Launched::start(command, report)
}

/// Waits for a flight of `seconds`, with a core taken away in its middle.
fn under_load(flight: Launched, args: &RealtimeArgs, seconds: f64) -> anyhow::Result<LoadedFlight> {
    // Stages take a moment to start, and the clock starts after that; what happened when is known
    // afterwards.
    std::thread::sleep(Duration::from_secs_f64(1.0 + 0.5 * (seconds - args.load_seconds).max(0.0)));
    let from = monotonic_nanos();
    let mut command = Command::new(sibling("terravision-bench")?);
    command.args(["load", "--seconds", &args.load_seconds.to_string()]).stdin(Stdio::null());
    let output = command.output().context("cannot start the load")?;
    let to = monotonic_nanos();
    let load_cores = String::from_utf8_lossy(&output.stdout).trim().parse().context("the load said nothing")?;
    let report = flight.wait()?.realtime.context("the report is of no flight against the clock")?;
    let start = report.clock_start_nanos as f64;
    let load_s = [from, to].map(|nanos| (nanos as f64 - start) / 1e9);
    Ok(LoadedFlight { report, load_s, load_cores })
}

impl LoadedFlight {
    /// Moments at which the load changed.
    fn is_after_step(&self, at_s: f64, within_s: f64) -> bool {
        self.load_s.iter().any(|step| (0.0..within_s).contains(&(at_s - step)))
    }

    fn measure(&self, name: &str, has_targets: bool, add: &mut Add<'_>) {
        let RealtimeReport { target_ms, frames, on_time, late, skipped, drawn, .. } = &self.report;
        let mut line = |what: &str, value: f64, unit: &'static str, target: Option<Target>, samples: u64| {
            add(&format!("{name}: {what}"), value, unit, target.filter(|_| has_targets), samples);
        };
        // Moments of all frames, those that were left out too.
        let first = drawn.frame.first().copied().unwrap_or(0);
        let judged = |index: u64| !self.is_after_step(index as f64 * target_ms / 1e3, AFTER_STEP_S);
        let all = (0..*frames).filter(|index| judged(*index)).count() as u64;
        let good =
            drawn.frame.iter().zip(&drawn.is_on_time).filter(|(frame, on_time)| **on_time && judged(*frame - first));
        let share = good.count() as f64 / all.max(1) as f64;
        line("on time, outside 2 s after each step", share, "share", Some(Target::AtLeast(0.95)), all);
        line("on time, all frames", *on_time as f64 / *frames as f64, "share", None, *frames);
        line("late", *late as f64, "frames", None, *frames);
        line("left out", *skipped as f64, "frames", None, *frames);
        let pace = drawn.interval_ms.get(1..).unwrap_or_default();
        let worst = pace.iter().copied().fold(0.0, f64::max);
        line(
            "worst interval against the target",
            worst / target_ms,
            "ratio",
            Some(Target::AtMost(3.0)),
            pace.len() as u64,
        );
        for (what, values) in [("r_z", &drawn.r_z_px), ("r_c", &drawn.r_c_px)] {
            let swing = self.swing(values);
            line(
                &format!("{what}: largest swing in a steady state"),
                swing,
                "ratio",
                Some(Target::AtMost(0.1)),
                values.len() as u64,
            );
        }
        let mut latency = drawn.latency_ms.get(1..).unwrap_or_default().to_vec();
        latency.sort_by(f64::total_cmp);
        for (what, share) in [("median", 0.5), ("p95", 0.95)] {
            let at = ((latency.len() as f64 * share) as usize).min(latency.len().saturating_sub(1));
            let value = latency.get(at).copied().unwrap_or(0.0);
            line(&format!("camera to read-back, {what}"), value, "ms", None, latency.len() as u64);
        }
        let (wanted, resident) = (sum(&drawn.tiles_wanted), sum(&drawn.tiles_resident));
        line("tiles resident of those wanted", resident / wanted.max(1.0), "share", None, drawn.frame.len() as u64);
        line("load", self.load_cores, "cores", None, 1);
    }

    /// The largest up-and-down (or down-and-up) of a value within a few seconds of steady state, as
    /// a share of it: the smaller one of the two moves. A drift, which follows the terrain, does
    /// not count.
    fn swing(&self, values: &[f64]) -> f64 {
        let mut worst: f64 = 0.0;
        let mut extremes: Vec<(f64, f64)> = Vec::new();
        for (at, value) in self.report.drawn.done_s.iter().zip(values) {
            if *at < STEADY_AFTER_S || self.is_after_step(*at, STEADY_AFTER_S) || *value <= 0.0 {
                extremes.clear();
                continue;
            }
            let point = (*at, value.ln());
            if let Some((until, last)) = extremes.last_mut()
                && *last == point.1
            {
                // A move begins where the value stops being what it was.
                *until = *at;
                continue;
            }
            match extremes[..] {
                [.., (_, before), (_, last)] if (last > before) == (point.1 > last) => {
                    extremes.pop();
                    extremes.push(point);
                }
                _ => extremes.push(point),
            }
            if let [.., (from, a), (_, b), (to, c)] = extremes[..]
                && to - from <= OSCILLATION_S
            {
                worst = worst.max((b - a).abs().min((c - b).abs()));
            }
        }
        worst.exp() - 1.0
    }
}

fn sum(values: &[u32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum()
}

fn draw(path: &Path, flights: &[LoadedFlight]) -> anyhow::Result<()> {
    let Some(first) = flights.first() else { return Ok(()) };
    let target = first.report.target_ms;
    let row = |unit: &str, marks: Vec<f64>, highest: Option<f64>, of: &dyn Fn(&DrawnFrames) -> Vec<f64>| TimeRow {
        unit: unit.to_owned(),
        curves: (flights.iter().zip(["feedback", "no feedback"]))
            .map(|(flight, name)| {
                let drawn = &flight.report.drawn;
                (name.to_owned(), drawn.done_s.iter().copied().zip(of(drawn)).skip(1).collect())
            })
            .collect(),
        marks,
        highest,
    };
    let rows = [
        row("interval, ms", vec![target], Some(4.0 * target), &|drawn| drawn.interval_ms.clone()),
        row("renderer, ms", vec![target], Some(2.5 * target), &|drawn| drawn.renderer_ms.clone()),
        row("camera to read-back, ms", vec![2.0 * target], Some(5.0 * target), &|drawn| drawn.latency_ms.clone()),
        row("r_z, px", vec![], None, &|drawn| drawn.r_z_px.clone()),
        row("r_c, px", vec![], None, &|drawn| drawn.r_c_px.clone()),
        row("tiles resident", vec![], None, &|drawn| drawn.tiles_resident.iter().map(|n| f64::from(*n)).collect()),
    ];
    let title = format!("against the clock: {:.1} frames/s; shaded: a core is taken away", 1e3 / target);
    plot::over_time(path, &title, &rows, &[first.load_s])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(done_s: Vec<f64>) -> LoadedFlight {
        let n = done_s.len();
        let zeros = || vec![0.0; n];
        let drawn = DrawnFrames {
            frame: (0..n as u64).collect(),
            is_on_time: vec![true; n],
            interval_ms: zeros(),
            renderer_ms: zeros(),
            latency_ms: zeros(),
            r_z_px: zeros(),
            r_c_px: zeros(),
            tiles_wanted: vec![0; n],
            tiles_resident: vec![0; n],
            done_s,
            ..DrawnFrames::default()
        };
        let frames = n as u64;
        let report = RealtimeReport {
            clock_start_nanos: 1,
            target_ms: 100.0,
            frames,
            on_time: frames,
            drawn,
            ..RealtimeReport::default()
        };
        LoadedFlight { report, load_s: [20.0, 30.0], load_cores: 1.0 }
    }

    #[test]
    fn a_swing_is_there_and_back_and_a_drift_is_none() {
        let flight = flight((0..600).map(|k| f64::from(k) * 0.1).collect());
        let swing = |value: &dyn Fn(f64) -> f64| {
            flight.swing(&flight.report.drawn.done_s.iter().map(|at| value(*at)).collect::<Vec<_>>())
        };
        assert_eq!(swing(&|_| 10.0), 0.0);
        assert_eq!(swing(&|at| 10.0 + at), 0.0);
        let there_and_back = swing(&|at| if (10.0..12.0).contains(&at) { 12.0 } else { 10.0 });
        assert!((there_and_back - 0.2).abs() < 1e-9, "{there_and_back}");
        // Within the settling after a step, and slowly.
        assert_eq!(swing(&|at| if (21.0..24.0).contains(&at) { 12.0 } else { 10.0 }), 0.0);
        assert_eq!(swing(&|at| if (36.0..50.0).contains(&at) { 12.0 } else { 10.0 }), 0.0);
    }

    #[test]
    fn frames_after_a_step_are_not_judged() {
        let mut flight = flight((0..600).map(|k| f64::from(k) * 0.1).collect());
        // The 2 s after both steps, and five frames besides.
        for frame in (200..220).chain(300..320).chain(400..405) {
            flight.report.drawn.is_on_time[frame] = false;
        }
        let mut found = Vec::new();
        flight.measure("x", true, &mut |name, value, _, _, samples| found.push((name.to_owned(), value, samples)));
        let (_, share, judged) = found.iter().find(|(name, ..)| name.contains("outside 2 s")).unwrap();
        assert_eq!((*judged, *share), (560, 555.0 / 560.0));
    }
}
