//! What tests and benches of several crates share. No program depends on it, but in its tests; it
//! depends on libraries alone.
//!
//! * [`fault_server`]: a static web server on loopback that misbehaves on demand;
//! * [`worlds`]: worlds without a database, and [`runs`] that no launcher has planned;
//! * [`rays`]: ways of casting rays that the program has no use for, to compare with, and grounds
//!   for them;
//! * [`mod@reference`]: the renderer that is exact where the pipeline approximates, and [`metrics`]
//!   of pictures against its own;
//! * [`floats`]: depth and ground positions as `still` writes them.

#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

pub mod fault_server;
pub mod floats;
pub mod metrics;
pub mod rays;
pub mod reference;
pub mod runs;
pub mod worlds;
