//! Films and Y4M: streams that this program keeps, so that a renderer that dies does not take them
//! along.
//!
//! ```text
//! renderer ──packets──▶ pipe ──▶ relay (a thread) ──whole frames, each once, in order──▶ ffmpeg, or standard output
//! its successor ──────▶ another pipe ──┘   ▲
//!    └─both: frames ──▶ stream ring ───────┘
//! ```
//!
//! * [`relay`]: from frames in shared memory to a stream. [`encoder`]: ffmpeg; [`hang`]: whether it takes what it
//!   is given. [`film`]: codecs.

pub mod encoder;
pub mod film;
pub mod hang;
pub mod relay;

use crate::process::thread::in_thread;
use encoder::Encoder;
use film::FilmFormat;
use hang::EncoderWatch;
use relay::{Passage, Relay, StreamShape};
use std::fs::File;
use std::io::{self, PipeReader, PipeWriter, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::film::{FrameEncoding, y4m_header};
use terravision_common::run::{RunConfig, SinkConfig};
use terravision_common::shm::{RunId, ShmError, StreamReader};

/// Between two looks at what is being completed.
const TICK: Duration = Duration::from_millis(2);
/// Room in the encoder's pipe, as far as the system grants it: fewer changes between the two
/// processes for every frame.
const PIPE_BYTES: usize = 1 << 20;

/// Where a stream ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StreamTarget {
    /// ffmpeg makes a film of it.
    Film {
        /// The film's name, for people.
        path: PathBuf,
        /// Where it is written to.
        temporary: PathBuf,
        /// How it is encoded.
        format: FilmFormat,
    },
    /// Y4M on standard output.
    Stdout,
}

impl StreamTarget {
    /// How its frames are written.
    #[must_use]
    pub fn encoding(&self) -> FrameEncoding {
        match self {
            Self::Film { format, .. } => format.codec.encoding(),
            Self::Stdout => FrameEncoding::Y4m,
        }
    }
}

/// A stream ended before its time.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// ffmpeg could not be started.
    #[error("ffmpeg, which makes films, could not be started: {source}")]
    StartEncoder {
        /// The system's reason.
        source: io::Error,
    },
    /// ffmpeg gave up.
    #[error("ffmpeg could not make {}: {reason}", path.display())]
    Encoder {
        /// Its last message.
        reason: String,
        /// The film.
        path: PathBuf,
    },
    /// ffmpeg hung.
    #[error("ffmpeg took nothing of {} for {seconds} s and was killed", path.display())]
    EncoderHung {
        /// For how long.
        seconds: u64,
        /// The film.
        path: PathBuf,
    },
    /// The program that reads standard output has ended.
    #[error("the program that reads standard output ended after {frames} frames")]
    ReaderGone {
        /// Frames that were written completely.
        frames: u64,
    },
    /// The stream could not be written.
    #[error("cannot write the film: {source}")]
    Write {
        /// The system's reason.
        source: io::Error,
    },
    /// There is no thread for it.
    #[error("{source:#}")]
    Thread {
        /// Why.
        source: anyhow::Error,
    },
    /// A packet is not of this flight.
    #[error("the renderer sent frame {frame} at position {position}, which is not a frame of this flight")]
    StrangePacket {
        /// The frame that it claims to be.
        frame: u64,
        /// Where it claims to lie.
        position: u64,
    },
    /// Frames cannot be read.
    #[error(transparent)]
    Ring {
        /// Why.
        source: ShmError,
    },
    /// A frame did not come, and nothing may stand in for it.
    #[error("frame {frame} of the film is missing: the renderer did not send it")]
    Gap {
        /// The frame.
        frame: u64,
    },
    /// Ctrl-C came while the stream was being completed.
    #[error("interrupted while the film was being completed")]
    Interrupted,
}

/// The end of a run's stream, from its first renderer to its last. Dropped before
/// [`StreamKeeper::finish`], the stream is broken off.
#[derive(Debug)]
pub struct StreamKeeper {
    target: StreamTarget,
    pipes: Option<Sender<PipeReader>>,
    relay: Option<JoinHandle<Result<(), StreamError>>>,
    passage: Arc<Passage>,
    encoder: Option<Encoder>,
}

