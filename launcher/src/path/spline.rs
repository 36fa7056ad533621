//! A smooth flight through poses at given moments.
//!
//! Position: cubic Hermite pieces whose tangents are those of the parabola through three
//! neighbouring poses (non-uniform Catmull-Rom; Bessel tangents), at most three times the slower
//! neighbour's speed, as for monotone curves (Fritsch and Carlson, "Monotone piecewise cubic
//! interpolation", 1980). So velocity is continuous: no corner. Attitude: the same on the sphere of
//! rotations, as Bézier curves built of spherical interpolations (Shoemake, "Animating rotation
//! with quaternion curves", SIGGRAPH 1985), along the shorter arc between neighbours; angular
//! velocity is continuous too. A rotation along the shorter arc tilts the horizon where heading and
//! pitch change together. So the view's direction is that of the rotation, and roll goes from key
//! to key by itself, as a number: between level poses the horizon stays level. Only where the view
//! may come near the vertical, where heading and roll are one turn, the rotation has its roll, too.

use super::Pose;
use glam::{DQuat, DVec3};
use std::f64::consts::PI;
use terravision_common::surface;

/// A pose at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Key {
    /// The moment, seconds.
    pub t: f64,
    /// The pose.
    pub pose: Pose,
    /// Whether the camera stands still for this moment.
    pub is_stop: bool,
    /// How high the way to the next pose rises above the curve half-way, metres.
    pub hop_m: f64,
}

impl Key {
    /// A pose that is passed through.
    #[must_use]
    pub fn passing(t: f64, pose: Pose) -> Self {
        Self { t, pose, is_stop: false, hop_m: 0.0 }
    }
}

/// A knot: the key, as the curve needs it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    t: f64,
    position: DVec3,
    attitude: DQuat,
    velocity: DVec3,
    /// Angular velocity in the camera's own frame, a rotation vector per second.
    spin: DVec3,
    /// Roll, radians, without jumps from knot to knot, and its change per second.
    roll: f64,
    roll_speed: f64,
    is_stop: bool,
    hop_m: f64,
}

/// Poses at most that steep, and that far apart in heading, have no steeper view between them than
/// 74 degrees.
const STEEPEST_LEVEL_RAD: f64 = 60.0 / 180.0 * PI;
const WIDEST_LEVEL_RAD: f64 = 120.0 / 180.0 * PI;

/// A target that is nearer than this gives no direction.
const NEAREST_TARGET_M: f64 = 1e-6;

/// A smooth flight; at least one pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Spline {
    knots: Vec<Knot>,
    /// Whether roll is interpolated by itself.
    has_own_roll: bool,
    /// What the camera looks at all the time, whatever the poses say.
    target: Option<DVec3>,
}

