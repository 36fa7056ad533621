//! Threads of the launcher, which the system may refuse.

use anyhow::Context;
use std::thread::{Builder, JoinHandle};

/// Runs `work` in a thread of this name.
///
/// # Errors
/// There are no threads left (`ulimit -u`, or the limit of a container), in a sentence.
pub fn in_thread<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> anyhow::Result<JoinHandle<T>> {
    Builder::new().name(name.to_owned()).spawn(work).with_context(|| no_thread(name))
}

/// What is told when there is no thread for `name`.
#[must_use]
pub fn no_thread(name: &str) -> String {
    format!("cannot start the thread \"{name}\": too many threads or processes run here (ulimit -u says how many may)")
}
