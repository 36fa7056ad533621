//! Ctrl-C and TERM.

use std::sync::atomic::{AtomicBool, Ordering};

static IS_INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C, TERM and HUP are noted and do not end the process.
///
/// # Errors
/// The system refused, or it was called twice.
pub fn listen() -> Result<(), ctrlc::Error> {
    // Relaxed: a flag that is looked at again and again.
    ctrlc::set_handler(|| IS_INTERRUPTED.store(true, Ordering::Relaxed))
}

/// Whether one has come.
#[must_use]
pub fn is_interrupted() -> bool {
    IS_INTERRUPTED.load(Ordering::Relaxed)
}
