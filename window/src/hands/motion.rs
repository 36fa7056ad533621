//! What moves the camera by itself: a flight to a pose, a soft turn, and the rest of a zoom.

use super::navigate::{between, ease, look, tilt_about, turn_about, zoom_to};
use super::view::turn;
use glam::DVec3;
use terravision_common::viewer::ViewerPose;

/// A soft turn takes this long, seconds.
const TURN_S: f64 = 0.25;
/// A zoom does most of its rest in this time, seconds.
const ZOOM_S: f64 = 0.07;
/// What is left of a zoom when it is done at once (of the logarithm of the factor).
const ZOOM_REST: f64 = 0.004;
/// Most zooming that is still to come (likewise).
const MOST_ZOOM: f64 = 4.0;

/// A motion that ends by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Planned {
    /// From a pose to another.
    Flight { from: ViewerPose, to: ViewerPose, ground_m: f64, duration_s: f64, passed_s: f64 },
    /// By these angles about a place, or about the camera itself; the share that is left.
    Turn { place: Option<DVec3>, heading: f64, pitch: f64, left: f64 },
}

impl Planned {
    /// Turns until north is up.
    pub(super) fn north_up(pose: &ViewerPose, place: Option<DVec3>) -> Self {
        Self::Turn { place, heading: turn(pose.heading, 0.0), pitch: 0.0, left: 1.0 }
    }

    /// The pose some seconds later; `None` when it has ended.
    pub(super) fn step(&mut self, pose: &ViewerPose, seconds: f64) -> Option<ViewerPose> {
        match self {
            Self::Flight { from, to, ground_m, duration_s, passed_s } => {
                if passed_s >= duration_s {
                    return None;
                }
                *passed_s += seconds;
                let is_there = passed_s >= duration_s;
                Some(if is_there { *to } else { between(from, to, ease(*passed_s / *duration_s), *ground_m) })
            }
            Self::Turn { place, heading, pitch, left } => {
                if *left <= 0.0 {
                    return None;
                }
                let share = (seconds / TURN_S).clamp(0.0, *left);
                *left -= share;
                let [heading, pitch] = [*heading, *pitch].map(|angle| angle * share);
                Some(match place {
                    Some(place) => tilt_about(&turn_about(pose, *place, heading), *place, pitch),
                    None => look(pose, heading, pitch),
                })
            }
        }
    }
}

/// A zoom that goes on for a moment after the wheel has turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Zoom {
    place: DVec3,
    /// Of the logarithm of the factor.
    left: f64,
}

impl Zoom {
    /// To a place, by a factor of the distance; what is left of one before is added.
    pub(super) fn to(place: DVec3, factor: f64, before: Option<Self>) -> Self {
        let left = before.map_or(0.0, |before| before.left) + factor.ln();
        Self { place, left: left.clamp(-MOST_ZOOM, MOST_ZOOM) }
    }

    /// The pose some seconds later, and whether it goes on.
    pub(super) fn step(&mut self, pose: &ViewerPose, seconds: f64, bounds_m: [f64; 2]) -> (ViewerPose, bool) {
        let share = 1.0 - (-seconds / ZOOM_S).exp();
        let done = if self.left.abs() < ZOOM_REST { self.left } else { self.left * share };
        self.left -= done;
        (zoom_to(pose, self.place, done.exp(), bounds_m), self.left != 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: ViewerPose =
        ViewerPose { x: 0.0, y: 0.0, z: 100.0, heading: 90.0, pitch: -45.0, roll: 0.0, vfov: 60.0 };

    #[test]
    fn motions_end_where_they_should() {
        let to = ViewerPose { x: 500.0, ..POSE };
        let mut flight = Planned::Flight { from: POSE, to, ground_m: 0.0, duration_s: 1.0, passed_s: 0.0 };
        let mut pose = POSE;
        let mut steps = 0;
        while let Some(next) = flight.step(&pose, 0.1) {
            assert!(next.x >= pose.x - 1e-6);
            (pose, steps) = (next, steps + 1);
        }
        // Ten tenths may be a hair less than one.
        assert!(pose == to && (10..=11).contains(&steps), "{pose:?} after {steps}");
        let mut turn = Planned::north_up(&POSE, None);
        let mut pose = POSE;
        while let Some(next) = turn.step(&pose, 0.1) {
            pose = next;
        }
        assert!(pose.heading.abs() < 1e-9);
    }

    #[test]
    fn a_zoom_is_done_in_a_moment_and_adds_up() {
        let mut zoom = Zoom::to(DVec3::ZERO, 0.5, Some(Zoom::to(DVec3::ZERO, 0.5, None)));
        let (mut pose, mut steps) = (POSE, 0);
        loop {
            let (next, goes_on) = zoom.step(&pose, 0.01, [3.0, 1e6]);
            (pose, steps) = (next, steps + 1);
            if !goes_on {
                break;
            }
        }
        assert!((pose.z - 25.0).abs() < 1e-6 && (10..100).contains(&steps), "{} after {steps}", pose.z);
    }
}
