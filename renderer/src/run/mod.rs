//! The frame loop: from a source through the engine to the sinks.

mod error;
mod telemetry;

pub use error::RunError;

use crate::engine::{self, Engine, EngineError, EngineOptions, Finished};
use crate::frame::{FrameError, FrameReader};
use crate::gpu::Place;
use crate::pixels::Pixels;
use crate::sink::workers::{SinkWorkers, Written};
use crate::skirt::{Border, Skirt};
use crate::source::{Done, FrameSource, SourceShape};
use crate::technique::DrawError;
use std::collections::VecDeque;
use std::time::Duration;
use terravision_common::event::monotonic_nanos;
use terravision_common::run::OPEN_END;
use terravision_common::shm::{Activity, Counter};

/// How long the loop waits for the device or a sink before it looks at everything else again.
const TICK: Duration = Duration::from_millis(2);

/// Read-back buffers take no more than this together, but there are two at least.
const READBACK_BYTES: u64 = 512 << 20;

/// Read-back buffers that a sink may lag behind by in realtime mode. Fewer than a worker's queue
/// holds.
const SPARE_READBACKS: usize = 12;

/// Losses of the device with not a frame written in between, after which it is given up.
const MOST_LOSSES: u32 = 3;

/// What a run did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RunSummary {
    /// Frames written.
    pub frames: u64,
    /// Frames that lacked a tile.
    pub unsettled: u64,
    /// Colour tiles uploaded.
    pub uploads: u64,
}

/// Draws and writes all frames of `source`. `on_device` is called once, before the first frame;
/// `observe` sees every finished frame before it goes to its sink. A device that is lost is opened
/// again, and the frames that it had are drawn once more.
///
/// # Errors
/// The first thing that failed; what is incomplete of the sinks' output is removed.
pub fn run(
    options: EngineOptions,
    source: &mut dyn FrameSource,
    workers: SinkWorkers,
    on_device: &mut dyn FnMut(&dyn Engine, &mut dyn FrameSource),
    observe: &mut dyn FnMut(&Finished),
) -> Result<RunSummary, RunError> {
    let mut looped = FrameLoop::new(options, source, workers)?;
    on_device(&*looped.engine, looped.source);
    tracing::debug!(buffers = looped.buffers, "draws");
    let mut losses = Losses::default();
    while let Err(error) = looped.fly(observe) {
        if !error.is_device_lost() || !losses.may_go_on(looped.summary.frames) {
            return Err(error);
        }
        // Standard error is the launcher's.
        terravision_common::terminal::complain(&format!("{error}; it is opened again"));
        looped = looped.rebuilt()?;
    }
    let is_cut_short = looped.reader.remaining() > 0 && looped.source.is_over();
    let FrameLoop { engine, workers, summary, source, shape, .. } = looped;
    source.awaits(Activity::AwaitsSink);
    workers.finish()?;
    if is_cut_short {
        // The pictures of the last frames went with a renderer that was killed; the sink has
        // repeated the one before.
        source.written(shape.frames[1].saturating_sub(shape.frames[0]));
    }
    engine.check_validation()?;
    Ok(summary)
}

/// How often the device was lost without getting anywhere.
#[derive(Debug, Default)]
struct Losses {
    in_a_row: u32,
    frames: u64,
}

impl Losses {
    /// The device was lost again, after `frames` written frames: whether to open it once more.
    fn may_go_on(&mut self, frames: u64) -> bool {
        self.in_a_row = if frames > self.frames { 1 } else { self.in_a_row + 1 };
        self.frames = frames;
        self.in_a_row <= MOST_LOSSES
    }
}

struct FrameLoop<'a> {
    // The workers first: they hold read-back buffers.
    workers: SinkWorkers,
    engine: Box<dyn Engine>,
    options: EngineOptions,
    shape: SourceShape,
    source: &'a mut dyn FrameSource,
    reader: FrameReader,
    skirt: Option<Skirt>,
    /// Of the frames that are with the engine, in order.
    borders: VecDeque<Vec<Border>>,
    record_started: u64,
    free: Vec<Pixels>,
    /// Read-back buffers in all.
    buffers: usize,
    last_finished: u64,
    summary: RunSummary,
    /// Frames that are with a worker.
    with_workers: u64,
    /// Frames are done with only when they are written: this process may be killed, and the one
    /// after it has to draw and write what this one has not. Against the clock they are not:
    /// nothing may wait for a sink.
    is_held_until_written: bool,
    /// Frames that are drawn and not done with, in order, and whether they are written.
    unwritten: VecDeque<(Done, bool)>,
}

