//! A folder of a realtime flight: one picture for every frame of the flight. In place of a frame
//! that was left out the last picture is there once more, so that a film of them keeps the flight's
//! time.

use super::{FrameSink, Picture, SinkError, SizedRgba};
use crate::pixels::PixelPlaces;
use terravision_common::camera::Camera;
use terravision_common::rig::Views;
use terravision_common::run::OPEN_END;

/// Fills the gaps between the frames that another sink is given.
pub struct RepeatSink {
    inner: Box<dyn FrameSink>,
    /// First frame of the flight, and one past the last.
    frames: [u64; 2],
    /// The frame that has to be written next.
    next: u64,
    /// What was written last: size and pixels.
    last: Option<SizedRgba>,
}

impl std::fmt::Debug for RepeatSink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RepeatSink").field("next", &self.next).finish_non_exhaustive()
    }
}

impl RepeatSink {
    /// Before `inner`, for a flight of these frames, the first `written` of which were written by a
    /// renderer that was killed.
    ///
    /// # Errors
    /// What it wrote cannot be read.
    pub fn new(mut inner: Box<dyn FrameSink>, frames: [u64; 2], written: u64) -> Result<Self, SinkError> {
        let next = frames[0].saturating_add(written).min(frames[1]);
        let last = if written > 0 { inner.read_back(next - 1)? } else { None };
        Ok(Self { inner, frames, next, last })
    }

    /// Writes a picture for every frame before `until`.
    fn repeat(&mut self, until: u64, picture: &Picture<'_>) -> Result<(), SinkError> {
        while self.next < until {
            let stand_in = Picture { frame: self.next, reversed_depth: None, is_settled: false, ..*picture };
            self.inner.write(&stand_in)?;
            self.next += 1;
        }
        Ok(())
    }
}

impl FrameSink for RepeatSink {
    fn needs(&self) -> PixelPlaces {
        self.inner.needs()
    }

    fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
        match self.last.take() {
            Some((size, rgba)) if size == picture.size => {
                self.repeat(picture.frame, &Picture { rgba: &rgba, ..*picture })?;
                self.last = Some((size, rgba));
            }
            // The picture before went with a renderer that was killed.
            _ => self.repeat(picture.frame, picture)?,
        }
        self.inner.write(picture)?;
        self.next = picture.frame.saturating_add(1);
        let (size, rgba) = self.last.get_or_insert_default();
        *size = picture.size;
        rgba.clear();
        rgba.extend_from_slice(picture.rgba);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        // Only what went with a renderer that was killed is missing here; a flight without a known
        // end ends where it ends.
        if let Some((size, rgba)) = self.last.take().filter(|_| self.frames[1] != OPEN_END) {
            let views = Views::single(&Camera::default());
            let (frame, rgba) = (self.next, &rgba);
            let on_device = None;
            let last =
                Picture { frame, view: None, size, rgba, reversed_depth: None, on_device, views, is_settled: false };
            self.repeat(self.frames[1], &last)?;
        }
        self.inner.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    type Written = Arc<Mutex<Vec<(u64, u8)>>>;

    /// Remembers number and first byte of what it is given, and finds `left` of a sink before it.
    struct Log {
        written: Written,
        left: Option<SizedRgba>,
    }

    impl FrameSink for Log {
        fn write(&mut self, picture: &Picture<'_>) -> Result<(), SinkError> {
            self.written.lock().unwrap().push((picture.frame, picture.rgba[0]));
            Ok(())
        }

        fn finish(&mut self) -> Result<(), SinkError> {
            Ok(())
        }

        fn read_back(&mut self, _frame: u64) -> Result<Option<SizedRgba>, SinkError> {
            Ok(self.left.take())
        }
    }

    fn pictures(left: Option<u8>, before: u64, frames: &[u64]) -> Vec<(u64, u8)> {
        let written = Written::default();
        let left = left.map(|byte| ([1, 1], vec![byte; 4]));
        let log = Log { written: Arc::clone(&written), left };
        fill(RepeatSink::new(Box::new(log), [5, 10], before).unwrap(), frames);
        written.lock().unwrap().clone()
    }

    fn fill(mut sink: RepeatSink, frames: &[u64]) {
        for &frame in frames {
            let rgba = [frame as u8; 4];
            let views = Views::single(&Camera::default());
            let (size, rgba, reversed_depth, on_device) = ([1, 1], &rgba[..], None, None);
            let picture = Picture { frame, view: None, size, rgba, reversed_depth, on_device, views, is_settled: true };
            sink.write(&picture).unwrap();
        }
        sink.finish().unwrap();
    }

    #[test]
    fn a_flight_without_a_known_end_ends_with_its_last_frame() {
        let written = Written::default();
        let log = Log { written: Arc::clone(&written), left: None };
        fill(RepeatSink::new(Box::new(log), [0, OPEN_END], 0).unwrap(), &[0, 2]);
        assert_eq!(*written.lock().unwrap(), [(0, 0), (1, 0), (2, 2)]);
    }

    #[test]
    fn every_frame_of_the_flight_has_a_picture() {
        assert_eq!(pictures(None, 0, &[5, 6, 9]), [(5, 5), (6, 6), (7, 6), (8, 6), (9, 9)]);
    }

    #[test]
    fn after_a_renderer_that_was_killed_the_last_picture_stays_until_the_next() {
        assert_eq!(pictures(Some(77), 2, &[8, 9]), [(7, 77), (8, 8), (9, 9)]);
        // The pictures of the last frames went with it.
        assert_eq!(pictures(Some(77), 3, &[]), [(8, 77), (9, 77)]);
        assert_eq!(pictures(Some(77), 2, &[7]), [(7, 7), (8, 7), (9, 7)]);
        // It had written nothing yet, or nothing can be read back.
        assert_eq!(pictures(None, 0, &[7, 9]), [(5, 7), (6, 7), (7, 7), (8, 7), (9, 9)]);
        assert_eq!(pictures(None, 2, &[9]), [(7, 9), (8, 9), (9, 9)]);
        assert_eq!(pictures(None, 5, &[]), []);
    }
}
