//! The prefetcher's program; the launcher starts it.

fn main() -> std::process::ExitCode {
    terravision_common::stage::main(terravision_prefetcher::run)
}
