//! A film of a realtime flight: one picture for every frame of the flight. In place of a frame that was left out the last
//! picture is there once more, so that the film keeps the flight's time.

use super::{FrameSink, Picture, SinkError};

/// Fills the gaps between the frames that another sink is given.
pub struct RepeatSink {
    inner: Box<dyn FrameSink>,
    /// Number of the last frame, and its pixels.
    last: Option<u64>,
    rgba: Vec<u8>,
}

impl std::fmt::Debug for RepeatSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RepeatSink").field("last", &self.last).finish_non_exhaustive()
    }
}

impl RepeatSink {
    /// Before `inner`. The first frame is never left out.
    #[must_use]
    pub fn new(inner: Box<dyn FrameSink>) -> Self {
        Self { inner, last: None, rgba: Vec::new() }
    }
}

impl FrameSink for RepeatSink {
    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        if let Some(last) = self.last {
            for frame in last + 1..picture.frame {
                self.inner.write(&Picture { frame, rgba: &self.rgba, reversed_depth: None, ..*picture })?;
            }
        }
        self.inner.write(picture)?;
        self.last = Some(picture.frame);
        self.rgba.clear();
        self.rgba.extend_from_slice(picture.rgba);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        self.inner.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;
    use std::sync::{Arc, Mutex};
    use terravision_common::camera::Camera;

    struct Log(Arc<Mutex<Vec<(u64, u8)>>>);

    impl FrameSink for Log {
        fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
            self.0.lock().unwrap().push((picture.frame, picture.rgba[0]));
            Ok(())
        }

        fn finish(&mut self) -> Result<(), SinkError> {
            Ok(())
        }
    }

    #[test]
    fn every_frame_of_the_flight_has_a_picture() {
        let log = Arc::new(Mutex::new(Vec::new()));
        let mut sink = RepeatSink::new(Box::new(Log(Arc::clone(&log))));
        for frame in [5, 6, 9] {
            let rgba = [frame as u8; 4];
            let camera = Camera::zeroed();
            let picture = Picture { frame, size: [1, 1], rgba: &rgba, reversed_depth: None, camera, is_settled: true };
            sink.write(&picture).unwrap();
        }
        sink.finish().unwrap();
        assert_eq!(*log.lock().unwrap(), [(5, 5), (6, 6), (7, 6), (8, 6), (9, 9)]);
    }
}
