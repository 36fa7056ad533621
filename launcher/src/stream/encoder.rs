//! ffmpeg, fed raw frames.
//!
//! What it is told of codecs stands in [`super::film`].

use super::StreamError;
use super::film::FilmFormat;
use std::io::Read;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;
use terravision_common::film::{even, rational_fps};

/// Bytes of ffmpeg's messages that are kept.
const MESSAGE_BYTES: usize = 4096;

/// An ffmpeg process. Its input is with who feeds it.
#[derive(Debug)]
pub struct Encoder {
    child: Child,
    messages: Option<JoinHandle<String>>,
}

impl Encoder {
    /// Starts `program` to make a film at `path`, of frames of RGBA of this size (made even), playing at `fps`; the
    /// extension of `path` chooses the container.
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
            .args(["-f", "rawvideo", "-pixel_format", "rgb0"])
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
        let messages = child.stderr.take().map(|stderr| std::thread::spawn(move || last_words(stderr)));
        let no_input = || StreamError::StartEncoder { source: std::io::ErrorKind::BrokenPipe.into() };
        let input = child.stdin.take().ok_or_else(no_input)?;
        Ok((Self { child, messages }, input))
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
    /// It gave up: its last words.
    pub fn end(mut self) -> Result<(), String> {
        let is_success = self.child.wait().is_ok_and(|status| status.success());
        let words = self.messages.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        // It tells errors alone (-loglevel error), and ends with success when only the end of the file could not be written.
        match words.lines().rev().find(|line| !line.trim().is_empty()) {
            None if is_success => Ok(()),
            None => Err("it ended without a word".to_owned()),
            Some(line) => Err(line.trim().to_owned()),
        }
    }

    /// Ends it at once.
    pub fn kill(mut self) {
        // It may have ended already.
        drop(self.child.kill());
        drop(self.end());
    }
}

/// The end of what ffmpeg says; reads until it closes its messages.
fn last_words(mut stderr: ChildStderr) -> String {
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
