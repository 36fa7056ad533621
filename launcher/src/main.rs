//! The program `terravision`; see the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(terravision_launcher::run(std::env::args_os()))
}
