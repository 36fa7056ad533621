//! From packets of one renderer after another to a stream in which each frame stands once.

use super::StreamError;
use std::io::{self, PipeReader, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use terravision_common::film::PacketHeader;
use terravision_common::run::OPEN_END;

/// What a stream is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamShape {
    /// Bytes of a frame.
    pub frame_bytes: u64,
    /// First frame, and one past the last, or [`OPEN_END`].
    pub frames: [u64; 2],
    /// Frames may be left out; the one before stands in for them.
    pub has_gaps: bool,
}

/// Bytes that are passed on before it is noted: what is written slowly is seen to move.
const CHUNK: usize = 1 << 20;

/// What both sides of the relay know.
#[derive(Debug, Default)]
pub struct Passage {
    /// The stream cannot go on.
    pub has_failed: AtomicBool,
    /// The flight has ended in good order.
    pub is_complete: AtomicBool,
    /// A picture is being written: its reader may make it wait.
    pub is_writing: AtomicBool,
    /// Bytes that were passed on.
    pub bytes: AtomicU64,
}

/// Passes on whole frames.
pub struct Relay {
    shape: StreamShape,
    out: Box<dyn Write + Send>,
    passage: Arc<Passage>,
    /// The frame that has to come next.
    next: u64,
    /// Frames that were passed on.
    passed: u64,
    last: Option<Vec<u8>>,
    coming: Vec<u8>,
}

impl std::fmt::Debug for Relay {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Relay").field("shape", &self.shape).field("next", &self.next).finish_non_exhaustive()
    }
}

impl Relay {
    /// To `out`.
    #[must_use]
    pub fn new(shape: StreamShape, out: Box<dyn Write + Send>, passage: Arc<Passage>) -> Self {
        Self { shape, out, passage, next: shape.frames[0], passed: 0, last: None, coming: Vec::new() }
    }

    /// Passes on what comes through one pipe after another, until no more is going to come, or the
    /// stream fails.
    pub(super) fn run(mut self, pipes: &Receiver<PipeReader>) -> Result<(), StreamError> {
        let mut relayed = Ok(());
        while let Ok(mut pipe) = pipes.recv() {
            relayed = self.relay(&mut pipe);
            if relayed.is_err() {
                // Before the pipe is closed: a renderer that cannot write must not look as if it
                // had died by itself.
                self.passage.has_failed.store(true, Ordering::Release);
                break;
            }
        }
        relayed?;
        if self.passage.is_complete.load(Ordering::Acquire) { self.complete() } else { Ok(()) }
    }

    /// All whole packets of a pipe.
    fn relay(&mut self, pipe: &mut dyn Read) -> Result<(), StreamError> {
        let mut header = [0; PacketHeader::SIZE];
        while read_whole(pipe, &mut header)? {
            let PacketHeader { frame, bytes } = PacketHeader::from_bytes(header);
            let [first, end] = self.shape.frames;
            if bytes != self.shape.frame_bytes || frame < first || frame >= end {
                return Err(StreamError::StrangePacket { frame, bytes });
            }
            self.coming.resize(bytes as usize, 0);
            if !read_whole(pipe, &mut self.coming)? {
                break;
            }
            // What a renderer wrote before it was killed may come again from the next one.
            if frame >= self.next {
                self.pass(frame)?;
            }
        }
        Ok(())
    }

    fn pass(&mut self, frame: u64) -> Result<(), StreamError> {
        if frame > self.next && !self.shape.has_gaps {
            return Err(StreamError::Gap { frame: self.next });
        }
        // Before the first picture there is nothing to repeat.
        let stand_in = self.last.take().unwrap_or_else(|| self.coming.clone());
        while self.next < frame {
            self.put(&stand_in)?;
        }
        let came = std::mem::replace(&mut self.coming, stand_in);
        self.put(&came)?;
        self.last = Some(came);
        Ok(())
    }

    fn put(&mut self, frame: &[u8]) -> Result<(), StreamError> {
        // Relaxed, here and below: looked at again and again, and nothing is read on the strength
        // of it.
        self.passage.is_writing.store(true, Ordering::Relaxed);
        for chunk in frame.chunks(CHUNK) {
            self.out.write_all(chunk).map_err(|source| match source.kind() {
                io::ErrorKind::BrokenPipe => StreamError::ReaderGone { frames: self.passed },
                _ => StreamError::Write { source },
            })?;
            self.passage.bytes.fetch_add(chunk.len() as u64, Ordering::Relaxed);
        }
        self.passage.is_writing.store(false, Ordering::Relaxed);
        self.next += 1;
        self.passed += 1;
        Ok(())
    }

    /// The frames at the end that went with a renderer; a flight without a known end ends where it
    /// ends.
    fn complete(mut self) -> Result<(), StreamError> {
        let end = self.shape.frames[1];
        if let Some(last) = self.last.take().filter(|_| self.shape.has_gaps && end != OPEN_END) {
            while self.next < end {
                self.put(&last)?;
            }
        }
        self.out.flush().map_err(|source| StreamError::Write { source })
    }
}

/// Fills `out`; false where the other side ended before.
fn read_whole(from: &mut dyn Read, out: &mut [u8]) -> Result<bool, StreamError> {
    match from.read_exact(out) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(source) => Err(StreamError::Write { source }),
    }
}
