//! A long random flight over a large world in little memory: whether memory and open files grow.

use crate::cli::{LongRunArgs, Options};
use crate::findings::Findings;
use crate::launch::{self, Launched};
use crate::measurement::{Measurement, Target};
use crate::plot::{self, TimeRow};
use crate::session::Scratch;
use crate::world;
use anyhow::{Context, bail, ensure};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use terravision_common::database::Index;
use terravision_common::report::Report;

/// Samples that are taken of a flight, about.
const SAMPLES: f64 = 360.0;
/// No shorter time lies between two of them.
const SHORTEST_S: f64 = 0.5;
/// The pools fill in the first part of the flight; from here on it is judged, and its last quarter
/// against this one.
const WARM: f64 = 0.25;

/// What the processes of a run have at a moment.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Sample {
    at_s: f64,
    /// Memory of their own, and with shared pages split among those that map them, MiB.
    own_mib: f64,
    pss_mib: f64,
    files: f64,
}

/// Flies, looks at the processes, draws `long-run.svg` when plots are wanted.
///
/// # Errors
/// When the flight fails.
pub fn run(args: &LongRunArgs, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    ensure!(args.seconds >= 8.0 && args.fps > 0.0, "a flight takes 8 s at least, and has frames");
    let world = world::database(options)?;
    let index = Index::open(&world)?;
    let bytes = ["elevation.pmtiles", "color.pmtiles"].map(|file| world.join(file).metadata().map_or(0, |m| m.len()));
    let scratch = Scratch::new("long-run")?;
    let path = launch::write_path(scratch.path(), &poses(&index, args), args.fps, options)?;
    let (samples, report) = fly(&world, &path, scratch.path().join("report.json"), args, options)?;
    findings.facts.push(("database", format!("{}, {:.2} GB", world.display(), bytes.iter().sum::<u64>() as f64 / 1e9)));
    findings.measurements.extend(measurements(&samples, &report));
    if let Some(folder) = &options.output {
        fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        findings.drawn.push("long-run");
        draw(&folder.join("long-run.svg"), &samples, options.memory_mib)?;
    }
    Ok(())
}

/// Numbers as if by chance, the same in every run (xorshift64*, Marsaglia 2003).
struct Chance(u64);

impl Chance {
    /// From 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// A flight that turns, climbs, speeds up and jumps to other places as it likes, and stays over the
/// world.
fn poses(index: &Index, args: &LongRunArgs) -> Vec<Value> {
    let world = index.world();
    let ([width, height], [x0, y0]) = (world.extent_m(), world.fields().origin);
    let top = index.ranges().range(world.root()).map_or(0.0, |range| f64::from(range[1]));
    let mut chance = Chance(args.seed.max(1));
    let (mut at, mut heading) = ([0.5 * width, 0.5 * height], 0.0f64);
    let (mut turn, mut speed, mut above, mut climb) = (0.0, 200.0, 500.0, 0.0);
    let frames = (args.seconds * args.fps) as u64;
    let every = |seconds: f64| ((seconds * args.fps) as u64).max(1);
    let mut poses = Vec::new();
    for frame in 0..frames {
        if frame % every(4.0) == 0 {
            (turn, speed, climb) =
                (chance.between(-15.0, 15.0), chance.between(50.0, 400.0), chance.between(-60.0, 60.0));
        }
        if frame % every(60.0) == every(60.0) - 1 {
            at = [chance.between(0.1, 0.9) * width, chance.between(0.1, 0.9) * height];
        }
        let step = 1.0 / args.fps;
        heading += turn * step;
        above = (above + climb * step).clamp(100.0, 2500.0);
        for (axis, (direction, side)) in
            [(heading.to_radians().sin(), width), (heading.to_radians().cos(), height)].into_iter().enumerate()
        {
            at[axis] = (at[axis] + direction * speed * step).clamp(0.02 * side, 0.98 * side);
        }
        poses.push(json!({
            "x": x0 + at[0], "y": y0 + at[1], "z": top + above, "heading": heading.rem_euclid(360.0), "pitch": -25, "roll": 0,
        }));
    }
    poses
}

/// Flies, and looks at the processes all the while.
fn fly(
    world: &Path,
    path: &Path,
    report: PathBuf,
    args: &LongRunArgs,
    options: &Options,
) -> anyhow::Result<(Vec<Sample>, Report)> {
    let mut command = launch::command(world, &report, options)?;
    command.args(["--mode", "realtime", "--path"]).arg(path);
    let mut flight = Launched::start(command, report)?;
    let every = Duration::from_secs_f64((args.seconds / SAMPLES).max(SHORTEST_S));
    let start = Instant::now();
    let mut samples = Vec::new();
    while !flight.has_ended()? {
        let sample = Sample { at_s: start.elapsed().as_secs_f64(), ..look(flight.pid()) };
        // All four stages are there.
        if sample.files > 0.0 {
            samples.push(sample);
        }
        std::thread::sleep(every);
        if start.elapsed().as_secs_f64() > 10.0 * args.seconds + 600.0 {
            bail!("the flight does not end");
        }
    }
    Ok((samples, flight.wait()?))
}

/// A process and its children; nothing before all stages have started, and when one has just ended.
fn look(pid: u32) -> Sample {
    let children = fs::read_to_string(format!("/proc/{pid}/task/{pid}/children")).unwrap_or_default();
    let pids: Vec<u32> = children.split_whitespace().filter_map(|pid| pid.parse().ok()).chain([pid]).collect();
    let figures = |pid: &u32| -> Option<Sample> {
        let kib = |file: &str, key: &str| -> Option<f64> {
            let text = fs::read_to_string(format!("/proc/{pid}/{file}")).ok()?;
            text.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().next()?.parse().ok())
        };
        Some(Sample {
            at_s: 0.0,
            own_mib: kib("status", "RssAnon:")? / 1024.0,
            pss_mib: kib("smaps_rollup", "Pss:")? / 1024.0,
            files: fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count() as f64,
        })
    };
    let all: Option<Vec<Sample>> = pids.iter().map(figures).collect();
    let all = all.filter(|all| all.len() >= 5).unwrap_or_default();
    let sum = |of: fn(&Sample) -> f64| all.iter().map(of).sum();
    Sample { at_s: 0.0, own_mib: sum(|s| s.own_mib), pss_mib: sum(|s| s.pss_mib), files: sum(|s| s.files) }
}

