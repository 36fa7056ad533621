//! Tests that need more than one file's innards, or more than one process.

mod allocations;
mod garbage;
mod pool;
mod processes;
mod ring;
mod segments;
mod vehicle_table;
mod waits;
mod want_list;

use std::time::{Duration, Instant};

/// Far beyond what any step of a test takes on a busy machine.
pub(super) const DEADLINE: Duration = Duration::from_secs(60);

/// Runs `body` on a thread of its own and fails when it does not end before the deadline.
pub(super) fn within_deadline<R: Send + 'static>(body: impl FnOnce() -> R + Send + 'static) -> R {
    let thread = std::thread::spawn(body);
    let start = Instant::now();
    while !thread.is_finished() {
        assert!(start.elapsed() < DEADLINE, "the test hangs");
        std::thread::sleep(Duration::from_millis(1));
    }
    match thread.join() {
        Ok(value) => value,
        Err(panic) => std::panic::resume_unwind(panic),
    }
}
