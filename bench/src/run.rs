//! Runs the verbs, one after the other.

use crate::cli::{Options, RAYS_ROUNDS, RaysArgs, Verb};
use crate::findings::Findings;
use crate::flight::Flight;
use crate::machine::Machine;
use crate::measurement::summary;
use crate::session::Settings;
use crate::{flat, link, long_run, quality, query, queues, rays, realtime, stages, techniques, vehicles, world};
use anyhow::Context;
use std::path::PathBuf;
use terravision_common::run::{RaysChoice, TechniqueChoice};

/// Measures, then prints.
///
/// # Errors
/// When something could not be measured, or written; with `--strict` when a target is missed.
pub fn run(verb: Option<&Verb>, options: &Options) -> anyhow::Result<()> {
    let machine = Machine::this();
    let mut findings = Findings::default();
    match verb {
        Some(verb) => measure(verb, options, &mut findings)?,
        None => {
            // Not those that take minutes: only when they are asked for.
            for verb in [Verb::Queues, Verb::Rays(RaysArgs { rounds: RAYS_ROUNDS }), Verb::Flat] {
                measure(&verb, options, &mut findings)?;
            }
            stages_and_replay([true, true], options, &mut findings)?;
            measure(&Verb::Ingest, options, &mut findings)?;
        }
    }
    findings.publish(&machine, options)?;
    match summary(&findings.measurements) {
        Some((line, false)) if options.strict => anyhow::bail!("{line}"),
        _ => Ok(()),
    }
}

fn measure(verb: &Verb, options: &Options, findings: &mut Findings) -> anyhow::Result<()> {
    match verb {
        Verb::Realtime(args) => realtime::run(args, options, findings).context("realtime"),
        Verb::LongRun(args) => long_run::run(args, options, findings).context("long-run"),
        Verb::Link(args) => link::run(args, options, findings).context("link"),
        Verb::Queues => {
            findings.measurements.extend(queues::run(queues::Load::default()).context("queues")?);
            Ok(())
        }
        Verb::Vehicles => vehicles::run(&world::database(options)?, findings).context("vehicles"),
        Verb::Query => query::run(&world::database(options)?, findings).context("query"),
        Verb::Rays(args) => {
            rays::run(args.rounds, findings).context("rays")?;
            techniques::run(&settings(options)?, options, findings).context("mesh and rays")
        }
        Verb::Quality(args) => {
            let world = args.database.clone().map_or_else(|| world::database(options), Ok)?;
            quality::run(args, &world, options, findings).context("quality")
        }
        // It flies over worlds of its own.
        Verb::Flat => flat::run(&settings_over(PathBuf::new(), options), options, findings).context("flat cost"),
        Verb::Stages => stages_and_replay([true, false], options, findings),
        Verb::Replay => stages_and_replay([false, true], options, findings),
        Verb::Ingest => world::ingest(options, findings).context("ingest"),
        // Processes of their own, which `main` has taken out.
        Verb::Reader(_) | Verb::Load(_) => Ok(()),
    }
}

/// Both fly the same recorded frames, in turns.
fn stages_and_replay(
    [has_stages, has_replay]: [bool; 2],
    options: &Options,
    findings: &mut Findings,
) -> anyhow::Result<()> {
    let settings = settings(options)?;
    let flight = Flight::open(&settings.world, options.frames, options.size)?;
    let recorded = stages::record(&settings, &flight)?;
    let (mut alone, mut whole, mut floors) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..stages::TURNS {
        alone.push(stages::fly_recorded(&settings, &flight, &recorded.frames)?);
        if has_stages {
            floors.push(stages::floors(&settings).context("the floor of the device")?);
        }
        if has_replay {
            whole.push(stages::fly_whole(&settings, &flight)?);
        }
    }
    if has_stages {
        stages::generator_and_preparer(&recorded, findings);
        stages::renderer(&settings, &alone, findings);
        stages::floor(&settings, &floors, &alone, findings);
    }
    if has_replay {
        stages::replay(&recorded, &whole, &alone, findings);
    }
    findings.facts.push(("database", settings.world.display().to_string()));
    findings.facts.push(("device", alone.iter().map(|flown| flown.log.device_name()).next().unwrap_or_default()));
    Ok(())
}

/// How the benches fly.
fn settings(options: &Options) -> anyhow::Result<Settings> {
    Ok(settings_over(world::database(options)?, options))
}

fn settings_over(world: PathBuf, options: &Options) -> Settings {
    Settings {
        world,
        size: options.size,
        memory_bytes: options.memory_mib << 20,
        r_px: [options.facet_px, options.texel_px],
        samples: options.samples,
        measure: options.measure,
        technique: TechniqueChoice::Mesh,
        rays: RaysChoice::Mipmap,
    }
}
