//! Runs the verbs and prints what they found.

use crate::cli::{Options, Verb};
use crate::flight::Flight;
use crate::machine::Machine;
use crate::measurement::{Measurement, summary, table};
use crate::plot::{self, Curve};
use crate::session::Settings;
use crate::{flat, link, long_run, queues, rays, realtime, stages, techniques, world};
use anyhow::Context;
use serde_json::json;
use std::io::Write;
use std::path::PathBuf;
use terravision_common::run::{RaysChoice, TechniqueChoice};

/// What a verb found.
#[derive(Debug, Default)]
pub struct Found {
    /// Numbers.
    pub measurements: Vec<Measurement>,
    /// Curves over frames.
    pub curves: Vec<Curve>,
    /// Benches that have drawn a plot of their own.
    pub drawn: Vec<&'static str>,
    /// Facts that are no numbers: the device, the database.
    pub facts: Vec<(&'static str, String)>,
}

/// Measures, then prints.
///
/// # Errors
/// When something could not be measured, or written; with `--strict` when a target is missed.
pub fn run(verb: Option<&Verb>, options: &Options) -> anyhow::Result<()> {
    let machine = Machine::this();
    let mut found = Found::default();
    let wants = |name: &str| match verb {
        None => true,
        Some(Verb::Queues) => name == "queues",
        Some(Verb::Stages) => name == "stages",
        Some(Verb::Replay) => name == "replay",
        Some(Verb::Ingest) => name == "ingest",
        Some(Verb::Rays(_)) => name == "rays",
        Some(Verb::Flat) => name == "flat",
        Some(Verb::Reader(_) | Verb::Realtime(_) | Verb::Link(_) | Verb::LongRun(_) | Verb::Load(_)) => false,
    };
    // Minutes long: only when it is asked for.
    if let Some(Verb::Realtime(args)) = verb {
        realtime::run(args, options, &mut found).context("realtime")?;
    }
    if let Some(Verb::LongRun(args)) = verb {
        long_run::run(args, options, &mut found).context("long-run")?;
    }
    if let Some(Verb::Link(args)) = verb {
        link::run(args, options, &mut found).context("link")?;
    }
    if wants("queues") {
        found.measurements.extend(queues::run(queues::Load::default()).context("queues")?);
    }
    if wants("rays") {
        let rounds = match verb {
            Some(Verb::Rays(args)) => args.rounds,
            _ => rays::ROUNDS,
        };
        rays::run(rounds, &mut found).context("rays")?;
        techniques::run(&settings(options)?, options, &mut found).context("mesh and rays")?;
    }
    if wants("flat") {
        // It flies over worlds of its own.
        flat::run(&settings_over(PathBuf::new(), options), options, &mut found).context("flat cost")?;
    }
    if wants("stages") || wants("replay") {
        let settings = settings(options)?;
        let flight = Flight::open(&settings.world, options.frames, options.size)?;
        let recorded = stages::record(&settings, &flight)?;
        let (mut alone, mut whole, mut floors) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..stages::TURNS {
            alone.push(stages::fly_recorded(&settings, &flight, &recorded.frames)?);
            if wants("stages") {
                floors.push(stages::floors(&settings).context("the floor of the device")?);
            }
            if wants("replay") {
                whole.push(stages::fly_whole(&settings, &flight)?);
            }
        }
        if wants("stages") {
            stages::generator_and_preparer(&recorded, &mut found);
            stages::renderer(&settings, &alone, &mut found);
            stages::floor(&settings, &floors, &alone, &mut found);
        }
        if wants("replay") {
            stages::replay(&recorded, &whole, &alone, &mut found);
        }
        found.facts.push(("database", settings.world.display().to_string()));
        found.facts.push(("device", alone.iter().map(|flown| flown.log.device_name()).next().unwrap_or_default()));
    }
    if wants("ingest") {
        world::ingest(options, &mut found).context("ingest")?;
    }
    print(&machine, &found, options)?;
    match summary(&found.measurements) {
        Some((line, false)) if options.strict => anyhow::bail!("{line}"),
        _ => Ok(()),
    }
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

fn print(machine: &Machine, found: &Found, options: &Options) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if options.json {
        let verdicts: Vec<_> = found.measurements.iter().map(Measurement::verdict).collect();
        let facts: serde_json::Map<_, _> = found.facts.iter().map(|(k, v)| ((*k).to_owned(), json!(v))).collect();
        let object = json!({
            "schema": "terravision-bench-1",
            "machine": machine,
            "facts": facts,
            "measurements": found.measurements,
            "verdicts": verdicts,
            "curves": found.curves.iter().map(|c| json!({"name": c.name, "ms": c.values})).collect::<Vec<_>>(),
        });
        writeln!(out, "{object:#}")?;
    } else {
        let release = if machine.is_release { "release" } else { "development" };
        let Machine { processor, cores, kernel, load, commit, .. } = machine;
        writeln!(out, "{processor}, {cores} cores, Linux {kernel}, load {load}; commit {commit}, {release} build")?;
        for (name, value) in &found.facts {
            writeln!(out, "{name}: {value}")?;
        }
        write!(out, "\n{}", table(&found.measurements))?;
        if let Some((line, _)) = summary(&found.measurements) {
            writeln!(out, "\n{line}")?;
        }
    }
    if let Some(folder) = &options.output {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let mut benches: Vec<&str> = found.measurements.iter().map(|m| m.bench).collect();
        benches.dedup();
        benches.retain(|bench| !found.drawn.contains(bench));
        for bench in benches {
            let of_bench: Vec<_> = found.measurements.iter().filter(|m| m.bench == bench).cloned().collect();
            plot::bars(folder, bench, &of_bench)?;
        }
        if !found.curves.is_empty() {
            plot::curves(folder, "frames", &found.curves)?;
        }
    }
    Ok(())
}
