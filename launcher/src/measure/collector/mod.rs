//! Collects what the stages tell of their work, by frame; and keeps all of it when a trace is
//! wanted.
//!
//! * [`frame`]: what is known of one frame. [`failures`]: what went wrong while the database was
//!   read.

pub mod failures;
pub mod frame;

use crate::data_set::FlownFrame;
use crate::path::MAX_FRAMES;
use failures::Failures;
use frame::FrameStats;
use std::collections::BTreeMap;
use terravision_common::database::Tile;
use terravision_common::event::{Event, EventContent, SpanName, TextKind};
use terravision_common::ids::FrameNumber;
use terravision_common::outcome::TileFailure;
use terravision_common::run::{TechniqueChoice, UNDECIDED_RAYS};
use terravision_common::shm::Stage;

/// More frames than this are never under way: the camera ring and the ring hold less.
const FRAMES_UNDER_WAY: usize = 8192;
/// Of a flight without an end of which nobody wants a report this many frames are kept, and at most
/// twice as many; and as many answers to requests for tiles.
const KEPT: usize = 2048;

/// How rays are cast.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RaysMethod {
    /// For people.
    pub description: String,
    /// Whether the renderer stays with it.
    pub is_final: bool,
}

/// A text that comes in pieces.
#[derive(Debug, Default)]
struct EventText {
    bytes: Vec<u8>,
    is_complete: bool,
}

impl EventText {
    fn take(&mut self, piece: &Event) {
        self.is_complete = piece.collect_text(&mut self.bytes);
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes).into_owned()
    }
}

/// What the stages told in a run.
#[derive(Debug)]
pub struct Collector {
    first_frame: FrameNumber,
    /// Frames that the flight has, at most.
    most_frames: u64,
    /// Whether old frames are forgotten.
    is_forgetful: bool,
    /// Frames that were forgotten, from the first.
    forgotten: u64,
    /// By frame, from the first that is kept.
    pub frames: Vec<FrameStats>,
    /// Tiles that could not be read, and why.
    pub unavailable: BTreeMap<Tile, TileFailure>,
    /// Tiles that could not be read at first, and came later.
    pub came_later: u64,
    /// What went wrong while the database was read.
    pub failures: Failures,
    /// From each request for a tile to its answer, milliseconds.
    pub round_trips_ms: Vec<f32>,
    device: EventText,
    driver: EventText,
    technique: EventText,
    technique_reason: EventText,
    /// The technique was told: later pieces do not undo that.
    is_technique_known: bool,
    failure: EventText,
    /// Events that made no sense.
    pub malformed_events: u64,
    /// All events, when a trace is wanted.
    pub trace: Option<Vec<(Stage, Event)>>,
}

impl Collector {
    /// For a run of `count` frames from `first_frame`.
    #[must_use]
    pub fn new(first_frame: FrameNumber, count: usize, is_traced: bool) -> Self {
        Self {
            first_frame,
            most_frames: count as u64,
            is_forgetful: false,
            forgotten: 0,
            frames: vec![FrameStats::default(); count],
            unavailable: BTreeMap::new(),
            came_later: 0,
            failures: Failures::default(),
            round_trips_ms: Vec::new(),
            device: EventText::default(),
            driver: EventText::default(),
            technique: EventText::default(),
            technique_reason: EventText::default(),
            is_technique_known: false,
            failure: EventText::default(),
            malformed_events: 0,
            trace: is_traced.then(Vec::new),
        }
    }

    /// The number of frames is not known: as many are kept as a path may have, or, when nobody
    /// wants a report of each, the last ones of any number.
    #[must_use]
    pub fn open_ended(self, is_forgetful: bool) -> Self {
        Self { most_frames: if is_forgetful { u64::MAX } else { MAX_FRAMES }, is_forgetful, ..self }
    }

    /// Notes when the pose of each frame came: until then the pipeline had nothing to do.
    pub fn note_poses(&mut self, poses: &[FlownFrame]) {
        for pose in poses {
            if let Some(frame) = self.index(pose.frame).and_then(|index| self.frames.get_mut(index)) {
                frame.pose_nanos = pose.camera.timestamp_nanos();
            }
        }
    }

    /// Number of the first frame.
    #[must_use]
    pub fn first_frame(&self) -> FrameNumber {
        self.first_frame
    }

    /// Frames that were forgotten: those kept come after them.
    #[must_use]
    pub fn forgotten(&self) -> u64 {
        self.forgotten
    }

