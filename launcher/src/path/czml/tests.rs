//! Paths in CZML: what is flown, and what is told of the rest.

use super::super::ecef::east_north_up;
use super::super::spline::attitude_from_pose;
use super::super::tests::{parse_text, parse_with, utm10};
use super::super::{Course, Pose};
use super::*;
use proptest::prelude::*;
use std::f64::consts::FRAC_PI_2;
use terravision_common::lonlat::{Projection, WGS84_LONLAT};

/// A document with these packets.
fn document(packets: &str) -> String {
    format!(r#"[{{"id":"document","version":"1.0"}},{packets}]"#)
}

/// East along a parallel in a minute, 900 m high.
const MOVES: &str =
    r#""epoch":"2024-05-01T10:00:00Z","cartographicDegrees":[0,-122,45,900, 30,-121.995,45,900, 60,-121.99,45,900]"#;

fn packet(id: &str, position: &str, more: &str) -> String {
    format!(r#"{{"id":"{id}","position":{position}{more}}}"#)
}

fn moving(more: &str) -> String {
    document(&packet("uav", &format!("{{{MOVES}}}"), more))
}

/// The rotation of a body that looks as a camera at a place would, from its axes to fixed ones.
fn turn(pose: &Pose, longitude_deg: f64, latitude_deg: f64) -> DQuat {
    let fixed_from_local = DQuat::from_mat3(&east_north_up(longitude_deg, latitude_deg));
    fixed_from_local * attitude_from_pose(pose) * DQuat::from_rotation_z(FRAC_PI_2)
}

fn quaternion(turn: DQuat) -> String {
    format!("{:?}", turn.to_array()).trim_matches(['[', ']']).to_owned()
}

#[test]
fn samples_without_an_orientation_are_flown_looking_ahead() {
    let (path, remarks) = parse_with(&moving(""), CourseOptions::default());
    let course = path.unwrap().course;
    assert_eq!(course.frame_count(1.0, 1.0).unwrap(), Some(61));
    let pose = course.pose(30, 1.0, 1.0).unwrap();
    assert!((pose.position.z - 900.0).abs() < 1e-6 && (pose.heading_rad.to_degrees() - 90.0).abs() < 2.0, "{pose:?}");
    assert!(remarks.notes[0].contains("above the ellipsoid"), "{remarks:?}");
    let low = CourseOptions { agl_m: Some(20.0), ..CourseOptions::default() };
    let (path, remarks) = parse_with(&moving(r##","orientation":{"velocityReference":"#position"}"##), low);
    let pose = path.unwrap().course.pose(30, 1.0, 1.0).unwrap();
    assert!((pose.position.z - 120.0).abs() < 1e-6 && remarks.notes.is_empty(), "{pose:?} {remarks:?}");
}

#[test]
fn all_forms_of_a_position_are_one_way() {
    let expected = parse_text(&moving("")).unwrap().course;
    let places = [-122.0, -121.995, -121.99f64];
    let times = ["2024-05-01T10:00:00Z", "20240501T100030Z", "2024-05-01T10:01Z"];
    let of = |form: &str, value: &dyn Fn(f64) -> String| {
        let samples: Vec<String> =
            times.iter().zip(places).map(|(time, lon)| format!("\"{time}\",{}", value(lon))).collect();
        document(&packet("uav", &format!(r#"{{"{form}":[{}]}}"#, samples.join(",")), ""))
    };
    let fixed = |lon: f64| {
        let place = Geodetic { longitude_deg: lon, latitude_deg: 45.0, height_m: 900.0 };
        let [x, y, z] = Ellipsoid::WGS84.ecef_from_geodetic(place).to_array();
        format!("{x},{y},{z}")
    };
    let texts = [
        of("cartographicDegrees", &|lon| format!("{lon},45,900")),
        of("cartographicRadians", &|lon| format!("{},{},900", lon.to_radians(), 45f64.to_radians())),
        of("cartesian", &fixed),
        of("cartesianVelocity", &|lon| format!("{},1,2,3", fixed(lon))),
        // Streamed: a packet for each sample, in any order.
        document(
            &[2, 0, 1]
                .map(|i| {
                    let value = format!(r#"{{"cartographicDegrees":["{}",{},45,900]}}"#, times[i], places[i]);
                    packet("uav", &value, "")
                })
                .join(","),
        ),
    ];
    for text in texts {
        let course = parse_text(&text).unwrap().course;
        for frame in [0, 20, 60] {
            let [found, expected] = [&course, &expected].map(|course| course.pose(frame, 1.0, 1.0).unwrap());
            assert!(found.position.distance(expected.position) < 1e-3, "{text}\n{found:?} {expected:?}");
        }
    }
}

#[test]
fn body_axes_are_ahead_left_and_up_in_fixed_axes() {
    // Where the zero meridian crosses the equator, fixed axes are up, east and north.
    let world = Georeference::new("WGS 84 / World Mercator".into(), Some(3395), Some("+proj=merc +datum=WGS84"));
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (quaternion, heading, pitch, roll) in [
        // As the fixed axes: it looks up, north is above, so that its heading is south.
        ([0.0, 0.0, 0.0, 1.0], 180.0, 90.0, 0.0),
        // Turned about z by 90 degrees: it looks east, and its z axis points north: rolled to the left.
        ([0.0, 0.0, half, half], 90.0, 0.0, -90.0),
        // Ahead is east and up is up: x to y, y to z, z to x.
        ([0.5, 0.5, 0.5, 0.5], 90.0, 0.0, 0.0),
    ] {
        let text = document(&packet(
            "a",
            r#"{"cartographicDegrees":[0,0,100]}"#,
            &format!(r#","orientation":{{"unitQuaternion":{quaternion:?}}}"#),
        ));
        let ground = super::super::tests::Plain;
        let path = parse(Path::new("p"), &text, &world, &ground, CourseOptions::default(), &mut Remarks::default());
        let course = path.unwrap().course;
        assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(1));
        let pose = course.pose(0, 30.0, 1.0).unwrap();
        let found = [pose.heading_rad, pose.pitch_rad, pose.roll_rad].map(f64::to_degrees);
        for (found, expected) in found.iter().zip([heading, pitch, roll]) {
            let off = (found - expected + 180.0).rem_euclid(360.0) - 180.0;
            assert!(off.abs() < 1e-5, "{quaternion:?}: {pose:?}");
        }
    }
}

#[test]
fn of_a_document_the_first_object_that_moves_is_flown_and_the_rest_is_told() {
    let others = [
        packet("base", r#"{"cartographicDegrees":[1,2,3]}"#, r#","label":{"text":"Base"}"#),
        packet("iss", r#"{"referenceFrame":"INERTIAL","cartesian":[0,7e6,0,0, 60,0,7e6,0]}"#, ""),
        packet(
            "uav",
            &format!("{{{MOVES}}}"),
            r#","model":{"gltf":"a.glb"},"label":{},"viewFrom":{"cartesian":[1,2,3]}"#,
        ),
        packet("car", &format!("{{{MOVES}}}"), ""),
        r#"{"id":"line","polyline":{}},{"id":"gone","delete":true}"#.into(),
    ];
    let text = format!(r#"[{{"id":"document","clock":{{"multiplier":60}}}},{}]"#, others.join(","));
    let (path, remarks) = parse_with(&text, CourseOptions::default());
    assert!(path.is_ok());
    assert_eq!(
        remarks.notes[..3],
        [
            "beside packet \"uav\" the file has 2 packets that move and 1 packet that stands still, not flown",
            "of packet \"uav\" the way is flown, without its model, label and place to watch it from (viewFrom)",
            "the clock of the document runs 60 times as fast; here --speed 60 does that",
        ]
    );
}

#[test]
fn intervals_and_availability_bound_what_is_flown() {
    let frames = |text: &str| parse_text(text).unwrap().course.frame_count(1.0, 1.0).unwrap().unwrap();
    let half = r#","availability":"2024-05-01T10:00:15Z/10:00:45Z""#;
    assert_eq!(frames(&moving(half)), 31);
    let twice = r#","availability":["2024-05-01T10:00:00Z/10:00:10Z","2024-05-01T10:00:50Z/10:01:00Z"]"#;
    let camera = r#","orientation":{"unitQuaternion":[0,0,0,1]}"#;
    let (path, remarks) = parse_with(&moving(&format!("{twice}{camera}")), CourseOptions::default());
    assert_eq!(path.unwrap().course.frame_count(1.0, 1.0).unwrap(), Some(21));
    assert!(remarks.notes.contains(&"1 gap in its times is a cut".into()), "{remarks:?}");
    // Two intervals that follow each other are one way.
    let first = r#"{"interval":"2024-05-01T10:00:00Z/10:00:30Z","epoch":"2024-05-01T10:00:00Z","cartographicDegrees":[0,-122,45,900, 30,-121.995,45,900]}"#;
    let second = first
        .replace("10:00:00Z/10:00:30Z", "10:00:30Z/10:01:00Z")
        .replace("[0,-122,45,900, 30,-121.995", "[30,-121.995,45,900, 60,-121.99");
    let text = document(&packet("uav", &format!("[{first},{second}]"), camera));
    let (path, remarks) = parse_with(&text, CourseOptions::default());
    let Course::Timed(pieces) = path.unwrap().course else { panic!("no times") };
    assert_eq!((pieces.len(), pieces[0].end() - pieces[0].start()), (1, 60.0));
    assert!(!remarks.notes.iter().any(|note| note.contains("gap")), "{remarks:?}");
    let late = r#","availability":"2024-06-01T10:00:15Z/10:00:45Z""#;
    let message = parse_text(&moving(late)).unwrap_err().to_string();
    assert!(message.contains("packet \"uav\": position: expected samples within its intervals"), "{message}");
}

#[test]
fn a_polynomial_is_a_curve_through_the_samples() {
    let corner = r#""cartographicDegrees":[0,-122,45,900, 60,-121.95,45,900, 120,-121.95,45.05,900]"#;
    let of = |more: &str| {
        let text = document(&packet("uav", &format!("{{{corner}{more}}}"), ""));
        let (path, remarks) = parse_with(&text, CourseOptions::default());
        (path.unwrap().course.pose(40, 1.0, 1.0).unwrap().position, remarks)
    };
    let (straight, plain) = of("");
    let (curved, remarks) = of(r#","interpolationAlgorithm":"LAGRANGE","interpolationDegree":5"#);
    assert!(straight.distance(curved) > 50.0, "{straight} {curved}");
    let note = "its positions are joined by a smooth curve through them, not by a LAGRANGE polynomial of degree 5";
    assert!(remarks.notes.contains(&note.into()) && !plain.notes.iter().any(|note| note.contains("curve")));
}

#[test]
fn bad_input_is_told_with_its_packet() {
    let position = |position: &str| document(&packet("uav", position, ""));
    let oriented = |value: &str| moving(&format!(r#","orientation":{value}"#));
    for (text, expected) in [
        ("[7]".into(), "packet 0: the entry: expected a packet of CZML, an object, found 7"),
        ("[{}".into(), "not valid JSON"),
        (document(r#"{"id":"a","model":{}},{"id":"b","label":{}}"#), "found 2 packets without a position of numbers"),
        (position(r#"{"cartographicDegrees":[1,2,3]}"#), "found 1 packet that stands still"),
        (position(r#"{"reference":"a#position"}"#), "found 1 packet without a position of numbers"),
        (
            position(r#"{"cartographicDegrees":[0,1,2,3,4,5]}"#),
            "packet \"uav\": position: \"cartographicDegrees\": expected a list of 3 numbers, or of a time and 3 numbers for \
             each sample, found 6 values",
        ),
        (
            position(r#"{"cartographicDegrees":[0,1,2,3, 9,1,2,3, 5,1,2,3]}"#),
            "sample 2: expected a time after that of the",
        ),
        (position(r#"{"cartographicDegrees":[0,1,91,3, 9,1,2,3]}"#), "sample 0: expected [longitude from -180 to 180"),
        (position(r#"{"cartographicDegrees":[0,1,"x",3, 9,1,2,3]}"#), "sample 0: expected a number, found \"x\""),
        (position(r#"{"cartographicDegrees":[0,1,NaN,3, 9,1,2,3]}"#), "not valid JSON"),
        (position(r#"{"cartographicDegrees":[0,1,1e999,3, 9,1,2,3]}"#), "sample 0: expected a number, found 1e999"),
        (position(r#"{"cartographicDegrees":["noon",1,2,3, "x",1,2,3]}"#), "sample 0: expected a time like"),
        (position(r#"{"cartographicDegrees":[1e99,1,2,3, 2e99,1,2,3]}"#), "sample 0: expected seconds from"),
        (position(r#"{"cartesian":[0,1,2,3, 9,1,2,3]}"#), "expected [x, y, z] in metres from the middle of the Earth"),
        (
            position(r#"{"epoch":7,"cartographicDegrees":[0,1,2,3, 9,1,2,3]}"#),
            "position: epoch: expected a time like 2024",
        ),
        (
            position(r#"{"interpolationAlgorithm":"SPLINE","cartographicDegrees":[0,1,2,3, 9,1,2,3]}"#),
            "interpolationAlgorithm: expected LINEAR, LAGRANGE or HERMITE, found \"SPLINE\"",
        ),
        (
            position(r#"{"referenceFrame":"INERTIAL","cartesian":[0,7e6,0,0, 60,0,7e6,0]}"#),
            "referenceFrame: expected FIXED (an inertial frame turns against the ground",
        ),
        (
            position(r#"[{"interval":"x","cartographicDegrees":[0,1,2,3, 9,1,2,3]}]"#),
            "position: interval: expected an interval",
        ),
        (moving(r#","availability":"always""#), "packet \"uav\": availability: expected an interval"),
        (oriented(r#"{"unitQuaternion":[0,0,0,0]}"#), "orientation: \"unitQuaternion\": expected a quaternion"),
        (oriented(r#"{"unitQuaternion":[0,0,1]}"#), "expected a list of 4 numbers, or of a time and 4 numbers"),
    ] {
        let message = parse_text(&text).unwrap_err().to_string();
        assert!(message.contains(expected) && !message.contains('\n'), "{text}\n  {message}\n  {expected}");
    }
    let low = CourseOptions { agl_m: Some(20.0), ..CourseOptions::default() };
    let message = parse_with(&oriented(r#"{"unitQuaternion":[0,0,0,1]}"#), low).0.unwrap_err().to_string();
    assert!(message.contains("has heights of its own: leave --agl out"), "{message}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Keyframes written as CZML and read again are the same flight.
    #[test]
    fn keyframes_survive_as_czml(
        raw in proptest::collection::vec((0.5..9.0, -3e3..3e3, -3e3..3e3, 0.0..4e3, -180.0..180.0, -80.0..80.0, -60.0..60.0), 1..7),
        is_cartesian: bool,
        has_own_times: bool,
    ) {
        let (plane, lonlat) = (Projection::of_epsg(32610).unwrap(), Projection::parse(WGS84_LONLAT).unwrap());
        let transform = utm10().from_lonlat().unwrap();
        let (mut t, mut keys, mut positions, mut turns) = (0.0, Vec::new(), Vec::new(), Vec::new());
        for (dt, x, y, z, heading, pitch, roll) in raw {
            t += dt;
            let [x, y] = [560_000.0 + x, 5_116_000.0 + y];
            keys.push(format!(
                r#"{{"t":{t},"x":{x},"y":{y},"z":{z},"heading":{heading},"pitch":{pitch},"roll":{roll}}}"#
            ));
            let [longitude_deg, latitude_deg] = plane.to(&lonlat, [x, y]).unwrap();
            let north = transform.heading(longitude_deg, latitude_deg, 0.0).unwrap();
            let [heading_rad, pitch_rad, roll_rad] = [heading, pitch, roll].map(f64::to_radians);
            let pose = Pose { position: DVec3::ZERO, heading_rad: heading_rad - north, pitch_rad, roll_rad };
            turns.push(format!("{t},{}", quaternion(turn(&pose, longitude_deg, latitude_deg))));
            let place = Geodetic { longitude_deg, latitude_deg, height_m: z };
            let [a, b, c] = if is_cartesian { Ellipsoid::WGS84.ecef_from_geodetic(place).to_array() } else { [longitude_deg, latitude_deg, z] };
            positions.push(format!("{t},{a},{b},{c}"));
        }
        let expected = parse_text(&format!("{{\"keyframes\":[{}]}}", keys.join(","))).unwrap().course;
        let form = if is_cartesian { "cartesian" } else { "cartographicDegrees" };
        let epoch = if has_own_times { r#""epoch":"2024-05-01T10:00:00Z","# } else { "" };
        let text = document(&packet(
            "camera",
            &format!(r#"{{{epoch}"{form}":[{}]}}"#, positions.join(",")),
            &format!(r#","orientation":{{{epoch}"unitQuaternion":[{}]}}"#, turns.join(",")),
        ));
        let found = parse_text(&text).unwrap().course;
        let count = expected.frame_count(5.0, 1.0).unwrap();
        prop_assert_eq!(found.frame_count(5.0, 1.0).unwrap(), count);
        for frame in 0..count.unwrap() {
            let [found, expected] = [&found, &expected].map(|course| course.pose(frame, 5.0, 1.0).unwrap());
            prop_assert!(found.position.distance(expected.position) < 0.01, "{frame}: {found:?} {expected:?}");
            let turned = attitude_from_pose(&found).angle_between(attitude_from_pose(&expected));
            prop_assert!(turned < 1e-4, "{frame}: {found:?} {expected:?}");
        }
    }

    #[test]
    fn any_values_never_panic(
        key in "(interval|epoch|interpolationAlgorithm|interpolationDegree|cartesian|cartographicRadians|cartographicDegrees|reference)",
        value in "(null|7|\"[0-9T:/Z-]{0,25}\"|\\[\\]|\\[(0|\"2024-05-01T10:00Z\"),[0-9]{1,7},[0-9],[0-9],60,[0-9],[0-9],[0-9]\\]|\\{\\}|\\[7\\])",
        is_list: bool,
    ) {
        let inner = format!(r#"{{"cartographicDegrees":[0,1,2,3, 9,1,2,3],"{key}":{value}}}"#);
        let text = document(&packet("a", &if is_list { format!("[{inner},{inner}]") } else { inner }, &format!(r#","orientation":{{"unitQuaternion":[0,0,0,1],"{key}":{value}}}"#)));
        if let Ok(path) = parse_text(&text) {
            prop_assert!(path.course.pose(0, 30.0, 1.0).is_none_or(|pose| pose.position.is_finite()));
        }
    }
}
