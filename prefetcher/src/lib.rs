//! The prefetcher: brings tiles into the pools, both those that frames want and those that
//! predicted views will want.
//!
//! * [`stage`] serves a run through its [`ports`]: it reads want lists, writes outcomes, and sleeps
//!   in between.
//! * [`scheduler`] decides which tiles are requested, in which order, which requests are cancelled,
//!   and which slots are reused. It uses no clock, no thread and no network, so that tests drive it
//!   step by step. [`request_window`] limits the number of requests in flight (N in
//!   docs/prefetch.md).
//! * [`executor`] does the work: requests on an async runtime, decoding on threads. [`source`]
//!   provides payloads, and decides when a tile may be requested again.
//! * [`light`] lights colour tiles as they are decoded.
//! * [`prediction`] predicts the view, and finds the tiles that it will want.
//! * [`store_usage`] reports the use of the database to the launcher.

pub mod executor;
pub mod light;
pub mod ports;
pub mod prediction;
pub mod request_window;
pub mod scheduler;
pub mod source;
pub mod stage;
pub mod store_usage;

pub use stage::{PrefetcherError, run};
