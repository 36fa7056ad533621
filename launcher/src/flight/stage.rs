//! One stage process: started beside this program, watched by a pidfd, its last messages kept.

use crate::process::thread::in_thread;
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};
use std::collections::VecDeque;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};
use terravision_common::bug::INTERNAL_ERROR_WORDS;
use terravision_common::log::{self, STAGE_MARK, STAGES_TARGET};
use terravision_common::shm::Stage;
use terravision_common::stage::{FROM_STDIN, STAGE_ENVIRONMENT};
use terravision_common::terminal::complain;

/// Lines of a stage's standard error that are kept.
const KEPT_LINES: usize = 20;
/// Longest line that is kept, bytes.
const LINE_BYTES: u64 = 4096;
/// How long the end of a dead stage's standard error is waited for: a child of it may hold it open.
const LAST_MESSAGE_WAIT: Duration = Duration::from_millis(200);

/// Why a stage does not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// Its program is not there.
    #[error(
        "the program of the {stage}, {}, is missing: the launcher starts the stages from its own folder, where \
         'cargo build --release' puts all of them", program.display()
    )]
    Missing {
        /// The stage.
        stage: Stage,
        /// Where it should be.
        program: PathBuf,
    },
    /// There is no thread that reads its messages.
    #[error("cannot start the {stage}: {source:#}")]
    Thread {
        /// The stage.
        stage: Stage,
        /// Why.
        source: anyhow::Error,
    },
    /// The system does not start it.
    #[error("cannot start the {stage}, {}: {source}", program.display())]
    Spawn {
        /// The stage.
        stage: Stage,
        /// Its program.
        program: PathBuf,
        /// Why.
        #[source]
        source: io::Error,
    },
}

impl StartError {
    /// There is no pipe for its pictures.
    #[must_use]
    pub fn no_pipe(stage: Stage, programs: &Path, source: io::Error) -> Self {
        Self::Spawn { stage, program: program_of(stage, programs), source }
    }
}

fn program_of(stage: Stage, programs: &Path) -> PathBuf {
    programs.join(format!("terravision-{stage}"))
}

/// What a stage wrote to its standard error.
#[derive(Debug, Default)]
struct Lines {
    lines: VecDeque<String>,
    is_over: bool,
}

#[derive(Debug, Default)]
struct Messages {
    kept: Mutex<Lines>,
    over: Condvar,
}

/// A stage process. Dropped while it lives, it is killed and waited for.
#[derive(Debug)]
pub struct StageProcess {
    stage: Stage,
    child: Child,
    pidfd: Option<OwnedFd>,
    messages: Arc<Messages>,
    status: Option<ExitStatus>,
}

impl StageProcess {
    /// Starts the program of a stage from the folder `programs`, with this as its standard output.
    /// Call it on a thread that lives as long as the run: the kernel tells the stage of the death
    /// of the *thread* that made it.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(stage: Stage, programs: &Path, run: &str, stdout: Option<OwnedFd>) -> Result<Self, StartError> {
        let program = program_of(stage, programs);
        let mut command = Command::new(&program);
        // The run is not on the command line, which everybody can read: see the module `stage`.
        command
            .envs(STAGE_ENVIRONMENT)
            .envs(log::environment())
            .arg("--run")
            .arg(FROM_STDIN)
            .stdin(Stdio::piped())
            .stderr(Stdio::piped());
        command.stdout(stdout.map_or_else(Stdio::null, Stdio::from));
        let mut child = command.spawn().map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => StartError::Missing { stage, program: program.clone() },
            _ => StartError::Spawn { stage, program: program.clone(), source },
        })?;
        if let Some(mut stdin) = child.stdin.take() {
            // Less than a pipe holds (64 KiB): this does not wait for a stage that does not read.
            // That one of them has died is noticed elsewhere.
            drop(stdin.write_all(run.as_bytes()));
        }
        tracing::debug!(%stage, pid = child.id(), "stage started");
        let messages = Arc::new(Messages::default());
        let stderr = child.stderr.take();
        let pid = Pid::from_child(&child);
        // Dropped, it takes the process along.
        let place = Self { stage, pidfd: pidfd_open(pid, PidfdFlags::empty()).ok(), child, messages, status: None };
        if let Some(stderr) = stderr {
            let messages = Arc::clone(&place.messages);
            // Ends with the pipe; it is not joined.
            let listening = in_thread(stage.name(), move || listen(stage, stderr, &messages));
            drop(listening.map_err(|source| StartError::Thread { stage, source })?);
        }
        Ok(place)
    }

    /// The stage.
    #[must_use]
    pub fn stage(&self) -> Stage {
        self.stage
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Readable when it has ended; `None` when it has been noticed already, or where the kernel has
    /// no pidfds.
    #[must_use]
    pub fn pidfd(&self) -> Option<BorrowedFd<'_>> {
        self.pidfd.as_ref().filter(|_| self.status.is_none()).map(AsFd::as_fd)
    }

    /// How it ended, if it has.
    pub fn poll(&mut self) -> Option<ExitStatus> {
        if self.status.is_none() {
            self.status = match self.child.try_wait() {
                Ok(status) => status,
                // Somebody else has waited for it: nothing is known but that it is gone.
                Err(_gone) => Some(ExitStatus::from_raw(1 << 8)),
            };
            if let Some(status) = self.status {
                tracing::debug!(stage = %self.stage, pid = self.pid(), %status, "stage ended");
            }
        }
        self.status
    }

    /// Sends it a signal, unless it has ended.
    pub fn signal(&mut self, signal: Signal) {
        if self.poll().is_none() {
            // It may end just now.
            kill_process(Pid::from_child(&self.child), signal).ok();
        }
    }

    /// Its last message, as one line; empty when it had none.
    #[must_use]
    pub fn last_message(&self) -> String {
        let end = Instant::now() + LAST_MESSAGE_WAIT;
        let mut kept = self.messages.kept.lock().unwrap_or_else(PoisonError::into_inner);
        while !kept.is_over && Instant::now() < end {
            let rest = end.saturating_duration_since(Instant::now());
            kept = self.messages.over.wait_timeout(kept, rest).unwrap_or_else(PoisonError::into_inner).0;
        }
        last_message(kept.lines.iter().map(String::as_str))
    }

    /// All lines that were kept.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        self.messages.kept.lock().unwrap_or_else(PoisonError::into_inner).lines.iter().cloned().collect()
    }
}

