//! The prefetcher: brings tiles into the pools, those that frames want and those that they are going to want.
//!
//! * [`stage`] serves a run through its [`ports`]: it reads want lists, answers with outcomes, and sleeps in between.
//! * [`scheduler`] decides: what is asked for, in which order, what is given up, where tiles go and what they replace. It
//!   knows no clock, no thread and no network, so that tests drive it step by step. [`request_window`] is how much it may
//!   ask for at a time (N of design §9).
//! * [`executor`] does the work: requests on an async runtime, decoding on threads. [`source`] is where payloads come from,
//!   and what decides when a tile is asked for again.
//! * [`prediction`] says which view is going to be, and which tiles it will want.
//! * [`store_usage`]: what the launcher is told of the database.

pub mod executor;
pub mod ports;
pub mod prediction;
pub mod request_window;
pub mod scheduler;
pub mod source;
pub mod stage;
pub mod store_usage;

pub use stage::{PrefetcherError, run};
