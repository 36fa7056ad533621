//! Mesh and rays over the same frames, one after the other, several times: what a frame costs on the same cores.
//!
//! Frames are recorded once and fed to the renderer alone; generator, preparer and prefetcher cost the same for both. How near
//! both pictures are to the truth is in docs/techniques.md: rays at the same facets are a little nearer.

use crate::cli::Options;
use crate::flight::Flight;
use crate::measurement::{Measurement, Target, median};
use crate::report::Found;
use crate::session::Settings;
use crate::stages::{Flown, TURNS, fly_recorded, median_of, record};
use anyhow::Context;
use terravision_common::run::TechniqueChoice;

const BENCH: &str = "techniques";
/// Most frames of a round: a second or two.
const MOST_FRAMES: u64 = 48;

/// Measures both.
///
/// # Errors
/// When a run fails: without a Vulkan device there is no mesh.
pub fn run(settings: &Settings, options: &Options, found: &mut Found) -> anyhow::Result<()> {
    let flight = Flight::open(&settings.world, options.frames.min(MOST_FRAMES), options.size)?;
    let recorded = record(settings, &flight)?;
    let mut flown: [Vec<Flown>; 2] = Default::default();
    let techniques = [TechniqueChoice::Mesh, TechniqueChoice::Rays];
    for _ in 0..TURNS {
        for (technique, flown) in techniques.into_iter().zip(&mut flown) {
            let settings = Settings { technique, samples: 1, ..settings.clone() };
            let turn = fly_recorded(&settings, &flight, &recorded.frames);
            flown.push(turn.with_context(|| format!("technique {}", technique.name()))?);
        }
    }
    let frames = (TURNS * flight.round.len()) as u64;
    let mut put = |name: String, value: f64, unit, target: Option<Target>| {
        let measurement = Measurement::new(BENCH, name, value, unit, frames);
        found.measurements.push(Measurement { target, ..measurement });
    };
    // The renderer is the third stage.
    let cpu = flown.each_ref().map(|flown| median_of(flown, &|flown| flown.cpu_ms[2]));
    let elapsed = flown.each_ref().map(|flown| median_of(flown, &|flown| median(&flown.frame_ms)));
    for ((technique, cpu), elapsed) in techniques.into_iter().zip(cpu).zip(elapsed) {
        let name = technique.name();
        put(format!("{name}: processor time of a frame"), cpu, "ms", None);
        put(format!("{name}: time of a frame, median"), elapsed, "ms", None);
    }
    put("mesh / rays, processor time".to_owned(), cpu[0] / cpu[1], "x", Some(Target::AtLeast(1.0)));
    put("mesh / rays, time of a frame".to_owned(), elapsed[0] / elapsed[1], "x", Some(Target::AtLeast(1.0)));
    for (technique, flown) in techniques.into_iter().zip(&flown) {
        let name = if technique == TechniqueChoice::Mesh { "device of the mesh" } else { "device of rays" };
        found.facts.push((name, flown.last().map(|flown| flown.log.device_name()).unwrap_or_default()));
    }
    Ok(())
}
