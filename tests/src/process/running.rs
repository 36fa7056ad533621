//! A process that runs, and one that has ended.

use super::Terravision;
use super::proc_fs::children_of;
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use std::io::Read;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terravision_common::bug::INTERNAL_ERROR_WORDS;

/// A process of a group of its own; the group is killed when this is dropped.
#[derive(Debug)]
pub struct Running {
    child: Child,
    what: String,
    deadline: Instant,
    started: Instant,
    output: Option<[JoinHandle<Vec<u8>>; 2]>,
    /// How much of its standard output is read.
    gate: Arc<Gate>,
}

/// Lets this many bytes of a pipe be read. A process that has more to write waits.
#[derive(Debug)]
struct Gate {
    most: Mutex<u64>,
    opened: Condvar,
}

impl Gate {
    fn new(most: u64) -> Arc<Self> {
        Arc::new(Self { most: Mutex::new(most), opened: Condvar::new() })
    }

    fn open(&self, most: u64) {
        *self.most.lock().unwrap_or_else(PoisonError::into_inner) = most;
        self.opened.notify_all();
    }

    /// Waits until more than `read` bytes may be read; how many more.
    fn wait(&self, read: u64) -> u64 {
        let most = self.most.lock().unwrap_or_else(PoisonError::into_inner);
        let most = self.opened.wait_while(most, |most| *most <= read).unwrap_or_else(PoisonError::into_inner);
        *most - read
    }
}

/// A process that has ended.
#[derive(Debug)]
pub struct Finished {
    /// Its command line.
    pub what: String,
    /// How it ended.
    pub status: ExitStatus,
    /// Its standard output.
    pub stdout: Vec<u8>,
    /// Its standard error.
    pub stderr: String,
    /// How long it ran.
    pub elapsed: Duration,
    /// The process id that it had.
    pub pid: u32,
}

fn drain(mut pipe: impl Read + Send + 'static, gate: Arc<Gate>) -> JoinHandle<Vec<u8>> {
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        loop {
            let more = gate.wait(bytes.len() as u64);
            // A pipe that breaks is a process that ended: what came until then is its output.
            if !pipe.by_ref().take(more).read_to_end(&mut bytes).is_ok_and(|read| read as u64 == more) {
                return bytes;
            }
        }
    })
}

impl Running {
    pub(super) fn start(command: &Terravision, readable: u64) -> Self {
        let mut process = Command::new(&command.program);
        process.args(&command.arguments).envs(command.environment.iter().cloned());
        process.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
        if let Some(folder) = &command.folder {
            process.current_dir(folder);
        }
        let what = format!("{} {:?}", command.program.display(), command.arguments);
        let mut child = process.spawn().unwrap_or_else(|error| panic!("{what} did not start: {error}"));
        let started = Instant::now();
        let gate = Gate::new(readable);
        let output = match (child.stdout.take(), child.stderr.take()) {
            (Some(stdout), Some(stderr)) => {
                Some([drain(stdout, Arc::clone(&gate)), drain(stderr, Gate::new(u64::MAX))])
            }
            _ => None,
        };
        Self { child, what, deadline: started + command.deadline, started, output, gate }
    }

