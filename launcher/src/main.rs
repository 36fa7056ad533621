//! The program `terravision`; see the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    terravision_common::bug::report_panics("terravision: ");
    ExitCode::from(terravision_launcher::run(std::env::args_os()))
}
