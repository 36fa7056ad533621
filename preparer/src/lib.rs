//! The preparer: turns the truncated quad tree into the tiles that the renderer draws.
//!
//! * [`frame_tree`] checks a tree that the generator wrote. [`await_tiles`] waits for the tiles
//!   that it wants; a [`loader`] asks the prefetcher to bring them into the pools.
//! * [`resident_tiles`] pins the resident tiles, when a flight does not wait.
//! * [`truncation`] decides what is drawn with those tiles. [`heights`] computes elevation arrays,
//!   without cracks between leaves. [`decimation`] omits vertices that are finer than wanted, and
//!   [`block_culling`] omits facets that are outside of the picture or behind the [`horizon`] of
//!   nearer ground. [`frame`] writes all of it to the rings. [`detail_coverage`] measures the share
//!   of visible ground that has the wanted resolution.
//! * [`stage`] handles the frames of a run through its [`ports`]: it takes a tree, waits for its
//!   tiles, and hands the frame over (`rings`).

pub mod await_tiles;
pub mod block_culling;
pub mod decimation;
pub mod detail_coverage;
pub mod frame;
pub mod frame_tree;
pub mod heights;
pub mod horizon;
pub mod loader;
pub mod ports;
pub mod resident_tiles;
mod rings;
pub mod stage;
pub mod truncation;

pub use stage::{PreparerError, run};
