//! The scheduler: which tiles are asked for, in which order, what is given up, and what is evicted for what.
//!
//! Three lists say what is wanted: what the newest frame lacks, what of the top levels is not there yet, and what the
//! predicted view lacks, each coarse to fine, in this order. A list replaces the one before; what is on none of them is
//! given up, waiting in line or on the wire. A tile's states:
//!
//! ```text
//!            the window has a place             payload           a slot            decoded
//!  (listed) ──────────────────────▶ Fetching ───────────▶ Arrived ───────▶ Decoding ───────▶ (resident)
//!     ▲ ▲                             │  │                   │                 │
//!     │ └───────── on no list ────────┘  │ failure           │ on no list      │ damaged
//!     │                                  ▼                   ▼                 ▼
//!     └── the store allows it ──── Unavailable           (given up)      Unavailable
//! ```
//!
//! When a tile that could not be read is asked for again is for the store to say ([`Executor::recent_failure`]), and so is
//! when a request is made anew. The scheduler asks, re-prioritises and cancels (docs/retries.md).
//!
//! Every tile of a new want list that is there, or that cannot be read, is told again: a preparer that lost its memory
//! learns it so. Slots: a tile that a frame wants takes the one that was longest neither wanted nor expected, of those
//! that no frame in flight names; a tile that is only expected takes none that is wanted or expected now.
//!
//! [`request_table`] has the lists and what became of the tiles on them, [`dispatch`] does what follows from them.

mod dispatch;
mod event;
mod request_table;

use crate::executor::{Ended, Executor};
use crate::request_window::RequestWindow;
pub use event::TileEvent;
use request_table::RequestTable;
use std::collections::HashSet;
use terravision_common::database::{Layer, Tile};
use terravision_common::ids::Sequence;
use terravision_common::outcome::{Outcome, TileFailure, TileOutcome};
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
pub enum Priority {
    /// The newest frame lacks it.
    Now,
    /// It is of the top levels.
    Top,
    /// The predicted view lacks it.
    Ahead,
}

impl Priority {
    /// All of them, the most urgent first.
    pub const ALL: [Self; 3] = [Self::Now, Self::Top, Self::Ahead];
}

/// See the module.
#[derive(Debug)]
pub struct Scheduler {
    world: World,
    /// Elevation, colour.
    pools: [PoolWriter; 2],
    head: WantHead,
    table: RequestTable,
    locked: HashSet<Tile>,
    window: RequestWindow,
    /// Time from request to residency, smoothed.
    latency_nanos: Option<f64>,
    /// Tiles of a list were passed over because too many of their layer are held.
    is_passed_over: bool,
    /// Slots by layer that expected tiles may still take.
    room_ahead: [u32; 2],
    /// By layer: the completed sequence at which the preparer was told that there is no room.
    told_no_room: [Option<Sequence>; 2],
    filled: [u64; 2],
    ended: Vec<Ended>,
    /// For the preparer, in order; the stage takes them.
    pub outcomes: Vec<TileOutcome>,
    /// For the launcher, in order; the stage takes them.
    pub events: Vec<TileEvent>,
}

impl Scheduler {
    /// A scheduler that fills these pools.
    #[must_use]
    pub fn new(world: &World, elevation: PoolWriter, color: PoolWriter) -> Self {
        let (top, _) = top_levels(world);
        // Of a prefetcher before this one.
        let held = |pool: &PoolWriter| pool.slots().filter(|slot| slot.state != SlotState::Free).count() as u64;
        let filled = [held(&elevation), held(&color)];
        let mut scheduler = Self {
            world: *world,
            pools: [elevation, color],
            head: WantHead::default(),
            table: RequestTable::default(),
            locked: top.iter().copied().collect(),
            window: RequestWindow::new(CYCLE_NANOS),
            latency_nanos: None,
            is_passed_over: false,
            room_ahead: [0; 2],
            told_no_room: [None; 2],
            filled,
            ended: Vec::new(),
            outcomes: Vec::new(),
            events: Vec::new(),
        };
        // A prefetcher before this one may have loaded them.
        for tile in &top {
            scheduler.lock(*tile);
        }
        scheduler.table.lists[Priority::Top as usize].tiles = top;
        scheduler
    }

    /// The window of requests.
    #[must_use]
    pub fn window(&self) -> &RequestWindow {
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
    pub fn priority_of(&self, tile: Tile) -> Option<Priority> {
        self.table.loads.get(&tile).map(|load| load.priority)
    }

    /// What the prefetcher does now, for the launcher to watch.
    #[must_use]
    pub fn activity(&self) -> Activity {
        match (self.table.in_flight(), self.table.loads.len()) {
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
    pub fn want(&mut self, head: WantHead, tiles: &[Tile], now: u64, control: &Control, executor: &mut impl Executor) {
        let sequence = head.sequence.min(control.completed_sequence().saturating_add(MOST_AHEAD));
        self.head = WantHead { sequence, ..head };
        self.told_no_room = [None; 2];
        let mut missing = self.table.take_list(Priority::Now);
        for tile in tiles.iter().copied() {
            if !self.has(tile) {
                self.tell(tile, Outcome::Unavailable { failure: TileFailure::Missing });
                continue;
            }
            match self.pool(tile.layer).touch_node(tile.node, sequence) {
                Residency::Resident { key } => self.tell(tile, Outcome::Resident { key }),
                Residency::Filling => {}
                Residency::Absent => match executor.recent_failure(tile) {
                    Some(failure) => {
                        self.lose(tile, self.head.frame, failure, now, control);
                        self.tell(tile, Outcome::Unavailable { failure });
                    }
                    None => missing.push(tile),
                },
            }
        }
        control.set_gauge(Gauge::TilesMissing, missing.len() as u64);
        self.table.lists[Priority::Now as usize].tiles = missing;
        self.relist(control, executor);
    }

    /// Takes all tiles that the predicted view wants, coarse to fine: those that are there are kept longer, and the first
    /// N that are not are asked for when nothing more urgent is.
    pub fn expect(&mut self, tiles: impl IntoIterator<Item = Tile>, control: &Control, executor: &mut impl Executor) {
        let stamp = self.stamp();
        let most = self.window.n() as usize;
        let mut missing = self.table.take_list(Priority::Ahead);
        for tile in tiles {
            let is_absent = self.pool(tile.layer).expect(tile.node, stamp) == Residency::Absent;
            if is_absent && missing.len() < most && self.has(tile) && executor.recent_failure(tile).is_none() {
                missing.push(tile);
            }
        }
        let completed = control.completed_sequence();
        self.room_ahead = [0, 1].map(|layer| self.pools[layer].unexpected_slots(stamp, completed));
        control.set_gauge(Gauge::TilesPredicted, missing.len() as u64);
        self.table.lists[Priority::Ahead as usize].tiles = missing;
        self.relist(control, executor);
    }

    /// Sequence that expected tiles are stamped with: that of the newest frame.
    fn stamp(&self) -> Sequence {
        self.head.sequence.max(Sequence::FIRST)
    }

    /// A list has changed: what is on none any more is given up.
    fn relist(&mut self, control: &Control, executor: &mut impl Executor) {
        for tile in self.table.relist() {
            self.cancel(tile, control, executor);
        }
    }
}
