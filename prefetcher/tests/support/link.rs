//! A flight over a database at the end of a simulated link, in simulated time: no clock, no
//! network, no thread.

use super::{MS, SLOT_BYTES};
use bytes::Bytes;
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::time::Duration;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, Tile};
use terravision_common::ids::{FrameNumber, Sequence};
use terravision_common::level::Measure;
use terravision_common::node::NodeId;
use terravision_common::outcome::{Outcome, TileFailure};
use terravision_common::rig::Views;
use terravision_common::run::Prediction;
use terravision_common::shm::{Control, Counter, PoolIndex, WantHead, memory};
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::TreeLimits;
use terravision_common::world::World;
use terravision_prefetcher::executor::{DecodeJob, Ended, Executor};
use terravision_prefetcher::prediction::CameraTrack;
use terravision_prefetcher::prediction::ahead_secs;
use terravision_prefetcher::prediction::{Resolution, WantedTiles};
use terravision_prefetcher::scheduler::{CYCLE_NANOS, Scheduler};
use terravision_store::patience;
use terravision_testkit::worlds;

const SEC: u64 = 1_000_000_000;
const TICK: u64 = 5 * MS;
/// Timeout of a request that is no longer repeated.
const TIMEOUT: Duration = Duration::from_secs(20);
const LIMITS: TreeLimits = TreeLimits { nodes: 32_768, elevation_leaves: 32_768 };

/// Properties of a link.
#[derive(Debug, Clone, Copy)]
pub struct LinkFields {
    /// From a request to the first byte of its answer, on an idle link.
    pub latency_nanos: u64,
    pub bytes_per_sec: u64,
    /// One in this many requests is lost; 0 for none.
    pub loses_one_in: u64,
}

/// A request that has no answer.
#[derive(Debug)]
struct Open {
    tile: Tile,
    /// Its newest message on the wire.
    message: u64,
    sent_at: u64,
    tries: u32,
}

/// Answers requests one by one, in the order in which they reach the server. A lost request is
/// repeated when the store's patience ends.
#[derive(Debug)]
pub struct Link {
    fields: LinkFields,
    pub now: u64,
    /// Requests on their way to the server, or queued there: message, tile, time of arrival.
    line: VecDeque<(u64, Tile, u64)>,
    free_at: u64,
    /// Answers on their way back: time of arrival, message, bytes.
    answers: VecDeque<(u64, u64, usize)>,
    /// By ticket.
    open: BTreeMap<u64, Open>,
    /// Tickets of messages that were not given up.
    ticket_of: HashMap<u64, u64>,
    ended: Vec<Ended>,
    messages: u64,
    /// How long answers take, smoothed.
    usual_nanos: Option<f64>,
    pub bytes: u64,
}

