//! A program that is watched: what it writes to its standard error is kept and passed on, and it is
//! started again when it dies.

use super::Event;
use crate::process::signals::killed_by;
use crate::process::thread::in_thread;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Longest line that is passed on.
const LINE_BYTES: u64 = 4096;
/// Longest time to the last line of a program that has ended: what it started may hold the pipe.
const LAST_LINE_WITHIN: Duration = Duration::from_millis(300);
/// Between two looks at whether it has ended.
const TICK: Duration = Duration::from_millis(5);
/// A program that dies a second time before it has worked is started again after this time, then
/// after twice that, ...
const FIRST_BACK_OFF: Duration = Duration::from_millis(500);
/// ... and at most this.
const LONGEST_BACK_OFF: Duration = Duration::from_secs(10);

/// A program that runs. Dropped while it does, it is killed and waited for.
#[derive(Debug)]
pub(super) struct Watched {
    child: Child,
    last: Arc<Mutex<String>>,
    /// Reads what it writes, until the pipe ends; it is not joined.
    listener: Option<JoinHandle<()>>,
}

impl Watched {
    /// Starts it. Its lines come as events that `event` makes of them. To be called on the main
    /// thread: the kernel tells the child of the death of the thread that made it.
    pub(super) fn start(
        command: &mut Command,
        event: impl Fn(String) -> Event + Send + 'static,
        events: SyncSender<Event>,
    ) -> anyhow::Result<Self> {
        let mut child = command.stderr(Stdio::piped()).spawn()?;
        let last = Arc::new(Mutex::new(String::new()));
        let stderr = child.stderr.take();
        let mut watched = Self { child, last: Arc::clone(&last), listener: None };
        if let Some(stderr) = stderr {
            let listen = move || listen(stderr, &last, |line| drop(events.send(event(line))));
            watched.listener = Some(in_thread("listen", listen)?);
        }
        Ok(watched)
    }

    pub(super) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// How it ended, if it has.
    pub(super) fn ended(&mut self) -> Option<ExitStatus> {
        // One that somebody else has waited for is gone, too.
        self.child.try_wait().unwrap_or(Some(ExitStatus::from_raw(1 << 8)))
    }

    pub(super) fn signal(&mut self, signal: Signal) {
        if self.ended().is_none() {
            kill_process(Pid::from_child(&self.child), signal).ok();
        }
    }

    /// Waits for its end, and kills it when that takes too long.
    pub(super) fn wait(&mut self, longest: Duration) {
        let end = Instant::now() + longest;
        while self.ended().is_none() && Instant::now() < end {
            std::thread::sleep(TICK);
        }
        if self.ended().is_none() {
            self.child.kill().ok();
            self.child.wait().ok();
        }
    }

    /// Why it ended, in words.
    pub(super) fn reason(&self, status: ExitStatus) -> String {
        // Its last line may not have been read yet.
        let end = Instant::now() + LAST_LINE_WITHIN;
        while self.listener.as_ref().is_some_and(|thread| !thread.is_finished()) && Instant::now() < end {
            std::thread::sleep(TICK);
        }
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match (status.signal(), last.trim_start_matches("terravision: ")) {
            (Some(signal), _) => killed_by(signal),
            (None, "") => format!("ended with exit code {}", status.code().unwrap_or(1)),
            (None, last) => format!("gave up: {last}"),
        }
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

fn listen(stderr: ChildStderr, last: &Mutex<String>, pass_on: impl Fn(String)) {
    let mut reader = BufReader::new(stderr);
    loop {
        let mut line = Vec::new();
        match reader.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        let line = String::from_utf8_lossy(&line).trim_end().to_owned();
        if !line.is_empty() {
            last.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&line);
            pass_on(line);
        }
    }
}

/// When a program that died is to be started again.
#[derive(Debug, Default)]
pub(super) struct BackOff {
    failures: u32,
}

impl BackOff {
    /// The program has worked.
    pub(super) fn reset(&mut self) {
        self.failures = 0;
    }

    /// How often it has died since it last worked.
    pub(super) fn failures(&self) -> u32 {
        self.failures
    }

    /// The program has died: how long to wait before it is started again.
    pub(super) fn note_failure(&mut self) -> Duration {
        self.failures += 1;
        match self.failures {
            1 => Duration::ZERO,
            failures => FIRST_BACK_OFF.saturating_mul(1 << (failures - 2).min(20)).min(LONGEST_BACK_OFF),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_never_works_waits_longer_each_time() {
        let mut back_off = BackOff::default();
        let waits: Vec<u128> = (0..7).map(|_| back_off.note_failure().as_millis()).collect();
        assert_eq!(waits, [0, 500, 1000, 2000, 4000, 8000, 10_000]);
        back_off.reset();
        assert_eq!(back_off.note_failure(), Duration::ZERO);
    }
}
