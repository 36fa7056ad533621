//! A folder of a realtime flight: one picture for every frame of the flight. In place of a frame
//! that was left out the last picture is there once more, so that a film of them keeps the flight's
//! time.

use super::{FrameSink, Picture, SinkError, SizedRgba};
use crate::pixels::PixelPlaces;
use std::ops::Range;
use terravision_common::camera::Camera;
use terravision_common::ids::FrameNumber;
use terravision_common::rig::Views;
use terravision_common::run::OPEN_END;

/// Fills the gaps between the frames that another sink is given.
pub struct RepeatSink {
    inner: Box<dyn FrameSink>,
    /// The frames of the flight.
    frames: Range<FrameNumber>,
    /// The frame that has to be written next.
    next: FrameNumber,
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
    pub fn new(mut inner: Box<dyn FrameSink>, frames: Range<FrameNumber>, written: u64) -> Result<Self, SinkError> {
        let number = |written: u64| FrameNumber::new(frames.start.get().saturating_add(written)).min(frames.end);
        let next = number(written);
        let last = written.checked_sub(1).map_or(Ok(None), |before| inner.read_back(number(before)))?;
        Ok(Self { inner, frames, next, last })
    }

    /// Writes a picture for every frame before `until`.
    fn repeat(&mut self, until: FrameNumber, picture: &Picture<'_>) -> Result<(), SinkError> {
        while self.next < until {
            let stand_in = Picture { frame: self.next, reversed_depth: None, is_settled: false, ..*picture };
            self.inner.write(&stand_in)?;
            self.next = self.next.next();
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
        self.next = picture.frame.next();
        let (size, rgba) = self.last.get_or_insert_default();
        *size = picture.size;
        rgba.clear();
        rgba.extend_from_slice(picture.rgba);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), SinkError> {
        // Only what went with a renderer that was killed is missing here; a flight without a known
        // end ends where it ends.
        if let Some((size, rgba)) = self.last.take().filter(|_| self.frames.end.get() != OPEN_END) {
            let views = Views::single(&Camera::default());
            let (frame, rgba) = (self.next, &rgba);
            let on_device = None;
            let last =
                Picture { frame, view: None, size, rgba, reversed_depth: None, on_device, views, is_settled: false };
            self.repeat(self.frames.end, &last)?;
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
            self.written.lock().unwrap().push((picture.frame.get(), picture.rgba[0]));
            Ok(())
        }

        fn finish(&mut self) -> Result<(), SinkError> {
            Ok(())
        }

        fn read_back(&mut self, _frame: FrameNumber) -> Result<Option<SizedRgba>, SinkError> {
            Ok(self.left.take())
        }
    }

    fn pictures(left: Option<u8>, before: u64, frames: &[u64]) -> Vec<(u64, u8)> {
        let written = Written::default();
        let left = left.map(|byte| ([1, 1], vec![byte; 4]));
        let log = Log { written: Arc::clone(&written), left };
        fill(RepeatSink::new(Box::new(log), FrameNumber::new(5)..FrameNumber::new(10), before).unwrap(), frames);
        written.lock().unwrap().clone()
    }

    fn fill(mut sink: RepeatSink, frames: &[u64]) {
        for &frame in frames {
            let rgba = [frame as u8; 4];
            let views = Views::single(&Camera::default());
            let (size, rgba, reversed_depth, on_device) = ([1, 1], &rgba[..], None, None);
            let frame = FrameNumber::new(frame);
            let picture = Picture { frame, view: None, size, rgba, reversed_depth, on_device, views, is_settled: true };
            sink.write(&picture).unwrap();
        }
        sink.finish().unwrap();
    }

    #[test]
    fn a_flight_without_a_known_end_ends_with_its_last_frame() {
        let written = Written::default();
        let log = Log { written: Arc::clone(&written), left: None };
        fill(RepeatSink::new(Box::new(log), FrameNumber::new(0)..FrameNumber::new(OPEN_END), 0).unwrap(), &[0, 2]);
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
