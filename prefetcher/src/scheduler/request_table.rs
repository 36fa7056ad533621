//! The request table: what is listed, what is on its way, and how far it has come.

use super::Priority;
use crate::request_window::CycleNumber;
use bytes::Bytes;
use std::collections::{HashMap, HashSet};
use terravision_common::database::Tile;
use terravision_common::ids::FrameNumber;

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
    pub(super) priority: Priority,
    /// The frame that was the newest when it was asked for.
    pub(super) frame: FrameNumber,
    pub(super) asked_at: u64,
    /// The lists that it was last found on.
    epoch: u64,
}

/// A list and how far it has been asked for.
#[derive(Debug, Default)]
pub(super) struct List {
    pub(super) tiles: Vec<Tile>,
    pub(super) at: usize,
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct RequestTable {
    /// By [`Priority`].
    pub(super) lists: [List; 3],
    pub(super) loads: HashMap<Tile, Load>,
    tile_of: HashMap<u64, Tile>,
    told_unavailable: HashSet<Tile>,
    next_ticket: u64,
    epoch: u64,
    /// Loads by layer that have arrived and are not through.
    pub(super) held: [usize; 2],
    pub(super) decoding: [usize; 2],
}

impl RequestTable {
    /// Requests that have no answer.
    pub(super) fn in_flight(&self) -> usize {
        self.tile_of.len()
    }

    /// Takes a list out, empty, to be filled anew and put back.
    pub(super) fn take_list(&mut self, priority: Priority) -> Vec<Tile> {
        let mut tiles = std::mem::take(&mut self.lists[priority as usize].tiles);
        tiles.clear();
        tiles
    }

    /// All lists are asked for from their beginning again.
    pub(super) fn rewind(&mut self) {
        self.lists.iter_mut().for_each(|list| list.at = 0);
    }

    /// Lists have changed: what is on its way takes its priority from them. Returns what is on none any more, but for what is
    /// being decoded.
    pub(super) fn relist(&mut self) -> Vec<Tile> {
        self.epoch += 1;
        self.rewind();
        for priority in Priority::ALL {
            for tile in &self.lists[priority as usize].tiles {
                if let Some(load) = self.loads.get_mut(tile)
                    && load.epoch != self.epoch
                {
                    (load.epoch, load.priority) = (self.epoch, priority);
                }
            }
        }
        let is_left = |load: &Load| load.epoch != self.epoch && !matches!(load.state, State::Decoding);
        let mut left: Vec<Tile> = self.loads.iter().filter(|(_, load)| is_left(load)).map(|(tile, _)| *tile).collect();
        left.sort_unstable_by_key(|tile| tile.pack());
        left
    }

    /// A request is made; its ticket.
    pub(super) fn ask(
        &mut self,
        tile: Tile,
        priority: Priority,
        frame: FrameNumber,
        now: u64,
        cycle: CycleNumber,
    ) -> u64 {
        let ticket = self.next_ticket;
        self.next_ticket += 1;
        let state = State::Fetching { ticket, asked_at: now, cycle };
        self.loads.insert(tile, Load { state, priority, frame, asked_at: now, epoch: self.epoch });
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

    /// A tile cannot be read: its load ends. What it was asked for, if it still was.
    pub(super) fn fail(&mut self, tile: Tile) -> Option<Load> {
        self.loads.remove(&tile)
    }

    /// A frame lacks a tile that cannot be read. Whether this is the first time.
    pub(super) fn is_first_told(&mut self, tile: Tile) -> bool {
        self.told_unavailable.insert(tile)
    }

    /// A tile is there. Its load, if it was one.
    pub(super) fn arrived(&mut self, tile: Tile) -> Option<Load> {
        self.loads.remove(&tile)
    }

    /// The predicted tile that was asked for last and has not come.
    pub(super) fn last_predicted(&self) -> Option<Tile> {
        let ticket_of = |load: &Load| match load.state {
            State::Fetching { ticket, .. } if load.priority == Priority::Ahead => Some(ticket),
            _ => None,
        };
        let open = self.loads.iter().filter_map(|(tile, load)| Some((ticket_of(load)?, *tile)));
        open.max_by_key(|(ticket, _)| *ticket).map(|(_, tile)| tile)
    }

    /// Payloads that wait for a slot, the urgent first.
    pub(super) fn waiting(&self) -> Vec<(Priority, Tile)> {
        let is_arrived = |load: &Load| matches!(load.state, State::Arrived { .. });
        let waiting = self.loads.iter().filter(|(_, load)| is_arrived(load));
        let mut waiting: Vec<(Priority, Tile)> = waiting.map(|(tile, load)| (load.priority, *tile)).collect();
        waiting.sort_unstable_by_key(|(priority, tile)| (*priority, u8::MAX - tile.node.q(), tile.pack()));
        waiting
    }

    /// A tile is there. Whether it was told as unavailable before.
    pub(super) fn came(&mut self, tile: Tile) -> bool {
        self.told_unavailable.remove(&tile)
    }
}
