//! The generator: reads cameras, searches the quad tree for each, and writes the truncated quad
//! tree into the half of the ping-pong buffer that the preparer does not read. The search itself is
//! [`terravision_common::traversal`].
//!
//! * [`stage`] goes through a run's frames, by its [`ports`]: takes a camera, has its tree
//!   searched, hands it over.
//! * In realtime mode the generator is the clock's hand (`realtime`): it says which frame is next,
//!   and how fine.

mod error;
pub mod ports;
mod realtime;
pub mod stage;

pub use error::GeneratorError;
pub use stage::run;
