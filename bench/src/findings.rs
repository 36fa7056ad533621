//! What was measured: gathered by the verbs, printed and plotted at the end.

use crate::cli::Options;
use crate::machine::Machine;
use crate::measurement::{Measurement, summary, table};
use crate::plot::{self, Curve};
use anyhow::Context;
use serde_json::json;
use std::io::{self, Write};
use std::path::Path;

/// What was measured.
#[derive(Debug, Default)]
pub struct Findings {
    /// Numbers.
    pub measurements: Vec<Measurement>,
    /// Curves over frames.
    pub curves: Vec<Curve>,
    /// Benches that have drawn a plot of their own.
    pub drawn: Vec<&'static str>,
    /// Tables of the numbers that are easier to read than a list of them, printed in its place.
    pub tables: Vec<String>,
    /// Facts beside the numbers: the device, the database.
    pub facts: Vec<(&'static str, String)>,
}

impl Findings {
    /// Prints a table, or JSON; draws plots where they are wanted.
    ///
    /// # Errors
    /// When standard output or a plot cannot be written.
    pub fn publish(&self, machine: &Machine, options: &Options) -> anyhow::Result<()> {
        let mut out = io::stdout().lock();
        let printed =
            if options.json { self.print_json(machine, &mut out) } else { self.print_table(machine, &mut out) };
        printed.context("cannot write to standard output")?;
        options.output.as_deref().map_or(Ok(()), |folder| self.plot(folder))
    }

    fn print_json(&self, machine: &Machine, out: &mut impl Write) -> io::Result<()> {
        let verdicts: Vec<_> = self.measurements.iter().map(Measurement::verdict).collect();
        let facts: serde_json::Map<_, _> = self.facts.iter().map(|(k, v)| ((*k).to_owned(), json!(v))).collect();
        let object = json!({
            "schema": "terravision-bench-1",
            "machine": machine,
            "facts": facts,
            "measurements": self.measurements,
            "verdicts": verdicts,
            "curves": self.curves.iter().map(|c| json!({"name": c.name, "ms": c.values})).collect::<Vec<_>>(),
        });
        writeln!(out, "{object:#}")
    }

    fn print_table(&self, machine: &Machine, out: &mut impl Write) -> io::Result<()> {
        let release = if machine.is_release { "release" } else { "development" };
        let Machine { processor, cores, kernel, load, commit, .. } = machine;
        writeln!(out, "{processor}, {cores} cores, Linux {kernel}, load {load}; commit {commit}, {release} build")?;
        for (name, value) in &self.facts {
            writeln!(out, "{name}: {value}")?;
        }
        if self.tables.is_empty() {
            write!(out, "\n{}", table(&self.measurements))?;
        }
        for table in &self.tables {
            write!(out, "\n{table}")?;
        }
        summary(&self.measurements).map_or(Ok(()), |(line, _)| writeln!(out, "\n{line}"))
    }

    fn plot(&self, folder: &Path) -> anyhow::Result<()> {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let mut benches: Vec<&str> = self.measurements.iter().map(|m| m.bench).collect();
        benches.dedup();
        benches.retain(|bench| !self.drawn.contains(bench));
        for bench in benches {
            let of_bench: Vec<_> = self.measurements.iter().filter(|m| m.bench == bench).cloned().collect();
            plot::bars(folder, bench, &of_bench)?;
        }
        if !self.curves.is_empty() {
            plot::curves(folder, "frames", &self.curves)?;
        }
        Ok(())
    }
}
