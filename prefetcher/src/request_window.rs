//! How much is asked for at a time: N of design §9.
//!
//! Requests are counted by the cycle in which they were made. A while after its end a cycle is judged by the share of
//! its requests that came. While that share is low N goes down; it goes up only when N were asked for and N came. What
//! N bounds is requests on their way: more would only wait in line somewhere on the wire, where nothing can overtake.

use std::collections::VecDeque;

/// N is never less, or nothing would be learnt of the link any more.
const LEAST: f64 = 8.0;
/// N is never more: no link has more of our tiles on its way at a time.
const MOST: f64 = 512.0;
/// N at first; and N is not less while what comes, comes as fast as on an idle link: then it is not N that loses the rest.
const FIRST: f64 = 32.0;
/// Below this share of requests that came N goes down.
const LOW_SHARE: f64 = 0.9;
/// From this share on all of them came.
const FULL_SHARE: f64 = 0.99;
/// N grows by this share of itself.
const GROWTH: f64 = 0.125;
/// Fewer requests than this are no sample.
const FEWEST: u32 = 4;
/// Cycles over which the shortest latency is taken for that of the empty link: 10 s at 5 a second.
const LATENCIES: usize = 50;

#[derive(Debug, Clone, Copy, Default)]
struct Cycle {
    asked: u32,
    came: u32,
    /// Given up by us: says nothing about the link.
    cancelled: u32,
    /// N requests were on their way at some time.
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
    /// Those that are not judged yet; the last one is now.
    cycles: VecDeque<Cycle>,
    /// Cycles before this one were asked with another N.
    judge_from: u64,
    latencies: VecDeque<u64>,
    latency_nanos: Option<f64>,
    share: f64,
}

/// The cycle that a request was made in.
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

    /// Requests on their way. Those of cycles that were judged are taken for lost.
    #[must_use]
    pub fn in_flight(&self) -> u32 {
        self.cycles.iter().map(Cycle::open).sum()
    }

    /// The share that came of the requests of the last cycle that was judged.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.share
    }

    /// How long a payload takes, smoothed; `None` before the first.
    #[must_use]
    pub fn latency_nanos(&self) -> Option<u64> {
        self.latency_nanos.map(|nanos| nanos as u64)
    }

    fn cycle(&mut self, number: CycleNumber) -> Option<&mut Cycle> {
        self.cycles.get_mut(usize::try_from(number.0.checked_sub(self.first)?).ok()?)
    }

    /// Takes a place for a request, if there is one.
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

    /// A payload came (or the answer that there is none), so long after its request. Of a request that was made anew no
    /// cycle is named: for the cycle that it was made in it is lost.
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

    /// A request was given up because nothing wants the tile any more.
    pub fn cancelled(&mut self, number: CycleNumber) {
        if let Some(cycle) = self.cycle(number) {
            cycle.cancelled += 1;
        }
    }

    /// A cycle is over: judges those before it that have had their time.
    pub fn end_cycle(&mut self) {
        // What was asked for at the end of a cycle has one cycle more, and what the empty link takes.
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

    /// How long an answer takes when none is before it, as far as known.
    fn shortest_latency(&self) -> u64 {
        self.latencies.iter().min().copied().filter(|nanos| *nanos < u64::MAX).unwrap_or(0)
    }

    /// Whether answers do not wait in line.
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