    /// The flight had this many frames: what was noted of later ones is of frames that were never
    /// drawn.
    pub fn end_after(&mut self, frames: u64) {
        self.frames.truncate(usize::try_from(frames.saturating_sub(self.forgotten)).unwrap_or(usize::MAX));
    }

    /// Name of the device that drew; empty when it was not told.
    #[must_use]
    pub fn device(&self) -> String {
        self.device.text()
    }

    /// Name of its driver; empty when it was not told.
    #[must_use]
    pub fn driver(&self) -> String {
        self.driver.text()
    }

    /// How rays are cast, when they are and it was told.
    #[must_use]
    pub fn rays(&self) -> Option<RaysMethod> {
        let is_told = self.driver.is_complete && self.technique().as_deref() == Some(TechniqueChoice::Rays.name());
        let description = self.driver();
        is_told.then(|| RaysMethod { is_final: !description.starts_with(UNDECIDED_RAYS), description })
    }

    /// Name of the technique that drew, once it was told.
    #[must_use]
    pub fn technique(&self) -> Option<String> {
        self.is_technique_known.then(|| self.technique.text())
    }

    /// Why it drew; empty when it was not told.
    #[must_use]
    pub fn technique_reason(&self) -> String {
        self.technique_reason.text()
    }

    /// Takes one event. It comes from shared memory: numbers are checked, nonsense is counted.
    pub fn take(&mut self, stage: Stage, event: Event) {
        if let Some(trace) = &mut self.trace {
            trace.push((stage, event));
        }
        if self.apply(&event).is_none() {
            self.malformed_events += 1;
        }
    }

    /// `None` when the event is malformed.
    fn apply(&mut self, event: &Event) -> Option<()> {
        let content = event.content()?;
        match content {
            EventContent::Text { kind: TextKind::Device } => self.device.take(event),
            EventContent::Text { kind: TextKind::Driver } => self.driver.take(event),
            EventContent::Text { kind: TextKind::Technique } => {
                self.technique.take(event);
                self.is_technique_known |= self.technique.is_complete;
            }
            EventContent::Text { kind: TextKind::TechniqueReason } => self.technique_reason.take(event),
            EventContent::Text { kind: TextKind::Failure } => {
                self.failure.take(event);
                if self.failure.is_complete {
                    self.failures.take(&self.failure.text())?;
                }
            }
            EventContent::TileUnavailable { tile, failure } => {
                self.unavailable.insert(tile, failure);
            }
            EventContent::TileCame { tile } => {
                self.unavailable.remove(&tile);
                self.came_later += 1;
            }
            content => self.apply_to_frame(content, event)?,
        }
        Some(())
    }

    fn apply_to_frame(&mut self, content: EventContent, event: &Event) -> Option<()> {
        let span = match content {
            EventContent::Span { name, .. } => Some(name),
            _ => None,
        };
        if span == Some(SpanName::FetchTile) {
            self.round_trips_ms.push((event.duration_nanos as f64 / 1e6) as f32);
            if self.is_forgetful && self.round_trips_ms.len() >= 2 * KEPT {
                self.round_trips_ms.drain(..KEPT);
            }
        }
        let is_forgotten = self.is_forgotten(event.frame());
        match self.frame_mut(event.frame()) {
            Some(frame) => frame.take(content, event),
            // Loading of the locked top levels belongs to no frame.
            None if span.is_none() && !is_forgotten => return None,
            None => {}
        }
        self.forget();
        Some(())
    }

    /// Where a frame is kept, or would be.
    fn index(&self, frame: FrameNumber) -> Option<usize> {
        usize::try_from(frame.since(self.first_frame)?.checked_sub(self.forgotten)?).ok()
    }

    /// A frame of this run; of a flight without a known end also one that is new.
    fn frame_mut(&mut self, frame: FrameNumber) -> Option<&mut FrameStats> {
        let index = self.index(frame)?;
        let is_new = index >= self.frames.len() && (index as u64) < self.most_frames;
        if is_new && index - self.frames.len() < FRAMES_UNDER_WAY {
            self.frames.resize(index + 1, FrameStats::default());
        }
        self.frames.get_mut(index)
    }

    fn is_forgotten(&self, frame: FrameNumber) -> bool {
        frame.since(self.first_frame).is_some_and(|index| index < self.forgotten)
    }

    fn forget(&mut self) {
        if self.is_forgetful && self.frames.len() > 2 * KEPT {
            let old = self.frames.len() - KEPT;
            self.frames.drain(..old);
            self.forgotten += old as u64;
        }
    }
}

#[cfg(test)]
mod tests;
