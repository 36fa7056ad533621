//! `terravision-ingest`: see `--help`.
//!
//! Exit codes: 0 done; 1 failed while writing; 2 wrong usage or input; 130 interrupted.

#![forbid(unsafe_code)]

use clap::Parser;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use terravision_common::bug::report_panics;
use terravision_common::terminal::{complain, printable, printable_json, usage_sentence};
use terravision_ingest::cli::{Cli, SynthJob, Verb};
use terravision_ingest::error::IngestError;
use terravision_ingest::job::{Job, summary};
use terravision_ingest::source::Note;
use terravision_ingest::sparse::{self, SparseOptions};
use terravision_ingest::synth;
use terravision_ingest::work::Work;

fn main() -> ExitCode {
    report_panics("terravision: ");
    // Also tells which GDAL was found; `terravision doctor` asks.
    if std::env::args_os().skip(1).eq(["--version"]) {
        let gdal = gdal::version::version_info("RELEASE_NAME");
        writeln!(io::stdout(), "terravision-ingest {}, GDAL {gdal}", env!("CARGO_PKG_VERSION")).ok();
        return ExitCode::SUCCESS;
    }
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        // Help and the like.
        Err(error) if !error.use_stderr() => error.exit(),
        Err(error) => {
            complain(&format!("terravision: {}", usage(&error)));
            return ExitCode::from(2);
        }
    };
    if let Err(error) = terravision_common::log::start(cli.log.as_deref()) {
        complain(&format!("terravision: --log: {error}"));
        return ExitCode::from(2);
    }
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    // Without a handler an interrupt simply kills us, and the next run cleans up.
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).ok();
    // Without it, too, a file that grows beyond its limit just ends us.
    terravision_common::stage::note_file_limit().ok();
    let result = match cli.verb {
        Verb::Ingest(args) => {
            let wants_json = args.json;
            args.validate().and_then(|job| ingest(&job, wants_json, stop))
        }
        Verb::Synth(args) => args.validate().and_then(|made| {
            let shows_progress = io::stderr().is_terminal();
            let output = match made {
                SynthJob::Plane(options) => synth::write(&options, stop, shows_progress).map(|()| options.output),
                SynthJob::Body(options) => synth::body::write(&options, stop, shows_progress).map(|()| options.output),
            }?;
            Ok(printable(&format!("{}: dem.tif and ortho.tif", output.display())).into_owned())
        }),
        Verb::Sparse(args) => {
            let options = SparseOptions {
                detailed_nodes: args.detailed_nodes,
                doublings: args.doublings,
                is_named: args.named,
                is_bulk: args.bulk,
                texels_per_post: args.texels_per_post,
            };
            let threads = std::thread::available_parallelism().map_or(1, usize::from);
            let work = Work::new(threads, stop, io::stderr().is_terminal(), args.output.clone());
            sparse::write(&args.output, options, &work)
                .map(|_| printable(&args.output.display().to_string()).into_owned())
        }
    };
    match result {
        Ok(line) => {
            // A closed standard output is not a failure of the ingest.
            writeln!(io::stdout(), "{line}").ok();
            ExitCode::SUCCESS
        }
        Err(error) => {
            print_error(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// What is wrong with the command line. Rasters without a flag are what is most often wrong.
fn usage(error: &clap::Error) -> String {
    let sentence = usage_sentence(&error.to_string(), "--help after the command");
    let is_ingest = std::env::args_os().nth(1).is_some_and(|verb| verb == "ingest");
    let is_file = is_ingest
        && error.kind() == ErrorKind::UnknownArgument
        && matches!(error.get(ContextKind::InvalidArg), Some(ContextValue::String(name)) if !name.starts_with('-'));
    if is_file { format!("{sentence}: rasters are named by --elevation and --color") } else { sentence }
}

/// Makes a database. Returns the text to be printed about it, safe for a terminal.
fn ingest(job: &Job, wants_json: bool, stop: Arc<AtomicBool>) -> Result<String, IngestError> {
    tracing::info!(output = %job.output.display(), elevation = job.elevation.len(), color = job.color.len(), "ingest begins");
    job.access.restrict_process(job.elevation.iter().chain(&job.color));
    let mut notes = Vec::new();
    let mut note = |note: Note| {
        print_note(&note);
        notes.push(note);
    };
    let manifest = job.run(stop, io::stderr().is_terminal(), &mut note)?;
    if wants_json {
        let text = format!("{:#}", summary(&job.output, &manifest, &notes));
        return Ok(printable_json(&text).into_owned());
    }
    let made = manifest.fields();
    let line = format!(
        "{}: {} elevation and {} colour tiles, heights {:.1} to {:.1} m",
        job.output.display(),
        made.elevation.archive.tiles,
        made.color.archive.tiles,
        made.elevation.range_m[0],
        made.elevation.range_m[1]
    );
    Ok(printable(&line).into_owned())
}

fn print_note(note: &Note) {
    tracing::debug!(?note, "note");
    complain(&match note {
        Note::Info(text) => format!("note: {text}"),
        Note::Warning(text) => format!("warning: {text}"),
    });
}

fn print_error(error: &IngestError) {
    complain(&format!("terravision: {error}"));
}
