//! The generator: reads cameras, searches the quad tree for each, and writes the truncated quad
//! tree into the half of the ping-pong buffer that the preparer does not read. The search itself is
//! [`terravision_common::traversal`].
//!
//! * [`stage`] handles the frames of a run through its [`ports`]: it takes a camera, searches the
//!   tree, and hands the tree over.
//! * In realtime mode the generator keeps time (`realtime`): it decides which frame is next, and at
//!   which resolution.

mod error;
pub mod ports;
mod realtime;
pub mod stage;

pub use error::GeneratorError;
pub use stage::run;
