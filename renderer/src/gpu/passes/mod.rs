//! Passes: pipelines with the commands that use them.

pub(super) mod floor;
mod pipeline;
pub(super) mod rays;
pub(super) mod terrain;
