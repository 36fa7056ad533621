//! Each stage alone, then the whole, in one run: what passes per second, and what a frame costs
//! where.

use crate::findings::Findings;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, median, quantile};
use crate::plot::Curve;
use crate::recording::{RecordedFrames, RecordedTrees, record_frames, record_trees};
use crate::session::{EventLog, Session, Settings, sibling};
use anyhow::{Context, ensure};
use serde::Deserialize;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use terravision_common::event::{Event, monotonic_nanos};
use terravision_common::shm::{CameraRecord, Consumer, Control, Producer, RunId, RunState, SegmentKind, Stage};
use terravision_common::stage::STAGE_ENVIRONMENT;

/// What stages and replay share: the recorded round.
#[derive(Debug)]
pub struct Recorded {
    /// Trees of one round.
    pub trees: RecordedTrees,
    /// Frames of one round.
    pub frames: RecordedFrames,
}

/// Records one round, each stage alone.
///
/// # Errors
/// When a run fails.
pub fn record(settings: &Settings, flight: &Flight) -> anyhow::Result<Recorded> {
    let trees = record_trees(settings, flight, 1).context("the generator alone")?;
    let frames = record_frames(settings, flight, &trees).context("the preparer alone")?;
    Ok(Recorded { trees, frames })
}

/// StoreStats of generator and preparer from their recordings.
pub fn generator_and_preparer(recorded: &Recorded, findings: &mut Findings) {
    let Recorded { trees, frames } = recorded;
    let count = trees.trees.len() as u64;
    let nodes: u64 = trees.trees.iter().map(|(_, nodes)| nodes.len() as u64).sum();
    let mut add = |name: &str, value: f64, unit: &'static str, samples: u64| {
        findings.measurements.push(Measurement::new("stages", name, value, unit, samples));
    };
    // The clock starts with the first tree.
    add("generator: trees", (count.saturating_sub(1)) as f64 / trees.seconds, "trees/s", count);
    add("generator: nodes", nodes as f64 / trees.seconds, "nodes/s", nodes);
    add("generator: nodes of a tree", nodes as f64 / count as f64, "nodes", count);
    add("generator: time of a tree, median", median(&trees.span_ms), "ms", count);
    let arrays = frames.elevation_arrays();
    let samples = arrays * frames.array_len() as u64;
    let slots = frames.tile_slots();
    add("preparer: frames", frames.len() as f64 / frames.seconds, "frames/s", frames.len() as u64);
    add("preparer: elevation samples", samples as f64 / frames.seconds, "samples/s", samples);
    add("preparer: elevation arrays", arrays as f64 / frames.seconds, "arrays/s", arrays);
    add("preparer: slots", slots as f64 / frames.seconds, "slots/s", slots);
    add("preparer: slots of a frame", slots as f64 / frames.len() as f64, "slots", frames.len() as u64);
    add("preparer: arrays of a frame", arrays as f64 / frames.len() as f64, "arrays", frames.len() as u64);
    add("preparer: time of a frame, median", median(&frames.span_ms), "ms", frames.len() as u64);
    let copy = copies_per_second(frames.arrays(), frames.array_len());
    add("plain copy of the same arrays", copy, "arrays/s", arrays);
    add("preparer: arrays against a plain copy", arrays as f64 / frames.seconds / copy, "ratio", arrays);
}

/// Arrays per second that a plain copy moves, one core.
fn copies_per_second(arrays: &[f32], array_len: usize) -> f64 {
    let mut out = vec![0f32; array_len];
    let mut copied = 0u64;
    let start = Instant::now();
    while start.elapsed() < Duration::from_millis(200) {
        for array in arrays.chunks_exact(array_len) {
            std::hint::black_box(&mut out).copy_from_slice(array);
            copied += 1;
        }
    }
    copied as f64 / start.elapsed().as_secs_f64()
}

/// Turns that things get which are compared: a shared machine is faster now and slower then.
pub const TURNS: usize = 3;

