//! Fixtures of the prefetcher's tests: a world, and an executor under the control of the test.
#![allow(dead_code, unreachable_pub, reason = "each test binary uses a part")]

pub mod link;

use bytes::Bytes;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terravision_common::database::{Layer, Tile};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::node::NodeId;
use terravision_common::outcome::{Outcome, TileFailure};
use terravision_common::shm::{Control, PoolReader, WantHead, memory};
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;
use terravision_prefetcher::executor::{DecodeJob, Ended, Executor};
use terravision_prefetcher::scheduler::Scheduler;
use terravision_store::{Cause, FailedTiles, Fault, FetchError, NegativeCache};
use terravision_testkit::worlds;

pub const MS: u64 = 1_000_000;
pub const SLOT_BYTES: u64 = 64;

pub fn world() -> World {
    worlds::world([512; 2], 10.0, [4, 64])
}

pub fn tile(layer: Layer, m: u32, q: u8) -> Tile {
    Tile { layer, node: NodeId::new(m, 1, q).expect("in range") }
}

/// A colour tile below the top levels.
pub fn color(m: u32) -> Tile {
    tile(Layer::Color, m, 2)
}

pub fn elevation(m: u32) -> Tile {
    tile(Layer::Elevation, m, 2)
}

/// Requests stay open until the test answers them; decoding takes no time.
#[derive(Debug)]
pub struct FakeExecutor {
    /// Every request that was made, in order.
    pub requests: Vec<(u64, Tile)>,
    pub cancelled: Vec<u64>,
    /// Decodings are kept until [`FakeExecutor::decode_all`].
    pub is_decoding_held: bool,
    pub jobs: Vec<DecodeJob>,
    ended: Vec<Ended>,
    /// The store's own policy, in simulated time.
    failed: NegativeCache,
    begun: Instant,
    now: u64,
}

/// An error that a store would have for a failure.
fn error_of(failure: TileFailure) -> FetchError {
    let cause = match failure {
        TileFailure::Missing => return FetchError::Absent,
        TileFailure::Damaged => Cause::Damaged,
        TileFailure::Unreadable => Cause::Server,
        TileFailure::Refused => Cause::NotFound,
        TileFailure::NotCached => Cause::Offline,
    };
    FetchError::Failed { fault: Arc::new(Fault { cause, why: String::new(), place: String::new() }) }
}

impl FakeExecutor {
    fn new(failed_tiles: FailedTiles) -> Self {
        let (top, _) = top_levels(&world());
        Self {
            requests: vec![],
            cancelled: vec![],
            is_decoding_held: false,
            jobs: vec![],
            ended: vec![],
            failed: NegativeCache::new(failed_tiles, world().coarsest_level(), top),
            begun: Instant::now(),
            now: 0,
        }
    }

    /// Tiles that were asked for and neither answered nor given up.
    pub fn open(&self) -> Vec<Tile> {
        let is_open = |ticket: &u64| !self.cancelled.contains(ticket);
        self.requests.iter().filter(|(ticket, _)| is_open(ticket)).map(|(_, tile)| *tile).collect()
    }

    pub fn asked(&self) -> Vec<Tile> {
        self.requests.iter().map(|(_, tile)| *tile).collect()
    }

    fn close(&mut self, tile: Tile) -> u64 {
        let at = self.requests.iter().rposition(|(_, t)| *t == tile).expect("it was asked for");
        self.requests.remove(at).0
    }

    pub fn answer(&mut self, tile: Tile, at_nanos: u64) {
        let ticket = self.close(tile);
        self.ended.push(Ended::Fetched {
            ticket,
            result: Ok(Bytes::from_static(b"payload")),
            resent_at_nanos: None,
            at_nanos,
        });
    }

    pub fn refuse(&mut self, tile: Tile, failure: TileFailure, at_nanos: u64) {
        let ticket = self.close(tile);
        self.failed.note(tile, Some(&error_of(failure)), self.begun + Duration::from_nanos(at_nanos));
        self.ended.push(Ended::Fetched { ticket, result: Err(failure), resent_at_nanos: None, at_nanos });
    }

    pub fn answer_all(&mut self, at_nanos: u64) {
        for tile in self.open() {
            self.answer(tile, at_nanos);
        }
    }

