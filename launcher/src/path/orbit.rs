//! The built-in path: once around the point of the world with the strongest relief.
//!
//! Radius, height and pitch follow from the relief, so that the mountain fills the picture. The path depends on the
//! world alone.

use super::{CameraPath, Course, Ground, PathSettings, Pose};
use glam::{DVec2, DVec3};
use std::f64::consts::TAU;

/// Frames of one round.
pub const ROUND_FRAMES: usize = 240;
/// Lattice on which relief is looked for: so many points along the longer side of the world.
const GRID: usize = 96;
/// Points at which the camera's round is held above ground.
const CLEARANCE_POINTS: usize = 72;

/// The extent of a world: south west and north east corner in its CRS.
#[derive(Debug, Clone, Copy)]
pub struct Extent {
    /// South west corner.
    pub low: DVec2,
    /// North east corner.
    pub high: DVec2,
}

impl Extent {
    /// Width and height.
    #[must_use]
    pub fn size(&self) -> DVec2 {
        self.high - self.low
    }

    /// How far a position lies outside, metres; 0 inside.
    #[must_use]
    pub fn distance(&self, place: DVec2) -> f64 {
        (self.low - place).max(place - self.high).max(DVec2::ZERO).length()
    }
}

/// The orbit of a world.
#[must_use]
pub fn orbit(extent: &Extent, ground: &dyn Ground) -> CameraPath {
    let size = extent.size();
    let shorter = size.min_element();
    // The camera flies inside the world, and sees enough of it behind the target.
    let largest = 0.22 * shorter;
    let (target, relief) = most_relief(extent, ground, 0.5 * largest, 1.1 * largest);
    // Six reliefs away a mountain is some 10 degrees high: with the slopes before it, it fills the picture.
    let radius = (6.0 * relief).clamp(0.4 * largest, largest);
    let at = |turn: f64, radius: f64| target.truncate() + DVec2::from_angle(turn * TAU) * radius;
    let clearance = (0..CLEARANCE_POINTS)
        .filter_map(|i| {
            let place = at(i as f64 / CLEARANCE_POINTS as f64, radius);
            ground.height_m(place.x, place.y)
        })
        .fold(target.z, f64::max);
    // High enough to look into the valleys behind, never lower than a third of the relief above what is flown over.
    let eye_z = (target.z + 0.55 * radius).max(clearance + 0.33 * relief).max(clearance + 0.1 * radius);
    let poses = (0..ROUND_FRAMES).map(|frame| {
        let place = at(frame as f64 / ROUND_FRAMES as f64 + 0.625, radius);
        let eye = place.extend(eye_z);
        let sight = target - eye;
        Pose {
            position: eye,
            heading_rad: sight.x.atan2(sight.y),
            pitch_rad: sight.z.atan2(sight.truncate().length()),
            roll_rad: 0.0,
        }
    });
    let settings = PathSettings { vfov_rad: Some(48f64.to_radians()), ..PathSettings::default() };
    CameraPath { settings, course: Course::Round(poses.collect()) }
}

