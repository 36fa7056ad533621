//! The atomics of the shared-memory algorithms: those of the standard library, or those of `loom`
//! under `--cfg loom`, so that the model checker runs the production code.
//!
//! Code in [`crate::shm`] takes atomics and fences only from here.

#[cfg(not(loom))]
pub use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering, fence};

#[cfg(loom)]
pub use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering, fence};
