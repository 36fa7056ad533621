//! The prefetcher: brings tiles into the pools, both those that frames want and those that
//! predicted views will want.
//!
//! * [`stage`] serves a run through its [`ports`]: it reads want lists, writes outcomes, and sleeps
//!   in between.
//! * [`scheduler`] decides which tiles are requested, in which order, which requests are cancelled,
//!   and which slots are reused. It uses no clock, no thread and no network, so that tests drive it
//!   step by step. [`window`] limits the number of requests in flight (N in docs/prefetch.md).
//! * [`executor`] does the work: requests on an async runtime, decoding on threads. [`source`]
//!   provides payloads, and decides when a tile may be requested again.
//! * [`track`] predicts the camera, or [`oracle`] knows its path; [`lookahead`] finds the tiles of
//!   a view; [`ahead`] combines them for the predicted view.
//! * [`usage`] reports the use of the database to the launcher.

pub mod ahead;
pub mod executor;
pub mod lookahead;
pub mod oracle;
pub mod ports;
pub mod scheduler;
pub mod source;
pub mod stage;
pub mod track;
pub mod usage;
pub mod window;

pub use stage::{PrefetcherError, run};
