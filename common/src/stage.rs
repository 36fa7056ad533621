//! The common shell of all stages: command line, signals, events, exit codes.
//!
//! The launcher starts a stage as `terravision-<stage> --run -`, with the run as JSON on its
//! standard input. The run may contain secrets (the password in a database's URL), and every user
//! can read command lines (`/proc/PID/cmdline`), while a pipe is private, leaves no copy in an
//! environment that children inherit, and has no size limit. `--run JSON` works too. A stage ends
//! by itself after the last frame, or when a wait returns that the run is over. SIGINT and SIGHUP
//! are left to the launcher, which also gets them from the terminal. SIGTERM ends a stage at once
//! (half-written data is never visible), and so does the launcher's death.

use crate::bug::report_panics;
use crate::event::{Event, EventContent, SpanName, monotonic_nanos};
use crate::ids::FrameNumber;
use crate::log::start_stage;
use crate::run::RunConfig;
use crate::shm::{Control, Counter, Producer, RunId, ShmError, Stage};
use crate::terminal::complain;
use std::io::Read;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Exit code of a stage whose command line cannot be used.
pub const BAD_USAGE: u8 = 2;
/// Exit code of a stage whose run was stopped.
pub const INTERRUPTED: u8 = 130;

/// The argument that means: the run is on standard input.
pub const FROM_STDIN: &str = "-";
/// Longest text of a run.
pub const MOST_RUN_BYTES: u64 = 1 << 20;

/// Environment of a stage's process. A software Vulkan device allocates and frees tens of megabytes
/// in every frame; glibc would return them to the kernel each time, and the page faults of new
/// allocations take a tenth of the frame.
pub const STAGE_ENVIRONMENT: [(&str, &str); 2] =
    [("MALLOC_TRIM_THRESHOLD_", "268435456"), ("MALLOC_MMAP_THRESHOLD_", "33554432")];

/// Why a command line is not a valid run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UsageError {
    /// Not `--run JSON`.
    #[error(
        "expected --run and one JSON object, or - for one on standard input: this program is started by the launcher (terravision fly)"
    )]
    Arguments,
    /// The JSON is not a valid run.
    #[error("the run cannot be read: {source}")]
    Json {
        /// What is wrong with it.
        #[from]
        source: serde_json::Error,
    },
    /// It is too long.
    #[error("the run has more than {most} bytes")]
    TooLong {
        /// The limit.
        most: u64,
    },
    /// The run's id is not valid.
    #[error("the run cannot be read: {source}")]
    RunId {
        /// What is wrong with it.
        #[from]
        source: ShmError,
    },
    /// A number is out of range.
    #[error("the run's {field} is {found}, expected {expected}")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// What was found.
        found: f64,
        /// What was expected, in words.
        expected: &'static str,
    },
    /// The process cannot be set up.
    #[error("cannot set up the process: {source}")]
    Os {
        /// Why.
        #[from]
        source: std::io::Error,
    },
}

/// A checked run, as a stage gets it.
#[derive(Debug, Clone)]
pub struct StageRun {
    config: RunConfig,
    id: RunId,
}

impl StageRun {
    /// Reads a command line, without the program's name.
    ///
    /// # Errors
    /// [`UsageError`].
    pub fn parse(arguments: impl IntoIterator<Item = String>) -> Result<Self, UsageError> {
        let arguments: Vec<String> = arguments.into_iter().collect();
        match arguments.as_slice() {
            [flag, dash] if flag == "--run" && dash == FROM_STDIN => Self::read(std::io::stdin().lock()),
            [flag, json] if flag == "--run" => Self::new(serde_json::from_str(json)?),
            _ => Err(UsageError::Arguments),
        }
    }

    /// Reads a run to the end of its input.
    fn read(input: impl Read) -> Result<Self, UsageError> {
        let mut json = Vec::new();
        input.take(MOST_RUN_BYTES + 1).read_to_end(&mut json)?;
        if json.len() as u64 > MOST_RUN_BYTES {
            return Err(UsageError::TooLong { most: MOST_RUN_BYTES });
        }
        Self::new(serde_json::from_slice(&json)?)
    }

    /// Checks a run.
    ///
    /// # Errors
    /// [`UsageError`].
    pub fn new(config: RunConfig) -> Result<Self, UsageError> {
        let id = RunId::parse(&config.run_id)?;
        let positive = |field, found: f64| match found {
            f if f.is_finite() && f > 1e-6 && f < 1e6 => Ok(()),
            found => Err(UsageError::OutOfRange { field, found, expected: "a number between 1e-6 and 1e6" }),
        };
        positive("r_z_px", config.r_z_px)?;
        positive("r_c_px", config.r_c_px)?;
        positive("width", config.width.into())?;
        positive("height", config.height.into())?;
        positive("fps", config.fps)?;
        let found = config.exaggeration;
        if !(0.0..=1e4).contains(&found) {
            return Err(UsageError::OutOfRange { field: "exaggeration", found, expected: "a number from 0 to 10000" });
        }
        if config.frames[0] > config.frames[1] {
            let found = config.frames[1] as f64;
            return Err(UsageError::OutOfRange { field: "last frame", found, expected: "no frame before the first" });
        }
        Ok(Self { config, id })
    }

    /// The run.
    #[must_use]
    pub fn config(&self) -> &RunConfig {
        &self.config
    }

    /// Its id.
    #[must_use]
    pub fn id(&self) -> &RunId {
        &self.id
    }
}

/// An error of a stage that may only say that the run was stopped.
pub trait StageError: std::error::Error {
    /// Whether this is the orderly end of a stopped run.
    fn is_stopping(&self) -> bool;