/// SplitMix64 (Steele, Lea and Flood 2014): numbers without a pattern, so that what is asked for
/// anew at a steady pace is not lost at the same pace.
fn mixed(number: u64) -> u64 {
    let mut z = number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Bytes of a tile on the network, including the overhead of a request.
fn bytes_of(tile: Tile) -> usize {
    match tile.layer {
        Layer::Color => 24_000,
        Layer::Elevation => 900,
    }
}

impl Link {
    fn new(fields: LinkFields) -> Self {
        Self {
            fields,
            now: 0,
            line: VecDeque::new(),
            free_at: 0,
            answers: VecDeque::new(),
            open: BTreeMap::new(),
            ticket_of: HashMap::new(),
            ended: vec![],
            messages: 0,
            usual_nanos: None,
            bytes: 0,
        }
    }

    fn advance(&mut self, now: u64) {
        self.now = now;
        let usual = Duration::from_nanos(self.usual_nanos.unwrap_or(0.0) as u64);
        let is_late = |open: &Open| {
            let wait = patience(usual, open.tries).unwrap_or(TIMEOUT);
            u128::from(now - open.sent_at) > wait.as_nanos()
        };
        let late: Vec<u64> = self.open.iter().filter(|(_, open)| is_late(open)).map(|(ticket, _)| *ticket).collect();
        for ticket in late {
            if let Some(open) = self.open.remove(&ticket) {
                self.ticket_of.remove(&open.message);
                self.send(ticket, open.tile, open.tries + 1);
            }
        }
        while let Some(&(message, tile, there_at)) = self.line.front() {
            let begins = there_at.max(self.free_at);
            if begins > now {
                break;
            }
            self.line.pop_front();
            // A request that was cancelled before its first byte was sent costs nothing.
            if !self.ticket_of.contains_key(&message) {
                continue;
            }
            let bytes = bytes_of(tile);
            self.free_at = begins + bytes as u64 * SEC / self.fields.bytes_per_sec;
            self.bytes += bytes as u64;
            self.answers.push_back((self.free_at + self.fields.latency_nanos / 2, message, bytes));
        }
    }

    fn send(&mut self, ticket: u64, tile: Tile, tries: u32) {
        self.messages += 1;
        let message = self.messages;
        self.ticket_of.insert(message, ticket);
        self.open.insert(ticket, Open { tile, message, sent_at: self.now, tries });
        // As if by chance, and the same in every run.
        let chance = mixed(message);
        if self.fields.loses_one_in == 0 || !chance.is_multiple_of(self.fields.loses_one_in) {
            self.line.push_back((message, tile, self.now + self.fields.latency_nanos / 2));
        }
    }
}

impl Executor for Link {
    fn fetch(&mut self, ticket: u64, tile: Tile) {
        self.send(ticket, tile, 0);
    }

    fn cancel(&mut self, ticket: u64) {
        if let Some(open) = self.open.remove(&ticket) {
            self.ticket_of.remove(&open.message);
        }
    }

    fn decode(&mut self, DecodeJob { tile, guard, .. }: DecodeJob) {
        let result = Ok(guard.publish());
        self.ended.push(Ended::Decoded { tile, result, thread: 1, start_nanos: self.now, duration_nanos: 0 });
    }

    fn drain(&mut self, ended: &mut Vec<Ended>) {
        ended.append(&mut self.ended);
        while let Some(&(at_nanos, message, bytes)) = self.answers.front()
            && at_nanos <= self.now
        {
            self.answers.pop_front();
            let Some(ticket) = self.ticket_of.remove(&message) else { continue };
            let Some(open) = self.open.remove(&ticket) else { continue };
            let took = at_nanos.saturating_sub(open.sent_at) as f64;
            let usual = self.usual_nanos.get_or_insert(took);
            *usual += (took - *usual) / 8.0;
            let resent_at_nanos = (open.tries > 0).then_some(open.sent_at);
            ended.push(Ended::Fetched { ticket, result: Ok(Bytes::from(vec![0; bytes])), resent_at_nanos, at_nanos });
        }
    }

    fn recent_failure(&self, _tile: Tile) -> Option<TileFailure> {
        None
    }
}

/// What is known of the flight to come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Foresight {
    None,
    Predicted(Prediction),
    /// The path itself.
    Oracle,
}

/// How a flight went.
#[derive(Debug, Clone)]
pub struct Flown {
    /// By frame: the share of the picture's ground that was drawn as finely as wanted.
    pub sharp: Vec<f64>,
    /// Bytes that came over the link.
    pub bytes: u64,
    pub cancelled: u64,
    /// N at the end of each cycle.
    pub n: Vec<u32>,
    /// Tiles that the last frame lacked.
    pub missing_at_end: usize,
}

impl Flown {
    pub fn mean(&self) -> f64 {
        self.sharp.iter().sum::<f64>() / self.sharp.len() as f64
    }
}

fn world() -> World {
    worlds::world([8192; 2], 10.0, [32, 256])
}

pub const RESOLUTION: Resolution = Resolution { r_z_px: 12.0, r_c_px: 1.5, exaggeration: 1.0, measure: Measure::Area };

