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
    /// Frames that are kept, at most.
    most_frames: usize,
    /// By frame, from the first.
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
            most_frames: count,
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

    /// With `is_open` the number of frames is not known: as many are kept as a path may have.
    #[must_use]
    pub fn open_ended(mut self, is_open: bool) -> Self {
        if is_open {
            self.most_frames = MAX_FRAMES as usize;
        }
        self
    }

    /// Notes when the pose of each frame came: until then the pipeline had nothing to do.
    pub fn note_poses(&mut self, poses: &[FlownFrame]) {
        for pose in poses {
            let index = pose.frame.since(self.first_frame).and_then(|index| usize::try_from(index).ok());
            if let Some(frame) = index.and_then(|index| self.frames.get_mut(index)) {
                frame.pose_nanos = pose.camera.timestamp_nanos();
            }
        }
    }

    /// Number of the first frame.
    #[must_use]
    pub fn first_frame(&self) -> FrameNumber {
        self.first_frame
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
        }
        match self.frame_mut(event.frame()) {
            Some(frame) => frame.take(content, event),
            // Loading of the locked top levels belongs to no frame.
            None => return span.map(|_| ()),
        }
        Some(())
    }

    /// A frame of this run; of a flight without a known end also one that is new.
    fn frame_mut(&mut self, frame: FrameNumber) -> Option<&mut FrameStats> {
        let index = usize::try_from(frame.since(self.first_frame)?).ok()?;
        let is_new = (self.frames.len()..self.most_frames).contains(&index);
        if is_new && index - self.frames.len() < FRAMES_UNDER_WAY {
            self.frames.resize(index + 1, FrameStats::default());
        }
        self.frames.get_mut(index)
    }
}

#[cfg(test)]
mod tests;
