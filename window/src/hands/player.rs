//! A path that is played: poses at even steps of time, straight between them.

use super::view::{eye_of, turn};
use terravision_common::camera::is_cut;
use terravision_common::viewer::ViewerPose;

/// A path, and where on it the camera is.
#[derive(Debug)]
pub(super) struct Player {
    poses: Vec<ViewerPose>,
    fps: f64,
    passed_s: f64,
    is_playing: bool,
}

impl Player {
    /// Of a path with a pose for each frame; `None` for one without any.
    pub(super) fn new(poses: Vec<ViewerPose>, fps: f64) -> Option<Self> {
        (!poses.is_empty()).then_some(Self { poses, fps, passed_s: 0.0, is_playing: false })
    }

    pub(super) fn is_playing(&self) -> bool {
        self.is_playing
    }

    pub(super) fn pause(&mut self) {
        self.is_playing = false;
    }

    /// Plays from where it was paused, or from the start when it had come to its end.
    pub(super) fn play(&mut self) {
        if self.passed_s >= self.length_s() {
            self.passed_s = 0.0;
        }
        self.is_playing = true;
    }

    /// Where on the path the camera is, and how long it takes, seconds.
    pub(super) fn progress_s(&self) -> [f64; 2] {
        [self.passed_s, self.length_s()]
    }

    /// The pose some seconds later. At its end it pauses.
    pub(super) fn step(&mut self, seconds: f64) -> ViewerPose {
        self.passed_s += seconds;
        if self.passed_s >= self.length_s() {
            (self.passed_s, self.is_playing) = (self.length_s(), false);
        }
        let frame = self.passed_s * self.fps;
        self.pose_at(frame.floor() as usize, frame.fract())
    }

    fn length_s(&self) -> f64 {
        (self.poses.len() - 1) as f64 / self.fps
    }

    /// The pose a share of the way from one frame to the next; at a cut it stays until the next.
    fn pose_at(&self, frame: usize, share: f64) -> ViewerPose {
        let at = |index: usize| &self.poses[index.min(self.poses.len() - 1)];
        let way = |a: &ViewerPose, b: &ViewerPose| eye_of(a).distance(eye_of(b));
        let (from, to) = (at(frame), at(frame + 1));
        let around = [way(at(frame.saturating_sub(1)), from), way(to, at(frame + 2))];
        if self.poses.len() > 3 && is_cut(way(from, to), around) { *from } else { straight(from, to, share) }
    }
}

/// The pose a share of the way from one to another, at a constant speed.
fn straight(a: &ViewerPose, b: &ViewerPose, share: f64) -> ViewerPose {
    let mix = |from: f64, to: f64| from + (to - from) * share;
    ViewerPose {
        x: mix(a.x, b.x),
        y: mix(a.y, b.y),
        z: mix(a.z, b.z),
        heading: a.heading + turn(a.heading, b.heading) * share,
        pitch: mix(a.pitch, b.pitch),
        roll: a.roll + turn(a.roll, b.roll) * share,
        vfov: mix(a.vfov, b.vfov),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64) -> ViewerPose {
        ViewerPose { x, y: 0.0, z: 100.0, heading: 350.0 + x, pitch: -10.0, roll: 0.0, vfov: 60.0 }
    }

    fn player(places: &[f64]) -> Player {
        Player::new(places.iter().copied().map(pose).collect(), 10.0).unwrap()
    }

    #[test]
    fn a_path_is_played_to_its_end_paused_and_played_again() {
        let mut path = player(&[0.0, 10.0, 20.0, 30.0]);
        path.play();
        let middle = path.step(0.15);
        assert!((middle.x - 15.0).abs() < 1e-9 && (turn(5.0, middle.heading)).abs() < 1e-9, "{middle:?}");
        path.pause();
        assert!(!path.is_playing());
        path.play();
        assert_eq!((path.step(9.0).x, path.is_playing(), path.progress_s()), (30.0, false, [0.3, 0.3]));
        path.play();
        assert_eq!((path.step(0.0).x, path.is_playing()), (0.0, true));
    }

    #[test]
    fn the_camera_does_not_fly_across_a_cut() {
        let mut path = player(&[0.0, 10.0, 20.0, 9000.0, 9010.0, 9020.0]);
        path.play();
        let places: Vec<f64> = (0..10).map(|_| path.step(0.05).x.round()).collect();
        assert_eq!(places, [5.0, 10.0, 15.0, 20.0, 20.0, 9000.0, 9005.0, 9010.0, 9015.0, 9020.0]);
        assert!(Player::new(Vec::new(), 30.0).is_none());
        let mut still = player(&[7.0]);
        still.play();
        assert_eq!((still.step(0.1).x, still.is_playing()), (7.0, false));
    }
}
