//! What a frame costs depends on the view alone: the same views over databases of 1, 16 and 256
//! times the area.

use crate::cli::Options;
use crate::findings::Findings;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, median};
use crate::recording::{record_frames, record_trees};
use crate::session::Settings;
use crate::stages::fly_recorded;
use crate::world;
use anyhow::{Context, ensure};
use std::f64::consts::TAU;
use terravision_common::camera::{Camera, CameraError, CameraFields};
use terravision_common::database::Database;

const BENCH: &str = "flat";
/// How often the side of the world is doubled.
const DOUBLINGS: [u8; 3] = [0, 2, 4];
/// Turns that the worlds get, one after the other.
const TURNS: usize = 5;
/// Frames of a round.
const MOST_FRAMES: u64 = 60;
/// The views look down this steeply, from this high above the datum: nothing beyond the detailed
/// square is in them.
const PITCH_DEG: f64 = -75.0;
const EYE_M: f64 = 2200.0;

/// Medians of a stage's time of a frame, a turn each.
#[derive(Debug, Default)]
struct Turns {
    generator: Vec<f64>,
    preparer: Vec<f64>,
    renderer: Vec<f64>,
}

impl Turns {
    fn medians(&self) -> [f64; 3] {
        [&self.generator, &self.preparer, &self.renderer].map(|of| median(of))
    }
}

/// Measures.
///
/// # Errors
/// When a world cannot be made, or a run fails.
pub fn run(settings: &Settings, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let worlds = DOUBLINGS.map(world::sparse).into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    let smallest = Database::open(&worlds[0])?;
    let round = views(&smallest, options)?;
    let flights = worlds
        .iter()
        .map(|folder| Ok(Flight { database: Database::open(folder)?, round: round.clone() }))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let mut turns: [Turns; DOUBLINGS.len()] = Default::default();
    let mut triangles = [0u64; DOUBLINGS.len()];
    for _ in 0..TURNS {
        for (at, flight) in flights.iter().enumerate() {
            let settings = Settings { world: worlds[at].clone(), ..settings.clone() };
            let trees = record_trees(&settings, flight, 1).context("the generator alone")?;
            let frames = record_frames(&settings, flight, &trees).context("the preparer alone")?;
            let flown = fly_recorded(&settings, flight, &frames)?;
            triangles[at] = flown.triangles.iter().sum();
            turns[at].generator.push(median(&trees.span_ms));
            turns[at].preparer.push(median(&frames.span_ms));
            turns[at].renderer.push(median(&flown.frame_ms));
        }
    }
    // Coarse levels end at the small world's edge and go on in the larger ones: heights near it are
    // not quite the same.
    ensure!(
        triangles.iter().all(|count| count.abs_diff(triangles[0]) * 100 <= triangles[0]),
        "the views are not the same: {triangles:?} triangles in a round"
    );
    let count = (TURNS * round.len()) as u64;
    for (at, doublings) in DOUBLINGS.into_iter().enumerate() {
        let times = 1u32 << (2 * doublings);
        let [own, smallest] = [at, 0].map(|at| turns[at].medians());
        for ((stage, value), smallest) in ["generator", "preparer", "renderer"].into_iter().zip(own).zip(smallest) {
            findings.measurements.push(Measurement::new(BENCH, format!("{stage}, {times} x"), value, "ms", count));
            if at > 0 {
                let ratio = value / smallest;
                let measurement =
                    Measurement::new(BENCH, format!("{stage}, {times} x against 1 x"), ratio, "ratio", count);
                findings.measurements.push(measurement.with_target(Target::AtMost(1.1)));
            }
        }
    }
    findings.facts.push(("triangles of a frame", (triangles[0] / round.len() as u64).to_string()));
    Ok(())
}

/// A small circle above the middle of the detailed square, looking steeply down.
fn views(smallest: &Database, options: &Options) -> Result<Vec<Camera>, CameraError> {
    let [width, height] = smallest.world().extent_m();
    let frames = options.frames.clamp(1, MOST_FRAMES);
    let view = |k: u64| {
        let angle = TAU * k as f64 / frames as f64;
        Camera::new(CameraFields {
            eye_in_world: [width * (0.5 + 0.05 * angle.sin()), height * (0.5 + 0.05 * angle.cos()), EYE_M],
            heading_rad: angle,
            pitch_rad: PITCH_DEG.to_radians(),
            roll_rad: 0.0,
            vfov_rad: 60f64.to_radians(),
            width: options.size[0],
            height: options.size[1],
            timestamp_nanos: 0,
        })
    };
    (0..frames).map(view).collect()
}