fn measurements(samples: &[Sample], report: &Report) -> Vec<Measurement> {
    let end = samples.last().map_or(0.0, |sample| sample.at_s);
    let part = |from: f64, to: f64| -> Vec<Sample> {
        samples.iter().filter(|s| (from * end..=to * end).contains(&s.at_s)).copied().collect()
    };
    let (early, late) = (part(WARM, WARM + 0.25), part(0.75, 1.0));
    let mean = |samples: &[Sample], of: fn(&Sample) -> f64| -> f64 {
        samples.iter().map(of).sum::<f64>() / samples.len().max(1) as f64
    };
    let most = |samples: &[Sample], of: fn(&Sample) -> f64| samples.iter().map(of).fold(0.0, f64::max);
    let mut found = Vec::new();
    let mut add = |name: &str, value: f64, unit: &'static str, target: Option<Target>| {
        let samples = samples.len() as u64;
        found.push(Measurement { target, ..Measurement::new("long-run", name, value, unit, samples) });
    };
    add("length", end, "s", None);
    add("memory of their own, all processes", mean(&late, |s| s.own_mib), "MiB", None);
    add("memory with the pools, all processes", mean(&late, |s| s.pss_mib), "MiB", None);
    let growth = |of: fn(&Sample) -> f64| mean(&late, of) / mean(&early, of).max(1e-9);
    add("memory of their own, last quarter against second", growth(|s| s.own_mib), "ratio", Some(Target::AtMost(1.05)));
    add(
        "memory with the pools, last quarter against second",
        growth(|s| s.pss_mib),
        "ratio",
        Some(Target::AtMost(1.05)),
    );
    let files = most(&late, |s| s.files) - most(&early, |s| s.files);
    add("open files", most(&late, |s| s.files), "files", None);
    add("open files, last quarter less second", files, "files", Some(Target::AtMost(0.0)));
    add("tiles loaded", report.tiles.loaded as f64, "", None);
    add("tiles evicted", report.tiles.evicted as f64, "", None);
    add("tiles unavailable", report.tiles.unavailable_count as f64, "", None);
    let drawn = report.realtime.as_ref().map_or(f64::NAN, |realtime| realtime.drawn.frame.len() as f64);
    add("frames drawn", drawn, "", None);
    found
}

fn draw(path: &Path, samples: &[Sample], memory_mib: u64) -> anyhow::Result<()> {
    let curve = |of: fn(&Sample) -> f64| samples.iter().map(|s| (s.at_s, of(s))).collect::<Vec<_>>();
    let memory = TimeRow {
        unit: "MiB".to_owned(),
        curves: vec![
            ("of their own".to_owned(), curve(|s| s.own_mib)),
            ("with the pools".to_owned(), curve(|s| s.pss_mib)),
        ],
        marks: vec![memory_mib as f64],
        ..TimeRow::default()
    };
    let files = TimeRow {
        unit: "open files".to_owned(),
        curves: vec![("all processes".to_owned(), curve(|s| s.files))],
        ..TimeRow::default()
    };
    plot::over_time(path, &format!("a flight at random with --memory {memory_mib}MiB"), &[memory, files], &[])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_found_and_the_filling_of_the_pools_is_not_growth() {
        let samples = |own: &dyn Fn(f64) -> f64, files: &dyn Fn(f64) -> f64| -> Vec<Sample> {
            let sample = |k: i32| {
                let at_s = f64::from(k);
                Sample { at_s, own_mib: own(at_s), pss_mib: 500.0, files: files(at_s) }
            };
            (0..=100).map(sample).collect()
        };
        let verdicts = |samples: &[Sample]| -> Vec<&'static str> {
            let found = measurements(samples, &Report::default());
            found.iter().filter(|m| m.target.is_some()).map(Measurement::verdict).collect()
        };
        let steady = samples(&|at| if at < 20.0 { 10.0 * at } else { 200.0 }, &|_| 80.0);
        assert_eq!(verdicts(&steady), ["ok", "ok", "ok"]);
        let leaks = samples(&|at| 200.0 + at, &|at| 80.0 + (at / 40.0).floor());
        assert_eq!(verdicts(&leaks), ["missed", "ok", "missed"]);
    }

    #[test]
    fn chance_is_the_same_in_every_run_and_spread() {
        let mut chance = Chance(1);
        let values: Vec<f64> = (0..1000).map(|_| chance.next()).collect();
        let mean = values.iter().sum::<f64>() / 1000.0;
        assert!(values.iter().all(|v| (0.0..1.0).contains(v)) && (0.45..0.55).contains(&mean), "{mean}");
        assert_eq!(values[0], Chance(1).next());
    }
}
