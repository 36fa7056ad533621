//! One step of the scheduler: takes ended work, finds slots for payloads that have arrived, and
//! makes new requests.

use super::request_table::State;
use super::{Priority, Scheduler, TileEvent};
use crate::executor::{DecodeJob, Ended, Executor};
use crate::request_window::CycleNumber;
use bytes::Bytes;
use terravision_common::database::Tile;
use terravision_common::ids::{FrameNumber, Sequence, SlotKey};
use terravision_common::outcome::{Outcome, TileFailure};
use terravision_common::shm::{Control, Counter, Gauge, Residency};

/// Upper bound of the payloads of a layer that wait for a slot or a decoder: while there are this
/// many, no more tiles of the layer are requested.
const HELD: usize = 64;

impl Scheduler {
    /// Takes ended work, finds slots for payloads that have arrived, and makes new requests.
    pub fn step(&mut self, now: u64, control: &Control, executor: &mut impl Executor) {
        let mut ended = std::mem::take(&mut self.ended);
        executor.drain(&mut ended);
        for ended in ended.drain(..) {
            match ended {
                Ended::Fetched { ticket, result, resent_at_nanos, at_nanos } => {
                    self.fetched(ticket, result, resent_at_nanos, at_nanos, control);
                }
                Ended::Decoded { tile, result, thread, start_nanos, duration_nanos } => {
                    let end = start_nanos.saturating_add(duration_nanos);
                    if let Some(load) = self.table.loads.get(&tile) {
                        let frame = load.frame;
                        self.events.push(TileEvent::Decoded { tile, frame, thread, start_nanos, duration_nanos });
                    }
                    self.decoded(tile, result, end, control);
                }
            }
        }
        self.ended = ended;
        self.place(control, executor);
        self.ask(now, control, executor);
        control.set_gauge(Gauge::TilesInFlight, self.table.in_flight() as u64);
    }

    fn fetched(
        &mut self,
        ticket: u64,
        result: Result<Bytes, TileFailure>,
        resent_at_nanos: Option<u64>,
        at_nanos: u64,
        control: &Control,
    ) {
        let Some((tile, load)) = self.table.answered(ticket) else { return };
        let State::Fetching { asked_at, cycle, .. } = load.state else { return };
        // A repeated request shows how fast the link is, and that the link lost the first one.
        let start_nanos = resent_at_nanos.map_or(asked_at, |resent_at| resent_at.max(asked_at));
        let latency = at_nanos.saturating_sub(start_nanos);
        let of_cycle = resent_at_nanos.is_none().then_some(cycle);
        self.events.push(TileEvent::Fetched { tile, frame: load.frame, start_nanos, duration_nanos: latency });
        match result {
            Ok(payload) => {
                self.window.came(of_cycle, latency);
                control.count(Counter::TilesReceived, 1);
                control.count(Counter::BytesReceived, payload.len() as u64);
                load.state = State::Arrived { payload };
                self.table.held[tile.layer as usize] += 1;
            }
            Err(failure) => {
                // "No such tile" is an answer; anything else is a loss.
                if failure == TileFailure::Missing {
                    self.window.came(of_cycle, latency);
                }
                self.fail(tile, failure, at_nanos, control);
            }
        }
    }

    fn decoded(&mut self, tile: Tile, result: Result<SlotKey, TileFailure>, now: u64, control: &Control) {
        self.table.held[tile.layer as usize] -= 1;
        self.table.decoding[tile.layer as usize] -= 1;
        match result {
            Ok(key) => {
                control.count(Counter::TilesLoaded, 1);
                if self.locked.contains(&tile) {
                    self.lock(tile);
                }
                if self.table.came(tile) {
                    self.events.push(TileEvent::Came { tile, at_nanos: now });
                }
                if let Some(load) = self.table.arrived(tile) {
                    let latency = now.saturating_sub(load.asked_at) as f64;
                    let smoothed = self.latency_nanos.get_or_insert(latency);
                    *smoothed += (latency - *smoothed) / 8.0;
                }
                self.tell(tile, Outcome::Resident { key });
            }
            Err(failure) => self.fail(tile, failure, now, control),
        }
    }

    fn fail(&mut self, tile: Tile, failure: TileFailure, now: u64, control: &Control) {
        let load = self.table.fail(tile);
        // A predicted tile is not yet missed: a frame may never want it, or find it resident.
        if load.as_ref().is_none_or(|load| load.priority != Priority::Ahead) {
            let frame = load.map_or(self.head.frame, |load| load.frame);
            self.lose(tile, frame, failure, now, control);
        }
        self.tell(tile, Outcome::Unavailable { failure });
    }

    /// Reports to the launcher, once, that a frame lacks a tile that cannot be read.
    pub(super) fn lose(&mut self, tile: Tile, frame: FrameNumber, failure: TileFailure, now: u64, control: &Control) {
        if self.table.is_first_told(tile) {
            control.count(Counter::TilesUnavailable, 1);
            self.events.push(TileEvent::Unavailable { tile, frame, failure, at_nanos: now });
        }
    }

