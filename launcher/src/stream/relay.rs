//! From the frames of one renderer after another to a stream in which each stands once.

use super::StreamError;
use std::io::{self, PipeReader, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use terravision_common::film::Packet;
use terravision_common::ids::RingPosition;
use terravision_common::run::OPEN_END;
use terravision_common::shm::StreamReader;

/// What a stream is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamShape {
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
    /// Where frames lie.
    ring: StreamReader,
    spout: Spout,
    /// The last frame, where it may have to stand in for others.
    last: Option<Vec<u8>>,
}

/// Where frames go.
struct Spout {
    out: Box<dyn Write + Send>,
    passage: Arc<Passage>,
    /// The frame that has to come next.
    next: u64,
    /// Frames that were passed on.
    passed: u64,
}

impl std::fmt::Debug for Relay {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Relay").field("shape", &self.shape).field("next", &self.spout.next).finish_non_exhaustive()
    }
}

impl Relay {
    /// From `ring` to `out`.
    #[must_use]
    pub fn new(shape: StreamShape, ring: StreamReader, out: Box<dyn Write + Send>, passage: Arc<Passage>) -> Self {
        Self { shape, ring, spout: Spout { out, passage, next: shape.frames[0], passed: 0 }, last: None }
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
                self.spout.passage.has_failed.store(true, Ordering::Release);
                break;
            }
        }
        relayed?;
        if self.spout.passage.is_complete.load(Ordering::Acquire) { self.complete() } else { Ok(()) }
    }

    /// All frames that a pipe tells of.
    fn relay(&mut self, pipe: &mut dyn Read) -> Result<(), StreamError> {
        let mut packet = [0; Packet::SIZE];
        while read_whole(pipe, &mut packet)? {
            let Packet { frame, position } = Packet::from_bytes(packet);
            let end = if frame == Packet::BEGIN {
                position
            } else {
                self.relay_frame(frame, position)?;
                position.wrapping_add(1)
            };
            self.ring.released(RingPosition::new(end)).map_err(|source| StreamError::Ring { source })?;
        }
        Ok(())
    }

    fn relay_frame(&mut self, frame: u64, position: u64) -> Result<(), StreamError> {
        let Self { shape: StreamShape { frames: [first, end], has_gaps }, ring, spout, last } = self;
        let came = ring.read_array(position).map_err(|source| StreamError::Ring { source })?;
        let Some(came) = came.filter(|_| (*first..*end).contains(&frame)) else {
            return Err(StreamError::StrangePacket { frame, position });
        };
        // What a renderer wrote before it was killed may come again from the next one.
        if frame < spout.next {
            return Ok(());
        }
        if frame > spout.next && !*has_gaps {
            return Err(StreamError::Gap { frame: spout.next });
        }
        // Before the first picture there is nothing to repeat.
        let stand_in = last.as_deref().unwrap_or(came);
        while spout.next < frame {
            spout.put(stand_in)?;
        }
        spout.put(came)?;
        if *has_gaps {
            let last = last.get_or_insert_default();
            last.clear();
            last.extend_from_slice(came);
        }
        Ok(())
    }

    /// The frames at the end that went with a renderer; a flight without a known end ends where it
    /// ends.
    fn complete(mut self) -> Result<(), StreamError> {
        let end = self.shape.frames[1];
        if let Some(last) = self.last.take().filter(|_| self.shape.has_gaps && end != OPEN_END) {
            while self.spout.next < end {
                self.spout.put(&last)?;
            }
        }
        self.spout.out.flush().map_err(|source| StreamError::Write { source })
    }
}

impl Spout {
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
}

/// Fills `out`; false where the other side ended before.
fn read_whole(from: &mut dyn Read, out: &mut [u8]) -> Result<bool, StreamError> {
    match from.read_exact(out) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(source) => Err(StreamError::Write { source }),
    }
}