impl Drop for StageProcess {
    fn drop(&mut self) {
        if self.poll().is_none() {
            drop(self.child.kill());
            drop(self.child.wait());
        }
    }
}

/// The last message of a process: its last line, or what it wrote about a fault of its own.
fn last_message<'a>(lines: impl DoubleEndedIterator<Item = &'a str> + Clone) -> String {
    let worth = |line: &&str| !line.trim().is_empty() && !line.starts_with("note: ");
    let lines: Vec<&str> = lines.filter(worth).collect();
    let from = lines.iter().rposition(|line| is_fault(line)).unwrap_or(lines.len().saturating_sub(1));
    without_echo(&lines[from..].iter().take(3).map(|line| line.trim()).collect::<Vec<_>>().join(" "))
}

/// Whether a line tells of a panic: by the sentence of a stage, or, of a program that is not ours,
/// by Rust's own.
fn is_fault(line: &str) -> bool {
    line.contains(INTERNAL_ERROR_WORDS) || line.contains("panicked at")
}

/// A chain of causes without those that the text before them ends with: "cannot write a: full:
/// full".
fn without_echo(text: &str) -> String {
    let mut said = String::new();
    for cause in text.split(": ") {
        if said.ends_with(cause) && !said.is_empty() {
            continue;
        }
        if !said.is_empty() {
            said.push_str(": ");
        }
        said.push_str(cause);
    }
    said
}

fn listen(stage: Stage, stderr: ChildStderr, messages: &Messages) {
    let mut reader = BufReader::new(stderr);
    let mut line = Vec::new();
    // A line without an end is cut, so that a stage that goes mad does not fill the memory.
    while matches!(reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line), Ok(1..)) {
        let text = String::from_utf8_lossy(&line).trim_end().to_owned();
        if let Some(logged) = text.strip_prefix(STAGE_MARK) {
            complain(logged);
            line.clear();
            continue;
        }
        tracing::info!(target: STAGES_TARGET, "{stage}: {text}");
        let mut kept = messages.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.lines.len() == KEPT_LINES {
            kept.lines.pop_front();
        }
        kept.lines.push_back(text);
        line.clear();
    }
    messages.kept.lock().unwrap_or_else(PoisonError::into_inner).is_over = true;
    messages.over.notify_all();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_message_is_the_last_line_or_a_whole_panic() {
        assert_eq!(last_message(["a", "cannot do it", "", " "].into_iter()), "cannot do it");
        let panic = ["a", "thread 'main' panicked at x.rs:1:2:", "oh no", "note: run with `RUST_BACKTRACE=1`"];
        assert_eq!(last_message(panic.into_iter()), "thread 'main' panicked at x.rs:1:2: oh no");
        assert_eq!(last_message([].into_iter()), "");
        assert_eq!(last_message(["cannot write a: full: full"].into_iter()), "cannot write a: full");
    }
}
