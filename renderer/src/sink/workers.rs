//! SinkWorkers: threads that run sinks, off the critical path.
//!
//! Frame number n of the run goes to worker n modulo the number of workers; a worker writes its
//! frames in order. Sinks whose frames depend on each other (film, y4m) have one worker, a folder
//! of pictures has several. Queues are bounded: the pixels travel in read-back buffers of which
//! there is a fixed number, and a buffer comes back when its frame is written.

use super::{FrameSink, Picture, SinkError};
use crate::air::Air;
use crate::engine::Finished;
use crate::pixels::{PixelPlaces, Pixels};
use crate::vehicles::VehicleFeed;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::vehicle::VehicleRecord;
use terravision_vehicles::painter::Painter;

/// Frames that wait for one worker, at most. More than there are read-back buffers: handing one
/// over does not wait.
const QUEUE: usize = 24;

/// A frame that has left its sink.
#[derive(Debug)]
pub struct Written {
    /// Its number.
    pub frame: FrameNumber,
    /// Counts the frames of the run from 1.
    pub sequence: Sequence,
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
    /// The worker that wrote it.
    pub worker: u32,
    /// When the worker began with it, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// How long it took.
    pub duration_nanos: u64,
    /// The buffer, free again.
    pub pixels: Pixels,
}

#[expect(clippy::large_enum_variant, reason = "a box would be an allocation a frame; the queue has room for both")]
enum Message {
    /// A frame, and where its vehicles are.
    Frame(Finished, Vec<VehicleRecord>),
    /// All frames were given: complete the output. A queue that closes without it means that the
    /// run was broken off.
    Finish,
}

struct Worker {
    messages: SyncSender<Message>,
    thread: JoinHandle<Result<(), SinkError>>,
}

/// The workers of a run.
pub struct SinkWorkers {
    workers: Vec<Worker>,
    written: Receiver<Result<Written, SinkError>>,
    needs: PixelPlaces,
    /// Of a sink that decides whether frames have outlines.
    overlay: Option<Arc<AtomicBool>>,
    vehicles: Option<VehicleFeed>,
    /// Worker of the next frame.
    next: usize,
}

/// What is laid over pictures before sinks see them.
#[derive(Debug, Default)]
pub struct Over {
    /// Haze and sky.
    pub air: Option<Air>,
    /// Vehicles, before the air.
    pub vehicles: Option<VehicleFeed>,
}

impl std::fmt::Debug for SinkWorkers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SinkWorkers").field("workers", &self.workers.len()).finish_non_exhaustive()
    }
}

