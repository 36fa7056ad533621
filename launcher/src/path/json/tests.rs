//! Paths in JSON: what is read, and what is told of the rest.

use super::*;
use crate::path::tests::parse_text;
use proptest::prelude::*;

const FRAME: &str = r#"{"x":500000,"y":4980000,"z":3000,"heading":90,"pitch":-10}"#;

#[test]
fn frames_are_read_and_unknown_keys_ignored() {
    let text = format!(
        r#"{{"crs":"EPSG:32610","width":640,"height":360.0,"vfov_deg":60,"fps":25,"sky_rgb":[1,2,3],"note":{{"a":[1]}},
           "frames":[{FRAME},{{"x":1,"y":2,"z":3,"heading":-10,"pitch":5,"roll":7,"label":"b"}}]}}"#
    );
    let path = parse_text(&text).unwrap();
    assert_eq!(path.settings.width, Some(640));
    assert_eq!(path.settings.height, Some(360));
    assert_eq!(path.settings.sky_rgb, Some([1, 2, 3]));
    let Course::Frames(poses) = &path.course else { panic!("not frames") };
    assert_eq!(poses[0].position, DVec3::new(500_000.0, 4_980_000.0, 3000.0));
    assert!((poses[1].roll_rad - 7f64.to_radians()).abs() < 1e-12 && poses[0].roll_rad == 0.0);
    assert_eq!(path.course.frame_count(25.0, 1.0).unwrap(), Some(2));
}

#[test]
fn keyframes_become_frames_at_any_rate() {
    let text = r#"{"keyframes":[{"t":1,"x":0,"y":0,"z":0,"heading":0,"pitch":0},
                                {"t":3,"x":100,"y":0,"z":0,"heading":0,"pitch":0}]}"#;
    let course = parse_text(text).unwrap().course;
    assert_eq!(course.frame_count(30.0, 1.0).unwrap(), Some(61));
    assert_eq!(course.frame_count(30.0, 2.0).unwrap(), Some(31));
    let middle = course.pose(30, 30.0, 1.0).unwrap();
    assert!((middle.position.x - 50.0).abs() < 1e-9);
    assert!(course.frame_count(1e9, 1.0).unwrap_err().to_string().contains("at most 2000000"));
}