impl Spline {
    /// The flight through these keys. `None` unless there is one and moments grow from each to the
    /// next.
    #[must_use]
    pub fn new(keys: &[Key]) -> Option<Self> {
        let grows = keys.windows(2).all(|pair| pair[0].t < pair[1].t);
        if keys.is_empty() || !grows || !keys.iter().all(|key| key.t.is_finite()) {
            return None;
        }
        let mut knots: Vec<Knot> = keys
            .iter()
            .map(|key| Knot {
                t: key.t,
                position: key.pose.position,
                attitude: attitude_from_pose(&key.pose),
                velocity: DVec3::ZERO,
                spin: DVec3::ZERO,
                roll: key.pose.roll_rad,
                roll_speed: 0.0,
                is_stop: key.is_stop,
                hop_m: key.hop_m,
            })
            .collect();
        for i in 1..knots.len() {
            // q and -q are one attitude; the shorter arc is the one between quaternions of one
            // hemisphere.
            if knots[i].attitude.dot(knots[i - 1].attitude) < 0.0 {
                knots[i].attitude = -knots[i].attitude;
            }
            knots[i].roll = knots[i - 1].roll + turn_between(knots[i - 1].roll, knots[i].roll);
        }
        for i in 0..knots.len() {
            if keys[i].is_stop {
                continue;
            }
            let before = i.checked_sub(1).map(|j| slope(&knots[j], &knots[i]));
            let after = knots.get(i + 1).map(|next| slope(&knots[i], next));
            let (velocity, spin, roll_speed) = match (before, after) {
                (Some(a), Some(b)) => {
                    let weight = a.seconds / (a.seconds + b.seconds);
                    // Beside a fast piece a slow one would swing far out, and one that stands still
                    // would move.
                    let fastest = 3.0 * a.velocity.length().min(b.velocity.length());
                    let velocity = a.velocity.lerp(b.velocity, weight).clamp_length_max(fastest);
                    let spin = a.spin.lerp(b.spin, weight).clamp_length_max(a.fastest_spin().min(b.fastest_spin()));
                    let fastest_roll = 3.0 * a.roll_speed.abs().min(b.roll_speed.abs());
                    let roll_speed = a.roll_speed + (b.roll_speed - a.roll_speed) * weight;
                    (velocity, spin, roll_speed.clamp(-fastest_roll, fastest_roll))
                }
                (Some(only), None) | (None, Some(only)) => (only.velocity, only.spin, only.roll_speed),
                (None, None) => (DVec3::ZERO, DVec3::ZERO, 0.0),
            };
            knots[i].velocity = velocity;
            knots[i].spin = spin;
            knots[i].roll_speed = roll_speed;
        }
        let is_flat = keys.iter().all(|key| key.pose.pitch_rad.abs() <= STEEPEST_LEVEL_RAD);
        let has_own_roll = is_flat
            && keys
                .windows(2)
                .all(|pair| turn_between(pair[0].pose.heading_rad, pair[1].pose.heading_rad).abs() <= WIDEST_LEVEL_RAD);
        Some(Self { knots, has_own_roll, target: None })
    }

    /// The same way, but the camera looks at a place all the time; it rolls as the poses do.
    #[must_use]
    pub fn looking_at(self, target: Option<DVec3>) -> Self {
        Self { target, has_own_roll: self.has_own_roll || target.is_some(), ..self }
    }

    /// What the camera looks at all the time.
    #[must_use]
    pub fn target(&self) -> Option<DVec3> {
        self.target
    }

    /// The poses that it was made of; a way that rises half-way has one there.
    pub fn keys(&self) -> impl Iterator<Item = Key> {
        let half_ways = self.knots.windows(2).map(|pair| {
            let t = f64::midpoint(pair[0].t, pair[1].t);
            (pair[0].hop_m != 0.0).then(|| Key::passing(t, self.pose(t)))
        });
        let key = |knot: &Knot| Key { is_stop: knot.is_stop, ..Key::passing(knot.t, self.pose_at(knot)) };
        self.knots
            .iter()
            .map(key)
            .zip(half_ways.chain([None]))
            .flat_map(|(key, half_way)| [Some(key), half_way])
            .flatten()
    }

    /// Its first moment.
    #[must_use]
    pub fn start(&self) -> f64 {
        self.knots.first().map_or(0.0, |knot| knot.t)
    }

