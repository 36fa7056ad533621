//! The atomics of the shared-memory algorithms, behind one door: the standard library's, or those
//! of `loom` under `--cfg loom`, so that the model checker runs the very code that flies.
//!
//! Code in [`crate::shm`] takes atomics and fences from here and from nowhere else.

#[cfg(not(loom))]
pub use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

#[cfg(loom)]
pub use loom::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};
