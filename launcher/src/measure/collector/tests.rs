//! What events become.

use super::*;
use proptest::prelude::*;

fn event(kind: EventKind, frame: u64, start: u64, duration: u64, value: u64) -> Event {
    Event { kind: kind as u32, thread: 0, frame, start_nanos: start, duration_nanos: duration, value, node: 0 }
}

#[test]
fn events_become_stats_of_their_frame() {
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
    assert_eq!(collector.malformed_events, 0);
    assert_eq!(collector.trace.as_ref().map(Vec::len), Some(8));
}

#[test]
fn a_flight_without_a_known_end_has_stats_of_the_frames_that_came() {
    let mut collector = Collector::new(0, 0, false).open_ended(true);
    for frame in 0..3 {
        collector.take(Stage::Renderer, event(EventKind::FrameDone, frame, 7, 0, 1));
    }
    // No healthy stage is so far ahead.
    collector.take(Stage::Renderer, event(EventKind::FrameDone, 1 << 40, 7, 0, 1));
    collector.take(Stage::Renderer, event(EventKind::FrameDone, 100_000, 7, 0, 1));
    assert_eq!((collector.frames.len(), collector.malformed_events), (3, 2));
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
        collector.take(Stage::Prefetcher, Event { node: node.pack(), ..event(EventKind::TileCame, 0, 0, 0, is_color) });
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
