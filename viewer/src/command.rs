//! A command that this process started: told to end when nobody wants it any more.

use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use terravision_common::log;
use terravision_common::viewer::VIEWER_ENVIRONMENT;
use tokio::process::{Child, ChildStderr, Command};

/// A command that runs. Dropped while it does, it is told to end, and removes what it has made.
#[derive(Debug)]
pub(crate) struct Running {
    child: Option<Child>,
}

/// `terravision` with these arguments, which ends with this process. Its standard error is to be
/// read.
pub(crate) fn terravision(program: &Path, arguments: Vec<String>) -> Command {
    let mut command = Command::new(program);
    command.args(arguments).arg("--child-of").arg(OsString::from(std::process::id().to_string()));
    for (name, _) in VIEWER_ENVIRONMENT {
        command.env_remove(name);
    }
    command.envs(log::environment()).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// The last line that a command left, as a part of a sentence.
pub(crate) fn reason(said: &str) -> String {
    let last = said.lines().last().unwrap_or("it left no message");
    last.trim_start_matches("terravision: ").to_owned()
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> std::io::Result<Self> {
        Ok(Self { child: Some(command.spawn()?) })
    }

    /// What it says, to be taken once.
    pub(crate) fn stderr(&mut self) -> Option<ChildStderr> {
        self.child.as_mut()?.stderr.take()
    }

    /// What it reads, where that was asked for; to be taken once.
    pub(crate) fn stdin(&mut self) -> Option<tokio::process::ChildStdin> {
        self.child.as_mut()?.stdin.take()
    }

    /// What it writes, where that was asked for; to be taken once.
    pub(crate) fn stdout(&mut self) -> Option<tokio::process::ChildStdout> {
        self.child.as_mut()?.stdout.take()
    }

    /// Waits for its end: its exit code, `None` where a signal ended it.
    pub(crate) async fn ended(&mut self) -> std::io::Result<Option<i32>> {
        let Some(child) = self.child.as_mut() else { return Ok(None) };
        let status = child.wait().await?;
        self.child = None;
        Ok(status.code())
    }

    /// Tells it to end.
    pub(crate) fn end(&self) {
        let pid = self.child.as_ref().and_then(Child::id);
        pid.and_then(|pid| Pid::from_raw(pid.cast_signed())).map(|pid| kill_process(pid, Signal::TERM).ok());
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.end();
        if let Some(mut child) = self.child.take() {
            // It is waited for by the runtime.
            tokio::spawn(async move { child.wait().await });
        }
    }
}

/// A file of a moment, removed when it has been read, or is not wanted.
#[derive(Debug)]
pub(crate) struct ScratchFile(pub(crate) PathBuf);

impl Drop for ScratchFile {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}