impl<'a> FrameLoop<'a> {
    fn new(options: EngineOptions, source: &'a mut dyn FrameSource, workers: SinkWorkers) -> Result<Self, RunError> {
        let pixels = workers.needs();
        // Air is laid over pictures in memory of the processor. One that stays on the device keeps its plain sky.
        let options = EngineOptions { pixels, has_air: options.has_air && !pixels.device, ..options };
        let reader = FrameReader::new(source.shape(), options.size)?;
        let pixels = u64::from(options.size[0]) * u64::from(options.size[1]);
        let bytes_per_pixel = if options.has_depth { 8 } else { 4 };
        let affordable = (READBACK_BYTES / (pixels * bytes_per_pixel).max(1)).max(2) as usize;
        let engine = engine::open(options.clone(), source)?;
        let shape = source.shape();
        // Walls are drawn over pixels in memory of the processor.
        let skirt =
            options.skirt_low_m.filter(|_| options.pixels.may_be_host()).map(|low| Skirt::new(&shape.world, low));
        let is_held_until_written = source.is_supervised() && !shape.has_gaps;
        // Against the clock a sink that is slow for a moment must not hold up what is drawn.
        // What is shown at once does not pile up.
        let spare = if shape.has_gaps && !options.pixels.either { SPARE_READBACKS } else { 0 };
        let wanted = engine.frames_in_flight() + workers.wanted_buffers() + spare;
        let free = (0..wanted.min(affordable)).map(|_| engine.new_pixels()).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            workers,
            engine,
            options,
            shape,
            source,
            reader,
            skirt,
            borders: VecDeque::new(),
            record_started: monotonic_nanos(),
            buffers: free.len(),
            free,
            last_finished: 0,
            summary: RunSummary::default(),
            with_workers: 0,
            is_held_until_written,
            unwritten: VecDeque::new(),
        })
    }

    /// With another device, behind the frames that are done with. The frames that the old one had
    /// are read again.
    fn rebuilt(mut self) -> Result<Self, RunError> {
        while self.with_workers > 0 {
            self.source.check()?;
            if let Some(written) = self.workers.wait_written(TICK)? {
                self.take_back(written)?;
            }
        }
        let Self { workers, engine, options, mut reader, skirt, source, summary, last_finished, .. } = self;
        // The old one goes first: there may be no room for both.
        drop(self.free);
        drop(engine);
        let engine = engine::open(options.clone(), source)?;
        let free = (0..self.buffers).map(|_| engine.new_pixels()).collect::<Result<Vec<_>, _>>()?;
        reader.resume(source.rewind());
        Ok(Self {
            workers,
            engine,
            options,
            shape: self.shape,
            source,
            reader,
            skirt,
            borders: VecDeque::new(),
            record_started: monotonic_nanos(),
            free,
            buffers: self.buffers,
            last_finished,
            summary,
            with_workers: 0,
            is_held_until_written: self.is_held_until_written,
            unwritten: VecDeque::new(),
        })
    }

    /// All frames that are still to come.
    fn fly(&mut self, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        while self.reader.remaining() > 0 && !self.source.is_over() {
            match self.step(observe) {
                // All frames are written; what is left is to complete the output.
                Err(error) if error.is_finished() => break,
                other => other?,
            }
        }
        self.drain(observe)
    }

    /// One frame: wait for a slot and a buffer, read the ring, record and submit; finished frames
    /// go to the sinks meanwhile.
    fn step(&mut self, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        self.source.check()?;
        let mut pixels = self.wait_for_room(observe)?;
        self.wait_for_frame(observe)?;
        if self.options.pixels.has_choice() {
            // Walls are drawn by the processor.
            let is_drawn_over = self.skirt.as_ref().is_some_and(|skirt| skirt.is_in_sight(self.reader.frame()));
            pixels.choose(if is_drawn_over { Place::Memory } else { Place::Device });
        }
        if let Some(has_overlay) = self.workers.wants_tree_overlay() {
            self.engine.set_tree_overlay(has_overlay)?;
        }
        let started = self.record_started;
        let submitted = self.engine.submit(self.reader.frame(), self.source, pixels);
        if matches!(submitted, Err(EngineError::Draw { source: DrawError::Frame { .. } })) {
            self.source.count(Counter::SlotsRejected, 1);
        }
        let submitted = submitted?;
        let borders = match &mut self.skirt {
            Some(skirt) => skirt.borders(self.reader.frame(), self.source, &mut *self.engine)?,
            None => Vec::new(),
        };
        self.borders.push_back(borders);
        let frame = self.reader.frame().number();
        telemetry::tell_of_recording(self.source, frame, started, &submitted);
        self.summary.uploads += u64::from(submitted.uploads);
        self.source.progress();
        tracing::trace!(frames = self.summary.frames, "frame is with the device");
        Ok(())
    }

    /// A free slot of the engine and a free read-back buffer.
    fn wait_for_room(&mut self, observe: &mut dyn FnMut(&Finished)) -> Result<Pixels, RunError> {
        loop {
            self.collect(Duration::ZERO, observe)?;
            if self.engine.has_room()
                && let Some(pixels) = self.free.pop()
            {
                return Ok(pixels);
            }
            self.source.check()?;
            if self.engine.has_room() {
                // Only the sinks can help.
                self.source.awaits(Activity::AwaitsSink);
                if let Some(written) = self.workers.wait_written(TICK)? {
                    self.take_back(written)?;
                }
            } else {
                self.source.awaits(Activity::AwaitsDevice);
                self.collect(TICK, observe)?;
            }
        }
    }

    /// Reads slots until a frame is complete. While frames are with the device, what they hold of
    /// the rings must be given back as soon as they are finished, because the preparer may be
    /// waiting for it: so it waits for the device, not for the ring.
    ///
    /// In a flight without a known end, unless the clock makes its frames, the next one may only
    /// come when somebody has seen this one, or never: sinks are waited for, too, before the ring;
    /// so they are where a frame holds what it has until it is written.
    fn wait_for_frame(&mut self, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        let awaits_frames = self.shape.frames[1] == OPEN_END && !self.shape.has_gaps;
        loop {
            let awaits_sinks = (awaits_frames || self.is_held_until_written) && self.with_workers > 0;
            let read = self.reader.read(self.source, !self.engine.is_busy() && !awaits_sinks);
            if read.as_ref().is_err_and(|error| !matches!(error, FrameError::Source { .. })) {
                self.source.count(Counter::SlotsRejected, 1);
            }
            if read? {
                self.record_started = monotonic_nanos();
                return Ok(());
            }
            self.source.check()?;
            self.await_device_or_sink();
            if self.engine.is_busy() {
                self.collect(TICK, observe)?;
            } else if let Some(written) = self.workers.wait_written(TICK)? {
                self.take_back(written)?;
            }
        }
    }

    fn await_device_or_sink(&mut self) {
        let activity = if self.engine.is_busy() { Activity::AwaitsDevice } else { Activity::AwaitsSink };
        self.source.awaits(activity);
    }

    /// Takes finished frames from the device (the oldest within `timeout`) and written ones from
    /// the workers.
    fn collect(&mut self, timeout: Duration, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        let mut wait = timeout;
        while let Some(finished) = self.engine.poll(wait)? {
            self.finish(finished, observe)?;
            wait = Duration::ZERO;
        }
        while let Some(written) = self.workers.try_written()? {
            self.take_back(written)?;
        }
        Ok(())
    }

    fn finish(&mut self, mut finished: Finished, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        self.source.progress();
        for border in self.borders.pop_front().unwrap_or_default() {
            border.draw(&mut finished.pixels, self.options.samples);
        }
        if self.is_held_until_written {
            self.unwritten.push_back((finished.done(), false));
        } else {
            self.source.complete(&finished.done())?;
        }
        self.source.count(Counter::FramesDrawn, 1);
        telemetry::tell_of_finished(self.source, &finished, self.last_finished);
        self.last_finished = finished.finished_nanos;
        observe(&finished);
        self.with_workers += 1;
        Ok(self.workers.put(finished)?)
    }

    fn take_back(&mut self, written: Written) -> Result<(), RunError> {
        self.with_workers -= 1;
        self.source.progress();
        if let Some((_, is_written)) = self.unwritten.iter_mut().find(|(done, _)| done.sequence == written.sequence) {
            *is_written = true;
        }
        while let Some((done, true)) = self.unwritten.front() {
            self.source.complete(done)?;
            self.unwritten.pop_front();
        }
        self.summary.frames += 1;
        let written_up_to = written.frame.next().get().saturating_sub(self.shape.frames[0]);
        telemetry::tell_of_written(self.source, &written);
        if !written.is_settled {
            self.summary.unsettled += 1;
            self.source.count(Counter::FramesUnsettled, 1);
        }
        // What repeats in place of frames that were left out is part of the film, too.
        let count =
            if self.shape.has_gaps { written_up_to } else { self.shape.done.sequence.get() + self.summary.frames };
        self.source.written(count);
        self.free.push(written.pixels);
        Ok(())
    }

    /// Waits until all frames are written.
    fn drain(&mut self, observe: &mut dyn FnMut(&Finished)) -> Result<(), RunError> {
        while self.engine.is_busy() || self.with_workers > 0 {
            match self.source.check().map_err(RunError::from) {
                Err(error) if !error.is_finished() => return Err(error),
                _goes_on => {}
            }
            self.await_device_or_sink();
            if self.engine.is_busy() {
                self.collect(TICK, observe)?;
            } else if let Some(written) = self.workers.wait_written(TICK)? {
                self.take_back(written)?;
            }
        }
        Ok(())
    }
}
