//! The desk: which tiles are asked for, in which order, what is given up, and what is evicted for what.
//!
//! Three lists say what is wanted: what the newest frame lacks, what of the top levels is not there yet, and what the
//! predicted view lacks, each coarse to fine, in this order. A list replaces the one before; what is on none of them is
//! given up, waiting in line or on the wire. A tile's states:
//!
//! ```text
//!            the window has a place             payload           a slot            decoded
//!  (listed) ──────────────────────▶ Fetching ───────────▶ Arrived ───────▶ Decoding ───────▶ (resident)
//!     ▲ ▲                             │  │                   │                 │
//!     │ └── on no list, or no answer ─┘  │ no such tile ...  │ on no list      │ damaged
//!     │                                  ▼                   ▼                 ▼
//!     └─────── after a while ─────── Unavailable          (given up)      Unavailable
//! ```
//!
//! Every tile of a new want list that is there, or that cannot be had, is told again: a preparer that lost its memory
//! learns it so. Slots: a tile that a frame wants takes the one that was longest neither wanted nor expected, of those
//! that no frame in flight names; a tile that is only expected takes none that is wanted or expected now.

use crate::crew::{Crew, DecodeJob, Ended};
use crate::window::{CycleNumber, Window};
use bytes::Bytes;
use std::collections::{HashMap, HashSet};
use terravision_common::database::{Layer, Tile};
use terravision_common::outcome::{Outcome, TileOutcome};
use terravision_common::shm::{Control, Counter, Gauge, PoolWriter, Residency, SlotState, WantHead};
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;

/// How often the view is predicted and the window judged: about 5 times a second (design §9).
pub const CYCLE_NANOS: u64 = 200_000_000;
/// Payloads of a layer that wait for a slot or a decoder, at most: more are not asked for before these are through.
const HELD: usize = 64;
/// A request that has no answer for this long is made again...
const FIRST_PATIENCE_NANOS: u64 = 600_000_000;
/// ... and after so many times left to its source, which knows when to give up.
const IMPATIENT_TRIES: u32 = 5;
/// A tile that could not be had is left alone for this long, where it is tried again at all ...
const RETRY_NANOS: u64 = 2_000_000_000;
/// ... and one that the database says it has not, for this long.
const RETRY_MISSING_NANOS: u64 = 60_000_000_000;
/// A want list's sequence is at most so many frames ahead of the last that was completed; a larger one is nonsense, and
/// would keep its tiles for ever.
const MOST_AHEAD: u64 = 1 << 16;
/// The code of a tile that the database has not.
const MISSING: u8 = 1;

/// Why a tile is asked for; the more urgent first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Wish {
    /// The newest frame lacks it.
    Now,
    /// It is of the top levels.
    Top,
    /// The predicted view lacks it.
    Ahead,
}

#[derive(Debug)]
enum State {
    Fetching { ticket: u64, asked_at: u64, cycle: CycleNumber },
    Arrived { payload: Bytes },
    Decoding,
}

#[derive(Debug)]
struct Load {
    state: State,
    wish: Wish,
    /// The frame that was the newest when it was asked for.
    frame: u64,
    asked_at: u64,
    /// The lists that it was last found on.
    epoch: u64,
}

#[derive(Debug, Clone, Copy)]
struct Unavailable {
    code: u8,
    /// When it is tried again; `None` for never.
    until: Option<u64>,
}

