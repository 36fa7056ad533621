//! When something is asked for again: the one policy, for requests and for tiles. `docs/retries.md`
//! draws it.
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
//! * [`budget`] keeps requests that are made again in proportion to those that are made the first
//!   time. It is for failures among successes.
//! * [`breaker`]: when requests for a file fail in a row, all reads of the file wait, and one
//!   request at a time probes. So a server that is away for a while costs a request now and then,
//!   nothing of the budget, and no read before its deadline.
//! * [`backoff`]: how long a read waits before it asks again. [`mod@patience`]: how long it waits
//!   for an answer before it asks anew although nothing has failed.
//! * [`negative_cache`]: which tiles are not asked for now, although a frame wants them.
//!
//! Nobody else decides this: readers of a store ask once, and whoever schedules tiles asks
//! [`crate::Store::recent_failure`] before it does.

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

/// A file of this machine is read once more when that may help: it says the same the next time.
pub(crate) const LOCAL_RETRIES: u32 = 1;
/// Damaged bytes of a server are read anew this many times.
pub(crate) const DAMAGED_RETRIES: u32 = 5;
/// Requests after the first while a database is opened: somebody waits for the answer.
pub(crate) const OPEN_RETRIES: u32 = 3;
/// A manifest, or the file of height ranges, that comes damaged is read this often in all.
pub(crate) const INDEX_READS: u32 = 4;

/// How failed requests are asked again.
#[derive(Debug, Clone, Copy)]
pub struct RetryOptions {
    /// Most requests after the first, of one read.
    pub most: u32,
    /// The wait before the second request, on average; it doubles each time.
    pub first_wait: Duration,
    /// The longest wait.
    pub longest_wait: Duration,
    /// Requests that may be asked again for each that is asked the first time, on average over all
    /// reads...
    pub share: f64,
    /// ... and so many more at once, after a while without failures.
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

/// What becomes of a tile that could not be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FailedTiles {
    /// It rests, and is asked for again afterwards: it may come while a flight goes on.
    #[default]
    Rest,
    /// It is not asked for again as long as the store is open: what a frame shows must not depend
    /// on when it is drawn.
    Final,
}