    /// Its last moment.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.t)
    }

    /// The pose at a moment; before the first and after the last it stands still.
    #[must_use]
    pub fn pose(&self, t: f64) -> Pose {
        let after = self.knots.partition_point(|knot| knot.t <= t);
        let (a, b) = match (after.checked_sub(1), self.knots.get(after)) {
            (Some(i), Some(next)) => (&self.knots[i], next),
            (Some(i), None) => return self.pose_at(&self.knots[i]),
            (None, _) => return self.pose_at(&self.knots[0]),
        };
        let h = b.t - a.t;
        let s = (t - a.t) / h;
        // Relative to the first end: coordinates of millions of metres would cost digits in the
        // products.
        let step = b.position - a.position;
        let (s2, s3) = (s * s, s * s * s);
        let mut position = a.position
            + step * (3.0 * s2 - 2.0 * s3)
            + a.velocity * (h * (s3 - 2.0 * s2 + s))
            + b.velocity * (h * (s3 - s2));
        position.z += a.hop_m * (PI * s).sin().powi(2);
        let first = a.attitude * DQuat::from_scaled_axis(a.spin * (h / 3.0));
        let second = b.attitude * DQuat::from_scaled_axis(b.spin * (-h / 3.0));
        let pose = pose_from_attitude(position, bezier(a.attitude, first, second, b.attitude, s));
        let roll_rad = a.roll
            + (b.roll - a.roll) * (3.0 * s2 - 2.0 * s3)
            + a.roll_speed * (h * (s3 - 2.0 * s2 + s))
            + b.roll_speed * (h * (s3 - s2));
        self.finished(pose, roll_rad)
    }

    fn pose_at(&self, knot: &Knot) -> Pose {
        self.finished(pose_from_attitude(knot.position, knot.attitude), knot.roll)
    }

    /// A pose with the roll of its own, where there is one, and turned to the target.
    fn finished(&self, pose: Pose, roll_rad: f64) -> Pose {
        let pose = if self.has_own_roll { Pose { roll_rad, ..pose } } else { pose };
        let Some(sight) = self.target.map(|target| target - pose.position) else { return pose };
        if sight.length() < NEAREST_TARGET_M {
            return pose;
        }
        // Above the target the heading is that of the way.
        let is_above = sight.x.hypot(sight.y) < NEAREST_TARGET_M;
        let heading_rad = if is_above { pose.heading_rad } else { surface::heading(sight) };
        Pose { heading_rad, pitch_rad: surface::pitch(sight), ..pose }
    }
}

/// The shorter turn from one angle to another, radians.
fn turn_between(from: f64, to: f64) -> f64 {
    (to - from + PI).rem_euclid(2.0 * PI) - PI
}

struct Slope {
    seconds: f64,
    velocity: DVec3,
    spin: DVec3,
    roll_speed: f64,
}

impl Slope {
    /// The angular velocity at an end above which the Bézier curve's inner points would leave the
    /// half of the sphere around it, where the shorter arc jumps to the other side; and which would
    /// swing out more than half the turn.
    fn fastest_spin(&self) -> f64 {
        let turn = self.spin.length() * self.seconds;
        (0.5 * turn).min(0.45 * (PI - turn)).max(0.0) * 3.0 / self.seconds
    }
}

fn slope(a: &Knot, b: &Knot) -> Slope {
    let seconds = b.t - a.t;
    // The axis of a rotation is the same before and after it, so this vector serves the frames of
    // both ends.
    let turn = (a.attitude.inverse() * b.attitude).normalize();
    Slope {
        seconds,
        velocity: (b.position - a.position) / seconds,
        spin: turn.to_scaled_axis() / seconds,
        roll_speed: (b.roll - a.roll) / seconds,
    }
}

/// De Casteljau's construction on the sphere.
fn bezier(q0: DQuat, q1: DQuat, q2: DQuat, q3: DQuat, s: f64) -> DQuat {
    let (a, b, c) = (slerp(q0, q1, s), slerp(q1, q2, s), slerp(q2, q3, s));
    slerp(slerp(a, b, s), slerp(b, c, s), s)
}

/// Along the shorter arc. Written out: `DQuat::slerp` falls back to a chord for close quaternions,
/// which shows as a tremble of the camera.
pub(super) fn slerp(a: DQuat, b: DQuat, s: f64) -> DQuat {
    let mut turn = (a.inverse() * b).normalize();
    if turn.w < 0.0 {
        turn = -turn;
    }
    (a * DQuat::from_scaled_axis(turn.to_scaled_axis() * s)).normalize()
}

