//! The prefetcher: brings tiles into the pools, those that frames want and those that they are going to want.
//!
//! * [`stage`] connects the segments of a run: it reads want lists, answers with outcomes, and sleeps in between.
//! * [`desk`] decides: what is asked for, in which order, what is given up, where tiles go and what they replace. It
//!   knows no clock, no thread and no network, so that tests drive it step by step. [`window`] is how much it may ask for
//!   at a time (N of design §9).
//! * [`crew`] does the work: requests on an async runtime, decoding on threads. [`source`] is where payloads come from.
//! * [`track`] predicts the camera, or [`oracle`] knows it; [`lookahead`] finds the tiles that it will want.
//! * [`accounts`]: what the launcher is told of the database.

pub mod accounts;
pub mod crew;
pub mod desk;
pub mod lookahead;
pub mod oracle;
pub mod source;
pub mod stage;
pub mod track;
pub mod window;

pub use stage::{PrefetcherError, run};
