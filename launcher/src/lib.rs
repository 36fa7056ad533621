//! TerraVision's launcher: the program `terravision`.
//!
//! * [`cli`]: the command line as typed; [`plan`]: the validated plan that is made of it.
//! * [`path`]: camera paths, from files or built in; [`ground`]: the ground that they keep above.
//! * [`input`]: poses that another program sends while the flight goes on.
//! * [`flight`]: runs the four stages: starts them, flies the camera, watches, collects, cleans up.
//! * [`measure`]: what a run says about itself, while it goes on and afterwards.
//! * [`output`]: files that appear whole or not at all. [`stream`]: films and Y4M.
//! * [`data_set`]: poses and intrinsics beside depth and ground of whole flights.
//! * [`device`]: the Vulkan device, and whether colour tiles are compressed for it.
//! * [`serve`]: a flight and a viewer for web browsers.
//! * [`query`]: questions to the ground.
//! * [`sun`]: where the sun stands.
//! * [`world`]: the terrain database that a command is about, wherever it is.
//! * [`command`]: commands that fly nothing. [`machine`], [`process`]: what this machine has, and
//!   what runs on it.

pub mod cli;
pub mod command;
pub mod data_set;
pub mod device;
pub mod failure;
pub mod fleet;
pub mod flight;
pub mod ground;
pub mod input;
pub mod machine;
pub mod measure;
pub mod output;
pub mod path;
pub mod plan;
pub mod process;
pub mod query;
pub mod rig_file;
pub mod serve;
pub mod stream;
pub mod sun;
pub mod world;

use clap::Parser;
use clap::error::ErrorKind;
use cli::planes::with_planes_last;
use cli::{Cli, Command};
use command::{doctor, exec, export, info};
use failure::{ExitStatus, Failure};
use std::ffi::OsString;
use terravision_common::event::monotonic_nanos;
use terravision_common::log;
use terravision_common::terminal::{complain, usage_sentence};

/// The whole program: reads the command line, does what it says, and returns the exit code.
#[must_use]
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let started_nanos = monotonic_nanos();
    // Where the system refuses, a file that grows beyond its limit ends this program without a
    // sentence.
    terravision_common::stage::note_file_limit().ok();
    let result = match parse(arguments.into_iter().collect()) {
        Ok(cli) => start_log(cli.log.as_deref())
            .and_then(|()| cli.child_of.map_or(Ok(()), process::end_with_parent))
            .and_then(|()| dispatch(cli.command, started_nanos)),
        Err(error) => usage(&error),
    };
    match result {
        Ok(()) => 0,
        Err(failure) => {
            // Standard error may be closed; the exit code still tells.
            complain(&format!("terravision: {failure}"));
            failure.status as u8
        }
    }
}

fn parse(arguments: Vec<OsString>) -> Result<Cli, clap::Error> {
    Cli::try_parse_from(&arguments).or_else(|error| {
        let is_incomplete = error.kind() == ErrorKind::MissingRequiredArgument;
        let moved = is_incomplete.then(|| with_planes_last(&arguments)).flatten();
        moved.and_then(|arguments| Cli::try_parse_from(arguments).ok()).ok_or(error)
    })
}

fn start_log(filter: Option<&str>) -> Result<(), Failure> {
    let name = if filter.is_some() { "--log" } else { log::VARIABLE };
    log::start(filter).map_err(|error| Failure::bad_input(anyhow::anyhow!("{name}: {error}")))
}

fn dispatch(command: Command, started_nanos: u64) -> Result<(), Failure> {
    let with_verb = |verb: &str, arguments: Vec<OsString>| [vec![OsString::from(verb)], arguments].concat();
    match command {
        Command::Synth(args) => exec::exec_program("terravision-ingest", with_verb("synth", args.arguments)),
        Command::Ingest(args) => exec::exec_program("terravision-ingest", with_verb("ingest", args.arguments)),
        Command::Bench(args) => exec::exec_program("terravision-bench", args.arguments),
        Command::Info(args) => info::info(&args),
        Command::Doctor(args) => doctor::doctor(&args),
        Command::Path(args) => export::export(&args),
        Command::Query(args) => query::query(&args),
        Command::Fly(args) => flight::run(plan::fly(&args)?, started_nanos),
        Command::Still(args) => flight::run(plan::still(&args)?, started_nanos),
        Command::View(args) => flight::run(plan::view(*args)?, started_nanos),
        Command::Serve(args) => serve::serve(&args),
    }
}

/// Help and version are results; a wrong command line is told in one sentence.
fn usage(error: &clap::Error) -> Result<(), Failure> {
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            error.print().map_err(|error| Failure::failed(anyhow::Error::from(error)))
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // No command at all: the help is the answer, and the exit code says that nothing was
            // done.
            drop(error.print());
            Err(Failure { status: ExitStatus::BadInput, error: anyhow::anyhow!("expected a command") })
        }
        _ => Err(Failure::bad_input(anyhow::anyhow!(
            "{}",
            usage_sentence(&error.to_string(), "terravision --help, or --help after a command")
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_command_line_is_one_sentence() {
        let error = Cli::try_parse_from(["terravision", "fly", "w.tv", "-o", "a.mp4", "--size", "0x0"]).unwrap_err();
        let failure = usage(&error).unwrap_err();
        assert_eq!(failure.status, ExitStatus::BadInput);
        let text = failure.to_string();
        assert!(text.contains("'0x0'") && text.contains("1280x720") && !text.contains('\n'), "{text}");
    }

    #[test]
    fn depth_takes_a_folder_and_never_the_world() {
        let fly = |words: &[&str]| {
            let words = ["terravision", "fly"].iter().chain(words).map(OsString::from).collect();
            let Command::Fly(args) = parse(words).unwrap().command else { panic!("not fly") };
            (args.draw.world.display().to_string(), args.planes.depth, args.planes.ground)
        };
        let folder = |name: &str| Some(Some(name.into()));
        let world = || "w.tv".to_owned();
        assert_eq!(fly(&["w.tv", "-o", "a/", "--depth", "d", "--ground", "g"]), (world(), folder("d"), folder("g")));
        assert_eq!(fly(&["w.tv", "-o", "shared:a", "--depth", "--ground"]), (world(), Some(None), Some(None)));
        assert_eq!(fly(&["w.tv", "--depth", "--size", "8x8", "-o", "shared:a"]), (world(), Some(None), None));
        // As it was written before they took folders.
        assert_eq!(fly(&["--depth", "--ground", "w.tv", "-o", "shared:a"]), (world(), Some(None), Some(None)));
        assert_eq!(fly(&["-o", "shared:a", "--depth", "w.tv"]), (world(), Some(None), None));
        assert!(parse(["terravision", "fly", "--depth", "-o", "shared:a"].map(OsString::from).into()).is_err());
    }

    #[test]
    fn exit_codes_are_those_of_the_contract() {
        let fly = ["terravision", "fly", "/nonexistent.tv", "-o", "/tmp/x/"];
        assert_eq!(run(fly.map(OsString::from)), 2);
        assert_eq!(run(["terravision", "--nonsense"].map(OsString::from)), 2);
        assert_eq!(run(["terravision", "--version"].map(OsString::from)), 0);
    }
}
