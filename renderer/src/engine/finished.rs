//! Frames on their way through an engine, and finished ones.

use super::cost::DrawCosts;
use crate::frame::Frame;
use crate::gpu::FrameTimes;
use crate::pixels::Pixels;
use crate::source::Done;
use terravision_common::camera::Camera;
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::{FrameNumber, RingPosition, Sequence};
use terravision_common::rig::Views;

/// What recording a frame took.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Submitted {
    /// Colour tiles uploaded.
    pub uploads: u32,
    /// When staging them began, nanoseconds of the monotonic clock.
    pub upload_started_nanos: u64,
    /// Nanoseconds spent on finding and staging them.
    pub upload_nanos: u64,
    /// What draws from now on ([`super::Described::driver`]), where that has just been decided.
    pub decided: Option<String>,
}

/// A frame that the device is done with.
#[derive(Debug)]
pub struct Finished {
    /// Its number.
    pub frame: FrameNumber,
    /// Counts the frames of the run from 1.
    pub sequence: Sequence,
    /// One past its last position in the elevation ring.
    pub elevation_end: RingPosition,
    /// One past its last slot in the ring.
    pub slots_end: RingPosition,
    /// The camera that its tree was made for.
    pub pose: Camera,
    /// Width and height of its picture, pixels.
    pub size: [u32; 2],
    /// What its picture shows, and where.
    pub views: Views,
    /// Screen resolutions of facets and texels that its tree was made for, pixels.
    pub r_px: [f64; 2],
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
    /// What each of its draws cost.
    pub costs: DrawCosts,
    /// When recording it began, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// When it was handed to the device, nanoseconds of the monotonic clock.
    pub submitted_nanos: u64,
    /// When it was found finished.
    pub finished_nanos: u64,
    /// Time that the device took by its own clock, if it has one.
    pub gpu_nanos: Option<f64>,
    /// Its pixels.
    pub pixels: Pixels,
}

/// A frame that was taken in, without its picture yet.
#[derive(Debug, Clone, Copy)]
pub(super) struct InFlight {
    frame: FrameNumber,
    done: Done,
    pose: Camera,
    size: [u32; 2],
    views: Views,
    r_px: [f64; 2],
    is_settled: bool,
    costs: DrawCosts,
    started_nanos: u64,
    submitted_nanos: u64,
}

impl InFlight {
    pub(super) fn new(frame: &Frame, costs: DrawCosts, started_nanos: u64, submitted_nanos: u64) -> Self {
        Self {
            frame: FrameNumber::new(frame.marker.frame),
            done: Done {
                sequence: frame.sequence,
                elevation_end: RingPosition::new(frame.end.elevation_end),
                slots_end: frame.slots_end,
            },
            pose: frame.pose,
            size: frame.marker.picture,
            views: frame.views,
            r_px: [frame.marker.r_z_px, frame.marker.r_c_px],
            is_settled: frame.end.unavailable_count == 0,
            costs,
            started_nanos,
            submitted_nanos,
        }
    }

    /// The frame with its picture, now, and with the times of its draws where a device has taken
    /// them.
    pub(super) fn finish_on_device(mut self, times: &FrameTimes, pixels: Pixels) -> Finished {
        for (number, cost) in self.costs.iter_mut().enumerate() {
            cost.nanos = times.piece(number).map(|nanos| nanos as u64);
        }
        Finished { gpu_nanos: times.whole, ..self.finish(pixels) }
    }

    /// The frame with its picture, now.
    pub(super) fn finish(self, pixels: Pixels) -> Finished {
        let Self { frame, done, pose, size, views, r_px, is_settled, costs, started_nanos, submitted_nanos } = self;
        let Done { sequence, elevation_end, slots_end } = done;
        Finished {
            frame,
            sequence,
            elevation_end,
            slots_end,
            pose,
            size,
            views,
            r_px,
            is_settled,
            costs,
            started_nanos,
            submitted_nanos,
            finished_nanos: monotonic_nanos(),
            gpu_nanos: None,
            pixels,
        }
    }
}

impl Finished {
    /// How far frames are done with when this one is.
    #[must_use]
    pub fn done(&self) -> Done {
        Done { sequence: self.sequence, elevation_end: self.elevation_end, slots_end: self.slots_end }
    }
}
