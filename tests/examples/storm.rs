//! Storms over a flight, a summary line each: what `scripts/storm.sh` runs.
//!
//! `cargo run -p terravision-tests --example storm -- death|bytes|all [--short]`

#![allow(clippy::print_stdout, reason = "its output is the summary")]

use std::process::ExitCode;
use std::time::{Duration, Instant};
use terravision_tests::storm::{BytesStorm, DeathStorm};
use terravision_tests::worlds::synth_world;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (is_short, names): (Vec<&str>, Vec<&str>) =
        arguments.iter().map(String::as_str).partition(|argument| *argument == "--short");
    let is_short = !is_short.is_empty();
    let name = match names[..] {
        [] => "all",
        [name @ ("death" | "bytes" | "all")] => name,
        _ => {
            println!("usage: storm death|bytes|all [--short]");
            return ExitCode::from(2);
        }
    };
    let world = synth_world(1024);
    let (start, mut faults) = (Instant::now(), Vec::new());
    if matches!(name, "death" | "all") {
        let seconds = if is_short { 12.0 } else { 180.0 };
        let report = DeathStorm { seconds, every: Duration::from_secs(2), seed: 1 }.fly(&world);
        println!("storm of death, {seconds} s: {report}");
        faults.extend(if is_short { report.faults() } else { report.faults_on_an_idle_machine() });
    }
    if matches!(name, "bytes" | "all") {
        let (rounds, seconds) = if is_short { (5, 1.5) } else { (45, 4.0) };
        let report = BytesStorm { rounds, seconds, every: Duration::from_millis(20), seed: 1 }.fly(&world);
        println!("storm of bytes, {rounds} flights of {seconds} s: {report}");
        faults.extend(report.faults);
    }
    for fault in &faults {
        println!("FAULT: {fault}");
    }
    println!(
        "{} in {:.0} s",
        if faults.is_empty() { "all held" } else { "NOT all held" },
        start.elapsed().as_secs_f64()
    );
    if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
