//! The preparer: from the truncated quad tree to what the renderer draws.
//!
//! * [`frame_tree`] checks a tree that the generator wrote. [`await_tiles`] waits for the tiles that it wants, which a
//!   [`loader`] has brought into the pools by the prefetcher.
//! * [`truncation`] decides what is drawn with the tiles that are there. [`heights`] makes elevation arrays of [tiles](entered_tile), with no
//!   cracks between leaves. [`thinning`] leaves out vertices that are finer than wanted, [`trim`] what is beside the picture or
//!   behind the [`horizon`] of what is nearer. [`frame`] puts it all into the rings. [`sharpness`] says how much of what is seen is as fine as wanted.
//! * [`stage`] connects these with the segments of a run.

pub mod await_tiles;
pub mod entered_tile;
pub mod frame;
pub mod frame_tree;
pub mod heights;
pub mod horizon;
pub mod loader;
pub mod sharpness;
pub mod stage;
pub mod there;
pub mod thinning;
pub mod trim;
pub mod truncation;

pub use stage::{PreparerError, run};
