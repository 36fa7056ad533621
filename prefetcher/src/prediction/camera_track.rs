//! Prediction of the camera.

use std::collections::VecDeque;
use std::f64::consts::{FRAC_PI_2, PI};
use terravision_common::camera::{Camera, CameraFields, MAX_SIDE_PX};
use terravision_common::rig::{View, Views};
use terravision_common::run::Prediction;

/// Number of poses that are kept.
const POSES: usize = 128;
/// Speed is measured over this time: long enough that jitter of poses matters little, short enough
/// to follow a bend.
const BASE_SECS: f64 = 0.2;
/// A camera without a new pose for this long counts as resting.
const REST_SECS: f64 = 0.5;
/// The field of view is widened by this much per second ahead, because the path may bend.
const WIDENING_RAD_PER_SEC: f64 = 0.2;
/// The widest field of view, vertically.
const WIDEST_RAD: f64 = 2.4;

/// A pose as continuous numbers: angles do not wrap.
type Pose = [f64; 6];

/// Recent poses, and the prediction from them.
#[derive(Debug)]
pub struct CameraTrack {
    poses: VecDeque<(f64, Pose)>,
    newest: Option<Camera>,
}

impl Default for CameraTrack {
    fn default() -> Self {
        Self { poses: VecDeque::with_capacity(POSES), newest: None }
    }
}

fn secs(nanos: u64) -> f64 {
    nanos as f64 / 1e9
}

impl CameraTrack {
    /// Takes the newest camera, read at `now`. A camera without a time of its own gets that time.
    pub fn see(&mut self, camera: &Camera, now_nanos: u64) {
        if self.newest == Some(*camera) {
            return;
        }
        let nanos = if camera.timestamp_nanos() == 0 { now_nanos } else { camera.timestamp_nanos() };
        let time = secs(nanos);
        let CameraFields { eye_in_world: [x, y, z], heading_rad, pitch_rad, roll_rad, .. } = *camera.fields();
        let mut pose = [x, y, z, heading_rad, pitch_rad, roll_rad];
        if let Some((before, last)) = self.poses.back() {
            if time <= *before {
                // Time runs forward; for another flight, or another clock, start afresh.
                self.poses.clear();
            } else {
                for angle in 3..6 {
                    let turn = pose[angle] - last[angle];
                    pose[angle] = last[angle] + turn - 2.0 * PI * (turn / (2.0 * PI)).round();
                }
            }
        }
        if self.poses.len() == POSES {
            self.poses.pop_front();
        }
        self.poses.push_back((time, pose));
        self.newest = Some(*camera);
    }

    /// The predicted camera `ahead_secs` after `now`, with a wider field of view at the same scale;
    /// `None` before the first pose.
    #[must_use]
    pub fn predict(&self, now_nanos: u64, ahead_secs: f64, prediction: Prediction) -> Option<Camera> {
        let camera = self.newest?;
        let &(time, pose) = self.poses.back()?;
        let age = (secs(now_nanos) - time).max(0.0);
        let ahead = if age > REST_SECS { 0.0 } else { age + ahead_secs };
        let mut later = pose;
        if let Some((speed, gain)) = self.motion(prediction) {
            for axis in 0..6 {
                later[axis] += speed[axis] * ahead + 0.5 * gain[axis] * ahead * ahead;
            }
        }
        let [x, y, z, heading_rad, pitch_rad, roll_rad] = later;
        let pitch_rad = pitch_rad.clamp(-FRAC_PI_2, FRAC_PI_2);
        let fields = CameraFields { eye_in_world: [x, y, z], heading_rad, pitch_rad, roll_rad, ..*camera.fields() };
        // After a jump the prediction may be far out of bounds.
        let moved = Camera::new(fields).unwrap_or(camera);
        Some(widened(&moved, WIDENING_RAD_PER_SEC * ahead_secs))
    }

    /// Current speed and acceleration, per second and per second squared.
    fn motion(&self, prediction: Prediction) -> Option<(Pose, Pose)> {
        let &(time, pose) = self.poses.back()?;
        let before = |secs: f64| {
            let old = self.poses.iter().rev().find(|(t, _)| time - t >= secs).or(self.poses.front())?;
            (time - old.0 > 1e-3).then_some(*old)
        };
        let slope = |(t0, p0): (f64, Pose), (t1, p1): (f64, Pose)| {
            std::array::from_fn::<f64, 6, _>(|axis| (p1[axis] - p0[axis]) / (t1 - t0))
        };
        let middle = before(BASE_SECS)?;
        let late = slope(middle, (time, pose));
        let resting = [0.0; 6];
        match prediction {
            Prediction::Off | Prediction::Oracle => None,
            Prediction::Linear => Some((late, resting)),
            Prediction::Quadratic => {
                let old = before(2.0 * BASE_SECS).filter(|old| middle.0 - old.0 > 1e-3);
                let Some(old) = old else { return Some((late, resting)) };
                let early = slope(old, middle);
                // Each slope is the speed in the middle of its interval.
                let between = 0.5 * (time - old.0);
                let gain = std::array::from_fn(|axis| (late[axis] - early[axis]) / between);
                let half = 0.5 * (time - middle.0);
                Some((std::array::from_fn(|axis| late[axis] + gain[axis] * half), gain))
            }
        }
    }
}

/// Views with wider fields of view, for poses that are predicted this far ahead.
#[must_use]
pub fn widened_views(views: &Views, ahead_secs: f64) -> Views {
    let wider = |view: &View| View { camera: widened(&view.camera, WIDENING_RAD_PER_SEC * ahead_secs), ..*view };
    Views::new(views.iter().map(wider)).unwrap_or(*views)
}

/// The camera with a wider field of view, and with a picture that is larger in proportion: the size
/// of a pixel stays the same, and so do the wanted levels.
fn widened(camera: &Camera, by_rad: f64) -> Camera {
    let narrow_rad = camera.vfov_rad();
    let vfov_rad = (narrow_rad + by_rad.max(0.0)).min(WIDEST_RAD.max(narrow_rad));
    let factor = (0.5 * vfov_rad).tan() / (0.5 * narrow_rad).tan();
    let larger = |pixels: u32| (f64::from(pixels) * factor).round().clamp(1.0, MAX_SIDE_PX.into()) as u32;
    let (width, height) = (larger(camera.width()), larger(camera.height()));
    // Always valid: at least as wide as it was, and the sides are clamped.
    Camera::new(CameraFields { vfov_rad, width, height, ..*camera.fields() }).unwrap_or(*camera)
}
