//! Shared memory between the processes of a run.
//!
//! | segment | writer | reader | when full |
//! |---|---|---|---|
//! | control block: [`Control`] | all | all | – |
//! | camera ring: [`Producer`]/[`Consumer`] of [`CameraRecord`] | launcher | generator | the launcher waits |
//! | ping-pong buffer: [`TreeWriter`], [`TreeReader`] | generator | preparer | the generator waits |
//! | ring: [`Producer`]/[`Consumer`] of [`crate::slot::Slot`] | preparer | renderer | the preparer waits |
//! | elevation ring: [`ElevationWriter`], [`ElevationReader`] | preparer | renderer | the preparer waits |
//! | stream ring: [`StreamWriter`], [`StreamReader`] | renderer | launcher | the renderer waits |
//! | colour pool, elevation pool: [`PoolWriter`], [`PoolReader`] | prefetcher | renderer, preparer | `allocate` says so |
//! | want list: [`WantListWriter`], [`WantListReader`] | preparer | prefetcher | the newest replaces the one before |
//! | tile outcomes: [`Producer`]/[`Consumer`] of [`crate::outcome::TileOutcome`] | prefetcher | preparer | dropped; told again for the next list |
//! | vehicle table: [`VehicleTableWriter`], [`VehicleTableReader`] | launcher | renderer | the launcher waits for written frames |
//! | four event rings: [`Producer`]/[`Consumer`] of [`crate::event::Event`] | a stage | launcher | dropped, counted |
//!
//! | frame ring: [`FrameRing`], [`FrameRingWriter`], [`FrameRingReader`] | renderer | other programs | the newest wins |
//! | poses: [`PoseInbox`], [`PoseSender`] | another program | launcher | the newest wins |
//!
//! The launcher makes all of them ([`RunSegments`]), stages open them by the run's name
//! ([`RunId`]), and [`memory`] makes the same handles over memory of one process, for tests and
//! benches.
//!
//! # Trust
//! The other side is our own code, but it may be dead, half started, of another build, or killed in
//! the middle of a write. Nothing that it wrote can make this side read out of bounds, wait for
//! ever or panic: positions, counts and indices are read once and checked, and invalid values are
//! [`ShmError::Corrupt`]. An item becomes visible by one store, the last one of its write, so that
//! a killed writer never publishes half an item; its successor continues from the last published
//! position. There is one exception: a peer that truncates a mapped file kills its readers
//! (SIGBUS). So segments that programs outside of the run may open are not mapped here, but read
//! and written as files ([`public_file`]). If a stage dies of it in the run's own segments, the
//! launcher reports the cause ([`RunSegments::cut_short`]); for the launcher itself there is a
//! handler ([`end_on_bus_error`]).
//!
//! # Waiting
//! Blocking calls take the [`Control`] of the run. They back off for a few microseconds, then sleep
//! on a futex that the processes share, at most [`WAIT_BOUND`] at a time. After each sleep they
//! check whether the run goes on, and whether launcher and peer are alive ([`WaitError`]).
//!
//! # Example
//! ```
//! use terravision_common::shm::memory;
//! let control = memory::control()?;
//! let (mut producer, mut consumer) = memory::ring::<u64>(8)?;
//! producer.push(&42, &control)?;
//! assert_eq!(consumer.pop(&control)?, 42);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The algorithms ([`bell`], [`cursor`], [`frame_core`], [`ring_core`], [`seqlock`],
//! [`slot_words`], [`want_core`]) do not depend on mappings, so that `loom` can check them:
//! `RUSTFLAGS="--cfg loom" cargo test -p terravision-common --lib --release loom_`.
#![cfg_attr(
    loom,
    allow(dead_code, unreachable_pub, reason = "the checker builds the algorithms without the segments that use them")
)]
#![expect(unsafe_code, reason = "shared memory is reached through raw addresses; every block says why it is sound")]

mod bell;
mod cursor;
mod error;
mod frame_core;
mod geometry;
mod kind;
mod layout;
mod process;
mod ring_core;
mod run_id;
mod seqlock;
mod slot_words;
mod vehicle_layout;
mod want_core;

#[cfg(not(loom))]
mod activity;
#[cfg(not(loom))]
mod array_ring;
#[cfg(not(loom))]
mod bus_guard;
#[cfg(not(loom))]
mod control;
#[cfg(not(loom))]
mod control_words;
#[cfg(not(loom))]
mod frame_ring;
#[cfg(not(loom))]
mod header;
#[cfg(not(loom))]
mod large_pages;
#[cfg(not(loom))]
pub mod memory;
#[cfg(not(loom))]
mod named;
#[cfg(not(loom))]
mod ping_pong;
#[cfg(not(loom))]
mod pool;
#[cfg(not(loom))]
mod poses;
#[cfg(not(loom))]
mod public_file;
#[cfg(not(loom))]
mod region;
#[cfg(not(loom))]
mod ring;
#[cfg(not(loom))]
mod segments;
#[cfg(not(loom))]
mod size;
#[cfg(not(loom))]
mod vehicle_table;
#[cfg(not(loom))]
mod want_list;

#[cfg(test)]
#[cfg(loom)]
mod loom_tests;
#[cfg(test)]
#[cfg(not(loom))]
mod tests;

#[cfg(not(loom))]
pub use activity::Activity;
#[cfg(not(loom))]
pub use array_ring::{
    ArrayGuard, ArrayItem, ArrayReader, ArrayWriter, ElevationReader, ElevationWriter, StreamReader, StreamWriter,
};
#[cfg(not(loom))]
pub use bus_guard::end_on_bus_error;
#[cfg(not(loom))]
pub use control::{Control, Counter, FAILURE_CAUSES, Gauge, RunState, WAIT_BOUND};
pub use error::{ShmError, WaitError};
#[cfg(not(loom))]
pub use frame_ring::{FrameInfo, FrameRing, FrameRingReader, FrameRingWriter, FrameShape, PoseTimes, SharedFrame};
#[cfg(not(loom))]
pub use header::LAYOUT_VERSION;
pub use kind::{SegmentKind, Stage};
pub use layout::{CameraRecord, Layout};
#[cfg(not(loom))]
pub use named::SharedName;
#[cfg(not(loom))]
pub use ping_pong::{TreeGuard, TreeHalf, TreeReader, TreeWriter};
#[cfg(not(loom))]
pub use pool::{FillGuard, PoolBytes, PoolIndex, PoolReader, PoolWriter, Residency, SlotInfo, SlotState};
#[cfg(not(loom))]
pub use poses::{PoseAnswers, PoseInbox, PoseRecord, PoseSender};
#[cfg(not(loom))]
pub use ring::{Consumer, Producer};
pub use run_id::RunId;
#[cfg(not(loom))]
pub use segments::{RunSegments, SegmentMemory, free_bytes, reap_dead_runs};
#[cfg(not(loom))]
pub use vehicle_table::{TableHead, VehicleTableReader, VehicleTableWriter};
#[cfg(not(loom))]
pub use want_list::{WantBell, WantHead, WantListReader, WantListWatcher, WantListWriter};
