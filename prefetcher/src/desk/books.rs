//! The desk's books: what is listed, what is on its way, what cannot be had.

use super::Wish;
use crate::window::CycleNumber;
use bytes::Bytes;
use std::collections::{HashMap, HashSet};
use terravision_common::database::Tile;

/// A tile that could not be had is left alone for this long, where it is tried again at all ...
const RETRY_NANOS: u64 = 2_000_000_000;
/// ... and one that the database says it has not, for this long.
const RETRY_MISSING_NANOS: u64 = 60_000_000_000;
/// The code of a tile that the database has not.
pub(super) const MISSING: u8 = 1;

/// How far a tile has come.
#[derive(Debug)]
pub(super) enum State {
    Fetching { ticket: u64, asked_at: u64, cycle: CycleNumber },
    Arrived { payload: Bytes },
    Decoding,
}

/// A tile on its way.
#[derive(Debug)]
pub(super) struct Load {
    pub(super) state: State,
    pub(super) wish: Wish,
    /// The frame that was the newest when it was asked for.
    pub(super) frame: u64,
    pub(super) asked_at: u64,
    /// The lists that it was last found on.
    epoch: u64,
}

#[derive(Debug, Clone, Copy)]
struct Unavailable {
    code: u8,
    /// When it is tried again; `None` for never.
    until: Option<u64>,
}

/// A list and how far it has been asked for.
#[derive(Debug, Default)]
pub(super) struct List {
    pub(super) tiles: Vec<Tile>,
    pub(super) at: usize,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Books {
    has_retries: bool,
    /// By [`Wish`].
    pub(super) lists: [List; 3],
    pub(super) loads: HashMap<Tile, Load>,
    tile_of: HashMap<u64, Tile>,
    unavailable: HashMap<Tile, Unavailable>,
    told_unavailable: HashSet<Tile>,
    tries: HashMap<Tile, u32>,
    next_ticket: u64,
    epoch: u64,
    /// Loads by layer that have arrived and are not through.
    pub(super) held: [usize; 2],
    pub(super) decoding: [usize; 2],
}

impl Books {
    pub(super) fn new(has_retries: bool) -> Self {
        Self {
            has_retries,
            lists: Default::default(),
            loads: HashMap::new(),
            tile_of: HashMap::new(),
            unavailable: HashMap::new(),
            told_unavailable: HashSet::new(),
            tries: HashMap::new(),
            next_ticket: 0,
            epoch: 0,
            held: [0; 2],
            decoding: [0; 2],
        }
    }

    /// Requests that have no answer.
    pub(super) fn in_flight(&self) -> usize {
        self.tile_of.len()
    }

    /// Takes a list out, empty, to be filled anew and put back.
    pub(super) fn take_list(&mut self, wish: Wish) -> Vec<Tile> {
        let mut tiles = std::mem::take(&mut self.lists[wish as usize].tiles);
        tiles.clear();
        tiles
    }

    /// All lists are asked for from their beginning again.
    pub(super) fn rewind(&mut self) {
        self.lists.iter_mut().for_each(|list| list.at = 0);
    }

    /// Lists have changed: what is on its way takes its wish from them. Returns what is on none any more, but for what is
    /// being decoded.
    pub(super) fn relist(&mut self) -> Vec<Tile> {
        self.epoch += 1;
        self.rewind();
        for wish in Wish::ALL {
            for tile in &self.lists[wish as usize].tiles {
                if let Some(load) = self.loads.get_mut(tile)
                    && load.epoch != self.epoch
                {
                    (load.epoch, load.wish) = (self.epoch, wish);
                }
            }
        }
        let is_left = |load: &Load| load.epoch != self.epoch && !matches!(load.state, State::Decoding);
        let mut left: Vec<Tile> = self.loads.iter().filter(|(_, load)| is_left(load)).map(|(tile, _)| *tile).collect();
        left.sort_unstable_by_key(|tile| tile.pack());
        left
    }

    /// A request is made; its ticket.
    pub(super) fn ask(&mut self, tile: Tile, wish: Wish, frame: u64, now: u64, cycle: CycleNumber) -> u64 {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let state = State::Fetching { ticket, asked_at: now, cycle };
        self.loads.insert(tile, Load { state, wish, frame, asked_at: now, epoch: self.epoch });
        self.tile_of.insert(ticket, tile);
        ticket
    }

