//! The desk at work: takes what has ended, finds room for what has arrived, asks for more.

use super::books::{MISSING, State};
use super::{Desk, News, Wish};
use crate::crew::{Crew, DecodeJob, Ended};
use crate::window::CycleNumber;
use bytes::Bytes;
use terravision_common::database::Tile;
use terravision_common::ids::SlotKey;
use terravision_common::outcome::Outcome;
use terravision_common::shm::{Control, Counter, Gauge, Residency};

/// Payloads of a layer that wait for a slot or a decoder, at most: more are not asked for before these are through.
const HELD: usize = 64;
/// A request that has no answer for this long is made again...
const FIRST_PATIENCE_NANOS: u64 = 600_000_000;
/// ... and after so many times left to its source, which knows when to give up.
const IMPATIENT_TRIES: u32 = 5;

impl Desk {
    /// Takes what has ended, finds room for what has arrived, asks for more.
    pub fn step(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        let mut ended = std::mem::take(&mut self.ended);
        crew.drain(&mut ended);
        for ended in ended.drain(..) {
            match ended {
                Ended::Fetched { ticket, result, at_nanos } => self.fetched(ticket, result, at_nanos, control),
                Ended::Decoded { tile, result, thread, start_nanos, duration_nanos } => {
                    let end = start_nanos.saturating_add(duration_nanos);
                    if let Some(load) = self.books.loads.get(&tile) {
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
        control.set_gauge(Gauge::TilesInFlight, self.books.in_flight() as u64);
    }

    fn fetched(&mut self, ticket: u64, result: Result<Bytes, u8>, at_nanos: u64, control: &Control) {
        let Some((tile, load)) = self.books.answered(ticket) else { return };
        let State::Fetching { asked_at, cycle, .. } = load.state else { return };
        let latency = at_nanos.saturating_sub(asked_at);
        self.news.push(News::Fetched { tile, frame: load.frame, start_nanos: asked_at, duration_nanos: latency });
        match result {
            Ok(payload) => {
                self.window.came(cycle, latency);
                control.count(Counter::TilesReceived, 1);
                control.count(Counter::BytesReceived, payload.len() as u64);
                load.state = State::Arrived { payload };
                self.books.held[tile.layer as usize] += 1;
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

    fn decoded(&mut self, tile: Tile, result: Result<SlotKey, u8>, now: u64, control: &Control) {
        self.books.held[tile.layer as usize] -= 1;
        self.books.decoding[tile.layer as usize] -= 1;
        match result {
            Ok(key) => {
                control.count(Counter::TilesLoaded, 1);
                if self.locked.contains(&tile) {
                    self.lock(tile);
                }
                if self.books.came(tile) {
                    self.news.push(News::Came { tile, at_nanos: now });
                }
                if let Some(load) = self.books.arrived(tile) {
                    let latency = now.saturating_sub(load.asked_at) as f64;
                    let smoothed = self.latency_nanos.get_or_insert(latency);
                    *smoothed += (latency - *smoothed) / 8.0;
                }
                self.tell(tile, Outcome::Resident { key });
            }
            Err(code) => self.fail(tile, code, now, control),
        }
    }

    fn fail(&mut self, tile: Tile, code: u8, now: u64, control: &Control) {
        let load = self.books.fail(tile, code, now);
        // What is only expected is no loss yet: a frame may never want it, or find it there.
        if load.as_ref().is_none_or(|load| load.wish != Wish::Ahead) {
            let frame = load.map_or(self.head.frame, |load| load.frame);
            self.lose(tile, frame, code, now, control);
        }
        self.tell(tile, Outcome::Unavailable { code });
    }

    /// A frame lacks a tile that cannot be had: the launcher is told once.
    pub(super) fn lose(&mut self, tile: Tile, frame: u64, code: u8, now: u64, control: &Control) {
        if self.books.is_first_told(tile) {
            control.count(Counter::TilesUnavailable, 1);
            self.news.push(News::Unavailable { tile, frame, code, at_nanos: now });
        }
    }

    /// Ends a load that is not being decoded. The cycle of its request, if that was under way.
    fn give_up(&mut self, tile: Tile, control: &Control, crew: &mut impl Crew) -> Option<CycleNumber> {
        let (ticket, cycle) = self.books.give_up(tile)?;
        crew.cancel(ticket);
        control.count(Counter::TilesCancelled, 1);
        Some(cycle)
    }

    /// Ends a load because nothing wants its tile any more, or something else more: that says nothing about the link.
    pub(super) fn cancel(&mut self, tile: Tile, control: &Control, crew: &mut impl Crew) {
        if let Some(cycle) = self.give_up(tile, control, crew) {
            self.window.cancelled(cycle);
        }
    }

    /// Finds slots for payloads that have arrived: the urgent first.
    fn place(&mut self, control: &Control, crew: &mut impl Crew) {
        if self.books.held == self.books.decoding {
            return;
        }
        let completed = control.completed_sequence();
        let (sequence, stamp) = (self.head.sequence, self.stamp());
        let mut is_full = [false; 2];
        for (wish, tile) in self.books.waiting() {
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
            if let Some(load) = self.books.loads.get_mut(&tile)
                && let State::Arrived { payload } = std::mem::replace(&mut load.state, State::Decoding)
            {
                self.books.decoding[layer] += 1;
                crew.decode(DecodeJob { tile, payload, guard });
            }
        }
    }

    /// Nothing of the tile's layer finds room; the preparer has to know when nothing here is going to change that.
    fn no_room(&mut self, tile: Tile, completed: u64) {
        let layer = tile.layer as usize;
        if self.books.decoding[layer] == 0 && self.told_no_room[layer] != Some(completed) {
            self.told_no_room[layer] = Some(completed);
            self.tell(tile, Outcome::NoRoom { completed });
        }
    }

    /// Asks for what is listed, as far as the window goes.
    fn ask(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        if std::mem::take(&mut self.is_passed_over) {
            self.books.rewind();
        }
        for wish in Wish::ALL {
            while let Some(tile) = self.next(wish, now) {
                if self.books.held[tile.layer as usize] >= HELD {
                    self.is_passed_over = true;
                    self.books.lists[wish as usize].at += 1;
                    continue;
                }
                let mut place = self.window.ask();
                if place.is_none()
                    && wish == Wish::Now
                    && let Some(predicted) = self.books.last_predicted()
                {
                    // What is needed now takes the place of what is only expected.
                    self.cancel(predicted, control, crew);
                    place = self.window.ask();
                }
                let Some(cycle) = place else { return };
                self.books.lists[wish as usize].at += 1;
                if wish == Wish::Ahead {
                    self.room_ahead[tile.layer as usize] -= 1;
                }
                let ticket = self.books.ask(tile, wish, self.head.frame, now, cycle);
                control.count(Counter::TilesRequested, 1);
                crew.fetch(ticket, tile);
            }
        }
    }

    /// The next tile of a list that has to be asked for; the list then stands at it.
    fn next(&mut self, wish: Wish, now: u64) -> Option<Tile> {
        loop {
            let list = &self.books.lists[wish as usize];
            let tile = *list.tiles.get(list.at)?;
            let has_room = wish != Wish::Ahead || self.room_ahead[tile.layer as usize] > 0;
            if !self.books.is_known(tile, now)
                && has_room
                && self.pool(tile.layer).residency(tile.node) == Residency::Absent
            {
                return Some(tile);
            }
            self.books.lists[wish as usize].at += 1;
        }
    }

    /// A cycle is over: the window is judged, and requests without an answer are made again.
    pub fn end_cycle(&mut self, now: u64, control: &Control, crew: &mut impl Crew) {
        self.window.end_cycle();
        for tile in self.books.late(now, self.patience_nanos(), IMPATIENT_TRIES) {
            // For the window it is lost: it did not come.
            self.give_up(tile, control, crew);
        }
        self.books.rewind();
        self.show(control);
    }

    /// Shows in the control block how things stand.
    pub fn show(&self, control: &Control) {
        control.set_gauge(Gauge::PrefetchWindow, self.window.n().into());
        control.set_gauge(Gauge::TileLatencyNanos, self.latency_nanos().unwrap_or(0));
        control.set_gauge(Gauge::RoundTripNanos, self.window.latency_nanos().unwrap_or(0));
        control.set_gauge(Gauge::ReceivedPerMillion, (self.window.share() * 1e6) as u64);
        for (gauge, pool) in [Gauge::ElevationSlotsUsed, Gauge::ColorSlotsUsed].into_iter().zip(&self.pools) {
            control.set_gauge(gauge, pool.used_slots().into());
        }
    }

    /// How long the first request for a tile waits for its answer.
    fn patience_nanos(&self) -> u64 {
        let usual = self.window.latency_nanos().unwrap_or(0);
        FIRST_PATIENCE_NANOS.max(usual.saturating_mul(4))
    }
}
