//! Poses and sizes of pictures on their way to the flight, by shared memory.

use crate::WindowError;
use terravision_common::event::monotonic_nanos;
use terravision_common::shm::{PoseRecord, PoseSender, SharedName};
use terravision_common::viewer::ViewerPose;

/// Two poses are this far apart in time at least, seconds.
const LEAST_STEP_S: f64 = 1e-6;
/// Smallest side of a picture, pixels.
const LEAST_PX: f64 = 16.0;

/// Seconds of the monotonic clock.
pub(super) fn now_s() -> f64 {
    monotonic_nanos() as f64 / 1e9
}

/// The size of the picture for a window: `scale` times as large, within what the flight can draw,
/// as wide for its height.
pub(super) fn picture_size(window_px: [u32; 2], scale: f64, most_px: [u32; 2]) -> [u32; 2] {
    let wanted = window_px.map(|side| f64::from(side) * scale);
    let shrink = (0..2).map(|axis| f64::from(most_px[axis]) / wanted[axis].max(1.0)).fold(1.0, f64::min);
    [0, 1].map(|axis| ((wanted[axis] * shrink).round().max(LEAST_PX) as u32).min(most_px[axis]))
}

/// The sender of poses.
#[derive(Debug)]
pub(super) struct Poses {
    sender: PoseSender,
    sent: Option<(ViewerPose, [u32; 2])>,
    newest_s: f64,
}

impl Poses {
    /// To the flight of this name.
    pub(super) fn open(name: &str) -> Result<Self, WindowError> {
        Ok(Self { sender: PoseSender::open(&SharedName::parse(name)?)?, sent: None, newest_s: 0.0 })
    }

    /// Where a window before this one, whose renderer was killed, has left the camera.
    pub(super) fn left(&self) -> Option<ViewerPose> {
        let PoseRecord { position: [x, y, z], heading_deg, pitch_deg, roll_deg, vfov_deg, .. } =
            self.sender.newest()?;
        let pose = ViewerPose { x, y, z, heading: heading_deg, pitch: pitch_deg, roll: roll_deg, vfov: vfov_deg };
        pose.fault().is_none().then_some(pose)
    }

    /// Sends a pose and the size of its picture, if one of them is new.
    pub(super) fn send(&mut self, pose: &ViewerPose, size: [u32; 2]) {
        if self.sent != Some((*pose, size)) {
            self.sent = Some((*pose, size));
            self.put(pose, size, false);
        }
    }

    /// Ends the flight.
    pub(super) fn end(&mut self, pose: &ViewerPose) {
        self.put(pose, [0; 2], true);
    }

    fn put(&mut self, pose: &ViewerPose, size: [u32; 2], is_end: bool) {
        self.newest_s = now_s().max(self.newest_s + LEAST_STEP_S);
        self.sender.send(&PoseRecord {
            position: [pose.x, pose.y, pose.z],
            heading_deg: pose.heading,
            pitch_deg: pose.pitch,
            roll_deg: pose.roll,
            vfov_deg: pose.vfov,
            time_s: self.newest_s,
            size,
            is_end,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_as_large_as_their_window_within_limits() {
        let most = [3840, 2160];
        assert_eq!(picture_size([1280, 720], 1.0, most), [1280, 720]);
        assert_eq!(picture_size([1280, 720], 0.5, most), [640, 360]);
        assert_eq!(picture_size([5120, 1440], 1.0, most), [3840, 1080]);
        assert_eq!(picture_size([1, 0], 1.0, most), [16, 16]);
        assert_eq!(picture_size([100, 40_000], 1.0, most), [16, 2160]);
    }
}
