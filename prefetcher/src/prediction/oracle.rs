//! Future cameras of a known path, which the launcher sends. Predictions are compared with them.

use std::collections::VecDeque;
use terravision_common::camera::Camera;
use terravision_common::shm::{CameraRecord, Consumer, ShmError};

/// Views that are searched in each cycle, evenly spread over twice the time ahead.
const VIEWS: u64 = 8;

/// The future cameras.
#[derive(Debug)]
pub struct Oracle {
    ring: Consumer<CameraRecord>,
    /// Time in the flight and camera, in order.
    to_come: VecDeque<(u64, Camera)>,
}

impl Oracle {
    /// Takes cameras from a ring. Their times are relative to the first frame.
    #[must_use]
    pub fn new(ring: Consumer<CameraRecord>) -> Self {
        Self { ring, to_come: VecDeque::new() }
    }

    /// Cameras from `now`, relative to the first frame, up to twice the time ahead, in order of
    /// time.
    ///
    /// # Errors
    /// [`ShmError`] when the ring is corrupt.
    pub fn cameras(&mut self, now_nanos: u64, ahead_nanos: u64) -> Result<Vec<Camera>, ShmError> {
        let until = now_nanos.saturating_add(2 * ahead_nanos);
        while self.to_come.back().is_none_or(|(at, _)| *at < until) {
            let Some(CameraRecord { camera, .. }) = self.ring.try_pop()? else { break };
            if let Ok(camera) = Camera::new(camera) {
                self.to_come.push_back((camera.timestamp_nanos(), camera));
            }
        }
        // The newest camera that has passed is the current one.
        while self.to_come.get(1).is_some_and(|(at, _)| *at <= now_nanos) {
            self.to_come.pop_front();
        }
        let mut cameras: Vec<Camera> = Vec::new();
        for view in 1..=VIEWS {
            let moment = now_nanos.saturating_add(2 * ahead_nanos * view / VIEWS);
            let next = self.to_come.iter().find(|(at, _)| *at >= moment).or(self.to_come.back());
            if let Some((_, camera)) = next
                && cameras.last().is_none_or(|last| !last.is_same_view(camera))
            {
                cameras.push(*camera);
            }
        }
        Ok(cameras)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::CameraFields;
    use terravision_common::shm::memory;

    const MS: u64 = 1_000_000;

    fn camera(at_nanos: u64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: [at_nanos as f64 / MS as f64, 0.0, 100.0],
            heading_rad: 0.0,
            pitch_rad: 0.0,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 64,
            height: 36,
            timestamp_nanos: at_nanos,
        })
        .expect("valid")
    }

    #[test]
    fn views_are_those_of_the_time_ahead_and_the_last_one_at_the_end() {
        let (mut writer, reader) = memory::ring::<CameraRecord>(64).expect("valid");
        for k in 0..60 {
            writer.try_push(CameraRecord { frame: k, camera: *camera(k * 100 * MS).fields() }).expect("there is room");
        }
        let mut oracle = Oracle::new(reader);
        let mut east = |now: u64, ahead: u64| -> Vec<f64> {
            let cameras = oracle.cameras(now * MS, ahead * MS).expect("not corrupt");
            cameras.iter().map(|camera| camera.fields().eye_in_world[0]).collect()
        };
        assert_eq!(east(0, 400), [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0]);
        assert_eq!(east(1050, 800), [1300.0, 1500.0, 1700.0, 1900.0, 2100.0, 2300.0, 2500.0, 2700.0]);
        // A path that pauses, or ends, has a single view.
        assert_eq!(east(5900, 800), [5900.0]);
        assert_eq!(east(90_000, 800), [5900.0]);
    }
}
