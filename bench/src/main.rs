//! `terravision bench`.

#![forbid(unsafe_code)]

use anyhow::Context;
use clap::Parser;
use std::io::Write;
use std::process::ExitCode;
use terravision_bench::cli::{Cli, Verb};
use terravision_bench::{queues, realtime, report};

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match &cli.verb {
        Some(Verb::Reader(reader)) => queues::read(reader, &mut std::io::stdout()),
        Some(Verb::Load(load)) => realtime::load(load.seconds, &mut std::io::stdout()),
        verb => report::run(verb.as_ref(), &cli.options).context("the bench ended early"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Nobody is left to tell when standard error is closed.
            drop(writeln!(std::io::stderr(), "terravision bench: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
