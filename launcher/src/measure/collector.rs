//! Collects what the stages tell of their work, as figures per frame; and keeps all of it when a trace is wanted.

use crate::data_set::FlownFrame;
use crate::path::MAX_FRAMES;
use std::collections::{BTreeMap, BTreeSet};
use terravision_common::event::{Event, EventKind, SpanName};
use terravision_common::node::NodeId;
use terravision_common::run::{TechniqueChoice, UNDECIDED_RAYS};
use terravision_common::shm::Stage;

/// Spans of which each frame has a sum: all names.
pub const SPANS: usize = SpanName::ALL.len();

/// More frames than this are never under way: the camera ring and the ring hold less.
const FRAMES_UNDER_WAY: usize = 8192;

/// Causes of failure, and sentences of each, that are kept.
const FAILURES: usize = 64;

/// What is known of one frame. Times are nanoseconds of the monotonic clock, 0 for what has not come.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrameFigures {
    /// Sum of durations by [`SpanName`] (its number less one).
    pub span_nanos: [u64; SPANS],
    /// When the renderer began with the frame.
    pub draw_started_nanos: u64,
    /// End of its read-back.
    pub done_nanos: u64,
    /// When it had left the sink.
    pub written_nanos: u64,
    /// Triangles drawn.
    pub triangles: u64,
    /// Tiles that it wanted.
    pub wanted: u32,
    /// Nodes of its tree.
    pub nodes: u32,
    /// Tiles that were copied to the device for it.
    pub uploaded: u64,
    /// Whether it was written with all the tiles that it wanted.
    pub is_settled: bool,
    /// When its camera was made (realtime).
    pub camera_nanos: u64,
    /// When its pose came, of a frame that was drawn for a pose of another program (exact mode).
    pub pose_nanos: u64,
    /// Screen resolutions of facets and texels, pixels (realtime).
    pub r_px: [f32; 2],
    /// Tiles that it wanted and that were not there (realtime).
    pub lacked: u32,
    /// Share of the ground's screen area that it draws as finely as wanted (realtime).
    pub sharp: f32,
}

/// Why a tile could not be had, as events give it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct UnavailableTile {
    /// Whether it is a colour tile (else elevation).
    pub is_color: bool,
    /// The node.
    pub node: NodeId,
}

/// Figures of a run.
#[derive(Debug)]
pub struct Collector {
    first_frame: u64,
    /// Frames that figures are kept of, at most.
    most_frames: usize,
    /// By frame, from the first.
    pub frames: Vec<FrameFigures>,
    /// Cause by tile: 1 missing, 2 corrupt, 3 read error, 4 refused, 5 not in the cache.
    pub unavailable: BTreeMap<UnavailableTile, u64>,
    /// Tiles that could not be had at first, and came later.
    pub came_later: u64,
    /// What went wrong while the database was read: sentences by the name of the cause.
    pub failures: BTreeMap<String, Vec<String>>,
    /// From each request for a tile to its answer, milliseconds.
    pub round_trips_ms: Vec<f32>,
    device: Vec<u8>,
    driver: Vec<u8>,
    is_driver_whole: bool,
    technique: Vec<u8>,
    is_technique_known: bool,
    failure: Vec<u8>,
    told_failures: BTreeSet<String>,
    told_before: Vec<String>,
    /// Events that made no sense.
    pub strange_events: u64,
    /// All events, when a trace is wanted.
    pub trace: Option<Vec<(Stage, Event)>>,
}

impl Collector {
    /// For a run of `count` frames from `first_frame`.
    #[must_use]
    pub fn new(first_frame: u64, count: usize, is_traced: bool) -> Self {
        Self {
            first_frame,
            most_frames: count,
            frames: vec![FrameFigures::default(); count],
            unavailable: BTreeMap::new(),
            came_later: 0,
            failures: BTreeMap::new(),
            round_trips_ms: Vec::new(),
            device: Vec::new(),
            driver: Vec::new(),
            is_driver_whole: false,
            technique: Vec::new(),
            is_technique_known: false,
            failure: Vec::new(),
            told_failures: BTreeSet::new(),
            told_before: Vec::new(),
            strange_events: 0,
            trace: is_traced.then(Vec::new),
        }
    }

