//! The sink that drops pictures: for benches.

use super::{FrameSink, Picture, SinkError};

/// Drops every picture.
#[derive(Debug, Clone, Copy, Default)]
pub struct NullSink;

impl FrameSink for NullSink {
    fn write(&mut self, _picture: &Picture<'_>) -> Result<(), SinkError> {
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}