    /// Whether the same command would fail again, because it asks for something impossible (exit
    /// code 2 instead of 1).
    fn is_bad_input(&self) -> bool {
        false
    }
}

/// The `main` of a stage: reads the command line, sets up the process, runs, and returns an exit
/// code; a failure is reported in one sentence on standard error.
pub fn main<E: StageError>(run: impl FnOnce(&StageRun) -> Result<(), E>) -> ExitCode {
    report_panics("");
    start_stage();
    let started = StageRun::parse(std::env::args().skip(1)).and_then(|stage_run| {
        set_up_process()?;
        Ok(stage_run)
    });
    let stage_run = match started {
        Ok(stage_run) => stage_run,
        Err(error) => return fail(&error, BAD_USAGE),
    };
    let (run_id, [first, end]) = (stage_run.id(), stage_run.config().frames);
    tracing::debug!(%run_id, first, end, "stage begins");
    let ended = run(&stage_run);
    tracing::debug!(error = ended.as_ref().err().map(tracing::field::display), "stage ends");
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is_stopping() => ExitCode::from(INTERRUPTED),
        Err(error) => fail(&error, if error.is_bad_input() { BAD_USAGE } else { 1 }),
    }
}

fn fail(error: &dyn std::error::Error, code: u8) -> ExitCode {
    complain(&error.to_string());
    ExitCode::from(code)
}

/// Sets up a stage's process: the kernel ends it when the launcher dies. SIGINT and SIGHUP, which a
/// terminal also sends to the launcher, are ignored: the launcher decides. See also
/// [`note_file_limit`].
///
/// # Errors
/// The system refuses.
pub fn set_up_process() -> Result<(), std::io::Error> {
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))?;
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, Arc::new(AtomicBool::new(false)))?;
    }
    note_file_limit()
}

/// From now on a write beyond the limit of a file's size (`ulimit -f`) is an error that can be
/// reported, instead of the signal SIGXFSZ, which ends a process without a message. Child processes
/// do not inherit this.
///
/// # Errors
/// The system refuses.
pub fn note_file_limit() -> Result<(), std::io::Error> {
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false))).map(drop)
}

/// The sender of a stage's events. Never waits: an event that finds the ring full is dropped and
/// counted.
#[derive(Debug)]
pub struct Events {
    ring: Producer<Event>,
}

impl Events {
    /// Opens a stage's event ring.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId, stage: Stage) -> Result<Self, ShmError> {
        Ok(Self { ring: Producer::open(run, stage.events())? })
    }

    /// Sends to any ring.
    #[must_use]
    pub fn new(ring: Producer<Event>) -> Self {
        Self { ring }
    }

    /// Sends an event.
    pub fn tell(&mut self, control: &Control, event: Event) {
        if self.ring.try_push(event).is_err() {
            control.count(Counter::EventsDropped, 1);
        }
    }

    /// Sends a span of work of the main thread on a frame, which ends now. Returns its end.
    pub fn span(&mut self, control: &Control, name: SpanName, frame: FrameNumber, start_nanos: u64) -> u64 {
        let end = monotonic_nanos();
        let span = Event::new(EventContent::Span { name, node: None });
        let event = span.of_frame(frame).at(start_nanos).lasting(end.saturating_sub(start_nanos));
        self.tell(control, event);
        end
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(change: impl FnOnce(&mut serde_json::Value)) -> [String; 2] {
        let mut run = serde_json::json!({
            "run_id": "tv-1-2", "world": "/w.tv", "width": 640, "height": 360, "fps": 30.0, "frames": [0, 5],
            "r_z_px": 10.0, "r_c_px": 1.0, "measure": "area", "exaggeration": 1.0, "decoder_threads": 2,
            "database": {
                "location": "/w.tv", "cache": null, "cache_bytes": 0, "is_offline": false, "request_timeout_ms": 1,
                "parallel_requests": 1,
            },
            "prefetch": { "prediction": "off", "has_retries": false },
            "render": {
                "technique": "mesh", "technique_reason": "asked for", "rays": "sweep", "sky_rgb": [1, 2, 3], "samples": 1, "has_tree_overlay": false, "has_validation": false,
                "frames_in_flight": 2, "sink": "null", "depth": [], "ground": [],
                "anaglyph": false,
            },
        });
        change(&mut run);
        ["--run".to_owned(), run.to_string()]
    }

    #[test]
    fn a_run_is_read_from_the_command_line() {
        let run = StageRun::parse(json(|_| {})).expect("valid");
        assert_eq!((run.config().frames, run.id().to_string().as_str()), ([0, 5], "tv-1-2"));
    }

    #[test]
    fn what_is_no_run_is_refused_with_a_sentence() {
        let refused = |arguments: Vec<String>| StageRun::parse(arguments).expect_err("no run").to_string();
        assert!(refused(vec![]).contains("--run"));
        assert!(refused(vec!["--run".into(), "{".into()]).contains("cannot be read"));
        let text = json(|_| {})[1].clone();
        assert_eq!(StageRun::read(text.as_bytes()).expect("valid").config().frames, [0, 5]);
        let endless = StageRun::read(std::io::repeat(b' ')).expect_err("no run").to_string();
        assert!(endless.contains("more than 1048576 bytes"), "{endless}");
        assert!(refused(json(|run| run["run_id"] = "x".into()).into()).contains("run"));
        assert!(refused(json(|run| run["r_z_px"] = 0.0.into()).into()).contains("r_z_px is 0"));
        assert!(refused(json(|run| run["exaggeration"] = (-1.0).into()).into()).contains("exaggeration is -1"));
        assert!(refused(json(|run| run["frames"] = serde_json::json!([3, 1])).into()).contains("last frame is 1"));
    }
}