    /// With `is_open` the number of frames is not known: figures are kept of as many as a path may have.
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
            let index = pose.frame.checked_sub(self.first_frame).and_then(|index| usize::try_from(index).ok());
            if let Some(frame) = index.and_then(|index| self.frames.get_mut(index)) {
                frame.pose_nanos = pose.camera.timestamp_nanos;
            }
        }
    }

    /// Number of the first frame.
    #[must_use]
    pub fn first_frame(&self) -> u64 {
        self.first_frame
    }

    /// Name of the device that drew; empty when it was not told.
    #[must_use]
    pub fn device(&self) -> String {
        String::from_utf8_lossy(&self.device).into_owned()
    }

    /// Name of its driver; empty when it was not told.
    #[must_use]
    pub fn driver(&self) -> String {
        String::from_utf8_lossy(&self.driver).into_owned()
    }

    /// How rays are cast, when they are and it was told; as an error, when that may change.
    #[must_use]
    pub fn rays(&self) -> Option<Result<String, String>> {
        let is_told = self.is_driver_whole && self.technique().as_deref() == Some(TechniqueChoice::Rays.name());
        let words = self.driver();
        is_told.then_some(if words.starts_with(UNDECIDED_RAYS) { Err(words) } else { Ok(words) })
    }

    /// Name of the technique that drew, once it was told.
    #[must_use]
    pub fn technique(&self) -> Option<String> {
        self.is_technique_known.then(|| String::from_utf8_lossy(&self.technique).into_owned())
    }

    /// The first sentence of each cause of failure that has not been told yet, with the cause's name.
    pub fn take_untold_failures(&mut self) -> Vec<(String, String)> {
        let untold = self.failures.iter().filter(|(cause, _)| !self.told_failures.contains(*cause));
        let untold: Vec<_> = untold.filter_map(|(cause, told)| Some((cause.clone(), told.first()?.clone()))).collect();
        self.told_failures.extend(untold.iter().map(|(cause, _)| cause.clone()));
        let is_news = |sentence: &str| !self.told_before.iter().any(|told| told.ends_with(sentence));
        untold.into_iter().filter(|(_, sentence)| is_news(sentence)).collect()
    }

    /// The user has been told these sentences before the flight: their failures are no news.
    pub fn note_told(&mut self, sentences: &[String]) {
        self.told_before.extend_from_slice(sentences);
    }

    /// Whether a cause of failure was told while the flight went on.
    #[must_use]
    pub fn is_failure_told(&self, cause: &str) -> bool {
        self.told_failures.contains(cause)
    }

    /// Takes a sentence about a failure, which begins with the name of its cause.
    fn take_failure(&mut self) {
        let text = String::from_utf8_lossy(&self.failure);
        let Some((cause, sentence)) = text.split_once(' ').filter(|_| self.failures.len() < FAILURES) else {
            self.strange_events += 1;
            return;
        };
        let told = self.failures.entry(cause.to_owned()).or_default();
        if told.len() < FAILURES && !told.iter().any(|before| before == sentence) {
            told.push(sentence.to_owned());
        }
    }

    /// Takes one event. It comes from shared memory: numbers are checked, nonsense is counted.
    pub fn take(&mut self, stage: Stage, event: Event) {
        if let Some(trace) = &mut self.trace {
            trace.push((stage, event));
        }
        let Some(kind) = EventKind::from_number(event.kind) else {
            self.strange_events += 1;
            return;
        };
        match kind {
            EventKind::DeviceName => {
                event.collect_text(&mut self.device);
                return;
            }
            EventKind::DriverName => {
                self.is_driver_whole = event.collect_text(&mut self.driver);
                return;
            }
            EventKind::TechniqueName => {
                self.is_technique_known |= event.collect_text(&mut self.technique);
                return;
            }
            EventKind::Failure => {
                if event.collect_text(&mut self.failure) {
                    self.take_failure();
                }
                return;
            }
            EventKind::Span if event.value == SpanName::FetchTile as u64 => {
                self.round_trips_ms.push((event.duration_nanos as f64 / 1e6) as f32);
            }
            EventKind::TileUnavailable => {
                let (is_color, cause) = (event.value & 0xFF == 1, event.value >> 8);
                match NodeId::unpack(event.node) {
                    Some(node) => {
                        self.unavailable.insert(UnavailableTile { is_color, node }, cause);
                    }
                    None => self.strange_events += 1,
                }
                return;
            }
            EventKind::TileCame => {
                let node = NodeId::unpack(event.node);
                let tile = node.map(|node| UnavailableTile { is_color: event.value & 0xFF == 1, node });
                match tile {
                    Some(tile) => {
                        self.unavailable.remove(&tile);
                        self.came_later += 1;
                    }
                    None => self.strange_events += 1,
                }
                return;
            }
            _ => {}
        }
        let index = event.frame.checked_sub(self.first_frame).and_then(|index| usize::try_from(index).ok());
        if let Some(index) = index.filter(|index| (self.frames.len()..self.most_frames).contains(index))
            && index - self.frames.len() < FRAMES_UNDER_WAY
        {
            self.frames.resize(index + 1, FrameFigures::default());
        }
        let Some(frame) = index.and_then(|index| self.frames.get_mut(index)) else {
            // Loading of the locked top levels belongs to no frame.
            self.strange_events += u64::from(kind != EventKind::Span);
            return;
        };
        match kind {
            EventKind::Span => match SpanName::from_number(event.value) {
                Some(name) => {
                    let sum = &mut frame.span_nanos[name as usize - 1];
                    *sum = sum.saturating_add(event.duration_nanos);
                    let is_drawing = matches!(name, SpanName::Record | SpanName::Upload | SpanName::Draw);
                    if is_drawing && (frame.draw_started_nanos == 0 || event.start_nanos < frame.draw_started_nanos) {
                        frame.draw_started_nanos = event.start_nanos;
                    }
                }
                None => self.strange_events += 1,
            },
            EventKind::FrameDone => {
                frame.done_nanos = event.start_nanos;
                frame.triangles = event.value;
            }
            EventKind::FrameWritten => {
                frame.written_nanos = event.start_nanos.saturating_add(event.duration_nanos);
                frame.is_settled = event.value == 1;
            }
            EventKind::FrameWanted => {
                frame.wanted = event.value as u32;
                frame.nodes = (event.value >> 32) as u32;
            }
            EventKind::FrameUploaded => frame.uploaded = frame.uploaded.saturating_add(event.value),
            EventKind::FrameCamera => {
                frame.camera_nanos = event.start_nanos;
                frame.r_px = [event.value as u32, (event.value >> 32) as u32].map(f32::from_bits);
            }
            EventKind::FrameLacked => {
                frame.lacked = event.value as u32;
                frame.sharp = f32::from_bits((event.value >> 32) as u32);
            }
            EventKind::DeviceName
            | EventKind::DriverName
            | EventKind::TechniqueName
            | EventKind::TileUnavailable
            | EventKind::TileCame
            | EventKind::Failure => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn event(kind: EventKind, frame: u64, start: u64, duration: u64, value: u64) -> Event {
        Event { kind: kind as u32, thread: 0, frame, start_nanos: start, duration_nanos: duration, value, node: 0 }
    }

    #[test]
    fn events_become_figures_of_their_frame() {
        let mut collector = Collector::new(10, 2, true);
        collector.take(Stage::Prefetcher, event(EventKind::Span, 11, 5, 7, SpanName::LoadTile as u64));
        collector.take(Stage::Prefetcher, event(EventKind::Span, 11, 9, 3, SpanName::LoadTile as u64));
        collector.take(Stage::Renderer, event(EventKind::Span, 11, 20, 3, SpanName::Record as u64));
        collector.take(Stage::Renderer, event(EventKind::FrameDone, 11, 40, 0, 1234));
        collector.take(Stage::Renderer, event(EventKind::FrameWritten, 11, 50, 2, 1));
        collector.take(Stage::Preparer, event(EventKind::FrameWanted, 11, 0, 0, 7 << 32 | 99));
        for piece in Event::text(EventKind::DeviceName, "llvmpipe (LLVM 15.0.6, 256 bits) and more than one piece") {
            collector.take(Stage::Renderer, piece);
        }
        let frame = collector.frames[1];
        assert_eq!(frame.span_nanos[SpanName::LoadTile as usize - 1], 10);
        assert_eq!((frame.draw_started_nanos, frame.done_nanos, frame.written_nanos), (20, 40, 52));
        assert_eq!((frame.triangles, frame.wanted, frame.nodes, frame.is_settled), (1234, 99, 7, true));
        assert!(collector.device().ends_with("more than one piece"));
        assert_eq!(collector.strange_events, 0);
        assert_eq!(collector.trace.as_ref().map(Vec::len), Some(8));
    }

    #[test]
    fn a_flight_without_a_known_end_has_figures_of_the_frames_that_came() {
        let mut collector = Collector::new(0, 0, false).open_ended(true);
        for frame in 0..3 {
            collector.take(Stage::Renderer, event(EventKind::FrameDone, frame, 7, 0, 1));
        }
        // No healthy stage is so far ahead.
        collector.take(Stage::Renderer, event(EventKind::FrameDone, 1 << 40, 7, 0, 1));
        collector.take(Stage::Renderer, event(EventKind::FrameDone, 100_000, 7, 0, 1));
        assert_eq!((collector.frames.len(), collector.strange_events), (3, 2));
    }

    #[test]
    fn a_tile_is_listed_once_with_its_cause() {
        let mut collector = Collector::new(0, 1, false);
        let node = NodeId::new(3, 4, 1).unwrap();
        for _ in 0..2 {
            let mut event = event(EventKind::TileUnavailable, 0, 0, 0, 1 + 256 * 2);
            event.node = node.pack();
            collector.take(Stage::Preparer, event);
        }
        let listed: Vec<_> = collector.unavailable.iter().collect();
        assert_eq!(listed, [(&UnavailableTile { is_color: true, node }, &2)]);
        // The elevation tile of the same node is another one.
        for (is_color, left) in [(0, 1), (1, 0)] {
            collector
                .take(Stage::Prefetcher, Event { node: node.pack(), ..event(EventKind::TileCame, 0, 0, 0, is_color) });
            assert_eq!(collector.unavailable.len(), left);
        }
    }

    proptest! {
        #[test]
        fn any_event_is_taken(kind in 0u32..20, thread: u32, frame in 0u64..4, value: u64, node: u64, start: u64, duration: u64) {
            let mut collector = Collector::new(1, 2, false);
            let event = Event { kind, thread, frame, start_nanos: start, duration_nanos: duration, value, node };
            collector.take(Stage::Renderer, event);
            collector.take(Stage::Renderer, event);
            prop_assert_eq!(collector.frames.len(), 2);
        }
    }
}
