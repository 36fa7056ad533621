//! The request table: listed tiles, loads, and their states.

use super::Priority;
use crate::request_window::CycleNumber;
use bytes::Bytes;
use std::collections::{HashMap, HashSet};
use terravision_common::database::Tile;
use terravision_common::ids::FrameNumber;

/// The state of a load.
#[derive(Debug)]
pub(super) enum State {
    Fetching { ticket: u64, asked_at: u64, cycle: CycleNumber },
    Arrived { payload: Bytes },
    Decoding,
}

/// A tile that is being loaded.
#[derive(Debug)]
pub(super) struct Load {
    pub(super) state: State,
    pub(super) priority: Priority,
    /// The frame that was the newest when it was asked for.
    pub(super) frame: FrameNumber,
    pub(super) asked_at: u64,
    /// The version of the lists in which it was last found.
    epoch: u64,
}

/// A list, and up to where its tiles have been requested.
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
    /// For each layer, loads whose payloads have arrived and are not yet decoded.
    pub(super) held: [usize; 2],
    pub(super) decoding: [usize; 2],
}

impl RequestTable {
    /// Requests without an answer.
    pub(super) fn in_flight(&self) -> usize {
        self.tile_of.len()
    }

    /// Takes a list out, emptied, to be refilled and put back.
    pub(super) fn take_list(&mut self, priority: Priority) -> Vec<Tile> {
        let mut tiles = std::mem::take(&mut self.lists[priority as usize].tiles);
        tiles.clear();
        tiles
    }

    /// Starts again at the beginning of all lists.
    pub(super) fn rewind(&mut self) {
        self.lists.iter_mut().for_each(|list| list.at = 0);
    }

    /// To be called when lists have changed: loads take their priorities from them. Returns the
    /// loads that are on no list any more, except those that are being decoded.
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

    /// Records a new request. Returns its ticket.
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

    /// Records an answer. Returns the tile and its load; `None` if the request has just been given
    /// up.
    pub(super) fn answered(&mut self, ticket: u64) -> Option<(Tile, &mut Load)> {
        let tile = self.tile_of.remove(&ticket)?;
        Some((tile, self.loads.get_mut(&tile)?))
    }

    /// Ends a load before its tile is resident. Returns ticket and cycle of its request, if that
    /// was in flight.
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

    /// Records that a tile cannot be read, and ends its load. Returns the load, if there was one.
    pub(super) fn fail(&mut self, tile: Tile) -> Option<Load> {
        self.loads.remove(&tile)
    }

    /// Records that a frame lacks a tile that cannot be read. Returns whether this is the first
    /// time.
    pub(super) fn is_first_told(&mut self, tile: Tile) -> bool {
        self.told_unavailable.insert(tile)
    }

    /// Records that a tile is resident. Returns its load, if there was one.
    pub(super) fn arrived(&mut self, tile: Tile) -> Option<Load> {
        self.loads.remove(&tile)
    }

    /// The predicted tile that was requested last and has not arrived.
    pub(super) fn last_predicted(&self) -> Option<Tile> {
        let ticket_of = |load: &Load| match load.state {
            State::Fetching { ticket, .. } if load.priority == Priority::Ahead => Some(ticket),
            _ => None,
        };
        let open = self.loads.iter().filter_map(|(tile, load)| Some((ticket_of(load)?, *tile)));
        open.max_by_key(|(ticket, _)| *ticket).map(|(_, tile)| tile)
    }

    /// Payloads that wait for a slot, the most urgent first.
    pub(super) fn waiting(&self) -> Vec<(Priority, Tile)> {
        let is_arrived = |load: &Load| matches!(load.state, State::Arrived { .. });
        let waiting = self.loads.iter().filter(|(_, load)| is_arrived(load));
        let mut waiting: Vec<(Priority, Tile)> = waiting.map(|(tile, load)| (load.priority, *tile)).collect();
        waiting.sort_unstable_by_key(|(priority, tile)| (*priority, u8::MAX - tile.node.q(), tile.pack()));
        waiting
    }

    /// Records that a tile is resident. Returns whether it had been reported as unavailable.
    pub(super) fn came(&mut self, tile: Tile) -> bool {
        self.told_unavailable.remove(&tile)
    }
}
