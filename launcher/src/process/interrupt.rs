//! Ctrl-C and TERM.

use std::sync::atomic::{AtomicU32, Ordering};

static INTERRUPTS: AtomicU32 = AtomicU32::new(0);

/// From now on Ctrl-C, TERM and HUP are noted and do not end the process.
///
/// # Errors
/// The system refused, or it was called twice.
pub fn listen() -> Result<(), ctrlc::Error> {
    // Relaxed: a count that is looked at again and again.
    ctrlc::set_handler(|| {
        INTERRUPTS.fetch_add(1, Ordering::Relaxed);
    })
}

/// Whether one has come.
#[must_use]
pub fn is_interrupted() -> bool {
    count() > 0
}

/// How many have come. A flight without a known end is ended in order by the first, and broken off
/// by the second.
#[must_use]
pub fn count() -> u32 {
    INTERRUPTS.load(Ordering::Relaxed)
}
