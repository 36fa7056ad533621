//! Processes as values: a typed builder, a deadline, captured output, killed when dropped.

mod binaries;
mod proc_fs;
mod running;

pub use binaries::binary;
pub use proc_fs::{children_of, is_alive, loopback_port, peak_kib, pss_kib, segments_of_launcher, segments_of_tests};
pub use running::{Finished, Running, signal_process};

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A command of TerraVision that is about to be run.
#[derive(Debug, Clone)]
pub struct Terravision {
    program: PathBuf,
    arguments: Vec<OsString>,
    environment: Vec<(OsString, OsString)>,
    folder: Option<PathBuf>,
    deadline: Duration,
}

impl Terravision {
    /// `terravision VERB`, built from the sources at hand.
    #[must_use]
    pub fn verb(verb: &str) -> Self {
        Self {
            program: binary("terravision"),
            arguments: vec![verb.into()],
            environment: Vec::new(),
            folder: None,
            deadline: Duration::from_secs(180),
        }
    }

    /// Any other program.
    #[must_use]
    pub fn program(program: impl Into<PathBuf>) -> Self {
        Self {
            program: program.into(),
            arguments: Vec::new(),
            environment: Vec::new(),
            folder: None,
            deadline: Duration::from_secs(180),
        }
    }

    /// One more argument.
    #[must_use]
    pub fn arg(mut self, argument: impl AsRef<OsStr>) -> Self {
        self.arguments.push(argument.as_ref().to_owned());
        self
    }

    /// More arguments.
    #[must_use]
    pub fn args<A: AsRef<OsStr>>(mut self, arguments: impl IntoIterator<Item = A>) -> Self {
        self.arguments.extend(arguments.into_iter().map(|a| a.as_ref().to_owned()));
        self
    }

    /// A variable of its environment.
    #[must_use]
    pub fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.environment.push((name.into(), value.as_ref().to_owned()));
        self
    }

    /// Where it runs.
    #[must_use]
    pub fn current_dir(mut self, folder: &Path) -> Self {
        self.folder = Some(folder.to_owned());
        self
    }

    /// How long it may take; then it is killed and the test fails. 3 minutes unless told.
    #[must_use]
    pub fn deadline(mut self, deadline: Duration) -> Self {
        self.deadline = deadline;
        self
    }

    /// Starts it.
    ///
    /// # Panics
    /// When it cannot be started.
    #[must_use]
    pub fn spawn(self) -> Running {
        Running::start(&self, u64::MAX)
    }

    /// Starts it, and reads nothing of its standard output before [`Running::read_up_to`]: what writes
    /// pictures there does not come to its end meanwhile, however slow the test is.
    ///
    /// # Panics
    /// When it cannot be started.
    #[must_use]
    pub fn spawn_unread(self) -> Running {
        Running::start(&self, 0)
    }

    /// Runs it to its end.
    ///
    /// # Panics
    /// When it cannot be started or passes its deadline.
    #[must_use]
    pub fn run(self) -> Finished {
        self.spawn().wait()
    }

    /// Runs it to its end, which has to be a success without a warning.
    ///
    /// # Panics
    /// When the exit code is not 0 or it warned about anything.
    pub fn succeed(self) -> Finished {
        let finished = self.run();
        finished.assert_code(0);
        finished.assert_no_warning();
        finished
    }
}
