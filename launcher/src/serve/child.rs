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
use std::time::{Duration, Instant};

/// Longest line that is passed on.
const LINE_BYTES: u64 = 4096;
/// Between two looks at whether it has ended.
const TICK: Duration = Duration::from_millis(5);
/// A program that does no good between two deaths is started again after this time, then twice
/// that, ...
const FIRST_BACK_OFF: Duration = Duration::from_millis(500);
/// ... and at most this.
const LONGEST_BACK_OFF: Duration = Duration::from_secs(10);

/// A program that runs. Dropped while it does, it is killed and waited for.
#[derive(Debug)]
pub(super) struct Watched {
    child: Child,
    last: Arc<Mutex<String>>,
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
        let watched = Self { child, last: Arc::clone(&last) };
        if let Some(stderr) = stderr {
            // Ends with the pipe; it is not joined.
            drop(in_thread("listen", move || listen(stderr, &last, |line| drop(events.send(event(line)))))?);
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
    strikes: u32,
}

impl BackOff {
    /// It has done some good.
    pub(super) fn forgive(&mut self) {
        self.strikes = 0;
    }

    /// How often it has died without.
    pub(super) fn strikes(&self) -> u32 {
        self.strikes
    }

    /// It has died: how long it is to wait.
    pub(super) fn strike(&mut self) -> Duration {
        self.strikes += 1;
        match self.strikes {
            1 => Duration::ZERO,
            strikes => FIRST_BACK_OFF.saturating_mul(1 << (strikes - 2).min(20)).min(LONGEST_BACK_OFF),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_does_no_good_waits_longer_each_time() {
        let mut back_off = BackOff::default();
        let waits: Vec<u128> = (0..7).map(|_| back_off.strike().as_millis()).collect();
        assert_eq!(waits, [0, 500, 1000, 2000, 4000, 8000, 10_000]);
        back_off.forgive();
        assert_eq!(back_off.strike(), Duration::ZERO);
    }
}