#[test]
fn a_camera_rests_where_it_is_told_to_and_looks_at_its_target() {
    let key = |t: u32, more: &str| format!(r#"{{"t":{t},"x":{},"y":0,"z":100,"heading":7,"pitch":0{more}}}"#, 100 * t);
    let of = |more: &str, head: &str| {
        let keys = [key(0, more), key(2, more), key(4, "")].join(",");
        parse_text(&format!(r#"{{{head}"keyframes":[{keys}]}}"#)).unwrap().course
    };
    let moved = |course: &Course, frame: u64| {
        let [a, b] = [frame, frame + 1].map(|frame| course.pose(frame, 100.0, 1.0).unwrap().position.x);
        b - a
    };
    assert!((moved(&of("", ""), 200) - 1.0).abs() < 1e-6);
    let rests = of(r#","rest":true"#, "");
    assert!(moved(&rests, 0) < 0.02 && moved(&rests, 200) < 0.02 && moved(&rests, 100) > 1.4);
    let course = of("", r#""target":[200,100,0],"#);
    for (frame, heading_deg) in [(0, 63.434_948_822_922f64), (200, 0.0), (400, -63.434_948_822_922)] {
        let pose = course.pose(frame, 100.0, 1.0).unwrap();
        assert!((pose.heading_rad.to_degrees() - heading_deg).abs() < 1e-9, "{pose:?}");
        assert!(pose.pitch_rad < -0.4 && pose.roll_rad == 0.0, "{pose:?}");
    }
    let above = of("", r#""target":[200,0,0],"#).pose(200, 100.0, 1.0).unwrap();
    assert!((above.pitch_rad.to_degrees() + 90.0).abs() < 1e-9 && (above.heading_rad.to_degrees() - 7.0).abs() < 1e-9);
}

#[test]
fn a_bad_value_is_named_by_file_frame_and_key() {
    for (text, expected) in [
        (r#"{"target":[1,2],"keyframes":[{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#, "a place to look at"),
        (
            r#"{"keyframes":[{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0,"rest":1}]}"#,
            "\"rest\": expected true or false, found 1",
        ),
        (
            r#"{"frames":[{"x":1,"y":2,"z":3,"heading":0,"pitch":"down"}]}"#,
            r#"p: frame 0: "pitch": expected degrees from -90 to 90, found "down""#,
        ),
        (
            r#"{"frames":[{"x":1,"y":2,"heading":0,"pitch":0}]}"#,
            r#"p: frame 0: "z": expected a coordinate in metres, found nothing"#,
        ),
        (r#"{"frames":[{"x":1,"y":2,"z":3,"heading":0,"pitch":91}]}"#, "found 91"),
        (r#"{"frames":[{"x":1e999,"y":2,"z":3,"heading":0,"pitch":0}]}"#, "found 1e999"),
        (r#"{"frames":[7]}"#, "frame 0: the entry: expected an object"),
        (r#"{"frames":{}}"#, r#""frames": expected a list, found {}"#),
        (r#"{"frames":[]}"#, "nothing to fly"),
        (r#"{}"#, "nothing to fly"),
        (r#"{"frames":[],"keyframes":[]}"#, "found both"),
        (r#"{"width":0,"frames":[]}"#, r#""width": expected a whole number of pixels from 1 to 65536, found 0"#),
        (r#"{"fps":-1,"frames":[]}"#, "frames per second"),
        (r#"{"sky_rgb":[1,2,256],"frames":[]}"#, "from 0 to 255"),
        (r#"{"crs":7,"frames":[]}"#, "EPSG:32610"),
        (r#"{"crs":"moon","frames":[]}"#, "not known here"),
        (
            r#"{"keyframes":[{"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
            r#"keyframe 0: "t": expected seconds from -10000000000 to 10000000000, found nothing"#,
        ),
        (
            r#"{"keyframes":[{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0},{"t":1,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
            "keyframe 1",
        ),
        (
            r#"{"keyframes":[{"t":1e300,"x":1,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
            "\"t\": expected seconds from -10000000000 to 10000000000, found 1e300",
        ),
        (
            r#"{"keyframes":[{"t":0,"x":1,"y":2,"z":3,"heading":0,"pitch":0},{"t":1e-320,"x":9,"y":2,"z":3,"heading":0,"pitch":0}]}"#,
            "by 0.000001 at least",
        ),
        (r#"{"type":"Topology","objects":{}}"#, "an object of type \"Topology\", which is not of GeoJSON"),
    ] {
        let message = parse_text(text).unwrap_err().to_string();
        assert!(message.contains(expected), "{text}\n  {message}\n  {expected}");
    }
}

#[test]
fn what_is_not_read_costs_nothing_and_what_is_has_a_bound() {
    let keys: String = (0..100_000).map(|i| format!("\"k{i}\":[[{{}}]],")).collect();
    let deep = format!("{}{}", "[".repeat(300_000), "]".repeat(300_000));
    let text = format!("{{{keys}\"deep\":{deep},\"frames\":[{FRAME}]}}");
    assert_eq!(parse_text(&text).unwrap().course.frame_count(1.0, 1.0).unwrap(), Some(1));
    let message = parse_text(&format!("{{\"frames\":{deep}}}")).unwrap_err().to_string();
    assert!(message.contains("frame 0: the entry: expected an object"), "{message}");
    let many = format!("{{\"keyframes\":[{}{FRAME}]}}", "{},".repeat(1_000_001));
    assert!(parse_text(&many).unwrap_err().to_string().contains("keyframe 0"));
    let key = |t: usize| FRAME.replacen('{', &format!("{{\"t\":{t},"), 1) + ",";
    let keyframes: String = (0..=MAX_KEYFRAMES).map(key).collect();
    let message = parse_text(&format!("{{\"keyframes\":[{}]}}", keyframes.trim_end_matches(','))).unwrap_err();
    assert!(message.to_string().contains("at most 1000000 keyframes, found more"), "{message}");
}

#[test]
fn another_crs_is_transformed_with_its_headings() {
    let text = r#"{"crs":"EPSG:4326","frames":[{"x":-122,"y":45,"z":3000,"heading":0,"pitch":-10}]}"#;
    let Course::Frames(poses) = parse_text(text).unwrap().course else { panic!("not frames") };
    assert!((poses[0].position - DVec3::new(578_815.30, 4_983_436.77, 3000.0)).length() < 0.01);
    assert!((poses[0].heading_rad.to_degrees() + 0.707).abs() < 0.001);
}

proptest! {
    #[test]
    fn any_json_values_never_panic(
        key in "(x|y|z|t|heading|pitch|roll|crs|fps|width|frames|keyframes)",
        value in "(null|true|-?[0-9]{1,3}(e[0-9]{1,3})?|\"[a-z]{0,5}\"|\\[\\]|\\{\\}|\\[\\{\\}\\])",
        outer: bool,
    ) {
        let text = if outer {
            format!("{{\"frames\":[{FRAME}],\"{key}\":{value}}}")
        } else {
            format!("{{\"keyframes\":[{{\"t\":0,\"x\":1,\"y\":1,\"z\":1,\"heading\":0,\"pitch\":0,\"{key}\":{value}}}]}}")
        };
        if let Ok(path) = parse_text(&text) {
            prop_assert!(path.course.pose(0, 30.0, 1.0).is_some());
        }
    }
}
