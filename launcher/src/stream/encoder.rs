//! ffmpeg, fed raw frames.
//!
//! What it is told of codecs stands in [`super::film`].

use super::film::FilmFormat;
use super::{PIPE_BYTES, StreamError};
use crate::process::signals::killed_by;
use crate::process::thread::in_thread;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io::Read;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use terravision_common::film::{even, rational_fps};

/// How long the end of an encoder's messages is waited for after its own.
const MESSAGES_PATIENCE: Duration = Duration::from_millis(500);
/// Bytes of ffmpeg's messages that are kept.
const MESSAGE_BYTES: usize = 4096;

/// An ffmpeg process. The relay holds its input.
#[derive(Debug)]
pub struct Encoder {
    child: Child,
    messages: Option<JoinHandle<String>>,
}

impl Encoder {
    /// Starts `program` to make a film at `path`, of frames of this size (made even) as its codec
    /// takes them ([`super::film::Codec::encoding`]), playing at `fps`; the extension of `path` chooses
    /// the container.
    ///
    /// # Errors
    /// [`StreamError::StartEncoder`].
    pub fn start(
        program: &Path,
        path: &Path,
        format: FilmFormat,
        size: [u32; 2],
        fps: f64,
    ) -> Result<(Self, ChildStdin), StreamError> {
        let ([n, d], [width, height]) = (rational_fps(fps), even(size));
        let mut command = Command::new(program);
        command
            .args(["-hide_banner", "-nostdin", "-loglevel", "error", "-y"])
            .args(format.input_arguments())
            .args(["-video_size", &format!("{width}x{height}"), "-framerate", &format!("{n}/{d}"), "-i", "pipe:0"])
            .args(format.arguments())
            // SVT-AV1 introduces itself on standard error otherwise, where errors are expected.
            .env("SVT_LOG", "1")
            .arg(path)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            // Ctrl-C is for this program: ffmpeg ends when its input does, or when it is killed.
            .process_group(0);
        let mut child = command.spawn().map_err(|source| StreamError::StartEncoder { source })?;
        let (stderr, stdin) = (child.stderr.take(), child.stdin.take());
        if let Some(input) = &stdin {
            // It may be more than a user is allowed to have.
            rustix::pipe::fcntl_setpipe_size(input, PIPE_BYTES).ok();
        }
        let mut encoder = Self { child, messages: None };
        let (Some(stderr), Some(input)) = (stderr, stdin) else {
            encoder.kill();
            return Err(StreamError::StartEncoder { source: std::io::ErrorKind::BrokenPipe.into() });
        };
        match in_thread("encoder", move || last_messages(stderr)) {
            Ok(thread) => encoder.messages = Some(thread),
            Err(source) => {
                encoder.kill();
                return Err(StreamError::Thread { source });
            }
        }
        Ok((encoder, input))
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Whether it has not ended yet.
    pub fn is_busy(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// It gave up: its last message.
    pub fn end(mut self) -> Result<(), String> {
        let status = self.child.wait();
        let messages = self.messages.take().map(|thread| self.last_message(thread)).unwrap_or_default();
        // It tells errors alone (-loglevel error), and ends with success when only the end of the
        // file could not be written.
        match messages.lines().rev().find(|line| !line.trim().is_empty()) {
            None => match status.map(|status| (status.success(), status.signal())) {
                Ok((true, _)) => Ok(()),
                Ok((_, Some(signal))) => Err(format!("it {}", killed_by(signal))),
                _ => Err("it ended and left no message".to_owned()),
            },
            Some(line) => Err(line.trim().to_owned()),
        }
    }

    /// Its last messages. It has ended, but a child of it may hold its standard error open, and
    /// would for ever.
    fn last_message(&self, thread: JoinHandle<String>) -> String {
        for _ in 0..2 {
            let end = Instant::now() + MESSAGES_PATIENCE;
            while !thread.is_finished() && Instant::now() < end {
                std::thread::sleep(Duration::from_millis(1));
            }
            if thread.is_finished() {
                return thread.join().unwrap_or_default();
            }
            kill_group(self.pid());
        }
        String::new()
    }

    /// Ends it at once, and what it has started.
    pub fn kill(self) {
        kill_group(self.pid());
        drop(self.end());
    }
}

/// Kills an encoder that has not been waited for, or whose children live, with all of its group.
pub(super) fn kill_group(pid: u32) {
    if let Some(group) = Pid::from_raw(pid.cast_signed()) {
        // It may have ended already.
        kill_process_group(group, Signal::KILL).ok();
    }
}

/// The end of its messages; reads until it closes standard error.
fn last_messages(mut stderr: ChildStderr) -> String {
    let (mut kept, mut chunk) = (Vec::new(), [0; 1024]);
    while let Ok(count) = stderr.read(&mut chunk) {
        if count == 0 {
            break;
        }
        kept.extend_from_slice(&chunk[..count]);
        let surplus = kept.len().saturating_sub(MESSAGE_BYTES);
        kept.drain(..surplus);
    }
    String::from_utf8_lossy(&kept).into_owned()
}