    /// An answer came: the tile, and its load; `None` of one that was given up a moment ago.
    pub(super) fn answered(&mut self, ticket: u64) -> Option<(Tile, &mut Load)> {
        let tile = self.tile_of.remove(&ticket)?;
        Some((tile, self.loads.get_mut(&tile)?))
    }

    /// A load ends before its tile is there. Of a request that was under way: its ticket and its cycle.
    pub(super) fn give_up(&mut self, tile: Tile) -> Option<(u64, CycleNumber)> {
        match self.loads.remove(&tile)?.state {
            State::Fetching { ticket, cycle, .. } => {
                self.tile_of.remove(&ticket);
                Some((ticket, cycle))
            }
            State::Arrived { .. } => {
                self.held[tile.layer as usize] -= 1;
                None
            }
            State::Decoding => None,
        }
    }

    /// Notes that a tile cannot be had. What it was asked for, if it still was.
    pub(super) fn fail(&mut self, tile: Tile, code: u8, now: u64) -> Option<Load> {
        let load = self.loads.remove(&tile);
        let wait = if code == MISSING { RETRY_MISSING_NANOS } else { RETRY_NANOS };
        let until = self.has_retries.then(|| now.saturating_add(wait));
        self.unavailable.insert(tile, Unavailable { code, until });
        load
    }

    /// A frame lacks a tile that cannot be had. Whether this is the first time.
    pub(super) fn is_first_told(&mut self, tile: Tile) -> bool {
        self.told_unavailable.insert(tile)
    }

    /// A tile is there. Its load, if it was one.
    pub(super) fn arrived(&mut self, tile: Tile) -> Option<Load> {
        self.unavailable.remove(&tile);
        self.tries.remove(&tile);
        self.loads.remove(&tile)
    }

    /// Why a tile cannot be had, as long as it is left alone.
    pub(super) fn is_unavailable(&self, tile: Tile, now: u64) -> Option<u8> {
        let unavailable = self.unavailable.get(&tile)?;
        unavailable.until.is_none_or(|until| now < until).then_some(unavailable.code)
    }

    /// Whether there is no sense in asking for a tile now.
    pub(super) fn is_known(&self, tile: Tile, now: u64) -> bool {
        self.loads.contains_key(&tile) || self.is_unavailable(tile, now).is_some()
    }

    /// The predicted tile that was asked for last and has not come.
    pub(super) fn last_predicted(&self) -> Option<Tile> {
        let ticket_of = |load: &Load| match load.state {
            State::Fetching { ticket, .. } if load.wish == Wish::Ahead => Some(ticket),
            _ => None,
        };
        let open = self.loads.iter().filter_map(|(tile, load)| Some((ticket_of(load)?, *tile)));
        open.max_by_key(|(ticket, _)| *ticket).map(|(_, tile)| tile)
    }

    /// Payloads that wait for a slot, the urgent first.
    pub(super) fn waiting(&self) -> Vec<(Wish, Tile)> {
        let is_arrived = |load: &Load| matches!(load.state, State::Arrived { .. });
        let waiting = self.loads.iter().filter(|(_, load)| is_arrived(load));
        let mut waiting: Vec<(Wish, Tile)> = waiting.map(|(tile, load)| (load.wish, *tile)).collect();
        waiting.sort_unstable_by_key(|(wish, tile)| (*wish, u8::MAX - tile.node.q(), tile.pack()));
        waiting
    }

    /// A tile is there. Whether it was told as unavailable before.
    pub(super) fn came(&mut self, tile: Tile) -> bool {
        self.told_unavailable.remove(&tile)
    }

    /// Requests that have waited for longer than `patience`, doubled with each try, `most` tries: they are to be made again.
    pub(super) fn late(&mut self, now: u64, patience: u64, most: u32) -> Vec<Tile> {
        let mut late = Vec::new();
        for (tile, load) in &self.loads {
            let tries = self.tries.get(tile).copied().unwrap_or(0);
            if let State::Fetching { asked_at, .. } = load.state
                && tries < most
                && now.saturating_sub(asked_at) > patience << tries
            {
                late.push(*tile);
            }
        }
        late.sort_unstable_by_key(|tile: &Tile| tile.pack());
        for tile in &late {
            *self.tries.entry(*tile).or_insert(0) += 1;
        }
        late
    }
}