/// What a flight of two rounds gave; only the second is measured, when all tiles are there.
#[derive(Debug)]
pub struct Flown {
    /// Milliseconds of each frame of the second round.
    pub frame_ms: Vec<f64>,
    /// Triangles of each frame of the second round.
    pub triangles: Vec<u64>,
    /// Frames per second of the second round.
    pub frames_per_second: f64,
    /// Frames per second of the first round, with loading.
    pub first_round: f64,
    /// Processor milliseconds per frame of the second round: generator, preparer, renderer,
    /// prefetcher (0 for one not started).
    pub cpu_ms: [f64; 4],
    /// What the stages told.
    pub log: EventLog,
}

/// How often events are drained. They carry their own times; draining should cost the stages
/// nothing.
const DRAINED_EVERY: Duration = Duration::from_millis(5);
/// How often stages are checked, and their processor time is read.
const LOOKED_AFTER_EVERY: Duration = Duration::from_millis(50);

/// Runs some of the stages over two rounds; `drive` does the work of the others, on a thread of its
/// own.
fn fly(
    settings: &Settings,
    flight: &Flight,
    stages: &[Stage],
    drive: impl FnOnce(&RunId, &Control) -> anyhow::Result<()> + Send,
) -> anyhow::Result<Flown> {
    let round = flight.round.len();
    let total = 2 * round;
    let mut session = Session::new(settings, flight, total as u64)?;
    let run = *session.run();
    let control = Control::open(&run)?;
    let mut rings =
        Stage::ALL.iter().map(|stage| Consumer::<Event>::open(&run, stage.events())).collect::<Result<Vec<_>, _>>()?;
    for stage in stages {
        session.start(*stage)?;
    }
    let mut log = EventLog::default();
    // Of each stage at the end of either round. A stage that has left keeps what it had when it was
    // last seen.
    let mut cpu = [[0.0f64; 4]; 2];
    let started = monotonic_nanos();
    std::thread::scope(|scope| {
        let driving = scope.spawn(|| drive(&run, &control));
        let mut watch = || {
            let mut next_look = Instant::now();
            let mut rounds = 0;
            loop {
                for ring in &mut rings {
                    log.drain(ring)?;
                }
                let done = log.done_nanos.len();
                // At the end of a round at once: what comes later is the next one's, or after the
                // last.
                let is_end = done / round > rounds;
                if is_end || Instant::now() >= next_look {
                    next_look = Instant::now() + LOOKED_AFTER_EVERY;
                    session.check()?;
                    for cpu in &mut cpu[rounds.min(1)..] {
                        for (cpu, stage) in cpu.iter_mut().zip(Stage::ALL) {
                            *cpu = cpu.max(session.cpu_of(stage).0);
                        }
                    }
                }
                rounds = done / round;
                if done >= total {
                    return anyhow::Ok(());
                }
                std::thread::sleep(DRAINED_EVERY);
            }
        };
        let watched = watch();
        if watched.is_err() {
            session.control().set_state(RunState::Stopping);
        }
        let driven = driving.join().map_err(|_panic| anyhow::anyhow!("the driver panicked"))?;
        watched.and(driven)
    })?;
    let [before, after] = cpu;
    let frame_ms = log.frame_ms(round);
    let first = log.done_nanos[round - 1].saturating_sub(started) as f64 / 1e9;
    Ok(Flown {
        triangles: log.triangles[round..].to_vec(),
        frames_per_second: frame_ms.len() as f64 / (frame_ms.iter().sum::<f64>() / 1e3),
        first_round: round as f64 / first,
        cpu_ms: std::array::from_fn(|k| 1e3 * (after[k] - before[k]).max(0.0) / round as f64),
        frame_ms,
        log,
    })
}

/// The whole pipeline.
///
/// # Errors
/// When the run fails.
pub fn fly_whole(settings: &Settings, flight: &Flight) -> anyhow::Result<Flown> {
    let records = flight.records(2);
    fly(settings, flight, &Stage::ALL, |run, control| {
        let mut cameras = Producer::<CameraRecord>::open(run, SegmentKind::CameraRing)?;
        records.iter().try_for_each(|record| cameras.push(record, control)).context("the pilot")
    })
    .context("the whole pipeline")
}

/// The renderer alone, fed with recorded frames.
///
/// # Errors
/// When the run fails.
pub fn fly_recorded(settings: &Settings, flight: &Flight, frames: &RecordedFrames) -> anyhow::Result<Flown> {
    fly(settings, flight, &[Stage::Renderer], |run, control| frames.play(run, control, flight, 2))
        .context("the renderer alone")
}