/// The summit around which heights differ most, and by how much; at least `reach` inside of the border.
fn most_relief(extent: &Extent, ground: &dyn Ground, window_m: f64, reach: f64) -> (DVec3, f64) {
    let size = extent.size();
    let step = size.max_element() / (GRID - 1) as f64;
    let count = |length: f64| ((length / step).floor() as usize).max(1) + 1;
    let (columns, rows) = (count(size.x), count(size.y));
    let spacing = DVec2::new(size.x / (columns - 1) as f64, size.y / (rows - 1) as f64);
    let place = |i: usize, j: usize| extent.low + DVec2::new(i as f64, j as f64) * spacing;
    let heights: Vec<f64> = (0..rows * columns)
        .map(|k| {
            let place = place(k % columns, k / columns).min(extent.high);
            ground.height_m(place.x, place.y).unwrap_or(f64::NAN)
        })
        .collect();
    let window = ((window_m / step).round() as usize).max(1);
    let mut best: Option<(f64, DVec3, f64)> = None;
    for j in 0..rows {
        for i in 0..columns {
            let (mut low, mut high, mut peak) = (f64::INFINITY, f64::NEG_INFINITY, (i, j));
            for y in j.saturating_sub(window)..rows.min(j + window + 1) {
                for x in i.saturating_sub(window)..columns.min(i + window + 1) {
                    let height = heights[y * columns + x];
                    low = low.min(height);
                    if height > high {
                        (high, peak) = (height, (x, y));
                    }
                }
            }
            let here = heights[j * columns + i];
            // Summits only, each once.
            if peak != (i, j) || !(high - low).is_finite() {
                continue;
            }
            let place = place(i, j);
            let inside = (place - extent.low).min(extent.high - place).min_element();
            // A round that leaves the world looks at its edge; farther in there is more to see behind.
            if inside < reach {
                continue;
            }
            let score = (high - low) * (0.5 + inside / size.min_element());
            if best.is_none_or(|(other, ..)| score > other) {
                // Half-way up the mountain is the middle of the picture.
                best = Some((score, place.extend(here - 0.45 * (high - low)), high - low));
            }
        }
    }
    best.map_or_else(
        || {
            let middle = (extent.low + extent.high) * 0.5;
            (middle.extend(ground.height_m(middle.x, middle.y).unwrap_or(0.0)), 0.0)
        },
        |(_, target, relief)| (target, relief),
    )
}

#[cfg(test)]
mod tests {
    use super::super::tests::Plain;
    use super::*;
    use proptest::prelude::*;

    /// A cone of 1000 m at a place.
    struct Cone(DVec2);

    impl Ground for Cone {
        fn height_m(&self, x: f64, y: f64) -> Option<f64> {
            Some((1000.0 - self.0.distance(DVec2::new(x, y)) * 0.5).max(0.0))
        }
    }

    const EXTENT: Extent = Extent { low: DVec2::new(500_000.0, 4_000_000.0), high: DVec2::new(540_000.0, 4_040_000.0) };

    #[test]
    fn it_circles_the_mountain_once_looking_at_it() {
        let summit = DVec2::new(517_000.0, 4_022_000.0);
        let Course::Round(poses) = orbit(&EXTENT, &Cone(summit)).course else { panic!("not a round") };
        assert_eq!(poses.len(), ROUND_FRAMES);
        for pose in &poses {
            let to_summit = summit - pose.position.truncate();
            assert!((to_summit.length() - 6000.0).abs() < 1000.0, "{pose:?}");
            let (sin, cos) = pose.heading_rad.sin_cos();
            assert!(DVec2::new(sin, cos).dot(to_summit.normalize()) > 0.99);
            assert!(pose.pitch_rad < -0.2 && pose.pitch_rad > -0.8, "{pose:?}");
            assert_eq!(EXTENT.distance(pose.position.truncate()), 0.0);
        }
        let step = poses[1].position.distance(poses[0].position);
        assert!((poses[239].position.distance(poses[0].position) - step).abs() < 1e-6);
    }

    #[test]
    fn a_plain_has_an_orbit_too() {
        let Course::Round(poses) = orbit(&EXTENT, &Plain).course else { panic!("not a round") };
        assert!(poses.iter().all(|pose| pose.position.z > 110.0 && pose.pitch_rad < -0.1));
    }

    proptest! {
        #[test]
        fn any_extent_has_an_orbit_above_ground(w in 1.0f64..1e6, h in 1.0f64..1e6, x in -1e6f64..1e6) {
            let extent = Extent { low: DVec2::new(x, -x), high: DVec2::new(x + w, h - x) };
            let Course::Round(poses) = orbit(&extent, &Cone(extent.low + extent.size() * 0.3)).course else { panic!() };
            for pose in poses {
                let ground = Cone(extent.low + extent.size() * 0.3).height_m(pose.position.x, pose.position.y).unwrap();
                prop_assert!(pose.position.is_finite() && pose.position.z > ground);
            }
        }
    }
}
