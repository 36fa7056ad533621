//! Mesh and rays over the same frames, one after the other, several times: what a frame costs on the same cores.
//!
//! Frames are recorded once and fed to the renderer alone; generator, preparer and prefetcher cost the same for both. How near
//! both pictures are to the truth is in docs/techniques.md: rays at the same facets are a little nearer.

use crate::cli::Options;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, median};
use crate::report::Found;
use crate::session::Settings;
use crate::stages::{Flown, Recorded, TURNS, fly_recorded, median_of, record};
use anyhow::Context;
use terravision_common::run::{RaysChoice, TechniqueChoice};

const BENCH: &str = "techniques";
/// Most frames of a round: a second or two.
const MOST_FRAMES: u64 = 48;
/// What Mesa's device on the processor is called. It casts rays a tenth as fast as the processor does by itself.
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

/// Measures mesh and rays on the same cores, and, where the device is a GPU, its rays.
///
/// # Errors
/// When a run fails: without a Vulkan device there is no mesh.
pub fn run(settings: &Settings, options: &Options, found: &mut Found) -> anyhow::Result<()> {
    let flight = Flight::open(&settings.world, options.frames.min(MOST_FRAMES), options.size)?;
    let recorded = record(settings, &flight)?;
    let mut ways: Vec<(Way, Vec<Flown>)> = [MESH, RAYS].map(|way| (way, Vec::new())).into();
    for turn in 0..TURNS {
        for (way, flown) in &mut ways {
            flown.push(fly(settings, way, &flight, &recorded)?);
        }
        if turn == 0 && !device_of(&ways[0].1).starts_with(SOFTWARE_DEVICE) {
            let first = fly(settings, &COMPUTE, &flight, &recorded)?;
            ways.push((COMPUTE, vec![first]));
        }
    }
    let frames = (TURNS * flight.round.len()) as u64;
    let mut put = |name: String, value: f64, unit, target: Option<Target>| {
        let measurement = Measurement::new(BENCH, name, value, unit, frames);
        found.measurements.push(Measurement { target, ..measurement });
    };
    let mut costs = Vec::new();
    for (Way { name, .. }, flown) in &ways {
        // The renderer is the third stage.
        let cpu = median_of(flown, &|flown| flown.cpu_ms[2]);
        let elapsed = median_of(flown, &|flown| median(&flown.frame_ms));
        put(format!("{name}: processor time of a frame"), cpu, "ms", None);
        put(format!("{name}: time of a frame, median"), elapsed, "ms", None);
        costs.push([cpu, elapsed]);
    }
    // On a GPU the mesh is not on the same cores.
    let target = (ways.len() == 2).then_some(Target::AtLeast(1.0));
    put("mesh / rays, processor time".to_owned(), costs[0][0] / costs[1][0], "x", target);
    put("mesh / rays, time of a frame".to_owned(), costs[0][1] / costs[1][1], "x", target);
    if let Some([_, elapsed]) = costs.get(2) {
        put("mesh / rays by a GPU, time of a frame".to_owned(), costs[0][1] / elapsed, "x", None);
    }
    for ((_, flown), name) in ways.iter().zip(["device of the mesh", "device of rays", "device of rays by a GPU"]) {
        found.facts.push((name, device_of(flown)));
    }
    Ok(())
}

fn fly(settings: &Settings, way: &Way, flight: &Flight, recorded: &Recorded) -> anyhow::Result<Flown> {
    let settings = Settings { technique: way.technique, rays: way.rays, samples: 1, ..settings.clone() };
    fly_recorded(&settings, flight, &recorded.frames).with_context(|| format!("technique {}", way.name))
}

fn device_of(flown: &[Flown]) -> String {
    flown.last().map(|flown| flown.log.device_name()).unwrap_or_default()
}
