//! The preparer: from the truncated quad tree to what the renderer draws.
//!
//! * [`frame_tree`] checks a tree that the generator wrote. [`await_tiles`] waits for the tiles
//!   that it wants, which a [`loader`] has brought into the pools by the prefetcher.
//! * [`resident_tiles`] pins the tiles that are there, where a flight does not wait.
//! * [`truncation`] decides what is drawn with those tiles. [`heights`] makes elevation arrays of
//!   them, with no cracks between leaves. [`decimation`] leaves out vertices that are finer than
//!   wanted, [`block_culling`] what is beside the picture or behind the [`horizon`] of what is
//!   nearer. [`frame`] writes it all into the rings. [`detail_coverage`] measures how much of what
//!   is seen is as fine as wanted.
//! * [`stage`] goes through a run's frames, by its [`ports`]: takes a tree, waits for its tiles,
//!   hands the frame over (`rings`).

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