/// A flight of `secs` seconds along `path`, 30 frames a second. The oracle asks the path itself.
pub fn fly(link: LinkFields, secs: u64, path: &dyn Fn(f64) -> Camera, foresight: Foresight) -> Flown {
    let world = world();
    let terrain = SyntheticTerrain::new(&world, Relief::Mountains { height_m: 20.0 }, 1);
    let (mut eye, mut ahead) = (WantedTiles::new(&world, terrain, LIMITS), WantedTiles::new(&world, terrain, LIMITS));
    let (elevation_writer, elevation) = memory::pool(8192, SLOT_BYTES).expect("valid");
    let (color_writer, colors) = memory::pool(1024, SLOT_BYTES).expect("valid");
    let mut pools = [PoolIndex::new(elevation), PoolIndex::new(colors)];
    let mut scheduler = Scheduler::new(&world, elevation_writer, color_writer);
    let control = memory::control().expect("a control block");
    let mut link = Link::new(link);
    let mut track = CameraTrack::default();
    let mut flown = Flown { sharp: vec![], bytes: 0, cancelled: 0, n: vec![], missing_at_end: 0 };
    let at = |nanos: u64| {
        Camera::new(CameraFields { timestamp_nanos: nanos, ..*path(nanos as f64 / 1e9).fields() }).expect("valid")
    };
    let mut next_cycle = CYCLE_NANOS;
    for tick in 1..=secs * (SEC / TICK) {
        let now = tick * TICK;
        link.advance(now);
        let frame = now * 30 / SEC;
        if frame > flown.sharp.len() as u64 {
            let camera = at(now);
            track.see(&camera, now);
            let wanted = eye.tiles(&camera, &Views::single(&camera), &RESOLUTION);
            let missing: Vec<Tile> = wanted
                .iter()
                .copied()
                .filter(|tile| !pools[tile.layer as usize].keep(tile.node, Sequence::new(frame)))
                .collect();
            flown.sharp.push(sharp_share(&world, &camera, wanted, &missing));
            flown.missing_at_end = missing.len();
            // Three frames are in flight.
            control.set_completed_sequence(Sequence::new(frame).saturating_sub(3));
            let head = WantHead { sequence: Sequence::new(frame), frame: FrameNumber::new(frame), is_last: false };
            scheduler.want(head, &missing, now, &control, &mut link);
        }
        if now >= next_cycle {
            next_cycle += CYCLE_NANOS;
            scheduler.end_cycle(&control);
            flown.n.push(scheduler.window().n());
            let secs_ahead = ahead_secs(scheduler.latency_nanos());
            match foresight {
                Foresight::None => {}
                Foresight::Predicted(prediction) => {
                    if let Some(camera) = track.predict(now, secs_ahead, prediction) {
                        let tiles = ahead.tiles(&camera, &Views::single(&camera), &RESOLUTION).to_vec();
                        scheduler.expect(tiles, &control, &mut link);
                    }
                }
                Foresight::Oracle => {
                    let mut tiles = vec![];
                    let mut seen = HashSet::new();
                    for step in 1..=8 {
                        let later = now + (secs_ahead * 1e9 * f64::from(step) / 4.0) as u64;
                        let of_then = ahead.tiles(&at(later), &Views::single(&at(later)), &RESOLUTION);
                        tiles.extend(of_then.iter().copied().filter(|tile| seen.insert(*tile)));
                    }
                    scheduler.expect(tiles, &control, &mut link);
                }
            }
        }
        scheduler.step(now, &control, &mut link);
        for outcome in scheduler.outcomes.drain(..) {
            if let Some((tile, Outcome::Resident { key })) = outcome.read() {
                pools[tile.layer as usize].note(tile.node, key);
            }
        }
        scheduler.events.clear();
    }
    flown.bytes = link.bytes;
    flown.cancelled = counter(&control, Counter::TilesCancelled);
    flown
}

fn counter(control: &Control, counter: Counter) -> u64 {
    control.counter(counter)
}

/// The share of a grid of rays that hit ground drawn at the wanted resolution. A node is expanded
/// only when the tiles of all its children are resident.
fn sharp_share(world: &World, camera: &Camera, wanted: &[Tile], missing: &[Tile]) -> f64 {
    let lacking: HashSet<NodeId> = missing.iter().map(|tile| tile.node).collect();
    let mut is_leaf_of: HashMap<NodeId, bool> = wanted.iter().map(|tile| (tile.node, true)).collect();
    // A parent of a wanted node is not a leaf, and can be expanded when none of its children lacks
    // a tile.
    let blocked: HashSet<NodeId> =
        lacking.iter().filter(|node| node.q() + 1 < world.levels()).map(|node| node.parent()).collect();
    let nodes: Vec<NodeId> = is_leaf_of.keys().copied().collect();
    for node in nodes {
        if node.q() + 1 < world.levels()
            && let Some(is_leaf) = is_leaf_of.get_mut(&node.parent())
        {
            *is_leaf = false;
        }
    }
    let (mut ground, mut sharp) = (0u32, 0u32);
    for (i, j) in (0..32).flat_map(|i| (0..18).map(move |j| (i, j))) {
        let px = (f64::from(i) + 0.5) / 32.0 * f64::from(camera.width());
        let py = (f64::from(j) + 0.5) / 18.0 * f64::from(camera.height());
        let ray = camera.ray_in_world(px, py);
        if ray.z >= -1e-6 {
            continue;
        }
        let point = camera.eye() + ray * ((10.0 - camera.eye().z) / ray.z);
        let cell = [point.x, point.y].map(|v| (v / world.lattice_unit_m()).floor());
        if cell.iter().zip(world.extent()).any(|(c, extent)| *c < 0.0 || *c >= f64::from(extent)) {
            continue;
        }
        let nz = f64::from(world.elevation_tile());
        let [m, n] = cell.map(|c| (c / nz) as u32);
        let Some(finest) = NodeId::new(m, n, 0) else { continue };
        let path = (0..world.levels()).map(|q| finest.ancestor(q));
        let Some(leaf) = path.clone().find(|node| is_leaf_of.contains_key(node)) else { continue };
        ground += 1;
        let is_sharp =
            !path.skip(usize::from(leaf.q()) + 1).any(|above| blocked.contains(&above)) && !lacking.contains(&leaf);
        sharp += u32::from(is_sharp);
    }
    f64::from(sharp) / f64::from(ground.max(1))
}
