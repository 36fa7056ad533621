//! The log of each process, for debugging. Off by default.
//!
//! What users have to know is a message of the launcher, not a line of the log. A filter
//! ([`VARIABLE`], or `--log`) selects what is logged: a level for all of TerraVision, or directives
//! of `tracing-subscriber` for single targets. The launcher passes its filter on to the processes
//! that it starts; stages send their lines to the launcher on standard error.
//!
//! Levels: `error` data are lost; `warn` something is done differently than requested; `info` once
//! in a run; `debug` once for each operation (a process, a request, a list of tiles); `trace` once
//! for each frame or tile.

use crate::terminal::{complain, cut};
use std::io::{self, Write};
use std::sync::OnceLock;
use tracing_subscriber::EnvFilter;

/// The environment variable with the filter.
pub const VARIABLE: &str = "TERRAVISION_LOG";
/// The target of other lines that stages write to standard error: `TERRAVISION_LOG=stages` shows
/// only these.
pub const STAGES_TARGET: &str = "stages";
/// Prefix of each line of a stage's log: the launcher passes such a line on, and does not treat it
/// as a message.
pub const STAGE_MARK: &str = "@log ";

/// Longest line of a log, bytes; longer ones are cut.
const LINE_BYTES: usize = 2048;
const LEVELS: [&str; 6] = ["off", "error", "warn", "info", "debug", "trace"];

/// The filter of this process, as it was given.
static FILTER: OnceLock<String> = OnceLock::new();

/// A text is not a filter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected off, error, warn, info, debug or trace, or a filter like info,terravision_store=trace; found {found:?}{reason}"
)]
pub struct FilterError {
    found: String,
    /// The reason, after a colon; may be empty.
    reason: String,
}

/// Starts the log of a program that a user starts, if there is a filter: `asked` (of `--log`), or
/// else [`VARIABLE`].
///
/// # Errors
/// [`FilterError`].
pub fn start(asked: Option<&str>) -> Result<(), FilterError> {
    let of_environment = || std::env::var(VARIABLE).ok();
    match asked.map(str::to_owned).or_else(of_environment).filter(|text| !text.trim().is_empty()) {
        Some(text) => start_with(text, ""),
        None => Ok(()),
    }
}

/// Starts the log of a stage, with the filter that the launcher has set.
pub fn start_stage() {
    if let Ok(text) = std::env::var(VARIABLE) {
        // The launcher has reported an invalid filter.
        start_with(text, STAGE_MARK).ok();
    }
}

/// The environment variable for child processes, so that they use the same filter.
#[must_use]
pub fn environment() -> Option<(&'static str, &'static str)> {
    FILTER.get().map(|text| (VARIABLE, text.as_str()))
}

fn start_with(text: String, mark: &'static str) -> Result<(), FilterError> {
    let filter = filter(&text)?;
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false);
    // It has been started already when two tests run in one process.
    log.with_writer(move || Lines { mark }).try_init().ok();
    FILTER.set(text).ok();
    Ok(())
}

/// A level alone applies to the programs of TerraVision: libraries (HTTP, TLS) then log only
/// warnings.
fn filter(text: &str) -> Result<EnvFilter, FilterError> {
    let text = text.trim();
    let error = |reason: String| FilterError { found: text.to_owned(), reason };
    let level = text.to_ascii_lowercase();
    let directives = match level.as_str() {
        "off" | "error" => level,
        level if LEVELS.contains(&level) => format!("warn,terravision={level},{STAGES_TARGET}={level}"),
        // A single word would be a target without lines: more likely it is a misspelled level.
        _ if !text.contains(['=', ',', '[']) && text != STAGES_TARGET && !text.starts_with("terravision") => {
            return Err(error(String::new()));
        }
        _ => text.to_owned(),
    };
    EnvFilter::builder().parse(directives).map_err(|source| error(format!(": {source}")))
}

/// Lines on standard error, each written at once.
struct Lines {
    mark: &'static str,
}

impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        complain(&format!("{}{}", self.mark, cut(text.trim_end(), LINE_BYTES)));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_is_for_the_programs_of_terravision() {
        let text = |filter: &str| super::filter(filter).map(|filter| filter.to_string());
        let debug = text("Debug").unwrap();
        assert!(debug.contains("terravision=debug") && debug.contains("warn"), "{debug}");
        assert_eq!(text("off").unwrap(), "off");
        assert_eq!(text("stages").unwrap(), "stages=trace");
        assert!(text("info,terravision_store=trace").unwrap().contains("terravision_store=trace"));
    }

    #[test]
    fn what_is_not_a_filter_is_refused_with_what_is_expected() {
        for wrong in ["debg", "5", "a=b=c", "terravision=loud"] {
            let message = filter(wrong).unwrap_err().to_string();
            assert!(message.starts_with("expected off, error, warn, info, debug or trace"), "{message}");
            assert!(message.contains(wrong), "{message}");
        }
    }
}
