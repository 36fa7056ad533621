//! The scheduler: which tiles are requested, in which order, which requests are cancelled, and
//! which tiles are evicted.
//!
//! There are three lists of wanted tiles, in order of priority: tiles that the newest frame lacks,
//! missing tiles of the top levels, and tiles that the predicted view lacks. Each list is sorted
//! coarse to fine. A new list replaces the one before. Tiles that are on no list are given up,
//! whether queued or in flight. The states of a tile:
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
//! The store decides when a tile that could not be read is requested again
//! ([`Executor::recent_failure`]), and when a request is repeated. The scheduler asks,
//! re-prioritises and cancels (docs/retries.md).
//!
//! For each new want list, the outcomes of all tiles that are resident or cannot be read are sent
//! again, so that a restarted preparer learns them. Slots: a tile that a frame wants takes the slot
//! that has been neither wanted nor predicted for the longest time, of those that no frame in
//! flight uses. A tile that is only predicted never takes a slot that is wanted or predicted now.
//!
//! [`request_table`] holds the lists and the states of their tiles, [`dispatch`] acts on them.

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

/// How often the view is predicted and the window adapted: 5 times a second.
pub const CYCLE_NANOS: u64 = 200_000_000;
/// Upper bound of how far the sequence of a want list is ahead of the last completed frame. A
/// larger one is invalid, and its tiles would never be evicted.
const MOST_AHEAD: u64 = 1 << 16;

/// Why a tile is requested, the most urgent first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// The newest frame lacks it.
    Now,
    /// It belongs to the top levels.
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
    /// Tiles of a list were skipped because too many payloads of their layer wait.
    is_passed_over: bool,
    /// For each layer, the number of slots that predicted tiles may still take.
    room_ahead: [u32; 2],
    /// For each layer, the completed sequence at which the preparer was told that there is no room.
    told_no_room: [Option<Sequence>; 2],
    filled: [u64; 2],
    ended: Vec<Ended>,
    /// Outcomes for the preparer, in order; the stage takes them.
    pub outcomes: Vec<TileOutcome>,
    /// Events for the launcher, in order; the stage takes them.
    pub events: Vec<TileEvent>,
}

impl Scheduler {
    /// A scheduler that fills these pools.
    #[must_use]
    pub fn new(world: &World, elevation: PoolWriter, color: PoolWriter) -> Self {
        let (top, _) = top_levels(world);
        // Left by an earlier prefetcher.
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
        // An earlier prefetcher may have loaded them.
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

    /// Time from the request of a tile until it is resident, smoothed; `None` before the first.
    #[must_use]
    pub fn latency_nanos(&self) -> Option<u64> {
        self.latency_nanos.map(|nanos| nanos as u64)
    }

    /// The newest want list's head.
    #[must_use]
    pub fn head(&self) -> WantHead {
        self.head
    }

    /// Why a tile is being loaded; `None` when it is not.
    #[must_use]
    pub fn priority_of(&self, tile: Tile) -> Option<Priority> {
        self.table.loads.get(&tile).map(|load| load.priority)
    }

    /// The current activity, for the launcher's supervision.
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

    /// Takes a new want list: `tiles` are the missing tiles of its frame.
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

    /// Takes all tiles that the predicted view wants, coarse to fine. Resident ones are kept
    /// longer; the first N that are missing are requested when nothing is more urgent.
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

    /// The sequence with which predicted tiles are stamped: that of the newest frame.
    fn stamp(&self) -> Sequence {
        self.head.sequence.max(Sequence::FIRST)
    }

    /// To be called when a list has changed: gives up tiles that are on no list any more.
    fn relist(&mut self, control: &Control, executor: &mut impl Executor) {
        for tile in self.table.relist() {
            self.cancel(tile, control, executor);
        }
    }
}
