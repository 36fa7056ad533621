//! How a command ends when it does not end well: one sentence for a person, and an exit code for a
//! script.

use std::fmt;

/// The exit codes that are not 0. They are documented in `terravision --help`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum ExitStatus {
    /// The run failed.
    Failed = 1,
    /// The command line is wrong, or something that it names cannot be used, for whatever reason;
    /// nothing was made.
    BadInput = 2,
    /// The flight finished, but tiles were missing and were drawn from coarser ones.
    TilesUnavailable = 3,
    /// Interrupted by Ctrl-C or TERM.
    Interrupted = 130,
}

/// Why a command ends with another exit code than 0.
#[derive(Debug)]
pub struct Failure {
    /// The exit code.
    pub status: ExitStatus,
    /// The reason; its chain of causes is printed as one sentence.
    pub error: anyhow::Error,
}

impl Failure {
    /// The run failed.
    pub fn failed(error: impl Into<anyhow::Error>) -> Self {
        Self { status: ExitStatus::Failed, error: error.into() }
    }

    /// The command line or the input is wrong.
    pub fn bad_input(error: impl Into<anyhow::Error>) -> Self {
        Self { status: ExitStatus::BadInput, error: error.into() }
    }
}

impl fmt::Display for Failure {
    /// One sentence on one line: the error, then each cause that the text before does not contain
    /// already.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = String::new();
        for cause in self.error.chain() {
            let cause = cause.to_string();
            let cause = cause.split_whitespace().collect::<Vec<_>>().join(" ");
            if text.contains(&cause) {
                continue;
            }
            if !text.is_empty() {
                text.push_str(": ");
            }
            text.push_str(&cause);
        }
        f.write_str(&text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn a_failure_is_one_line_and_says_nothing_twice() {
        let inner = Err::<(), _>(std::io::Error::other("no space\nleft"));
        let error = inner.context("cannot write a.png: no space left").context("frame 3").unwrap_err();
        assert_eq!(Failure::failed(error).to_string(), "frame 3: cannot write a.png: no space left");
    }
}
