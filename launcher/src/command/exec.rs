//! Subcommands that are programs of their own: `synth`, `ingest`, `bench`.

use crate::failure::Failure;
use crate::process::own_folder;
use anyhow::anyhow;
use std::ffi::OsString;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::Command;
use terravision_common::log;

/// Replaces this process by the program beside it (`execve`). Returns only when that fails.
///
/// # Errors
/// The program is missing or does not start.
pub fn exec_program(name: &str, arguments: impl IntoIterator<Item = OsString>) -> Result<(), Failure> {
    let program = own_folder()?.join(name);
    // Its help shows the command that was typed.
    let mut command = Command::new(&program);
    let error = command.arg0("terravision").args(arguments).envs(log::environment()).exec();
    let failure = match error.kind() {
        io::ErrorKind::NotFound => anyhow!(
            "the program {} is missing: 'cargo build --release' puts all programs into one folder",
            program.display()
        ),
        _ => anyhow!("cannot start {}: {error}", program.display()),
    };
    Err(Failure::failed(failure))
}