/// What the device can do at best, from the renderer's own `--floor-json`.
#[derive(Debug, Deserialize)]
pub struct Floors {
    /// One full-screen grid each, coarse to fine; the last has 33 thousand triangles.
    passes: Vec<FloorPass>,
}

#[derive(Debug, Deserialize)]
struct FloorPass {
    triangles: u64,
    cpu_ms_per_frame: f64,
    wall_ms_per_frame: f64,
}

/// Draws the floor of the device: full-screen grids, textured and depth-tested.
///
/// # Errors
/// When the renderer cannot.
pub fn floors(settings: &Settings) -> anyhow::Result<Floors> {
    let [width, height] = settings.size;
    let arguments = ["--floor-json".to_owned(), format!("{width}x{height}"), FLOOR_FRAMES.to_string()];
    let mut command = Command::new(sibling("terravision-renderer")?);
    let output = command.envs(STAGE_ENVIRONMENT).args(arguments).stdin(Stdio::null()).output()?;
    ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr).trim());
    serde_json::from_slice(&output.stdout).context("the renderer's floor is no JSON")
}

/// Frames of each grid of the floor.
const FLOOR_FRAMES: u32 = 60;

/// StoreStats of the floor, and of the renderer against it, of turns in which one followed the
/// other.
pub fn floor(settings: &Settings, floors: &[Floors], alone: &[Flown], findings: &mut Findings) {
    let passes = |pass: fn(&[FloorPass]) -> Option<&FloorPass>| -> Vec<&FloorPass> {
        floors.iter().filter_map(|floors| pass(&floors.passes)).collect()
    };
    let (first, last) = (passes(<[_]>::first), passes(<[_]>::last));
    let Some(full) = last.first() else { return };
    let of = |passes: &[&FloorPass], value: fn(&FloorPass) -> f64| {
        median(&passes.iter().map(|pass| value(pass)).collect::<Vec<_>>())
    };
    let against = |renderer: fn(&Flown) -> f64, floor: fn(&FloorPass) -> f64| {
        median(&alone.iter().zip(&last).map(|(flown, pass)| renderer(flown) / floor(pass)).collect::<Vec<_>>())
    };
    let pixels = f64::from(settings.size[0]) * f64::from(settings.size[1]);
    let mut add = |name: &str, value: f64, unit: &'static str, target: Option<Target>| {
        let measurement = Measurement::new("stages", name, value, unit, FLOOR_FRAMES.into());
        findings.measurements.push(Measurement { target, ..measurement });
    };
    add("full-screen textured pass", pixels / of(&first, |pass| pass.wall_ms_per_frame) / 1e3, "Mpix/s", None);
    let (cpu, wall) = (of(&last, |pass| pass.cpu_ms_per_frame), of(&last, |pass| pass.wall_ms_per_frame));
    add("floor: triangles of a frame", full.triangles as f64, "triangles", None);
    add("floor: triangles", full.triangles as f64 / wall * 1e3, "triangles/s", None);
    add("floor: time of a frame", wall, "ms", None);
    add("floor: processor time of a frame", cpu, "ms", None);
    let ratio = against(|flown| 1e3 / flown.frames_per_second, |pass| pass.wall_ms_per_frame);
    add("renderer: time of a frame against the floor", ratio, "ratio", Some(Target::AtMost(1.5)));
    let ratio = against(|flown| flown.cpu_ms[2], |pass| pass.cpu_ms_per_frame);
    add("renderer: processor time of a frame against the floor", ratio, "ratio", Some(Target::AtMost(1.5)));
}

/// Median over turns.
pub fn median_of(turns: &[Flown], value: &dyn Fn(&Flown) -> f64) -> f64 {
    median(&turns.iter().map(value).collect::<Vec<_>>())
}

impl Flown {
    fn triangles_median(&self) -> f64 {
        median(&self.triangles.iter().map(|t| *t as f64).collect::<Vec<_>>())
    }

    fn triangles_per_second(&self) -> f64 {
        self.frames_per_second * self.triangles.iter().sum::<u64>() as f64 / self.triangles.len() as f64
    }
}