    /// Ends a load that is not being decoded. Returns the cycle of its request, if that was in
    /// flight.
    fn give_up(&mut self, tile: Tile, control: &Control, executor: &mut impl Executor) -> Option<CycleNumber> {
        let (ticket, cycle) = self.table.give_up(tile)?;
        executor.cancel(ticket);
        control.count(Counter::TilesCancelled, 1);
        Some(cycle)
    }

    /// Ends a load because its tile is no longer wanted, or something else is more urgent: this
    /// says nothing about the link.
    pub(super) fn cancel(&mut self, tile: Tile, control: &Control, executor: &mut impl Executor) {
        if let Some(cycle) = self.give_up(tile, control, executor) {
            self.window.cancelled(cycle);
        }
    }

    /// Finds slots for payloads that have arrived, the most urgent first.
    fn place(&mut self, control: &Control, executor: &mut impl Executor) {
        if self.table.held == self.table.decoding {
            return;
        }
        let completed = control.completed_sequence();
        let (sequence, stamp) = (self.head.sequence, self.stamp());
        let mut is_full = [false; 2];
        for (priority, tile) in self.table.waiting() {
            let layer = tile.layer as usize;
            if is_full[layer] && priority != Priority::Ahead {
                continue;
            }
            let pool = &mut self.pools[layer];
            let guard = match priority {
                Priority::Now => pool.allocate(tile.node, sequence, completed),
                Priority::Top => pool.allocate(tile.node, Sequence::NONE, completed),
                Priority::Ahead if is_full[layer] => None,
                Priority::Ahead => pool.allocate_expected(tile.node, stamp, completed),
            };
            let Some(guard) = guard else {
                if priority == Priority::Ahead {
                    // The view came to want other tiles than predicted.
                    self.give_up(tile, control, executor);
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
            if let Some(load) = self.table.loads.get_mut(&tile)
                && let State::Arrived { payload } = std::mem::replace(&mut load.state, State::Decoding)
            {
                self.table.decoding[layer] += 1;
                executor.decode(DecodeJob { tile, payload, guard });
            }
        }
    }

    /// No tile of this layer finds a slot. Tells the preparer, if nothing here is going to change
    /// that.
    fn no_room(&mut self, tile: Tile, completed: Sequence) {
        let layer = tile.layer as usize;
        if self.table.decoding[layer] == 0 && self.told_no_room[layer] != Some(completed) {
            self.told_no_room[layer] = Some(completed);
            self.tell(tile, Outcome::NoRoom { completed });
        }
    }

    /// Requests listed tiles, as far as the window allows.
    fn ask(&mut self, now: u64, control: &Control, executor: &mut impl Executor) {
        if std::mem::take(&mut self.is_passed_over) {
            self.table.rewind();
        }
        for priority in Priority::ALL {
            while let Some(tile) = self.next(priority, executor) {
                if self.table.held[tile.layer as usize] >= HELD {
                    self.is_passed_over = true;
                    self.table.lists[priority as usize].at += 1;
                    continue;
                }
                let mut place = self.window.ask();
                if place.is_none()
                    && priority == Priority::Now
                    && let Some(predicted) = self.table.last_predicted()
                {
                    // A tile that is needed now replaces a request for a predicted tile.
                    self.cancel(predicted, control, executor);
                    place = self.window.ask();
                }
                let Some(cycle) = place else { return };
                self.table.lists[priority as usize].at += 1;
                if priority == Priority::Ahead {
                    self.room_ahead[tile.layer as usize] -= 1;
                }
                let ticket = self.table.ask(tile, priority, self.head.frame, now, cycle);
                control.count(Counter::TilesRequested, 1);
                executor.fetch(ticket, tile);
            }
        }
    }

    /// The next tile of a list that has to be requested; the list's position is then at this tile.
    fn next(&mut self, priority: Priority, executor: &impl Executor) -> Option<Tile> {
        loop {
            let list = &self.table.lists[priority as usize];
            let tile = *list.tiles.get(list.at)?;
            let has_room = priority != Priority::Ahead || self.room_ahead[tile.layer as usize] > 0;
            if !self.table.loads.contains_key(&tile)
                && has_room
                && self.pool(tile.layer).residency(tile.node) == Residency::Absent
                && executor.recent_failure(tile).is_none()
            {
                return Some(tile);
            }
            self.table.lists[priority as usize].at += 1;
        }
    }

    /// Ends a cycle: adapts the window, and starts again at the beginning of all lists, because
    /// tiles that could not be read may be requested again by now.
    pub fn end_cycle(&mut self, control: &Control) {
        self.window.end_cycle();
        self.table.rewind();
        self.show(control);
    }

    /// Writes the state of the prefetcher to the control block.
    pub fn show(&self, control: &Control) {
        control.set_gauge(Gauge::PrefetchWindow, self.window.n().into());
        control.set_gauge(Gauge::TileLatencyNanos, self.latency_nanos().unwrap_or(0));
        control.set_gauge(Gauge::RoundTripNanos, self.window.latency_nanos().unwrap_or(0));
        control.set_gauge(Gauge::ReceivedPerMillion, (self.window.share() * 1e6) as u64);
        for (gauge, pool) in [Gauge::ElevationSlotsUsed, Gauge::ColorSlotsUsed].into_iter().zip(&self.pools) {
            control.set_gauge(gauge, pool.used_slots().into());
        }
    }
}