/// What the launcher is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum News {
    /// A request was answered.
    Fetched {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was made.
        frame: u64,
        /// When it was made, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
    /// A tile was decoded, or could not be.
    Decoded {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: u64,
        /// The thread, from 1.
        thread: u32,
        /// When it began, nanoseconds of the monotonic clock.
        start_nanos: u64,
        /// How long it took.
        duration_nanos: u64,
    },
    /// A tile was found to be unavailable; told once for each tile.
    Unavailable {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: u64,
        /// Why: 1 missing, 2 corrupt, 3 cannot be read.
        code: u8,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
}

/// A list and how far it has been asked for.
#[derive(Debug, Default)]
struct List {
    tiles: Vec<Tile>,
    at: usize,
}

/// See the module.
#[derive(Debug)]
pub struct Desk {
    world: World,
    /// Elevation, colour.
    pools: [PoolWriter; 2],
    has_retries: bool,
    head: WantHead,
    /// By [`Wish`].
    lists: [List; 3],
    locked: HashSet<Tile>,
    loads: HashMap<Tile, Load>,
    tile_of: HashMap<u64, Tile>,
    unavailable: HashMap<Tile, Unavailable>,
    told_unavailable: HashSet<Tile>,
    tries: HashMap<Tile, u32>,
    window: Window,
    /// Time from request to residency, smoothed.
    latency_nanos: Option<f64>,
    next_ticket: u64,
    epoch: u64,
    /// Loads by layer that have arrived and are not through.
    held: [usize; 2],
    decoding: [usize; 2],
    /// Tiles of a list were passed over because too many of their layer are held.
    is_passed_over: bool,
    /// Slots by layer that expected tiles may still take.
    room_ahead: [u32; 2],
    /// By layer: the completed sequence at which the preparer was told that there is no room.
    told_no_room: [Option<u64>; 2],
    filled: [u64; 2],
    ended: Vec<Ended>,
    /// For the preparer, in order; the stage takes them.
    pub outcomes: Vec<TileOutcome>,
    /// For the launcher, in order; the stage takes them.
    pub news: Vec<News>,
}

impl Desk {
    /// A desk that fills these pools. `has_retries`: tiles that could not be had are tried again after a while.
    #[must_use]
    pub fn new(world: &World, elevation: PoolWriter, color: PoolWriter, has_retries: bool) -> Self {
        let (top, _) = top_levels(world);
        // Of a prefetcher before this one.
        let held = |pool: &PoolWriter| pool.slots().filter(|slot| slot.state != SlotState::Free).count() as u64;
        let filled = [held(&elevation), held(&color)];
        let mut desk = Self {
            world: *world,
            pools: [elevation, color],
            has_retries,
            head: WantHead::default(),
            lists: Default::default(),
            locked: top.iter().copied().collect(),
            loads: HashMap::new(),
            tile_of: HashMap::new(),
            unavailable: HashMap::new(),
            told_unavailable: HashSet::new(),
            tries: HashMap::new(),
            window: Window::new(CYCLE_NANOS),
            latency_nanos: None,
            next_ticket: 0,
            epoch: 0,
            held: [0; 2],
            decoding: [0; 2],
            is_passed_over: false,
            room_ahead: [0; 2],
            told_no_room: [None; 2],
            filled,
            ended: Vec::new(),
            outcomes: Vec::new(),
            news: Vec::new(),
        };
        // A prefetcher before this one may have loaded them.
        for tile in &top {
            desk.lock(*tile);
        }
        desk.lists[Wish::Top as usize].tiles = top;
        desk
    }

    /// The window of requests.
    #[must_use]
    pub fn window(&self) -> &Window {
        &self.window
    }

    /// How long a tile takes from its request until it is there, smoothed; `None` before the first.
    #[must_use]
    pub fn latency_nanos(&self) -> Option<u64> {
        self.latency_nanos.map(|nanos| nanos as u64)
    }

    /// The newest want list's head.
    #[must_use]
    pub fn head(&self) -> WantHead {
        self.head
    }

    /// Why a tile is on its way; `None` when it is not.
    #[must_use]
    pub fn wish_of(&self, tile: Tile) -> Option<Wish> {
        self.loads.get(&tile).map(|load| load.wish)
    }

    fn pool(&mut self, layer: Layer) -> &mut PoolWriter {
        &mut self.pools[layer as usize]
    }

    fn lock(&mut self, tile: Tile) {
        let pool = self.pool(tile.layer);
        if let Some((slot, _)) = pool.find(tile.node) {
            pool.lock(slot);
        }
    }

    fn has(&self, tile: Tile) -> bool {
        match tile.layer {
            Layer::Elevation => self.world.has_elevation(tile.node),
            Layer::Color => self.world.has_color(tile.node),
        }
    }

    fn is_unavailable(&self, tile: Tile, now: u64) -> Option<u8> {
        let unavailable = self.unavailable.get(&tile)?;
        unavailable.until.is_none_or(|until| now < until).then_some(unavailable.code)
    }

    fn tell(&mut self, tile: Tile, outcome: Outcome) {
        self.outcomes.push(TileOutcome::new(tile, outcome));
    }

    /// Takes a new want list, with all that it lacks.
    pub fn want(&mut self, head: WantHead, tiles: &[Tile], now: u64, control: &Control, crew: &mut impl Crew) {
        let sequence = head.sequence.min(control.completed_sequence().saturating_add(MOST_AHEAD));
        self.head = WantHead { sequence, ..head };
        self.told_no_room = [None; 2];
        let mut missing = std::mem::take(&mut self.lists[Wish::Now as usize].tiles);
        missing.clear();
        for tile in tiles.iter().copied() {
            if !self.has(tile) {
                self.tell(tile, Outcome::Unavailable { code: MISSING });
                continue;
            }
            match self.pool(tile.layer).touch_node(tile.node, sequence) {
                Residency::Resident { slot, generation } => self.tell(tile, Outcome::Resident { slot, generation }),
                Residency::Filling => {}
                Residency::Absent => match self.is_unavailable(tile, now) {
                    Some(code) => self.tell(tile, Outcome::Unavailable { code }),
                    None => missing.push(tile),
                },
            }
        }
        control.set_gauge(Gauge::TilesMissing, missing.len() as u64);
        self.lists[Wish::Now as usize].tiles = missing;
        self.relist(control, crew);
    }

    /// Takes all tiles that the predicted view wants, coarse to fine: those that are there are kept longer, and the first
    /// N that are not are asked for when nothing more urgent is.
    pub fn expect(&mut self, tiles: impl IntoIterator<Item = Tile>, now: u64, control: &Control, crew: &mut impl Crew) {
        let stamp = self.stamp();
        let most = self.window.n() as usize;
        let mut missing = std::mem::take(&mut self.lists[Wish::Ahead as usize].tiles);
        missing.clear();
        for tile in tiles {
            let is_absent = self.pool(tile.layer).expect(tile.node, stamp) == Residency::Absent;
            if is_absent && missing.len() < most && self.has(tile) && self.is_unavailable(tile, now).is_none() {
                missing.push(tile);
            }
        }
        let completed = control.completed_sequence();
        self.room_ahead = [0, 1].map(|layer| self.pools[layer].unexpected_slots(stamp, completed));
        control.set_gauge(Gauge::TilesPredicted, missing.len() as u64);
        self.lists[Wish::Ahead as usize].tiles = missing;
        self.relist(control, crew);
    }

    /// Sequence that expected tiles are stamped with: that of the newest frame.
    fn stamp(&self) -> u64 {
        self.head.sequence.max(1)
    }

    /// A list has changed: what is on none any more is given up.
    fn relist(&mut self, control: &Control, crew: &mut impl Crew) {
        self.epoch += 1;
        for wish in [Wish::Now, Wish::Top, Wish::Ahead] {
            let list = &mut self.lists[wish as usize];
            list.at = 0;
            for tile in &list.tiles {
                if let Some(load) = self.loads.get_mut(tile)
                    && load.epoch != self.epoch
                {
                    (load.epoch, load.wish) = (self.epoch, wish);
                }
            }
        }
        let epoch = self.epoch;
        let is_left = |load: &Load| load.epoch != epoch && !matches!(load.state, State::Decoding);
        let mut left: Vec<Tile> = self.loads.iter().filter(|(_, load)| is_left(load)).map(|(tile, _)| *tile).collect();
        left.sort_unstable_by_key(|tile| tile.pack());
        for tile in left {
            if let Some(cycle) = self.give_up(tile, control, crew) {
                self.window.cancelled(cycle);
            }
        }
    }

    /// Ends a load that is not being decoded. The cycle of its request, if that was under way.
    fn give_up(&mut self, tile: Tile, control: &Control, crew: &mut impl Crew) -> Option<CycleNumber> {
        match self.loads.remove(&tile)?.state {
            State::Fetching { ticket, cycle, .. } => {
                self.tile_of.remove(&ticket);
                crew.cancel(ticket);
                control.count(Counter::TilesCancelled, 1);
                Some(cycle)
            }
            State::Arrived { .. } => {
                self.held[tile.layer as usize] -= 1;
                None
            }
            State::Decoding => None,
        }
    }

    /// Takes what has ended, finds room for what has arrived, asks for more.
    pub fn step(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        let mut ended = std::mem::take(&mut self.ended);
        crew.drain(&mut ended);
        for ended in ended.drain(..) {
            match ended {
                Ended::Fetched { ticket, result, at_nanos } => self.fetched(ticket, result, at_nanos, control),
                Ended::Decoded { tile, result, thread, start_nanos, duration_nanos } => {
                    let end = start_nanos.saturating_add(duration_nanos);
                    if let Some(load) = self.loads.get(&tile) {
                        let frame = load.frame;
                        self.news.push(News::Decoded { tile, frame, thread, start_nanos, duration_nanos });
                    }
                    self.decoded(tile, result, end, control);
                }
            }
        }
        self.ended = ended;
        self.place(control, crew);
        self.ask(now, control, crew);
        control.set_gauge(Gauge::TilesInFlight, self.tile_of.len() as u64);
    }

    fn fetched(&mut self, ticket: u64, result: Result<Bytes, u8>, at_nanos: u64, control: &Control) {
        // One that was given up a moment ago has no tile any more.
        let Some(tile) = self.tile_of.remove(&ticket) else { return };
        let Some(load) = self.loads.get_mut(&tile) else { return };
        let State::Fetching { asked_at, cycle, .. } = load.state else { return };
        let latency = at_nanos.saturating_sub(asked_at);
        let frame = load.frame;
        self.news.push(News::Fetched { tile, frame, start_nanos: asked_at, duration_nanos: latency });
        match result {
            Ok(payload) => {
                self.window.came(cycle, latency);
                control.count(Counter::TilesReceived, 1);
                control.count(Counter::BytesReceived, payload.len() as u64);
                load.state = State::Arrived { payload };
                self.held[tile.layer as usize] += 1;
            }
            Err(code) => {
                // "There is none" is an answer; anything else is a loss.
                if code == MISSING {
                    self.window.came(cycle, latency);
                }
                self.fail(tile, code, at_nanos, control);
            }
        }
    }

    fn fail(&mut self, tile: Tile, code: u8, now: u64, control: &Control) {
        let frame = self.loads.remove(&tile).map_or(self.head.frame, |load| load.frame);
        let wait = if code == MISSING { RETRY_MISSING_NANOS } else { RETRY_NANOS };
        let until = self.has_retries.then(|| now.saturating_add(wait));
        self.unavailable.insert(tile, Unavailable { code, until });
        if self.told_unavailable.insert(tile) {
            control.count(Counter::TilesUnavailable, 1);
            self.news.push(News::Unavailable { tile, frame, code, at_nanos: now });
        }
        self.tell(tile, Outcome::Unavailable { code });
    }

    fn decoded(&mut self, tile: Tile, result: Result<(u32, u32), u8>, now: u64, control: &Control) {
        self.held[tile.layer as usize] -= 1;
        self.decoding[tile.layer as usize] -= 1;
        match result {
            Ok((slot, generation)) => {
                control.count(Counter::TilesLoaded, 1);
                self.unavailable.remove(&tile);
                self.tries.remove(&tile);
                if self.locked.contains(&tile) {
                    self.lock(tile);
                }
                if let Some(load) = self.loads.remove(&tile) {
                    let latency = now.saturating_sub(load.asked_at) as f64;
                    let smoothed = self.latency_nanos.get_or_insert(latency);
                    *smoothed += (latency - *smoothed) / 8.0;
                }
                self.tell(tile, Outcome::Resident { slot, generation });
            }
            Err(code) => self.fail(tile, code, now, control),
        }
    }

    /// Finds slots for payloads that have arrived: the urgent first.
    fn place(&mut self, control: &Control, crew: &mut impl Crew) {
        if self.held == self.decoding {
            return;
        }
        let is_arrived = |load: &Load| matches!(load.state, State::Arrived { .. });
        let mut arrived: Vec<(Wish, u8, Tile)> = self
            .loads
            .iter()
            .filter(|(_, load)| is_arrived(load))
            .map(|(tile, load)| (load.wish, u8::MAX - tile.node.q(), *tile))
            .collect();
        arrived.sort_unstable_by_key(|(wish, depth, tile)| (*wish, *depth, tile.pack()));
        let completed = control.completed_sequence();
        let (sequence, stamp) = (self.head.sequence, self.stamp());
        let mut is_full = [false; 2];
        for (wish, _, tile) in arrived {
            let layer = tile.layer as usize;
            if is_full[layer] && wish != Wish::Ahead {
                continue;
            }
            let pool = &mut self.pools[layer];
            let guard = match wish {
                Wish::Now => pool.allocate(tile.node, sequence, completed),
                Wish::Top => pool.allocate(tile.node, 0, completed),
                Wish::Ahead if is_full[layer] => None,
                Wish::Ahead => pool.allocate_expected(tile.node, stamp, completed),
            };
            let Some(guard) = guard else {
                if wish == Wish::Ahead {
                    // The view came to want other tiles than were expected.
                    self.give_up(tile, control, crew);
                } else {
                    is_full[layer] = true;
                    self.no_room(tile, completed);
                }
                continue;
            };
            self.filled[layer] += 1;
            if self.filled[layer] > u64::from(self.pools[layer].capacity()) {
                control.count(Counter::TilesEvicted, 1);
            }
            if let Some(load) = self.loads.get_mut(&tile)
                && let State::Arrived { payload } = std::mem::replace(&mut load.state, State::Decoding)
            {
                self.decoding[layer] += 1;
                crew.decode(DecodeJob { tile, payload, guard });
            }
        }
    }

    /// Nothing of the tile's layer finds room; the preparer has to know when nothing here is going to change that.
    fn no_room(&mut self, tile: Tile, completed: u64) {
        let layer = tile.layer as usize;
        if self.decoding[layer] == 0 && self.told_no_room[layer] != Some(completed) {
            self.told_no_room[layer] = Some(completed);
            self.tell(tile, Outcome::NoRoom { completed });
        }
    }

    /// Asks for what is listed, as far as the window goes.
    fn ask(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        if std::mem::take(&mut self.is_passed_over) {
            self.lists.iter_mut().for_each(|list| list.at = 0);
        }
        for wish in [Wish::Now, Wish::Top, Wish::Ahead] {
            while let Some(tile) = self.next(wish, now) {
                if self.held[tile.layer as usize] >= HELD {
                    self.is_passed_over = true;
                    self.lists[wish as usize].at += 1;
                    continue;
                }
                let mut place = self.window.ask();
                if place.is_none() && wish == Wish::Now && self.give_up_predicted(control, crew) {
                    place = self.window.ask();
                }
                let Some(cycle) = place else { return };
                self.lists[wish as usize].at += 1;
                if wish == Wish::Ahead {
                    self.room_ahead[tile.layer as usize] -= 1;
                }
                let ticket = self.next_ticket;
                self.next_ticket += 1;
                let state = State::Fetching { ticket, asked_at: now, cycle };
                let load = Load { state, wish, frame: self.head.frame, asked_at: now, epoch: self.epoch };
                self.loads.insert(tile, load);
                self.tile_of.insert(ticket, tile);
                control.count(Counter::TilesRequested, 1);
                crew.fetch(ticket, tile);
            }
        }
    }

    /// Gives up the predicted tile that was asked for last, for one that is needed now; `false` when there is none.
    fn give_up_predicted(&mut self, control: &Control, crew: &mut impl Crew) -> bool {
        let ticket_of = |load: &Load| match load.state {
            State::Fetching { ticket, .. } if load.wish == Wish::Ahead => Some(ticket),
            _ => None,
        };
        let last = self.loads.iter().filter_map(|(tile, load)| Some((ticket_of(load)?, *tile))).max_by_key(|l| l.0);
        let Some((_, tile)) = last else { return false };
        if let Some(cycle) = self.give_up(tile, control, crew) {
            self.window.cancelled(cycle);
        }
        true
    }

    /// The next tile of a list that has to be asked for; the list then stands at it.
    fn next(&mut self, wish: Wish, now: u64) -> Option<Tile> {
        loop {
            let list = &self.lists[wish as usize];
            let tile = *list.tiles.get(list.at)?;
            let is_known = self.loads.contains_key(&tile) || self.is_unavailable(tile, now).is_some();
            let has_room = wish != Wish::Ahead || self.room_ahead[tile.layer as usize] > 0;
            if !is_known && has_room && self.pool(tile.layer).residency(tile.node) == Residency::Absent {
                return Some(tile);
            }
            self.lists[wish as usize].at += 1;
        }
    }

    /// A cycle is over: the window is judged, and requests without an answer are made again.
    pub fn end_cycle(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        self.window.end_cycle();
        let mut late = Vec::new();
        for (tile, load) in &self.loads {
            let tries = self.tries.get(tile).copied().unwrap_or(0);
            if let State::Fetching { asked_at, .. } = load.state
                && tries < IMPATIENT_TRIES
                && now.saturating_sub(asked_at) > self.patience_nanos() << tries
            {
                late.push(*tile);
            }
        }
        late.sort_unstable_by_key(|tile: &Tile| tile.pack());
        for tile in late {
            // For the window it is lost: it did not come.
            self.give_up(tile, control, crew);
            *self.tries.entry(tile).or_insert(0) += 1;
        }
        for list in &mut self.lists {
            list.at = 0;
        }
        control.set_gauge(Gauge::PrefetchWindow, self.window.n().into());
        control.set_gauge(Gauge::TileLatencyNanos, self.latency_nanos().unwrap_or(0));
        control.set_gauge(Gauge::ReceivedPerMillion, (self.window.share() * 1e6) as u64);
    }

    /// How long the first request for a tile waits for its answer.
    fn patience_nanos(&self) -> u64 {
        let usual = self.window.latency_nanos().unwrap_or(0);
        FIRST_PATIENCE_NANOS.max(usual.saturating_mul(4))
    }
}
