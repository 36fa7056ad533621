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
//!
//! [`books`] has the lists and what became of the tiles on them, [`dispatch`] does what follows from them.

mod books;
mod dispatch;

use crate::crew::{Crew, Ended};
use crate::window::Window;
use books::{Books, MISSING};
use std::collections::HashSet;
use terravision_common::database::{Layer, Tile};
use terravision_common::outcome::{Outcome, TileOutcome};
use terravision_common::shm::{Activity, Control, Gauge, PoolWriter, Residency, SlotState, Stage, WantHead};
use terravision_common::top_levels::top_levels;
use terravision_common::world::World;

/// How often the view is predicted and the window judged: about 5 times a second (design §9).
pub const CYCLE_NANOS: u64 = 200_000_000;
/// A want list's sequence is at most so many frames ahead of the last that was completed; a larger one is nonsense, and
/// would keep its tiles for ever.
const MOST_AHEAD: u64 = 1 << 16;

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

impl Wish {
    /// All of them, the most urgent first.
    pub const ALL: [Self; 3] = [Self::Now, Self::Top, Self::Ahead];
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
    /// A tile that a frame wants, or one of the top levels, was found to be unavailable; told once for each tile.
    Unavailable {
        /// The tile.
        tile: Tile,
        /// The frame that was the newest when it was asked for.
        frame: u64,
        /// Why: 1 missing, 2 corrupt, 3 cannot be read, 4 refused.
        code: u8,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
    /// A tile that was unavailable came after all.
    Came {
        /// The tile.
        tile: Tile,
        /// When, nanoseconds of the monotonic clock.
        at_nanos: u64,
    },
}

/// See the module.
#[derive(Debug)]
pub struct Desk {
    world: World,
    /// Elevation, colour.
    pools: [PoolWriter; 2],
    head: WantHead,
    books: Books,
    locked: HashSet<Tile>,
    window: Window,
    /// Time from request to residency, smoothed.
    latency_nanos: Option<f64>,
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
            head: WantHead::default(),
            books: Books::new(has_retries),
            locked: top.iter().copied().collect(),
            window: Window::new(CYCLE_NANOS),
            latency_nanos: None,
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
        desk.books.lists[Wish::Top as usize].tiles = top;
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
        self.books.loads.get(&tile).map(|load| load.wish)
    }

    /// What the prefetcher does now, for the launcher to watch.
    #[must_use]
    pub fn activity(&self) -> Activity {
        match (self.books.in_flight(), self.books.loads.len()) {
            (0, 0) => Activity::Awaits(Stage::Preparer),
            (0, _) => Activity::Works,
            _ => Activity::AwaitsStorage,
        }
    }

    fn pool(&mut self, layer: Layer) -> &mut PoolWriter {
        &mut self.pools[layer as usize]
    }

    fn lock(&mut self, tile: Tile) {
        let pool = self.pool(tile.layer);
        if let Some(key) = pool.find(tile.node) {
            pool.lock(key.slot);
        }
    }

    fn has(&self, tile: Tile) -> bool {
        match tile.layer {
            Layer::Elevation => self.world.has_elevation(tile.node),
            Layer::Color => self.world.has_color(tile.node),
        }
    }

    fn tell(&mut self, tile: Tile, outcome: Outcome) {
        self.outcomes.push(TileOutcome::new(tile, outcome));
    }

    /// Takes a new want list, with all that it lacks.
    pub fn want(&mut self, head: WantHead, tiles: &[Tile], now: u64, control: &Control, crew: &mut impl Crew) {
        let sequence = head.sequence.min(control.completed_sequence().saturating_add(MOST_AHEAD));
        self.head = WantHead { sequence, ..head };
        self.told_no_room = [None; 2];
        let mut missing = self.books.take_list(Wish::Now);
        for tile in tiles.iter().copied() {
            if !self.has(tile) {
                self.tell(tile, Outcome::Unavailable { code: MISSING });
                continue;
            }
            match self.pool(tile.layer).touch_node(tile.node, sequence) {
                Residency::Resident { key } => self.tell(tile, Outcome::Resident { key }),
                Residency::Filling => {}
                Residency::Absent => match self.books.is_unavailable(tile, now) {
                    Some(code) => {
                        self.lose(tile, self.head.frame, code, now, control);
                        self.tell(tile, Outcome::Unavailable { code });
                    }
                    None => missing.push(tile),
                },
            }
        }
        control.set_gauge(Gauge::TilesMissing, missing.len() as u64);
        self.books.lists[Wish::Now as usize].tiles = missing;
        self.relist(control, crew);
    }

    /// Takes all tiles that the predicted view wants, coarse to fine: those that are there are kept longer, and the first
    /// N that are not are asked for when nothing more urgent is.
    pub fn expect(&mut self, tiles: impl IntoIterator<Item = Tile>, now: u64, control: &Control, crew: &mut impl Crew) {
        let stamp = self.stamp();
        let most = self.window.n() as usize;
        let mut missing = self.books.take_list(Wish::Ahead);
        for tile in tiles {
            let is_absent = self.pool(tile.layer).expect(tile.node, stamp) == Residency::Absent;
            if is_absent && missing.len() < most && self.has(tile) && self.books.is_unavailable(tile, now).is_none() {
                missing.push(tile);
            }
        }
        let completed = control.completed_sequence();
        self.room_ahead = [0, 1].map(|layer| self.pools[layer].unexpected_slots(stamp, completed));
        control.set_gauge(Gauge::TilesPredicted, missing.len() as u64);
        self.books.lists[Wish::Ahead as usize].tiles = missing;
        self.relist(control, crew);
    }

    /// Sequence that expected tiles are stamped with: that of the newest frame.
    fn stamp(&self) -> u64 {
        self.head.sequence.max(1)
    }

    /// A list has changed: what is on none any more is given up.
    fn relist(&mut self, control: &Control, crew: &mut impl Crew) {
        for tile in self.books.relist() {
            self.cancel(tile, control, crew);
        }
    }
}
