//! Mesh and rays over the same frames, one after the other, several times: what a frame costs on
//! the same cores.
//!
//! Frames are recorded once and fed to the renderer alone; generator, preparer and prefetcher cost
//! the same for both. How near both pictures are to the truth is in docs/techniques.md: about
//! equally near, by default and at best.

use crate::cli::Options;
use crate::findings::Findings;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, median};
use crate::session::Settings;
use crate::stages::{Flown, TURNS, fly_recorded, median_of, record};
use anyhow::Context;
use terravision_common::run::{RaysChoice, TechniqueChoice};

const BENCH: &str = "techniques";
/// What Mesa's device on the processor is called. It casts rays a tenth as fast as the processor
/// does by itself.
const SOFTWARE_DEVICE: &str = "llvmpipe";

/// One way to draw.
#[derive(Debug)]
struct Way {
    name: &'static str,
    technique: TechniqueChoice,
    rays: RaysChoice,
}

const MESH: Way = Way { name: "mesh", technique: TechniqueChoice::Mesh, rays: RaysChoice::Mipmap };
const RAYS: Way = Way { name: "rays", technique: TechniqueChoice::Rays, rays: RaysChoice::Mipmap };
const COMPUTE: Way = Way { name: "rays by a GPU", technique: TechniqueChoice::Rays, rays: RaysChoice::Compute };

/// How good the picture is meant to be. At both the pictures are about equally near to the truth
/// (docs/techniques.md).
#[derive(Debug)]
struct Level {
    label: &'static str,
    /// Most frames of a round: a second or two by default.
    most_frames: u64,
    facet_px: Option<f64>,
    /// Samples per pixel of the mesh; rays have one.
    mesh_samples: u32,
    /// How many times as fast rays are to be, where both use the same cores.
    wanted: f64,
}

const LEVELS: [Level; 2] = [
    Level { label: "", most_frames: 48, facet_px: None, mesh_samples: 1, wanted: 1.0 },
    // As `--quality best`.
    Level { label: "at best, ", most_frames: 16, facet_px: Some(3.0), mesh_samples: 4, wanted: 3.0 },
];

/// Measures mesh and rays on the same cores, and, where the device is a GPU, its rays.
///
/// # Errors
/// When a run fails: without a Vulkan device there is no mesh.
pub fn run(settings: &Settings, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    LEVELS.iter().try_for_each(|level| compare(level, settings, options, findings))
}

fn compare(level: &Level, settings: &Settings, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    let [facet_px, texel_px] = settings.r_px;
    let settings = &Settings { r_px: [level.facet_px.unwrap_or(facet_px), texel_px], ..settings.clone() };
    let flight = Flight::open(&settings.world, options.frames.min(level.most_frames), options.size)?;
    let recorded = record(settings, &flight)?;
    let fly = |way: &Way| {
        let samples = if way.technique == TechniqueChoice::Mesh { level.mesh_samples } else { 1 };
        let settings = Settings { technique: way.technique, rays: way.rays, samples, ..settings.clone() };
        fly_recorded(&settings, &flight, &recorded.frames).with_context(|| format!("technique {}", way.name))
    };
    let mut ways: Vec<(Way, Vec<Flown>)> = [MESH, RAYS].map(|way| (way, Vec::new())).into();
    for turn in 0..TURNS {
        for (way, flown) in &mut ways {
            flown.push(fly(way)?);
        }
        if turn == 0 && !device_of(&ways[0].1).starts_with(SOFTWARE_DEVICE) {
            let first = fly(&COMPUTE)?;
            ways.push((COMPUTE, vec![first]));
        }
    }
    let frames = (TURNS * flight.round.len()) as u64;
    let mut put = |name: &str, value: f64, unit, target: Option<Target>| {
        let measurement = Measurement::new(BENCH, format!("{}{name}", level.label), value, unit, frames);
        findings.measurements.push(Measurement { target, ..measurement });
    };
    let mut costs = Vec::new();
    for (Way { name, .. }, flown) in &ways {
        // The renderer is the third stage.
        let cpu = median_of(flown, &|flown| flown.cpu_ms[2]);
        let elapsed = median_of(flown, &|flown| median(&flown.frame_ms));
        put(&format!("{name}: processor time of a frame"), cpu, "ms", None);
        put(&format!("{name}: time of a frame, median"), elapsed, "ms", None);
        costs.push([cpu, elapsed]);
    }
    // On a GPU the mesh is not on the same cores.
    let target = (ways.len() == 2).then_some(Target::AtLeast(level.wanted));
    put("mesh / rays, processor time", costs[0][0] / costs[1][0], "x", target);
    put("mesh / rays, time of a frame", costs[0][1] / costs[1][1], "x", target);
    if let Some([_, elapsed]) = costs.get(2) {
        put("mesh / rays by a GPU, time of a frame", costs[0][1] / elapsed, "x", None);
    }
    if level.label.is_empty() {
        for ((_, flown), name) in ways.iter().zip(["device of the mesh", "device of rays", "device of rays by a GPU"]) {
            findings.facts.push((name, device_of(flown)));
        }
    }
    Ok(())
}

fn device_of(flown: &[Flown]) -> String {
    flown.last().map(|flown| flown.log.device_name()).unwrap_or_default()
}
