//! Whole flights through the preparer: the same frames for any number of threads and any memory
//! that suffices, missing tiles drawn from their parents, and errors that end it.

mod support;

use support::flight::{Flight, Frame, Source, limits, most_wanted, path, small_world};
use terravision_common::event::{Event, EventContent, SpanName};
use terravision_common::ids::{FrameNumber, RingPosition, Sequence};
use terravision_common::node::NodeId;
use terravision_common::shm::RunState;
use terravision_common::stage::StageError;
use terravision_common::traversal::Traversal;
use terravision_common::tree::{COLOR_LEAF, ELEVATION_LEAF, TreeHeader, TreeNode};
use terravision_preparer::PreparerError;
use terravision_preparer::stage::Preparer;

fn frames_of(flight: &Flight) -> Vec<Frame> {
    flight.fly().expect("a flight").0
}

#[test]
fn frames_are_the_same_for_any_order_of_tiles_and_any_memory_that_suffices() {
    let flight = Flight::new();
    let frames = frames_of(&flight);
    assert_eq!(frames.len(), 40);
    assert!(frames.windows(2).all(|w| w[0].tiles != w[1].tiles), "the path shows something new in each frame");
    assert!(frames.iter().all(|f| f.end.unavailable_count == 0 && f.tiles.len() > 20));
    let most = most_wanted(&frames);
    for (rotation, slots, in_flight) in [(1, 1500, 1), (40, 1500, 3), (3, most * 2 / 3, 1), (77, most * 2 / 3, 3)] {
        let other = Flight { rotation, color_slots: slots, elevation_slots: slots, in_flight, ..flight.clone() };
        assert!(frames_of(&other) == frames, "rotated by {rotation}, {slots} slots, {in_flight} frames in flight");
    }
}

#[test]
fn a_flight_in_two_parts_has_the_frames_of_the_whole() {
    let whole = frames_of(&Flight { frames: 12, ..Flight::new() });
    // The path begins with the first frame of a flight, so this is the first part, with a cold
    // start of its own.
    let part = frames_of(&Flight { frames: 5, ..Flight::new() });
    assert!(whole[..5] == part[..]);
}

#[test]
fn missing_tiles_are_counted_in_each_frame_and_drawn_from_their_parents() {
    let flight = Flight { source: Source::new(20), ..Flight::new() };
    let frames = frames_of(&flight);
    assert!(frames.iter().any(|f| f.end.unavailable_count > 0));
    // That the slots name resident tiles of the right nodes is what the renderer of these flights
    // checks.
    let other = Flight { rotation: 5, in_flight: 1, ..flight };
    assert!(frames_of(&other) == frames);
}

#[test]
fn every_frame_is_told_with_its_spans_and_what_it_wanted() {
    let (frames, events) = Flight { frames: 6, ..Flight::new() }.fly().expect("a flight");
    for (k, frame) in (100u64..).zip(&frames) {
        let said: Vec<EventContent> =
            events.iter().filter(|e| e.frame().get() == k).filter_map(Event::content).collect();
        let spans = |name: SpanName| said.iter().filter(|c| **c == EventContent::Span { name, node: None }).count();
        assert_eq!((spans(SpanName::AwaitTiles), spans(SpanName::Prepare)), (1, 1));
        let wanted = EventContent::FrameWanted { tiles: frame.end.wanted_count, nodes: frame.end.node_count };
        assert_eq!(said.iter().filter(|content| **content == wanted).count(), 1);
    }
}

#[test]
fn a_frame_that_no_pool_can_hold_is_an_error_that_says_so() {
    let flight = Flight { color_slots: 64, elevation_slots: 80, ..Flight::new() };
    let error = flight.fly().expect_err("too little");
    assert!(error.to_string().contains("--texel-px"), "{error}");
    assert!(!error.is_stopping());
}

#[test]
fn without_the_tiles_of_the_root_there_is_no_picture() {
    let source = Source { is_root_missing: true, ..Source::new(0) };
    let error = Flight { source, ..Flight::new() }.fly().expect_err("no root");
    let PreparerError::RootMissing { frame, .. } = error else { panic!("{error}") };
    assert_eq!(frame, FrameNumber::new(100));
    let told = error.to_string();
    assert!(told.contains("colour tile of the root") && told.ends_with("; ingest the world again"), "{told}");
}

#[test]
fn a_run_that_stops_ends_the_preparer_while_it_waits() {
    let flight = Flight::new();
    let mut parts = flight.parts();
    let mut preparer = Preparer::new(&small_world(), &flight.config(), parts.loader, &mut parts.ports).expect("made");
    parts.control.set_state(RunState::Stopping);
    assert!(preparer.frame(&mut parts.ports).expect_err("stopped").is_stopping());
}

#[test]
fn impossible_trees_and_headers_are_refused() {
    let root = small_world().root();
    let leaf = |node: NodeId| TreeNode {
        node: node.pack(),
        flags: ELEVATION_LEAF | COLOR_LEAF,
        ..bytemuck::Zeroable::zeroed()
    };
    let refused = |change: &dyn Fn(&mut TreeHeader, &mut [TreeNode])| {
        let flight = Flight::new();
        let mut parts = flight.parts();
        let mut preparer =
            Preparer::new(&small_world(), &flight.config(), parts.loader, &mut parts.ports).expect("made");
        let write = parts.trees.write(&parts.control, |nodes| {
            let mut header = TreeHeader {
                frame: 100,
                camera: *path(1)[0].fields(),
                r_z_px: 1.0,
                r_c_px: 1.0,
                node_count: 1,
                ..bytemuck::Zeroable::zeroed()
            };
            nodes[0] = leaf(root);
            change(&mut header, nodes);
            header
        });
        write.expect("written");
        preparer.frame(&mut parts.ports).expect_err("refused").to_string()
    };
    assert!(refused(&|header, _| header.frame = 99).contains("another frame"));
    assert!(refused(&|header, _| header.camera.vfov_rad = f64::NAN).contains("camera"));
    assert!(refused(&|header, _| header.r_c_px = -1.0).contains("resolutions"));
    assert!(refused(&|_, nodes| nodes[0].node = u64::MAX).contains("not a node of this world"));
    assert!(refused(&|_, nodes| nodes[0] = leaf(root.child(0).expect("not the finest"))).contains("expected the root"));
    assert!(refused(&|header, _| header.node_count = 2).contains("node"));
}

#[test]
fn a_frame_in_the_steady_state_allocates_nothing() {
    let flight = Flight { frames: 40, ..Flight::new() };
    let mut parts = flight.parts();
    let mut preparer = Preparer::new(&small_world(), &flight.config(), parts.loader, &mut parts.ports).expect("made");
    let mut traversal = Traversal::new(&small_world(), limits());
    let mut allocations = vec![];
    for (k, camera) in (0..).zip(path(flight.frames)) {
        let made = allocation_counter::measure(|| {
            flight.generate_one(&mut traversal, 100 + k, &camera, &parts.control, &mut parts.trees).expect("written");
            preparer.frame(&mut parts.ports).expect("a frame");
        });
        allocations.push(made.count_total);
        while parts.ring.try_pop().expect("not corrupt").is_some() {}
        parts.elevation.released(RingPosition::new(parts.ports.elevation.next_position())).expect("not corrupt");
        parts.control.set_completed_sequence(Sequence::new(k + 1));
    }
    // The first frame may size buffers of the system's (locks, queues).
    assert_eq!(allocations[2..].iter().sum::<u64>(), 0, "{allocations:?}");
}
