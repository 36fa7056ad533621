//! Lanes: threads that run sinks, off the critical path.
//!
//! Frame number n of the run goes to lane n modulo the number of lanes; a lane writes its frames in order. Sinks whose
//! frames depend on each other (film, y4m) have one lane, a folder of pictures has several. Queues are bounded: the pixels
//! travel in read-back buffers of which there is a fixed number, and a buffer comes back when its frame is written.

use super::{FrameSink, Picture, SinkError};
use crate::engine::Finished;
use crate::pixels::Pixels;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::Sequence;

/// Frames that wait for one lane, at most. More than there are read-back buffers: handing one over does not wait.
const QUEUE: usize = 24;

/// A frame that has left its sink.
#[derive(Debug)]
pub struct Written {
    /// Its number.
    pub frame: u64,
    /// Counts the frames of the run from 1.
    pub sequence: Sequence,
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
    /// The lane that wrote it.
    pub lane: u32,
    /// When the lane began with it, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// How long it took.
    pub duration_nanos: u64,
    /// The buffer, free again.
    pub pixels: Pixels,
}

#[expect(clippy::large_enum_variant, reason = "a box would be an allocation a frame; the queue has room for both")]
enum Message {
    Frame(Finished),
    /// All frames were given: complete the output. A queue that closes without it means that the run was broken off.
    Finish,
}

struct Lane {
    messages: SyncSender<Message>,
    thread: JoinHandle<Result<(), SinkError>>,
}

/// The lanes of a run.
pub struct Lanes {
    lanes: Vec<Lane>,
    written: Receiver<Result<Written, SinkError>>,
    /// Lane of the next frame.
    next: usize,
}

impl std::fmt::Debug for Lanes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Lanes").field("lanes", &self.lanes.len()).finish_non_exhaustive()
    }
}

impl Lanes {
    /// One lane for each of these sinks.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn start(sinks: Vec<Box<dyn FrameSink>>) -> Result<Self, SinkError> {
        // Room for all frames that lanes can hold, so that a lane never waits for the frame loop.
        let (done, written) = sync_channel(sinks.len() * (QUEUE + 2));
        let lanes = sinks
            .into_iter()
            .enumerate()
            .map(|(index, sink)| {
                let (messages, queue) = sync_channel(QUEUE);
                let done = done.clone();
                let lane = index as u32;
                let thread = std::thread::Builder::new()
                    .name(format!("sink {lane}"))
                    .spawn(move || run_lane(lane, sink, &queue, &done))
                    .map_err(|source| SinkError::Write { source, path: "a thread".into() })?;
                Ok(Lane { messages, thread })
            })
            .collect::<Result<_, SinkError>>()?;
        Ok(Self { lanes, written, next: 0 })
    }

    /// Read-back buffers that keep all lanes busy: one being written and one waiting, each.
    #[must_use]
    pub fn wanted_buffers(&self) -> usize {
        2 * self.lanes.len()
    }

    /// Hands a frame to its lane. Waits while the lane's queue is full.
    ///
    /// # Errors
    /// The lane's sink has failed.
    pub fn put(&mut self, frame: Finished) -> Result<(), SinkError> {
        let lane = self.next % self.lanes.len().max(1);
        self.next += 1;
        let Some(lane) = self.lanes.get(lane) else { return Err(SinkError::LaneGone) };
        lane.messages.send(Message::Frame(frame)).map_err(|_closed| self.failure())
    }

    /// Why a lane ended.
    fn failure(&self) -> SinkError {
        while let Ok(written) = self.written.try_recv() {
            if let Err(error) = written {
                return error;
            }
        }
        SinkError::LaneGone
    }

    /// A frame that was written, if there is one now.
    ///
    /// # Errors
    /// A sink has failed.
    pub fn try_written(&self) -> Result<Option<Written>, SinkError> {
        match self.written.try_recv() {
            Ok(written) => written.map(Some),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(SinkError::LaneGone),
        }
    }

    /// A frame that was written; waits for one, `timeout` at most.
    ///
    /// # Errors
    /// A sink has failed.
    pub fn wait_written(&self, timeout: Duration) -> Result<Option<Written>, SinkError> {
        match self.written.recv_timeout(timeout) {
            Ok(written) => written.map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(SinkError::LaneGone),
        }
    }

    /// No more frames: completes all sinks. Lanes that are dropped without it remove what is incomplete.
    ///
    /// # Errors
    /// The first sink that could not be completed.
    pub fn finish(mut self) -> Result<(), SinkError> {
        let mut first = Ok(());
        for lane in self.lanes.drain(..) {
            // A lane that has failed has closed its queue; its error is what the join brings or was told before.
            let _sent = lane.messages.send(Message::Finish);
            drop(lane.messages);
            let result = lane.thread.join().unwrap_or(Err(SinkError::LaneGone));
            first = first.and(result);
        }
        first
    }
}

impl Drop for Lanes {
    fn drop(&mut self) {
        for lane in self.lanes.drain(..) {
            drop(lane.messages);
            // The run was broken off for another reason; the thread is waited for so that nothing is left behind.
            let _result = lane.thread.join();
        }
    }
}

fn run_lane(
    lane: u32,
    mut sink: Box<dyn FrameSink>,
    queue: &Receiver<Message>,
    done: &SyncSender<Result<Written, SinkError>>,
) -> Result<(), SinkError> {
    loop {
        let frame = match queue.recv() {
            Ok(Message::Frame(frame)) => frame,
            Ok(Message::Finish) => return sink.finish(),
            Err(_broken_off) => return Ok(()),
        };
        let started_nanos = monotonic_nanos();
        let picture = Picture {
            frame: frame.frame,
            size: frame.pixels.size(),
            rgba: frame.pixels.rgba(),
            reversed_depth: frame.pixels.reversed_depth(),
            view: None,
            views: frame.views,
            is_settled: frame.is_settled,
        };
        let result = sink.write(&picture).map(|()| Written {
            frame: frame.frame,
            sequence: frame.sequence,
            is_settled: frame.is_settled,
            lane,
            started_nanos,
            duration_nanos: monotonic_nanos() - started_nanos,
            pixels: frame.pixels,
        });
        let is_failed = result.is_err();
        if done.send(result).is_err() || is_failed {
            // The run is over, or the loop has been told: what is incomplete goes with the sink.
            return Ok(());
        }
    }
}
