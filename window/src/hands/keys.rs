//! Keys that are held: they move the camera as long as they are down.

use super::navigate::{fly, fly_along_axis, look, speed_at, tilt_about, turn_about, zoom_to};
use super::{Hands, HeldKey, Purpose};
use glam::DVec3;
use std::collections::BTreeSet;
use terravision_common::viewer::ViewerPose;

/// Degrees a second of turning and tilting.
const TURN_SPEED: f64 = 50.0;
const TILT_SPEED: f64 = 35.0;
/// With Shift.
const FASTER: f64 = 4.0;
/// Distances shrink to this share in a second of zooming.
const ZOOM_SHARE: f64 = 0.35;

/// The keys that are down.
#[derive(Debug, Default)]
pub(super) struct Keys {
    down: BTreeSet<HeldKey>,
    pub(super) is_shifted: bool,
    /// What the middle of the picture showed when the first of them went down.
    pub(super) middle: Option<DVec3>,
}

impl Keys {
    pub(super) fn are_held(&self) -> bool {
        !self.down.is_empty()
    }

    pub(super) fn let_go(&mut self, key: HeldKey) {
        self.down.remove(&key);
    }

    pub(super) fn clear(&mut self) {
        self.down.clear();
    }
}

impl Hands {
    pub(super) fn hold(&mut self, key: HeldKey) {
        if !self.keys.are_held() {
            self.stop();
            self.keys.middle = None;
            self.ask_place(self.middle(), Purpose::Keys);
        }
        self.keys.down.insert(key);
    }

    /// The pose after some seconds of the keys that are held.
    pub(super) fn step_keys(&self, pose: &ViewerPose, seconds: f64) -> ViewerPose {
        let metres = speed_at(self.clearance_m(), self.world.side_m) * seconds;
        self.keys.down.iter().fold(*pose, |pose, key| self.step_key(&pose, *key, seconds, metres))
    }

    fn step_key(&self, pose: &ViewerPose, key: HeldKey, seconds: f64, metres: f64) -> ViewerPose {
        use HeldKey as K;
        let is_shifted = self.keys.is_shifted;
        let fast = if is_shifted { metres * FASTER } else { metres };
        match key {
            K::Up if is_shifted => self.tilt(pose, TILT_SPEED * seconds),
            K::Down if is_shifted => self.tilt(pose, -TILT_SPEED * seconds),
            K::Left if is_shifted => self.turn(pose, -TURN_SPEED * seconds),
            K::Right if is_shifted => self.turn(pose, TURN_SPEED * seconds),
            K::Up => fly(pose, metres, 0.0, 0.0),
            K::Down => fly(pose, -metres, 0.0, 0.0),
            K::Left => fly(pose, 0.0, -metres, 0.0),
            K::Right => fly(pose, 0.0, metres, 0.0),
            K::Forward => fly_along_axis(pose, fast, 0.0),
            K::Backward => fly_along_axis(pose, -fast, 0.0),
            K::LeftWing => fly_along_axis(pose, 0.0, -fast),
            K::RightWing => fly_along_axis(pose, 0.0, fast),
            K::Rise => fly(pose, 0.0, 0.0, fast),
            K::Sink => fly(pose, 0.0, 0.0, -fast),
            K::ZoomIn => self.zoom_middle(pose, ZOOM_SHARE.powf(seconds)),
            K::ZoomOut => self.zoom_middle(pose, ZOOM_SHARE.powf(-seconds)),
        }
    }

    fn turn(&self, pose: &ViewerPose, angle: f64) -> ViewerPose {
        self.keys.middle.map_or_else(|| look(pose, angle, 0.0), |place| turn_about(pose, place, angle))
    }

    fn tilt(&self, pose: &ViewerPose, angle: f64) -> ViewerPose {
        self.keys.middle.map_or_else(|| look(pose, 0.0, angle), |place| tilt_about(pose, place, angle))
    }

    fn zoom_middle(&self, pose: &ViewerPose, factor: f64) -> ViewerPose {
        let place = self.keys.middle.unwrap_or_else(|| self.ahead(self.middle()));
        zoom_to(pose, place, factor, self.zoom_bounds())
    }
}
