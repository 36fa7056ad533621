use super::*;
use crate::cli::values::Triple;
use crate::path::tests::{Plain, utm10};
use terravision_common::camera::{Camera, CameraFields};

fn plane() -> Surface {
    Surface::Plane(terravision_common::surface::Plane::new(10.0, [4096; 2], 64))
}

fn place(text: &str) -> Option<Place> {
    Some(text.parse().unwrap())
}

fn resolved(args: &PoseArgs, is_agl: bool) -> Result<Pose, String> {
    let georeference = utm10();
    let context = PoseContext { georeference: &georeference, surface: &plane(), ground: &Plain, is_agl };
    resolve(args, context).map(|(pose, _)| pose).map_err(|failure| failure.to_string())
}

/// Where the middle of the picture is, at the distance of a place.
fn middle(pose: &Pose, target: DVec3) -> DVec3 {
    let camera = Camera::new(CameraFields {
        eye_in_world: pose.position.to_array(),
        heading_rad: pose.heading_rad,
        pitch_rad: pose.pitch_rad,
        roll_rad: pose.roll_rad,
        vfov_rad: 1.0,
        width: 640,
        height: 480,
        timestamp_nanos: 0,
    })
    .expect("valid");
    let [_, _, forward] = camera.axes_in_world();
    pose.position + forward * pose.position.distance(target)
}

#[test]
fn a_target_is_seen_in_the_middle_from_where_it_is_asked() {
    let args = PoseArgs {
        look_at: place("580000,4980000"),
        from: Some(Triple([225.0, 30.0, 1000.0])),
        roll: Some(10.0),
        ..PoseArgs::default()
    };
    let pose = resolved(&args, false).unwrap();
    // The plain is at 100 m; south west of the target, 500 m above it.
    let side = 1000.0 * 30f64.to_radians().cos() * 0.5f64.sqrt();
    let target = DVec3::new(580_000.0, 4_980_000.0, 100.0);
    assert!((pose.position - (target + DVec3::new(-side, -side, 500.0))).length() < 1e-6, "{pose:?}");
    assert!((middle(&pose, target) - target).length() < 1e-6);
    let heights = PoseArgs { look_at: place("580000,4980000,50"), ..args.clone() };
    let above = target + DVec3::Z * 50.0;
    assert!((middle(&resolved(&heights, true).unwrap(), above) - above).length() < 1e-6);
    assert!((resolved(&heights, false).unwrap().position.z - 550.0).abs() < 1e-6);
    let down = PoseArgs { from: Some(Triple([0.0, 90.0, 300.0])), roll: None, ..args };
    let pose = resolved(&down, false).unwrap();
    assert!(
        (pose.position - (target + DVec3::Z * 300.0)).length() < 1e-6
            && (middle(&pose, target) - target).length() < 1e-6
    );
}

#[test]
fn an_eye_looks_at_its_target() {
    for (eye, look_at, is_agl, z) in [
        ("580000,4980000,900", "581000,4981000,200", false, [900.0, 200.0]),
        ("580000,4980000,900", "581000,4981000,200", true, [1000.0, 300.0]),
        ("580000,4980000", "581000,4981000", false, [102.0, 100.0]),
        ("580000,4980000,900", "580000,4980000", false, [900.0, 100.0]),
    ] {
        let args = PoseArgs { eye: place(eye), look_at: place(look_at), ..PoseArgs::default() };
        let pose = resolved(&args, is_agl).unwrap();
        let at = place(look_at).unwrap();
        let target = DVec3::new(at.x, at.y, z[1]);
        assert!(
            (pose.position.z - z[0]).abs() < 1e-9 && (middle(&pose, target) - target).length() < 1e-6,
            "{eye} {pose:?}"
        );
    }
}

#[test]
fn longitude_and_latitude_are_those_of_proj_and_north_is_true() {
    // echo -122 45 | proj +proj=utm +zone=10 +datum=WGS84 gives 578815.30 4983436.77, true north is
    // 0.707 degrees west of grid north there.
    let args = PoseArgs {
        eye: place("-122,45,3000"),
        heading: Some(90.0),
        pitch: Some(-10.0),
        lonlat: true,
        ..PoseArgs::default()
    };
    let pose = resolved(&args, false).unwrap();
    assert!((pose.position - DVec3::new(578_815.303, 4_983_436.768, 3000.0)).length() < 0.01, "{pose:?}");
    assert!((pose.heading_rad.to_degrees() - (90.0 - 0.707)).abs() < 0.001);
    let args = PoseArgs {
        look_at: place("-122,45"),
        from: Some(Triple([0.0, 0.0, 1000.0])),
        eye: None,
        heading: None,
        pitch: None,
        ..args
    };
    let pose = resolved(&args, false).unwrap();
    let turn = 0.707f64.to_radians();
    let eye = DVec2::new(578_815.303 - 1000.0 * turn.sin(), 4_983_436.768 + 1000.0 * turn.cos());
    assert!((pose.position.truncate() - eye).length() < 0.05, "{pose:?}");
}

#[test]
fn a_camera_in_the_ground_is_lifted_and_still_looks_at_its_target() {
    let georeference = utm10();
    let context = PoseContext { georeference: &georeference, surface: &plane(), ground: &Plain, is_agl: false };
    let args =
        PoseArgs { eye: place("580000,4980000,50"), look_at: place("580000,4980500,300"), ..PoseArgs::default() };
    let (pose, warning) = resolve(&args, context).unwrap();
    let target = DVec3::new(580_000.0, 4_980_500.0, 300.0);
    assert!((pose.position.z - 102.0).abs() < 1e-9 && (middle(&pose, target) - target).length() < 1e-6);
    assert!(warning.unwrap().contains("lifted by 52.0 m"));
}

#[test]
fn what_is_missing_or_too_much_is_said() {
    let eye = place("580000,4980000,900");
    for (args, expected) in [
        (PoseArgs::default(), "no pose is given"),
        (PoseArgs { eye, ..PoseArgs::default() }, "but not where it looks"),
        (PoseArgs { eye, heading: Some(1.0), ..PoseArgs::default() }, "but not where it looks"),
        (PoseArgs { eye, look_at: eye, ..PoseArgs::default() }, "are the same place"),
        (PoseArgs { eye, look_at: eye, pitch: Some(1.0), ..PoseArgs::default() }, "--pitch and --look-at both"),
        (PoseArgs { look_at: eye, ..PoseArgs::default() }, "but not where it is"),
        (PoseArgs { eye, from: Some(Triple([0.0; 3])), ..PoseArgs::default() }, "--from and --eye both"),
        (PoseArgs { look_at: eye, from: Some(Triple([0.0; 3])), ..PoseArgs::default() }, "metres, from 0.001"),
        (PoseArgs { eye, heading: Some(0.0), pitch: Some(91.0), ..PoseArgs::default() }, "--pitch 91"),
        (
            PoseArgs {
                eye: place("200,45"),
                lonlat: true,
                heading: Some(0.0),
                pitch: Some(0.0),
                ..PoseArgs::default()
            },
            "",
        ),
        (
            PoseArgs { eye: place("0,95"), lonlat: true, heading: Some(0.0), pitch: Some(0.0), ..PoseArgs::default() },
            "no place",
        ),
    ] {
        match resolved(&args, false) {
            Ok(pose) => assert!(expected.is_empty(), "{args:?}: {pose:?}"),
            Err(message) => assert!(message.contains(expected) && !message.contains('\n'), "{message}"),
        }
    }
}