/// The rotation that takes camera axes (x right, y forward, z up, of a camera that looks north) to
/// the pose's.
pub(super) fn attitude_from_pose(pose: &Pose) -> DQuat {
    DQuat::from_rotation_z(-pose.heading_rad)
        * DQuat::from_rotation_x(pose.pitch_rad)
        * DQuat::from_rotation_y(pose.roll_rad)
}

/// The pose with camera axes (x right, y forward, z up) turned so.
pub(super) fn pose_from_attitude(position: DVec3, attitude: DQuat) -> Pose {
    let (right, forward, up) = (attitude * DVec3::X, attitude * DVec3::Y, attitude * DVec3::Z);
    let pitch_rad = forward.z.clamp(-1.0, 1.0).asin();
    if forward.x.hypot(forward.y) < 1e-9 {
        // Straight up or down, heading and roll are one turn: all of it is heading.
        let ahead = if forward.z > 0.0 { -up } else { up };
        return Pose { position, heading_rad: ahead.x.atan2(ahead.y), pitch_rad, roll_rad: 0.0 };
    }
    let heading_rad = forward.x.atan2(forward.y);
    let level_right = surface::level_right(heading_rad);
    let level_up = level_right.cross(forward);
    let roll_rad = (-right.dot(level_up)).atan2(right.dot(level_right));
    Pose { position, heading_rad, pitch_rad, roll_rad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use terravision_common::camera::{Camera, CameraFields};

    fn pose(x: f64, heading: f64, pitch: f64, roll: f64) -> Pose {
        Pose {
            position: DVec3::new(x, x * 0.3, 10.0),
            heading_rad: heading.to_radians(),
            pitch_rad: pitch.to_radians(),
            roll_rad: roll.to_radians(),
        }
    }

    fn axes(pose: &Pose) -> [DVec3; 3] {
        let camera = Camera::new(CameraFields {
            eye_in_world: [0.0; 3],
            heading_rad: pose.heading_rad,
            pitch_rad: pose.pitch_rad,
            roll_rad: pose.roll_rad,
            vfov_rad: 1.0,
            width: 1,
            height: 1,
            timestamp_nanos: 0,
        })
        .expect("valid");
        camera.axes_in_world()
    }

    fn keys(poses: &[(f64, Pose)]) -> Vec<Key> {
        poses.iter().map(|(t, pose)| Key::passing(*t, *pose)).collect()
    }

    #[test]
    fn heading_goes_the_short_way_and_stays_level() {
        let spline = Spline::new(&keys(&[(0.0, pose(0.0, 350.0, -20.0, 0.0)), (1.0, pose(1.0, 10.0, -20.0, 0.0))]));
        let middle = spline.unwrap().pose(0.5);
        assert!(middle.heading_rad.abs() < 1e-9, "{middle:?}");
        assert!((middle.pitch_rad + 20f64.to_radians()).abs() < 1e-9 && middle.roll_rad.abs() < 1e-9);
    }

    #[test]
    fn the_horizon_stays_level_between_level_poses_however_they_look() {
        let three = [
            (0.0, pose(0.0, 0.0, -10.0, 0.0)),
            (3.0, pose(9.0, 90.0, -40.0, 0.0)),
            (6.0, pose(5.0, 180.0, -10.0, 0.0)),
        ];
        let spline = Spline::new(&keys(&three)).unwrap();
        assert!((0..=600).all(|n| spline.pose(f64::from(n) * 0.01).roll_rad.abs() < 1e-12));
        // Roll goes the short way, by itself.
        let rolled = [(0.0, pose(0.0, 0.0, -10.0, 170.0)), (1.0, pose(9.0, 50.0, -40.0, -170.0))];
        let middle = Spline::new(&keys(&rolled)).unwrap().pose(0.5);
        assert!((middle.roll_rad.to_degrees() - 180.0).abs() < 1e-9, "{middle:?}");
    }

    #[test]
    fn a_stop_stands_still_and_a_hop_rises() {
        let mut stops = keys(&[(0.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(10.0, 0.0, 0.0, 0.0))]);
        stops.iter_mut().for_each(|key| key.is_stop = true);
        stops[0].hop_m = 5.0;
        let spline = Spline::new(&stops).unwrap();
        assert!((spline.pose(0.001).position.x).abs() < 1e-3);
        assert!((spline.pose(0.5).position.z - 15.0).abs() < 1e-9);
        assert_eq!(spline.pose(7.0).position.x, 10.0);
    }

    #[test]
    fn equal_poses_stand_still_between_fast_ones() {
        let p = |x| pose(x, x, 0.0, 0.0);
        let spline = Spline::new(&keys(&[(0.0, p(0.0)), (0.1, p(90.0)), (5.0, p(90.0)), (5.1, p(0.0))])).unwrap();
        for t in [0.1, 1.0, 2.5, 4.9] {
            assert!((spline.pose(t).position.x - 90.0).abs() < 1e-9, "{t}");
            assert!((spline.pose(t).heading_rad.to_degrees() - 90.0).abs() < 1e-6, "{t}");
        }
    }

    #[test]
    fn keys_have_to_grow() {
        assert!(Spline::new(&[]).is_none());
        assert!(Spline::new(&keys(&[(1.0, pose(0.0, 0.0, 0.0, 0.0)), (1.0, pose(1.0, 0.0, 0.0, 0.0))])).is_none());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn attitude_and_pose_are_inverse(h in -180.0..180.0, p in -89.9..89.9, r in -179.0..179.0) {
            let there = pose(0.0, h, p, r);
            let back = pose_from_attitude(there.position, attitude_from_pose(&there));
            for (a, b) in axes(&there).iter().zip(axes(&back)) {
                prop_assert!((*a - b).length() < 1e-9, "{there:?} {back:?}");
            }
        }

        #[test]
        fn straight_down_keeps_the_view(h in -180.0..180.0, up: bool) {
            let there = pose(0.0, h, if up { 90.0 } else { -90.0 }, 0.0);
            let back = pose_from_attitude(there.position, attitude_from_pose(&there));
            for (a, b) in axes(&there).iter().zip(axes(&back)) {
                prop_assert!((*a - b).length() < 1e-6, "{there:?} {back:?}");
            }
        }

        /// Velocity, of the position and of the camera's axes, is the same just before and just
        /// after every key.
        #[test]
        fn there_is_no_corner(
            raw in proptest::collection::vec((0.1..5.0, -50.0..50.0, -180.0..180.0, -80.0..80.0, -40.0..40.0), 3..7)
        ) {
            let mut t = 0.0;
            let keys: Vec<Key> = raw.iter().map(|&(dt, x, h, p, r)| { t += dt; Key::passing(t, pose(x, h, p, r)) }).collect();
            let spline = Spline::new(&keys).unwrap();
            // Nowhere a jump: in a thousandth of a second no more than ten full turns a second.
            let mut previous = axes(&spline.pose(spline.start()));
            for i in 1..=((spline.end() - spline.start()) * 1000.0) as usize {
                let next = axes(&spline.pose(spline.start() + i as f64 * 1e-3));
                for (a, b) in previous.iter().zip(next) {
                    prop_assert!((*a - b).length() < 0.2, "jump at {i} ms");
                }
                previous = next;
            }
            let eps = 1e-6;
            for key in &keys[1..keys.len() - 1] {
                let at = spline.pose(key.t);
                prop_assert!((at.position - key.pose.position).length() < 1e-9);
                let (before, after) = (spline.pose(key.t - eps), spline.pose(key.t + eps));
                let jump = (after.position - at.position) - (at.position - before.position);
                prop_assert!(jump.length() / eps < 0.3, "{jump}");
                for i in 0..3 {
                    let turn = (axes(&after)[i] - axes(&at)[i]) - (axes(&at)[i] - axes(&before)[i]);
                    prop_assert!(turn.length() / eps < 0.1, "{turn}");
                }
            }
        }
    }
}
