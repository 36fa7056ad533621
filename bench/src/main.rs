//! `terravision bench`.

#![forbid(unsafe_code)]

use anyhow::Context;
use clap::Parser;
use std::process::ExitCode;
use terravision_bench::cli::{Cli, Verb};
use terravision_bench::{queues, realtime, run};

fn main() -> ExitCode {
    terravision_common::bug::report_panics("terravision bench: ");
    let cli = Cli::parse();
    if let Err(error) = terravision_common::log::start(cli.log.as_deref()) {
        terravision_common::terminal::complain(&format!("terravision bench: --log: {error}"));
        return ExitCode::from(2);
    }
    let result = match &cli.verb {
        Some(Verb::Reader(reader)) => queues::read(reader, &mut std::io::stdout()),
        Some(Verb::Load(load)) => realtime::load(load.seconds, &mut std::io::stdout()),
        verb => run::run(verb.as_ref(), &cli.options).context("the bench ended early"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            terravision_common::terminal::complain(&format!("terravision bench: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
