//! The window: how many requests may be in flight (N in docs/prefetch.md).
//!
//! Requests are counted by the cycle in which they were made. Some time after its end, a cycle is
//! judged by the share of its requests that were answered. If that share is low, N is multiplied by
//! it. N grows only when N requests were in flight and all of them were answered. More requests
//! than N would only queue in the network, where urgent ones cannot overtake.

use std::collections::VecDeque;

/// Lower bound of N: with fewer requests the link could no longer be measured.
const LEAST: f64 = 8.0;
/// Upper bound of N: no link carries more tiles at a time.
const MOST: f64 = 512.0;
/// The initial N. N does not fall below it while answers are as fast as on an idle link: then
/// losses have another cause than N.
const FIRST: f64 = 32.0;
/// Below this share of answered requests, N is reduced.
const LOW_SHARE: f64 = 0.9;
/// From this share on, all requests count as answered.
const FULL_SHARE: f64 = 0.99;
/// Relative growth of N.
const GROWTH: f64 = 0.125;
/// A cycle with fewer requests is not judged.
const FEWEST: u32 = 4;
/// The shortest latency of this many cycles counts as that of the idle link: 10 s at 5 cycles a
/// second.
const LATENCIES: usize = 50;

#[derive(Debug, Clone, Copy, Default)]
struct Cycle {
    asked: u32,
    came: u32,
    /// Requests cancelled by us, which say nothing about the link.
    cancelled: u32,
    /// Whether N requests were in flight at some time.
    is_full: bool,
}

impl Cycle {
    fn open(&self) -> u32 {
        self.asked.saturating_sub(self.came + self.cancelled)
    }
}

/// The window of requests.
#[derive(Debug)]
pub struct RequestWindow {
    n: f64,
    cycle_nanos: u64,
    /// Number of the first of `cycles`.
    first: u64,
    /// Cycles that are not judged yet; the last one is the current one.
    cycles: VecDeque<Cycle>,
    /// Cycles before this one had another N.
    judge_from: u64,
    latencies: VecDeque<u64>,
    latency_nanos: Option<f64>,
    share: f64,
}

/// The cycle in which a request was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CycleNumber(u64);

impl RequestWindow {
    /// A window whose cycles are this long.
    #[must_use]
    pub fn new(cycle_nanos: u64) -> Self {
        Self {
            n: FIRST,
            cycle_nanos: cycle_nanos.max(1),
            first: 0,
            cycles: VecDeque::from([Cycle::default()]),
            judge_from: 0,
            latencies: VecDeque::from([u64::MAX]),
            latency_nanos: None,
            share: 1.0,
        }
    }

    /// N.
    #[must_use]
    pub fn n(&self) -> u32 {
        self.n as u32
    }

    /// Requests in flight. Unanswered requests of judged cycles count as lost.
    #[must_use]
    pub fn in_flight(&self) -> u32 {
        self.cycles.iter().map(Cycle::open).sum()
    }

    /// The share of answered requests of the cycle that was judged last.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.share
    }

    /// Latency of payloads, smoothed; `None` before the first.
    #[must_use]
    pub fn latency_nanos(&self) -> Option<u64> {
        self.latency_nanos.map(|nanos| nanos as u64)
    }

    fn cycle(&mut self, number: CycleNumber) -> Option<&mut Cycle> {
        self.cycles.get_mut(usize::try_from(number.0.checked_sub(self.first)?).ok()?)
    }

    /// Takes a place in the window for a request, if one is free.
    pub fn ask(&mut self) -> Option<CycleNumber> {
        let is_full = self.in_flight() >= self.n();
        let number = CycleNumber(self.first + self.cycles.len() as u64 - 1);
        let cycle = self.cycles.back_mut()?;
        if is_full {
            cycle.is_full = true;
            return None;
        }
        cycle.asked += 1;
        Some(number)
    }

    /// Records an answer (a payload, or that there is none), and its latency. For a repeated
    /// request no cycle is given: in the cycle of the first attempt it counts as lost.
    pub fn came(&mut self, number: Option<CycleNumber>, latency_nanos: u64) {
        if let Some(cycle) = number.and_then(|number| self.cycle(number)) {
            cycle.came += 1;
        }
        let smoothed = self.latency_nanos.get_or_insert(latency_nanos as f64);
        *smoothed += (latency_nanos as f64 - *smoothed) / 8.0;
        if let Some(shortest) = self.latencies.back_mut() {
            *shortest = (*shortest).min(latency_nanos);
        }
    }

    /// Records that a request was cancelled because the tile is no longer wanted.
    pub fn cancelled(&mut self, number: CycleNumber) {
        if let Some(cycle) = self.cycle(number) {
            cycle.cancelled += 1;
        }
    }

    /// Ends a cycle, and judges earlier cycles that have had enough time.
    pub fn end_cycle(&mut self) {
        // Requests from the end of a cycle get one more cycle, plus the latency of the idle link.
        let time = 1 + self.shortest_latency().div_ceil(self.cycle_nanos).min(64) as usize;
        while self.cycles.len() > time {
            let number = self.first;
            self.first += 1;
            if let Some(cycle) = self.cycles.pop_front() {
                self.judge(number, cycle);
            }
        }
        self.cycles.push_back(Cycle::default());
        self.latencies.push_back(u64::MAX);
        if self.latencies.len() > LATENCIES {
            self.latencies.pop_front();
        }
    }

    /// Latency on an idle link, as far as known.
    fn shortest_latency(&self) -> u64 {
        self.latencies.iter().min().copied().filter(|nanos| *nanos < u64::MAX).unwrap_or(0)
    }

    /// Whether answers do not queue.
    fn is_idle(&self) -> bool {
        self.latency_nanos.is_some_and(|nanos| nanos <= 2.0 * self.shortest_latency() as f64)
    }

    fn judge(&mut self, number: u64, cycle: Cycle) {
        let asked = cycle.asked - cycle.cancelled.min(cycle.asked);
        if asked == 0 {
            return;
        }
        self.share = f64::from(cycle.came.min(asked)) / f64::from(asked);
        if number < self.judge_from || asked < FEWEST {
            return;
        }
        if self.share < LOW_SHARE {
            let least = if self.is_idle() { FIRST.min(self.n) } else { LEAST };
            self.n = (self.n * self.share.max(0.5)).max(least);
            self.judge_from = self.first + self.cycles.len() as u64;
        } else if self.share >= FULL_SHARE && cycle.is_full {
            self.n = (self.n + (self.n * GROWTH).max(1.0)).min(MOST);
        }
    }
}
