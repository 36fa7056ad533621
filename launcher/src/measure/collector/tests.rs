//! What events become.

use super::*;
use proptest::prelude::*;
use terravision_common::database::Layer;
use terravision_common::ids::FrameNumber;
use terravision_common::node::NodeId;

fn event(content: EventContent, frame: u64, start: u64, duration: u64) -> Event {
    Event::new(content).of_frame(FrameNumber::new(frame)).at(start).lasting(duration)
}

fn span(name: SpanName) -> EventContent {
    EventContent::Span { name, node: None }
}

#[test]
fn events_become_stats_of_their_frame() {
    let mut collector = Collector::new(FrameNumber::new(10), 2, true);
    collector.take(Stage::Prefetcher, event(span(SpanName::LoadTile), 11, 5, 7));
    collector.take(Stage::Prefetcher, event(span(SpanName::LoadTile), 11, 9, 3));
    collector.take(Stage::Renderer, event(span(SpanName::Record), 11, 20, 3));
    collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: 1234 }, 11, 40, 0));
    collector.take(Stage::Renderer, event(EventContent::FrameWritten { is_settled: true }, 11, 50, 2));
    collector.take(Stage::Preparer, event(EventContent::FrameWanted { tiles: 99, nodes: 7 }, 11, 0, 0));
    for piece in Event::text(TextKind::Device, "llvmpipe (LLVM 15.0.6, 256 bits) and more than one piece") {
        collector.take(Stage::Renderer, piece);
    }
    let frame = collector.frames[1];
    assert_eq!(frame.span_nanos[SpanName::LoadTile as usize - 1], 10);
    assert_eq!((frame.draw_started_nanos, frame.done_nanos, frame.written_nanos), (20, 40, 52));
    assert_eq!((frame.triangles, frame.wanted, frame.nodes, frame.is_settled), (1234, 99, 7, true));
    assert!(collector.device().ends_with("more than one piece"));
    assert_eq!(collector.malformed_events, 0);
    assert_eq!(collector.trace.as_ref().map(Vec::len), Some(8));
}

#[test]
fn a_flight_without_a_known_end_has_stats_of_the_frames_that_came() {
    let mut collector = Collector::new(FrameNumber::new(0), 0, false).open_ended(false);
    for frame in 0..3 {
        collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: 1 }, frame, 7, 0));
    }
    // No healthy stage is so far ahead.
    collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: 1 }, 1 << 40, 7, 0));
    collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: 1 }, 100_000, 7, 0));
    assert_eq!((collector.frames.len(), collector.malformed_events), (3, 2));
}

#[test]
fn of_a_flight_that_nobody_reports_of_the_last_frames_are_kept() {
    let mut collector = Collector::new(FrameNumber::new(5), 0, false).open_ended(true);
    let last = 5 + 10 * KEPT as u64;
    for frame in 5..=last {
        collector.take(Stage::Prefetcher, event(span(SpanName::FetchTile), frame, 1, 1_000_000));
        collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: frame }, frame, 7, 0));
        assert!(collector.frames.len() <= 2 * KEPT && collector.round_trips_ms.len() <= 2 * KEPT);
    }
    let kept = collector.frames.len() as u64;
    assert!(kept >= KEPT as u64 && collector.forgotten() + kept == last - 4, "{kept} kept");
    assert_eq!(collector.frames.last().map(|frame| frame.triangles), Some(last));
    // An event about a frame that was forgotten comes late, and makes sense.
    collector.take(Stage::Renderer, event(EventContent::FrameDone { triangles: 1 }, 6, 7, 0));
    assert_eq!(collector.malformed_events, 0);
    collector.end_after(last - 6);
    assert_eq!(collector.frames.last().map(|frame| frame.triangles), Some(last - 2));
}

#[test]
fn a_tile_is_listed_once_with_its_cause() {
    let mut collector = Collector::new(FrameNumber::new(0), 1, false);
    let node = NodeId::new(3, 4, 1).unwrap();
    let [elevation, color] = [Layer::Elevation, Layer::Color].map(|layer| Tile { layer, node });
    let unavailable = EventContent::TileUnavailable { tile: color, failure: TileFailure::Damaged };
    for _ in 0..2 {
        collector.take(Stage::Preparer, event(unavailable, 0, 0, 0));
    }
    let listed: Vec<_> = collector.unavailable.iter().collect();
    assert_eq!(listed, [(&color, &TileFailure::Damaged)]);
    // The elevation tile of the same node is another one.
    for (tile, left) in [(elevation, 1), (color, 0)] {
        collector.take(Stage::Prefetcher, event(EventContent::TileCame { tile }, 0, 0, 0));
        assert_eq!(collector.unavailable.len(), left);
    }
}

proptest! {
    #[test]
    fn any_event_is_taken(words in prop::array::uniform6(any::<u64>()), kind in 0u32..20, frame in 0u64..4) {
        let mut collector = Collector::new(FrameNumber::new(1), 2, false);
        // The kind is the first number of an event, the frame begins eight bytes later.
        let mut words = words;
        (words[0], words[1]) = (words[0] << 32 | u64::from(kind), frame);
        let event: Event = bytemuck::cast(words);
        collector.take(Stage::Renderer, event);
        collector.take(Stage::Renderer, event);
        prop_assert_eq!(collector.frames.len(), 2);
    }
}
