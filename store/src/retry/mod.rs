//! The only retry policy, for requests and for tiles. `docs/retries.md` has a state diagram.
//!
//! ```text
//!  one read                       [`tries`]: attempts, deadline, budget, breaker, patience
//!    ask ─▶ answer ─▶ checked ─▶ bytes
//!     ▲        │         │
//!     └─ wait ─┴─────────┴─ failure that may pass ─▶ error, when attempts, time or budget are used up
//!
//!  between reads                  [`NegativeCache`]: a tile that could not be read rests, or is given up for the run
//! ```
//!
//! * [`budget`] keeps the number of repeated requests in proportion to that of first requests. It
//!   handles failures among successes.
//! * [`breaker`]: when requests for a file fail in a row, all reads of the file wait, and one
//!   request at a time probes. So a server that is down for a while costs a request from time to
//!   time, takes nothing from the budget, and fails no read before its deadline.
//! * [`backoff`]: how long a read waits before it repeats a request. [`mod@patience`]: how long it
//!   waits for an answer before it repeats the request although nothing has failed.
//! * [`negative_cache`]: which tiles are not requested now, although a frame wants them.
//!
//! No other module decides this: readers of a store ask once, and the scheduler of tiles calls
//! [`crate::Store::recent_failure`] first.

mod backoff;
mod breaker;
mod budget;
mod negative_cache;
mod patience;
mod tries;

pub use negative_cache::NegativeCache;
pub use patience::patience;
pub(crate) use tries::{Allowance, RetryPolicy};

use std::time::Duration;

/// A local file is read only once more: a third read would give the same.
pub(crate) const LOCAL_RETRIES: u32 = 1;
/// Damaged bytes from a server are read again this many times.
pub(crate) const DAMAGED_RETRIES: u32 = 5;
/// Retries while a database is opened: few, because the user waits.
pub(crate) const OPEN_RETRIES: u32 = 3;
/// A manifest, or a file of height ranges, that arrives damaged is read this often in all.
pub(crate) const INDEX_READS: u32 = 4;

/// How failed requests are repeated.
#[derive(Debug, Clone, Copy)]
pub struct RetryOptions {
    /// Maximum number of retries of one read.
    pub most: u32,
    /// The wait before the second request, on average; it doubles each time.
    pub first_wait: Duration,
    /// The longest wait.
    pub longest_wait: Duration,
    /// Budget: retries for each first request, on average over all reads ...
    pub share: f64,
    /// ... and this many more at once, after a while without failures.
    pub burst: u32,
}

impl Default for RetryOptions {
    fn default() -> Self {
        Self {
            most: 8,
            first_wait: Duration::from_millis(200),
            longest_wait: Duration::from_secs(8),
            share: 1.0,
            burst: 64,
        }
    }
}

/// When a tile that could not be read may be requested again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FailedTiles {
    /// After a rest: it may arrive during the flight.
    #[default]
    Rest,
    /// Never while the store is open: the content of a frame must not depend on when it is drawn.
    Final,
}