    pub fn decode_all(&mut self, start_nanos: u64) {
        for DecodeJob { tile, guard, .. } in self.jobs.drain(..) {
            let result = Ok(guard.publish());
            self.ended.push(Ended::Decoded { tile, result, thread: 1, start_nanos, duration_nanos: 0 });
        }
    }
}

impl Executor for FakeExecutor {
    fn fetch(&mut self, ticket: u64, tile: Tile) {
        self.requests.push((ticket, tile));
    }

    fn cancel(&mut self, ticket: u64) {
        assert!(self.requests.iter().any(|(t, _)| *t == ticket), "what was answered is not given up");
        self.cancelled.push(ticket);
    }

    fn decode(&mut self, job: DecodeJob) {
        self.jobs.push(job);
        if !self.is_decoding_held {
            self.decode_all(0);
        }
    }

    fn drain(&mut self, ended: &mut Vec<Ended>) {
        ended.append(&mut self.ended);
    }

    fn recent_failure(&self, tile: Tile) -> Option<TileFailure> {
        let now = self.begun + Duration::from_nanos(self.now);
        self.failed.find(tile, now).map(|error| error.failure())
    }
}

/// A scheduler with a fake executor, and what it told so far.
pub struct Fixture {
    pub scheduler: Scheduler,
    pub executor: FakeExecutor,
    pub control: Control,
    pub elevation: PoolReader,
    pub colors: PoolReader,
    pub now: u64,
}

impl Fixture {
    pub fn new(slots: u32, failed_tiles: FailedTiles) -> Self {
        let (elevation_writer, elevation) = memory::pool(slots, SLOT_BYTES).expect("valid");
        let (color_writer, colors) = memory::pool(slots, SLOT_BYTES).expect("valid");
        let scheduler = Scheduler::new(&world(), elevation_writer, color_writer);
        let control = memory::control().expect("a control block");
        Self { scheduler, executor: FakeExecutor::new(failed_tiles), control, elevation, colors, now: 1 }
    }

    /// With the top levels loaded, and nothing told of it.
    pub fn warmed(slots: u32, failed_tiles: FailedTiles) -> Self {
        let mut fixture = Self::new(slots, failed_tiles);
        for _ in 0..4 {
            fixture.step();
            fixture.executor.answer_all(fixture.now);
        }
        fixture.step();
        fixture.step();
        assert!(fixture.executor.requests.is_empty(), "all of the top levels are there");
        fixture.scheduler.outcomes.clear();
        fixture.scheduler.events.clear();
        fixture
    }

    pub fn want(&mut self, sequence: u64, tiles: &[Tile]) {
        let head =
            WantHead { sequence: Sequence::new(sequence), frame: FrameNumber::new(100 + sequence), is_last: false };
        self.executor.now = self.now;
        self.scheduler.want(head, tiles, self.now, &self.control, &mut self.executor);
        self.step();
    }

    pub fn expect(&mut self, tiles: &[Tile]) {
        self.executor.now = self.now;
        self.scheduler.expect(tiles.iter().copied(), &self.control, &mut self.executor);
        self.step();
    }

    pub fn step(&mut self) {
        // Twice: a fake executor decodes at once, and the scheduler hears of it at its next step.
        for _ in 0..2 {
            self.scheduler.step(self.now, &self.control, &mut self.executor);
        }
    }

    /// Time passes; cycles end.
    pub fn pass(&mut self, cycles: u64) {
        for _ in 0..cycles {
            self.now += 200 * MS;
            self.executor.now = self.now;
            self.scheduler.end_cycle(&self.control);
            self.step();
        }
    }

    pub fn told(&mut self) -> Vec<(Tile, Outcome)> {
        self.scheduler.outcomes.drain(..).map(|outcome| outcome.read().expect("it can be read")).collect()
    }

    pub fn reader(&self, layer: Layer) -> &PoolReader {
        match layer {
            Layer::Elevation => &self.elevation,
            Layer::Color => &self.colors,
        }
    }

    pub fn is_there(&self, tile: Tile) -> bool {
        self.reader(tile.layer).find(tile.node).is_some()
    }
}
