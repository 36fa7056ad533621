//! The sink that drops pictures: for benches. For it alone no picture is read back from the device.

use super::{FrameSink, Picture, SinkError};
use crate::pixels::PixelPlaces;

/// Drops every picture.
#[derive(Debug, Clone, Copy, Default)]
pub struct NullSink;

impl FrameSink for NullSink {
    fn needs(&self) -> PixelPlaces {
        PixelPlaces::NOWHERE
    }

    fn write(&mut self, _picture: &Picture<'_>) -> Result<(), SinkError> {
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        Ok(())
    }
}
