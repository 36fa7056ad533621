//! The prefetcher as in a run: handles of real segments, real threads, stored tiles.

mod support;

use proptest::test_runner::{Config, TestRunner};
use std::collections::{HashMap, HashSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use support::{MS, color, elevation, world};
use terravision_common::database::{Layer, Tile, color_tile_bytes, encode_elevation_tile};
use terravision_common::event::{Event, EventContent, SpanName};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::outcome::{Outcome, TileFailure, TileOutcome};
use terravision_common::run::RunConfig;
use terravision_common::shm::{
    Consumer, Control, Counter, PoolReader, RunState, SlotState, WantHead, WantListWriter, memory,
};
use terravision_common::stage::Events;
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::top_levels::top_levels;
use terravision_prefetcher::ports::Ports;
use terravision_prefetcher::source::PayloadSource;
use terravision_prefetcher::stage::{PrefetcherError, serve};
use terravision_store::Payload;

/// Elevation whose heights name their node; no colour. Some requests are never answered.
#[derive(Debug, Clone, Default)]
struct Source {
    dropped: Arc<AtomicU64>,
    asked: Arc<Mutex<Vec<Tile>>>,
    is_stuck: Arc<AtomicBool>,
    failed: Arc<Mutex<HashMap<Tile, TileFailure>>>,
}

fn height(tile: Tile) -> f32 {
    (tile.node.m() * 10 + u32::from(tile.node.q())) as f32
}

/// Counts when a request is dropped that was not answered.
struct Request(Arc<AtomicU64>);

impl Drop for Request {
    fn drop(&mut self) {
        self.0.fetch_add(1, Ordering::SeqCst);
    }
}

impl PayloadSource for Source {
    async fn payload(&self, tile: Tile) -> Result<Payload, TileFailure> {
        self.asked.lock().expect("no panic").push(tile);
        if tile.layer == Layer::Color {
            self.failed.lock().expect("no panic").insert(tile, TileFailure::Missing);
            return Err(TileFailure::Missing);
        }
        if self.is_stuck.load(Ordering::SeqCst) && tile.node.q() == 2 {
            let _request = Request(Arc::clone(&self.dropped));
            std::future::pending::<()>().await;
        }
        let mut payload = encode_elevation_tile(&[height(tile); 25], 5);
        if tile.node.m() == 13 && tile.node.q() == 2 {
            // Damaged on its way.
            payload[20] ^= 1;
        }
        Ok(Payload::new(payload.into()))
    }

    fn recent_failure(&self, tile: Tile) -> Option<TileFailure> {
        self.failed.lock().expect("no panic").get(&tile).copied()
    }

    fn reject(&self, tile: Tile) {
        self.failed.lock().expect("no panic").insert(tile, TileFailure::Damaged);
    }
}

struct Peer {
    control: Arc<Control>,
    wants: WantListWriter,
    outcomes: Consumer<TileOutcome>,
    elevation: PoolReader,
    events: Consumer<Event>,
}

fn config() -> RunConfig {
    serde_json::from_value(serde_json::json!({
        "run_id": "tv-1-2", "world": "/w.tv", "width": 640, "height": 360, "fps": 30.0, "frames": [0, 5],
        "r_z_px": 10.0, "r_c_px": 1.0, "measure": "area", "exaggeration": 1.0, "decoder_threads": 2,
        "prefetch": { "prediction": "linear", "has_retries": false },
        "database": {
            "location": "/w.tv", "cache": null, "cache_bytes": 0, "is_offline": false, "request_timeout_ms": 1,
            "parallel_requests": 1,
        },
        "render": {
            "technique": "mesh", "technique_reason": "asked for", "rays": "sweep", "sky_rgb": [1, 2, 3], "samples": 1, "has_tree_overlay": false, "has_validation": false,
            "frames_in_flight": 2, "sink": "null", "depth": [], "ground": [],
                "anaglyph": false,
        },
    }))
    .expect("valid")
}

/// Runs a prefetcher with `source` beside `peer`, which ends it. Returns its result and its events.
fn with_prefetcher(source: &Source, peer: impl FnOnce(&mut Peer) + Send + 'static) -> Result<Vec<Event>, String> {
    let source = source.clone();
    #[expect(clippy::disallowed_methods, reason = "a test sends a few")]
    let (send, receive) = channel();
    // A test that hangs is a test that fails.
    let thread = std::thread::spawn(move || {
        let control = Arc::new(memory::control().expect("a control block"));
        let (wants_writer, wants) = memory::want_list(256).expect("valid");
        let (outcomes, outcomes_reader) = memory::outcomes(256).expect("valid");
        let (elevation, elevation_reader) = memory::pool(200, 100).expect("valid");
        let (color, _) = memory::pool(100, color_tile_bytes(&world()) as u64).expect("valid");
        let (told, events) = memory::ring::<Event>(4096).expect("valid");
        let ports = Ports {
            control: Arc::clone(&control),
            wants,
            outcomes,
            elevation,
            color,
            path: None,
            events: Events::new(told),
        };
        let terrain = SyntheticTerrain::new(&world(), Relief::Mountains { height_m: 100.0 }, 1);
        let served = std::thread::spawn(move || serve(&world(), terrain, &config(), source, ports));
        let mut other =
            Peer { control, wants: wants_writer, outcomes: outcomes_reader, elevation: elevation_reader, events };
        peer(&mut other);
        let result: Result<(), PrefetcherError> = served.join().expect("no panic");
        let events = std::iter::from_fn(|| other.events.try_pop().expect("not corrupt")).collect();
        send.send(result.map(|()| events).map_err(|error| error.to_string())).expect("somebody waits");
    });
    let result = receive.recv_timeout(Duration::from_secs(60)).expect("it ends in time");
    thread.join().expect("no panic");
    result
}

impl Peer {
    fn want(&mut self, sequence: u64, tiles: &[Tile]) {
        self.wants.publish(
            WantHead {
                sequence: Sequence::new(sequence),
                frame: FrameNumber::new(sequence.saturating_add(100)),
                is_last: false,
            },
            tiles,
        );
    }

    fn end(&mut self) {
        self.wants.publish(WantHead { is_last: true, ..WantHead::default() }, &[]);
    }

    /// Waits until each of these tiles has an outcome.
    fn outcomes_of(&mut self, tiles: &[Tile]) -> HashMap<Tile, Outcome> {
        let mut found = HashMap::new();
        while !tiles.iter().all(|tile| found.contains_key(tile)) {
            let outcome = self.outcomes.pop(&self.control).expect("the run goes on");
            found.extend(outcome.read());
        }
        found
    }
}

#[test]
fn wanted_tiles_are_decoded_into_their_slots_and_told_with_their_spans() {
    let source = Source::default();
    let wanted = [elevation(3), elevation(13), color(3), elevation(7)];
    let events = with_prefetcher(&source, move |peer| {
        peer.want(1, &wanted);
        let outcomes = peer.outcomes_of(&wanted);
        for tile in [elevation(3), elevation(7)] {
            let Outcome::Resident { key } = outcomes[&tile] else { panic!("{tile} is not there") };
            let bytes = peer.elevation.bytes(key).expect("readable");
            assert_eq!(bytes.f32()[..25], [height(tile); 25]);
        }
        assert_eq!(outcomes[&elevation(13)], Outcome::Unavailable { failure: TileFailure::Damaged });
        assert_eq!(outcomes[&color(3)], Outcome::Unavailable { failure: TileFailure::Missing });
        // The top levels come without being asked for, and stay.
        let (top, _) = top_levels(&world());
        peer.want(2, &top);
        let outcomes = peer.outcomes_of(&top);
        for tile in top.iter().filter(|tile| tile.layer == Layer::Elevation) {
            let Outcome::Resident { key } = outcomes[tile] else { panic!("{tile} is not there") };
            assert_eq!(peer.elevation.info(key.slot).map(|info| info.state), Some(SlotState::Locked));
        }
        assert_eq!(peer.control.counter(Counter::TilesUnavailable), 2 + 21);
        peer.end();
    });
    let events = events.expect("it ends in order");
    let spans = |name: SpanName| {
        let of_name =
            move |event: &&Event| matches!(event.content(), Some(EventContent::Span { name: n, .. }) if n == name);
        events.iter().filter(of_name).collect::<Vec<_>>()
    };
    let asked = source.asked.lock().expect("no panic").clone();
    assert_eq!(asked.iter().collect::<HashSet<_>>().len(), asked.len(), "no tile is asked for twice");
    assert_eq!(spans(SpanName::FetchTile).len(), asked.len());
    assert_eq!(spans(SpanName::LoadTile).len(), asked.iter().filter(|tile| tile.layer == Layer::Elevation).count());
    let told = events.iter().filter_map(|event| match event.content()? {
        EventContent::TileUnavailable { tile, failure } => Some((tile, failure, event.frame().get())),
        _ => None,
    });
    let told: Vec<_> = told.collect();
    assert_eq!(told.len(), 2 + 21, "each once");
    assert!(told.contains(&(elevation(13), TileFailure::Damaged, 101)));
}

#[test]
fn a_request_that_nothing_wants_any_more_is_dropped() {
    let source = Source { is_stuck: Arc::new(AtomicBool::new(true)), ..Source::default() };
    let dropped = Arc::clone(&source.dropped);
    let result = with_prefetcher(&source.clone(), move |peer| {
        peer.want(1, &[elevation(1), elevation(2)]);
        // Both are under way.
        while !source.asked.lock().expect("no panic").contains(&elevation(2)) {
            std::thread::sleep(Duration::from_nanos(MS));
        }
        peer.want(2, &[elevation(2)]);
        while dropped.load(Ordering::SeqCst) == 0 {
            std::thread::sleep(Duration::from_nanos(MS));
        }
        // The other ends with the run, answered or not.
        peer.end();
    });
    assert!(result.is_ok(), "{result:?}");
}

#[test]
fn a_run_that_stops_or_a_list_that_cannot_be_ends_it() {
    let stopped = with_prefetcher(&Source::default(), |peer| peer.control.set_state(RunState::Stopping));
    assert_eq!(stopped.expect_err("it was stopped"), "the run is stopping");
    let mut runner = TestRunner::new(Config { cases: 8, failure_persistence: None, ..Config::default() });
    let sequences = proptest::arbitrary::any::<u64>();
    runner
        .run(&sequences, |sequence| {
            // Any sequence is served, and frames after it too.
            let served = with_prefetcher(&Source::default(), move |peer| {
                peer.want(sequence, &[elevation(4)]);
                peer.outcomes_of(&[elevation(4)]);
                peer.want(3, &[elevation(5)]);
                peer.outcomes_of(&[elevation(5)]);
                peer.end();
            });
            assert!(served.is_ok(), "{served:?}");
            Ok(())
        })
        .expect("all cases");
}
