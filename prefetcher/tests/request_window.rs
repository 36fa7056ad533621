//! N falls while fewer requests are answered than made, and grows only when N were in flight and N
//! were answered.

use std::collections::VecDeque;
use terravision_prefetcher::request_window::{CycleNumber, RequestWindow};

const MS: u64 = 1_000_000;
const CYCLE: u64 = 200 * MS;

/// A link that answers requests in their order, one every `gap_ms`, each at the earliest `delay_ms`
/// after it was made; and loses one in `loses_one_in` (0: none).
struct Link {
    window: RequestWindow,
    open: VecDeque<(u64, CycleNumber)>,
    now: u64,
    free_at: u64,
    delay_ms: u64,
    gap_ms: u64,
    loses_one_in: u64,
    count: u64,
    came: u64,
}

impl Link {
    fn new(delay_ms: u64, gap_ms: u64) -> Self {
        let (window, open) = (RequestWindow::new(CYCLE), VecDeque::new());
        Self { window, open, now: 0, free_at: 0, delay_ms, gap_ms, loses_one_in: 0, count: 0, came: 0 }
    }

    /// A cycle in which at most `demand` tiles are wanted. N at its end.
    fn cycle(&mut self, demand: u32) -> u32 {
        let mut left = demand;
        for _ in 0..CYCLE / MS {
            self.now += MS;
            while let Some(&(due, _)) = self.open.front()
                && due <= self.now
            {
                let (due, cycle) = self.open.pop_front().expect("there is one");
                self.window.came(Some(cycle), due.saturating_sub(self.now) + self.delay_ms * MS);
                self.came += 1;
            }
            while left > 0
                && let Some(cycle) = self.window.ask()
            {
                left -= 1;
                self.count += 1;
                self.free_at = self.free_at.max(self.now + self.delay_ms * MS) + self.gap_ms * MS;
                if self.loses_one_in == 0 || !self.count.is_multiple_of(self.loses_one_in) {
                    self.open.push_back((self.free_at, cycle));
                }
            }
        }
        self.window.end_cycle();
        self.window.n()
    }

    fn cycles(&mut self, count: u32, demand: u32) -> Vec<u32> {
        (0..count).map(|_| self.cycle(demand)).collect()
    }
}

#[test]
fn n_grows_while_n_are_asked_for_and_come_and_stays_while_fewer_are_wanted() {
    let mut link = Link::new(50, 0);
    let idle = link.cycles(20, 5);
    assert!(idle.windows(2).all(|pair| pair[0] == pair[1]), "{idle:?}");
    let busy = link.cycles(40, 100_000);
    assert!(busy.windows(2).all(|pair| pair[0] <= pair[1]) && busy[39] > 10 * idle[0], "{busy:?}");
    let idle = link.cycles(20, 5);
    assert_eq!(idle.first(), idle.last(), "what was learnt is kept");
}

#[test]
fn n_goes_down_under_loss_and_up_again_after_it() {
    let mut link = Link::new(50, 0);
    let before = *link.cycles(20, 100_000).last().expect("some");
    link.loses_one_in = 3;
    let lossy = link.cycles(30, 100_000);
    assert!(*lossy.last().expect("some") < before / 3, "{before}, then {lossy:?}");
    assert!(*lossy.last().expect("some") >= 8, "something is asked for, or nothing would be learnt");
    link.loses_one_in = 0;
    let after = link.cycles(40, 100_000);
    assert!(*after.last().expect("some") >= before, "{after:?}");
}

#[test]
fn n_settles_near_what_a_slow_link_carries_in_a_cycle_or_two_and_keeps_it_busy() {
    // One tile every 10 ms: 20 a cycle.
    let mut link = Link::new(80, 10);
    link.cycles(50, 100_000);
    let came = link.came;
    let n = link.cycles(100, 100_000);
    let (least, most) = (n.iter().min().expect("some"), n.iter().max().expect("some"));
    assert!(*least >= 15 && *most <= 80, "{n:?}");
    assert!(link.came - came > 1900, "{} of 2000 came", link.came - came);
}

#[test]
fn what_is_given_up_says_nothing_about_the_link() {
    let mut window = RequestWindow::new(CYCLE);
    let before = window.n();
    for _ in 0..20 {
        let cycles: Vec<CycleNumber> = std::iter::from_fn(|| window.ask()).collect();
        assert_eq!(cycles.len(), window.n() as usize);
        cycles.into_iter().for_each(|cycle| window.cancelled(cycle));
        window.end_cycle();
    }
    assert_eq!((window.n(), window.in_flight()), (before, 0));
}