/// StoreStats of the renderer alone: medians of the turns.
pub fn renderer(settings: &Settings, alone: &[Flown], findings: &mut Findings) {
    let pixels = f64::from(settings.size[0]) * f64::from(settings.size[1]);
    let count = alone.iter().map(|flown| flown.frame_ms.len() as u64).sum();
    let rate = median_of(alone, &|flown| flown.frames_per_second);
    let mut add = |name: &str, value: f64, unit: &'static str| {
        findings.measurements.push(Measurement::new("stages", name, value, unit, count));
    };
    add("renderer: frames", rate, "frames/s");
    add("renderer: pixels", rate * pixels / 1e6, "Mpix/s");
    add("renderer: triangles", median_of(alone, &Flown::triangles_per_second), "triangles/s");
    add("renderer: triangles of a frame, median", median_of(alone, &Flown::triangles_median), "triangles");
    add("renderer: time of a frame, median", median_of(alone, &|flown| median(&flown.frame_ms)), "ms");
    add("renderer: processor time of a frame", median_of(alone, &|flown| flown.cpu_ms[2]), "ms");
}

/// StoreStats of the whole against the renderer alone, of turns in which one followed the other:
/// medians of the turns.
pub fn replay(recorded: &Recorded, whole: &[Flown], alone: &[Flown], findings: &mut Findings) {
    let count = whole.iter().map(|flown| flown.frame_ms.len() as u64).sum();
    let mut add = |name: &str, value: f64, unit: &'static str, target: Option<Target>| {
        let measurement = Measurement::new("replay", name, value, unit, count);
        findings.measurements.push(Measurement { target, ..measurement });
    };
    add("whole pipeline", median_of(whole, &|flown| flown.frames_per_second), "frames/s", None);
    add("renderer alone, recorded frames", median_of(alone, &|flown| flown.frames_per_second), "frames/s", None);
    let ratios = whole.iter().zip(alone).map(|(whole, alone)| whole.frames_per_second / alone.frames_per_second);
    let ratio = median(&ratios.collect::<Vec<_>>());
    add("whole pipeline against renderer alone", ratio, "ratio", Some(Target::AtLeast(0.9)));
    add(
        "whole pipeline, first round (tiles are loaded)",
        median_of(whole, &|flown| flown.first_round),
        "frames/s",
        None,
    );
    let renderer = median_of(alone, &|flown| median(&flown.frame_ms));
    let (generator, preparer) = (median(&recorded.trees.span_ms), median(&recorded.frames.span_ms));
    add(
        "generator's time of a frame against the renderer's",
        generator / renderer,
        "ratio",
        Some(Target::AtMost(0.05)),
    );
    add("preparer's time of a frame against the renderer's", preparer / renderer, "ratio", Some(Target::AtMost(0.15)));
    add("triangles of a frame, median", median_of(whole, &Flown::triangles_median), "triangles", None);
    for (at, stage) in Stage::ALL.into_iter().enumerate() {
        add(&format!("{stage}: processor time of a frame"), median_of(whole, &|flown| flown.cpu_ms[at]), "ms", None);
    }
    add("all stages: processor time of a frame", median_of(whole, &|flown| flown.cpu_ms.iter().sum()), "ms", None);
    for (name, flown) in [("whole pipeline", whole), ("renderer alone", alone)] {
        let quantiles = |share: f64| median_of(flown, &|flown| quantile(&flown.frame_ms, share));
        add(&format!("{name}: time of a frame, median"), quantiles(0.5), "ms", None);
        add(&format!("{name}: time of a frame, p99"), quantiles(0.99), "ms", None);
        // A view that takes long does so in every turn.
        let worst = median_of(flown, &|flown| quantile(&flown.frame_ms, 1.0) / median(&flown.frame_ms));
        add(&format!("{name}: worst frame against the median"), worst, "ratio", Some(Target::AtMost(3.0)));
    }
    for (name, flown) in [("whole pipeline", whole), ("renderer alone", alone)] {
        let values = flown.last().map(|flown| flown.frame_ms.clone()).unwrap_or_default();
        findings.curves.push(Curve { name: name.to_owned(), values });
    }
    findings.curves.push(Curve { name: "generator".to_owned(), values: recorded.trees.span_ms.clone() });
    findings.curves.push(Curve { name: "preparer".to_owned(), values: recorded.frames.span_ms.clone() });
}