    /// Reads its standard output up to this many bytes, if it was started with
    /// [`Terravision::spawn_unread`].
    pub fn read_up_to(&self, bytes: u64) {
        self.gate.open(bytes);
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Its children: process ids and names of their programs.
    #[must_use]
    pub fn children(&self) -> Vec<(u32, String)> {
        children_of(self.pid())
    }

    /// The child process of a stage, waited for.
    ///
    /// # Panics
    /// When it does not appear before the deadline.
    #[must_use]
    pub fn stage(&mut self, stage: &str) -> u32 {
        let name = format!("terravision-{stage}");
        self.until(&format!("the {stage} to start"), |running| {
            running.children().into_iter().find(|(_, child)| *child == name).map(|(pid, _)| pid)
        })
    }

    /// Polls until `look` finds something.
    ///
    /// # Panics
    /// When it does not before the deadline, or the process ends first.
    pub fn until<T>(&mut self, what: &str, mut look: impl FnMut(&Self) -> Option<T>) -> T {
        loop {
            if let Some(found) = look(self) {
                return found;
            }
            let ended = self.child.try_wait().ok().flatten();
            assert!(ended.is_none(), "{} ended ({ended:?}) before {what}", self.what);
            assert!(Instant::now() < self.deadline, "{}: no sign of {what}", self.what);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|status| status.is_some())
    }

    /// Sends a signal to the process alone.
    ///
    /// # Panics
    /// When it is gone already.
    pub fn signal(&self, signal: Signal) {
        signal_process(self.pid(), signal);
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// When it passes its deadline.
    #[must_use]
    pub fn wait(mut self) -> Finished {
        self.gate.open(u64::MAX);
        let status = loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                break status;
            }
            if Instant::now() >= self.deadline {
                let seen = self.children();
                self.kill_group();
                let (_, stderr) = self.collect();
                panic!("{} passed its deadline; children {seen:?}; it said:\n{stderr}", self.what);
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let elapsed = self.started.elapsed();
        let pid = self.pid();
        let (stdout, stderr) = self.collect();
        Finished { what: self.what.clone(), status, stdout, stderr, elapsed, pid }
    }

    /// What it printed. A child of its own may still hold the pipes: they end when it does.
    fn collect(&mut self) -> (Vec<u8>, String) {
        self.gate.open(u64::MAX);
        let Some([stdout, stderr]) = self.output.take() else { return (Vec::new(), String::new()) };
        let until = Instant::now() + Duration::from_secs(5);
        while !(stdout.is_finished() && stderr.is_finished()) && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(2));
        }
        if !(stdout.is_finished() && stderr.is_finished()) {
            self.kill_group();
        }
        let stdout = stdout.join().unwrap_or_default();
        let stderr = stderr.join().unwrap_or_default();
        (stdout, String::from_utf8_lossy(&stderr).into_owned())
    }

    fn kill_group(&mut self) {
        if let Some(group) = Pid::from_raw(self.pid().cast_signed()) {
            // Gone already: nothing to kill.
            kill_process_group(group, Signal::KILL).unwrap_or_default();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.gate.open(u64::MAX);
        self.kill_group();
        // Reaps it; an error means that it was.
        drop(self.child.wait());
    }
}

/// Sends a signal to a process.
///
/// # Panics
/// When there is no such process.
pub fn signal_process(pid: u32, signal: Signal) {
    let pid = Pid::from_raw(pid.cast_signed()).expect("a process id is not 0");
    kill_process(pid, signal).expect("the process is there to take a signal");
}

impl Finished {
    /// Standard output as text.
    #[must_use]
    pub fn stdout_text(&self) -> String {
        String::from_utf8_lossy(&self.stdout).into_owned()
    }

    /// Its exit code; `None` when a signal ended it.
    #[must_use]
    pub fn code(&self) -> Option<i32> {
        self.status.code()
    }

    /// # Panics
    /// When the exit code is another one.
    pub fn assert_code(&self, code: i32) {
        let found = self.status;
        assert_eq!(
            found.code(),
            Some(code),
            "{} ended with {found} (signal {:?}); it said:\n{}",
            self.what,
            found.signal(),
            self.stderr
        );
    }

    /// # Panics
    /// When it warned about something, or panicked.
    pub fn assert_no_warning(&self) {
        let said = self.stderr.to_lowercase();
        let bad = ["warning", "warn ", "error", "panicked"].iter().find(|word| said.contains(**word));
        assert!(bad.is_none(), "{} said what it should not:\n{}", self.what, self.stderr);
    }

    /// Whether one of its processes had a fault of its own.
    #[must_use]
    pub fn has_panicked(&self) -> bool {
        [INTERNAL_ERROR_WORDS, "panicked"].iter().any(|words| self.stderr.contains(words))
    }

    /// Asserts what every failure owes its user: this exit code, a message of one sentence, no
    /// panic, and nothing of the run left in /dev/shm.
    ///
    /// # Panics
    /// When one of them does not hold.
    pub fn assert_told(&self, code: i32) {
        self.assert_code(code);
        assert!(!self.has_panicked(), "{} panicked:\n{}", self.what, self.stderr);
        let lines: Vec<&str> = self.stderr.lines().filter(|line| !line.trim().is_empty()).collect();
        assert!(!lines.is_empty(), "{} failed and said nothing", self.what);
        let left = super::segments_of_launcher(self.pid);
        assert!(left.is_empty(), "{} left {left:?} in /dev/shm", self.what);
    }
}