impl SinkWorkers {
    /// One worker for each of these sinks.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn start(sinks: Vec<Box<dyn FrameSink>>) -> Result<Self, SinkError> {
        Self::start_over(sinks, Over::default())
    }

    /// Likewise; this is laid over pictures before sinks see them.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn start_over(sinks: Vec<Box<dyn FrameSink>>, over: Over) -> Result<Self, SinkError> {
        let Over { air, vehicles } = over;
        // Room for all frames that workers can hold, so that a worker never waits for the frame
        // loop.
        let (done, written) = sync_channel(sinks.len() * (QUEUE + 2));
        let mut needs = sinks.iter().fold(PixelPlaces::NOWHERE, |needs, sink| needs.and(sink.needs()));
        if (air.is_some() || vehicles.is_some()) && needs.either {
            // The processor draws it over them.
            needs = PixelPlaces { either: false, host: true, ..needs };
        }
        let overlay = sinks.iter().find_map(|sink| sink.tree_overlay());
        let workers = sinks
            .into_iter()
            .enumerate()
            .map(|(index, sink)| {
                let (messages, queue) = sync_channel(QUEUE);
                let (done, air) = (done.clone(), air.clone());
                let painter = vehicles.as_ref().map(VehicleFeed::painter);
                let worker = index as u32;
                let thread = std::thread::Builder::new()
                    .name(format!("sink {worker}"))
                    .spawn(move || run_worker(worker, (sink, air, painter), &queue, &done))
                    .map_err(|source| SinkError::Write { source, path: "a thread".into() })?;
                Ok(Worker { messages, thread })
            })
            .collect::<Result<_, SinkError>>()?;
        Ok(Self { workers, written, needs, overlay, vehicles, next: 0 })
    }

    /// Where they need the pixels of pictures.
    #[must_use]
    pub fn needs(&self) -> PixelPlaces {
        self.needs
    }

    /// Whether frames are to have outlines of the tree's colour leaves, where a sink decides that.
    #[must_use]
    pub fn wants_tree_overlay(&self) -> Option<bool> {
        // Relaxed: one value, from which nothing follows.
        self.overlay.as_ref().map(|overlay| overlay.load(Ordering::Relaxed))
    }

    /// Read-back buffers that keep all workers busy: one being written and one waiting, each.
    #[must_use]
    pub fn wanted_buffers(&self) -> usize {
        2 * self.workers.len()
    }

    /// Hands a frame to its worker. Waits while the worker's queue is full.
    ///
    /// # Errors
    /// The worker's sink has failed, or it is not known where the frame's vehicles are.
    pub fn put(&mut self, frame: Finished) -> Result<(), SinkError> {
        let vehicles = self.vehicles.as_mut().map_or(Ok(Vec::new()), |feed| feed.of_frame(frame.frame))?;
        let worker = self.next % self.workers.len().max(1);
        self.next += 1;
        let Some(worker) = self.workers.get(worker) else { return Err(SinkError::WorkerGone) };
        worker.messages.send(Message::Frame(frame, vehicles)).map_err(|_closed| self.failure())
    }

    /// Why a worker ended.
    fn failure(&self) -> SinkError {
        while let Ok(written) = self.written.try_recv() {
            if let Err(error) = written {
                return error;
            }
        }
        SinkError::WorkerGone
    }

    /// A frame that was written, if there is one now.
    ///
    /// # Errors
    /// A sink has failed.
    pub fn try_written(&self) -> Result<Option<Written>, SinkError> {
        match self.written.try_recv() {
            Ok(written) => written.map(Some),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(SinkError::WorkerGone),
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
            Err(RecvTimeoutError::Disconnected) => Err(SinkError::WorkerGone),
        }
    }

    /// No more frames: completes all sinks. SinkWorkers that are dropped without it remove what is
    /// incomplete.
    ///
    /// # Errors
    /// The first sink that could not be completed.
    pub fn finish(mut self) -> Result<(), SinkError> {
        let mut first = Ok(());
        for worker in self.workers.drain(..) {
            // A worker that has failed has closed its queue; its error is what the join brings or
            // was told before.
            let _sent = worker.messages.send(Message::Finish);
            drop(worker.messages);
            let result = worker.thread.join().unwrap_or(Err(SinkError::WorkerGone));
            first = first.and(result);
        }
        first
    }
}

impl Drop for SinkWorkers {
    fn drop(&mut self) {
        for worker in self.workers.drain(..) {
            drop(worker.messages);
            // The run was broken off for another reason; the thread is waited for so that nothing
            // is left behind.
            let _result = worker.thread.join();
        }
    }
}

fn run_worker(
    worker: u32,
    (mut sink, air, painter): (Box<dyn FrameSink>, Option<Air>, Option<Arc<Painter>>),
    queue: &Receiver<Message>,
    done: &SyncSender<Result<Written, SinkError>>,
) -> Result<(), SinkError> {
    loop {
        let (mut frame, vehicles) = match queue.recv() {
            Ok(Message::Frame(frame, vehicles)) => (frame, vehicles),
            Ok(Message::Finish) => return sink.finish(),
            Err(_broken_off) => return Ok(()),
        };
        let started_nanos = monotonic_nanos();
        if let Some(painter) = &painter {
            let stride = frame.pixels.size()[0] as usize;
            if let (rgba, Some(depth)) = frame.pixels.planes_mut() {
                painter.draw((rgba, depth), stride, &frame.views, &vehicles);
            }
        }
        if let Some(air) = &air {
            air.draw(&mut frame.pixels, &frame.views);
        }
        let picture = Picture {
            frame: frame.frame,
            size: frame.size,
            rgba: frame.pixels.rgba(),
            reversed_depth: frame.pixels.reversed_depth(),
            on_device: frame.pixels.on_device(),
            view: None,
            views: frame.views,
            is_settled: frame.is_settled,
        };
        let result = sink.write(&picture).map(|()| Written {
            frame: frame.frame,
            sequence: frame.sequence,
            is_settled: frame.is_settled,
            worker,
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
