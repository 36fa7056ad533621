//! Why an ingest ends early.

use std::io;
use std::path::PathBuf;

/// Why an ingest (or synth) ends early. Messages are whole sentences for the user.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IngestError {
    /// Something about the input is wrong; `reason` continues the sentence that begins with the
    /// file.
    #[error("{} {reason}", file.display())]
    Source {
        /// The file.
        file: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// An option or a combination of inputs is wrong.
    #[error("{message}")]
    Usage {
        /// What is wrong, and what to do.
        message: String,
    },
    /// The place of the output cannot be used.
    #[error("cannot write into {}: {source}", path.display())]
    Place {
        /// Why.
        #[source]
        source: io::Error,
        /// The folder.
        path: PathBuf,
    },
    /// The output cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Output {
        /// Why.
        #[source]
        source: io::Error,
        /// What.
        path: PathBuf,
    },
    /// There is not enough room for the levels and the result.
    #[error(
        "about {} MB are needed in {} while the database is made, {} MB are free",
        needed_bytes >> 20, path.display(), free_bytes >> 20
    )]
    DiskSpace {
        /// What is needed.
        needed_bytes: u64,
        /// What is free.
        free_bytes: u64,
        /// The folder.
        path: PathBuf,
    },
    /// No thread can be started.
    #[error("cannot start a thread: {source}; too many threads or processes run here (ulimit -u says how many may)")]
    Threads {
        /// The system's reason.
        source: std::io::Error,
    },
    /// Ctrl-C.
    #[error("interrupted: nothing was left in {}; the same command can be run again", path.display())]
    Interrupted {
        /// The output.
        path: PathBuf,
    },
}

impl IngestError {
    /// A wrong option or combination.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::Usage { message: message.into() }
    }

    /// A wrong file.
    pub fn source(file: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self::Source { file: file.into(), reason: reason.into() }
    }

    /// The exit code of a program that ends for this reason: 2 wrong input or usage, 1 failed, 130
    /// interrupted.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Source { .. } | Self::Usage { .. } | Self::Place { .. } => 2,
            Self::Output { .. } | Self::DiskSpace { .. } | Self::Threads { .. } => 1,
            Self::Interrupted { .. } => 130,
        }
    }
}

/// What a GDAL error says, as one line.
#[must_use]
pub fn gdal_message(error: &gdal::errors::GdalError) -> String {
    use gdal::errors::GdalError::{CplError, NullPointer};
    let text = match error {
        CplError { msg, .. } | NullPointer { msg, .. } => msg.clone(),
        other => other.to_string(),
    };
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if line.is_empty() { "GDAL gives no reason".to_owned() } else { line }
}
