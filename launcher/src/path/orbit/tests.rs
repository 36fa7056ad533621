use super::super::tests::Plain;
use super::*;
use proptest::prelude::*;

/// Cones of a height at places, on a plain at 0 m.
struct Cones(Vec<(DVec2, f64)>);

impl Ground for Cones {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        let place = DVec2::new(x, y);
        Some(self.0.iter().map(|(summit, height)| height - summit.distance(place) * 0.5).fold(0.0, f64::max))
    }
}

const EXTENT: Extent = Extent { low: DVec2::new(500_000.0, 4_000_000.0), high: DVec2::new(540_000.0, 4_040_000.0) };
const USUAL: OrbitWishes =
    OrbitWishes { around: None, radius_m: None, height_m: None, turns: 1.0, post_spacing_m: 10.0 };

fn poses(extent: &Extent, ground: &dyn Ground, wishes: &OrbitWishes) -> (Vec<Pose>, String) {
    let Orbit { path, note } = orbit(extent, ground, wishes);
    match path.course {
        Course::Round(poses) => (poses, note),
        other => panic!("not a round: {other:?}"),
    }
}

/// Whether a pose looks at a place, as a map shows it.
fn looks_at(pose: &Pose, place: DVec2) -> bool {
    let (sin, cos) = pose.heading_rad.sin_cos();
    DVec2::new(sin, cos).dot((place - pose.position.truncate()).normalize()) > 0.99
}

#[test]
fn it_circles_the_mountain_once_looking_at_it() {
    let summit = DVec2::new(517_000.0, 4_022_000.0);
    let (poses, note) = poses(&EXTENT, &Cones(vec![(summit, 1000.0)]), &USUAL);
    assert_eq!(poses.len(), ROUND_FRAMES);
    for pose in &poses {
        let to_summit = summit - pose.position.truncate();
        assert!((to_summit.length() - 6000.0).abs() < 1000.0, "{pose:?}");
        assert!(looks_at(pose, summit));
        assert!(pose.pitch_rad < -0.2 && pose.pitch_rad > -0.8, "{pose:?}");
        assert_eq!(EXTENT.distance(pose.position.truncate()), 0.0);
    }
    let step = poses[1].position.distance(poses[0].position);
    assert!((poses[239].position.distance(poses[0].position) - step).abs() < 1e-6);
    assert!(note.contains("the relief around it") && note.contains("--around X,Y"), "{note}");
}

#[test]
fn a_plain_has_an_orbit_too() {
    let (poses, note) = poses(&EXTENT, &Plain, &USUAL);
    assert!(poses.iter().all(|pose| pose.position.z > 110.0 && pose.pitch_rad < -0.1));
    assert!(note.contains("the middle of the world, as no mountain stands out"), "{note}");
}

#[test]
fn a_mountain_at_the_border_is_found_and_the_camera_stays_over_the_world() {
    let everest = DVec2::new(536_000.0, 4_039_000.0);
    let ground = Cones(vec![(everest, 3000.0), (DVec2::new(515_000.0, 4_015_000.0), 1200.0)]);
    let (poses, note) = poses(&EXTENT, &ground, &USUAL);
    assert_eq!(poses.len(), ROUND_FRAMES);
    assert!(poses.iter().all(|pose| EXTENT.distance(pose.position.truncate()) == 0.0 && looks_at(pose, everest)));
    // To and fro without a jump, also from the last frame to the first.
    let step = |i: usize| poses[i].position.distance(poses[(i + 1) % poses.len()].position);
    assert!((0..poses.len()).all(|i| step(i) < 300.0));
    assert!(note.contains("in the south west of it, as the world ends 1,"), "{note}");
}

#[test]
fn a_higher_mountain_that_is_not_taken_is_told_of() {
    let (inner, border) = (DVec2::new(515_000.0, 4_015_000.0), DVec2::new(539_000.0, 4_039_000.0));
    let (poses, note) = poses(&EXTENT, &Cones(vec![(inner, 1200.0), (border, 1400.0)]), &USUAL);
    assert!(poses.iter().all(|pose| looks_at(pose, inner)));
    assert!(note.contains("is higher, but has"), "{note}");
}

#[test]
fn what_is_asked_for_is_flown() {
    let place = DVec2::new(510_000.0, 4_010_000.0);
    let wishes =
        OrbitWishes { around: Some(place), radius_m: Some(2000.0), height_m: Some(700.0), turns: -1.5, ..USUAL };
    let ground = Cones(vec![(place, 1000.0)]);
    let (poses, note) = poses(&EXTENT, &ground, &wishes);
    assert_eq!(poses.len(), 360);
    for pose in &poses {
        assert!(((pose.position.truncate() - place).length() - 2000.0).abs() < 1e-6 && pose.position.z == 1700.0);
        // 700 m over the target, 2000 m away.
        assert!((pose.pitch_rad - (-700f64).atan2(2000.0)).abs() < 1e-9 && looks_at(pose, place));
    }
    // Clockwise: seen from above the bearing from the middle grows.
    let bearing = |pose: &Pose| (pose.position.x - place.x).atan2(pose.position.y - place.y);
    assert!(bearing(&poses[1]) > bearing(&poses[0]));
    assert_eq!(note, "the orbit turns around 510000, 4010000 (1,000 m high), 2,000 m from it and 700 m above it");
}

#[test]
fn coarse_posts_keep_the_camera_away() {
    // Posts of 400 m: at 20 pixels each the camera is 12.5 km away.
    let summit = DVec2::new(520_000.0, 4_020_000.0);
    let wishes = OrbitWishes { post_spacing_m: 400.0, ..USUAL };
    let (poses, note) = poses(&EXTENT, &Cones(vec![(summit, 1000.0)]), &wishes);
    for pose in &poses {
        let slant = pose.position.distance(summit.extend(550.0));
        assert!(400.0 * REFERENCE_FOCAL_PX / slant < 25.0, "{slant}");
    }
    assert!(note.contains("as elevation posts are 400 m apart"), "{note}");
}

proptest! {
    #[test]
    fn any_extent_has_an_orbit_above_ground(w in 1.0f64..1e6, h in 1.0f64..1e6, x in -1e6f64..1e6, spacing in 0.1f64..1e4) {
        let extent = Extent { low: DVec2::new(x, -x), high: DVec2::new(x + w, h - x) };
        let ground = Cones(vec![(extent.low + extent.size() * 0.3, 1000.0)]);
        for pose in poses(&extent, &ground, &OrbitWishes::usual(spacing)).0 {
            let height = ground.height_m(pose.position.x, pose.position.y).unwrap();
            prop_assert!(pose.position.is_finite() && pose.position.z > height);
        }
    }
}
