//! The viewer's process: see the library.

fn main() -> std::process::ExitCode {
    terravision_viewer::main()
}