impl StreamKeeper {
    /// The stream of a run, if its pictures go into one.
    ///
    /// # Errors
    /// [`StreamError::StartEncoder`], [`StreamError::Write`], [`StreamError::Ring`].
    pub fn start(run: &RunId, config: &RunConfig, target: Option<&StreamTarget>) -> Result<Option<Self>, StreamError> {
        let (Some(target), SinkConfig::Stream(_)) = (target, &config.render.sink) else { return Ok(None) };
        let size = config.output_size();
        let shape = StreamShape { frames: config.frames, has_gaps: config.realtime.is_some() };
        let ring = StreamReader::open(run).map_err(|source| StreamError::Ring { source })?;
        let (encoder, out): (_, Box<dyn Write + Send>) = match target {
            StreamTarget::Film { temporary, format, .. } => {
                let (encoder, input) = Encoder::start("ffmpeg".as_ref(), temporary, *format, size, config.fps)?;
                (Some(encoder), Box::new(input))
            }
            StreamTarget::Stdout => {
                let failed = |source| StreamError::Write { source };
                // As a file: the buffer of `std::io::Stdout` would look for the ends of lines in
                // every picture.
                let mut out = File::from(io::stdout().as_fd().try_clone_to_owned().map_err(failed)?);
                match out.write_all(y4m_header(size, config.fps).as_bytes()) {
                    Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {
                        return Err(StreamError::ReaderGone { frames: 0 });
                    }
                    written => written.map_err(failed)?,
                }
                (None, Box::new(out))
            }
        };
        #[expect(clippy::disallowed_methods, reason = "a pipe for each start of a renderer, of which there are few")]
        let (pipes, coming) = channel();
        let passage = Arc::new(Passage::default());
        let relay = Relay::new(shape, ring, out, Arc::clone(&passage));
        let relay = in_thread("stream", move || relay.run(&coming)).map_err(|source| StreamError::Thread { source })?;
        Ok(Some(Self { target: target.clone(), pipes: Some(pipes), relay: Some(relay), passage, encoder }))
    }

    /// The end of a new pipe that the next renderer writes its packets into.
    ///
    /// # Errors
    /// The system has no pipes left.
    pub fn pipe(&self) -> io::Result<OwnedFd> {
        let (read, write): (PipeReader, PipeWriter) = io::pipe()?;
        if let Some(pipes) = &self.pipes {
            // A relay that has failed takes no more pipes: writing into one fails.
            drop(pipes.send(read));
        }
        Ok(write.into())
    }

    /// Whether the stream cannot go on: [`StreamKeeper::finish`] says why.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        // Acquire is not needed: nothing is read on the strength of it but the thread's result,
        // after it was joined.
        self.passage.has_failed.load(Ordering::Relaxed)
    }

    /// Whether a picture waits for the encoder, or for the reader of standard output.
    #[must_use]
    pub fn is_blocked(&self) -> bool {
        // Relaxed: a flag that is looked at again and again.
        self.passage.is_writing.load(Ordering::Relaxed)
    }

    /// Process id of the encoder, if there is one.
    #[must_use]
    pub fn encoder_pid(&self) -> Option<u32> {
        self.encoder.as_ref().map(Encoder::pid)
    }

    /// All renderers have ended in good order: completes the stream. Waits for the encoder, or the
    /// reader.
    ///
    /// # Errors
    /// Why the stream is not complete.
    pub fn finish(mut self, is_interrupted: &dyn Fn() -> bool, watch: &mut EncoderWatch) -> Result<(), StreamError> {
        self.passage.is_complete.store(true, Ordering::Release);
        self.pipes = None;
        while self.relay.as_ref().is_some_and(|relay| !relay.is_finished())
            || self.encoder.as_mut().is_some_and(Encoder::is_busy)
        {
            if is_interrupted() {
                return Err(StreamError::Interrupted);
            }
            watch.look(&self, true);
            // An encoder that has given up closes its input, which the relay notices with its next
            // frame.
            std::thread::sleep(TICK);
        }
        let relayed = self.relay.take().map_or(Ok(()), |relay| {
            relay.join().unwrap_or_else(|_panic| {
                Err(StreamError::Write { source: io::Error::other("a thread ended unexpectedly") })
            })
        });
        let ended = self.encoder.take().map(Encoder::end);
        let (Some(ended), StreamTarget::Film { path, temporary, .. }) = (ended, &self.target) else { return relayed };
        let failed = |reason: &str| Err(StreamError::Encoder { reason: reason.to_owned(), path: path.clone() });
        match (ended, relayed) {
            _ if watch.hung_after().is_some() => {
                let seconds = watch.hung_after().unwrap_or_default().as_secs_f64().round() as u64;
                Err(StreamError::EncoderHung { seconds, path: path.clone() })
            }
            // What it says tells more than that its input was closed.
            (Err(reason), _) => failed(&reason),
            (Ok(()), Err(StreamError::ReaderGone { frames })) => {
                failed(&format!("it ended with exit code 0, but took only {frames} of the frames"))
            }
            (Ok(()), Ok(())) if is_empty_file(temporary) => failed("it ended with exit code 0, but wrote nothing"),
            (Ok(()), relayed) => relayed,
        }
    }
}

/// Whether the film is missing or empty. (A device or a FIFO keeps nothing.)
fn is_empty_file(path: &Path) -> bool {
    path.metadata().map_or(true, |found| found.is_file() && found.len() == 0)
}

impl Drop for StreamKeeper {
    fn drop(&mut self) {
        self.pipes = None;
        if let Some(encoder) = self.encoder.take() {
            encoder.kill();
            // With its encoder and the renderers gone the relay has nothing to wait for.
            if let Some(relay) = self.relay.take() {
                drop(relay.join());
            }
        }
        // A reader of standard output that reads no more would hold the relay for ever: it ends
        // with this process.
    }
}

#[cfg(test)]
mod tests;
