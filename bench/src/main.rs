//! `terravision bench`.

#![forbid(unsafe_code)]

use anyhow::Context;
use clap::Parser;
use std::process::ExitCode;
use terravision_bench::cli::{Cli, Verb};
use terravision_bench::{queues, realtime, run};
use terravision_common::terminal::{complain, usage_sentence};

fn main() -> ExitCode {
    terravision_common::bug::report_panics("terravision bench: ");
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and the like.
        Err(error) if !error.use_stderr() => error.exit(),
        Err(error) => {
            let sentence = usage_sentence(&error.to_string(), "terravision bench --help");
            complain(&format!("terravision bench: {sentence}"));
            return ExitCode::from(2);
        }
    };
    if let Err(error) = terravision_common::log::start(cli.log.as_deref()) {
        complain(&format!("terravision bench: --log: {error}"));
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
            complain(&format!("terravision bench: {error:#}"));
            ExitCode::FAILURE
        }
    }
}
