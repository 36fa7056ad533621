//! Paths in GeoJSON: what is flown, and what is told of the rest.

use super::*;
use crate::path::tests::{parse_text, parse_with};
use proptest::prelude::*;

const TWO: &str = "[[-122,45],[-121.99,45]]";
const TIMES: &str = r#"["2024-05-01T10:00:00Z","2024-05-01T10:01:00Z"]"#;

fn feature(kind: &str, coordinates: &str, properties: &str) -> String {
    format!(
        r#"{{"type":"Feature","properties":{properties},"geometry":{{"type":"{kind}","coordinates":{coordinates}}}}}"#
    )
}

fn collection(features: &[String]) -> String {
    format!(r#"{{"type":"FeatureCollection","features":[{}]}}"#, features.join(","))
}

fn frames(text: &str) -> u64 {
    parse_text(text).unwrap().course.frame_count(1.0, 1.0).unwrap().unwrap()
}

/// The same way as GPX, which is read by other code.
fn gpx() -> String {
    let point = |lon: f64, minute: u32| {
        format!("<trkpt lat=\"45\" lon=\"{lon}\"><time>2024-05-01T10:0{minute}:00Z</time></trkpt>")
    };
    format!("<gpx><trk><trkseg>{}{}</trkseg></trk></gpx>", point(-122.0, 0), point(-121.99, 1))
}

#[test]
fn lines_and_points_with_times_are_flown_as_gpx_is() {
    let expected = parse_text(&gpx()).unwrap();
    let millis = "[1714557600000, 1714557660000]";
    let point = |lon: &str, time: &str| feature("Point", &format!("[{lon},45]"), &format!(r#"{{"time":{time}}}"#));
    for text in [
        collection(&[feature("LineString", TWO, &format!(r#"{{"name":"a","coordTimes":{TIMES}}}"#))]),
        feature("LineString", TWO, &format!(r#"{{"coordinateProperties":{{"times":{TIMES}}}}}"#)),
        feature("LineString", TWO, &format!(r#"{{"times":{millis}}}"#)),
        feature("LineString", TWO, r#"{"times":[1714557600, 1714557660]}"#),
        feature("MultiLineString", &format!("[{TWO}]"), &format!(r#"{{"coordTimes":[{TIMES}]}}"#)),
        feature("MultiLineString", &format!("[{TWO}]"), &format!(r#"{{"coordTimes":{TIMES}}}"#)),
        feature("MultiPoint", TWO, &format!(r#"{{"time":{TIMES}}}"#)),
        collection(&[point("-122", "\"2024-05-01T10:00:00Z\""), point("-121.99", "\"2024/05/01 10:01:00+00\"")]),
        collection(&[point("-122", "1714557600"), point("-121.99", "1714557660000")]),
    ] {
        let (path, remarks) = parse_with(&text, CourseOptions::default());
        assert_eq!(path.unwrap(), expected, "{text}");
        assert_eq!(remarks, Remarks::default(), "{text}");
    }
}

#[test]
fn a_line_without_times_is_flown_at_an_even_speed_also_bare_and_in_another_crs() {
    let line = format!(r#"{{"type":"LineString","coordinates":{TWO}}}"#);
    let expected = parse_text(&line).unwrap();
    assert!((30..34).contains(&frames(&line)));
    let of_collection = format!(r#"{{"type":"GeometryCollection","geometries":[{line}]}}"#);
    assert_eq!(parse_text(&of_collection).unwrap(), expected);
    let crs = |name: &str, coordinates: &str| {
        format!(
            r#"{{"type":"FeatureCollection","crs":{{"type":"name","properties":{{"name":"{name}"}}}},"features":[{}]}}"#,
            feature("LineString", coordinates, "null")
        )
    };
    assert_eq!(parse_text(&crs("urn:ogc:def:crs:OGC:1.3:CRS84", TWO)).unwrap(), expected);
    let metres = crs("urn:ogc:def:crs:EPSG::32610", "[[578815.30,4983436.77],[579603.55,4983446.50]]");
    let [a, b] = [&expected, &parse_text(&metres).unwrap()].map(|path| path.course.pose(9, 1.0, 1.0).unwrap().position);
    assert!(a.distance(b) < 1.0, "{a} {b}");
}

#[test]
fn heights_are_flown_in_the_air_and_it_is_said_above_what() {
    let line = "[[-122,45,900],[-121.99,45,900]]";
    let text = feature("LineString", line, &format!(r#"{{"coordTimes":{TIMES}}}"#));
    let (path, remarks) = parse_with(&text, CourseOptions::default());
    assert!((path.unwrap().course.pose(30, 1.0, 1.0).unwrap().position.z - 900.0).abs() < 1e-6);
    assert!(remarks.notes[0].contains("above the ellipsoid") && remarks.notes[1].contains("its own heights"));
    let low = CourseOptions { agl_m: Some(20.0), ..CourseOptions::default() };
    let (path, remarks) = parse_with(&text, low);
    assert!((path.unwrap().course.pose(30, 1.0, 1.0).unwrap().position.z - 120.0).abs() < 1e-6);
    assert_eq!(remarks, Remarks::default());
    // An unknown height is written as null.
    let text = text.replace("900", "null");
    assert!((parse_text(&text).unwrap().course.pose(30, 1.0, 1.0).unwrap().position.z - 250.0).abs() < 1e-6);
}

#[test]
fn points_of_several_tracks_are_several_segments() {
    let point = |track: u32, minute: u32| {
        let lon = -122.0 + 0.05 * f64::from(track) + 0.001 * f64::from(minute);
        let properties =
            format!(r#"{{"track_fid":{track},"track_seg_id":0,"time":"2024-05-0{}T10:0{minute}:00Z"}}"#, track + 1);
        feature("Point", &format!("[{lon},45]"), &properties)
    };
    let text = collection(&[point(0, 0), point(0, 1), point(1, 0), point(1, 1)]);
    let (path, remarks) = parse_with(&text, CourseOptions::default());
    assert_eq!(path.unwrap().course.frame_count(1.0, 1.0).unwrap(), Some(121));
    assert!(remarks.notes[0].starts_with("1 gap in the recording"), "{remarks:?}");
}

#[test]
fn what_is_not_flown_and_what_is_odd_is_told() {
    let line = feature("LineString", TWO, r#"{"coordTimes":["2024-05-01T10:00:00Z"]}"#);
    let others = [
        line,
        feature("Point", "[1,2]", "{}"),
        feature("Point", "[1,2]", r#"{"time":"2024-05-01T10:00:00Z"}"#),
        feature("Polygon", "[]", "{}"),
        r#"{"type":"Feature","geometry":null,"properties":{}}"#.into(),
    ];
    let (path, remarks) = parse_with(&collection(&others), CourseOptions::default());
    assert!(path.is_ok());
    let note = "beside the lines the file has 1 point with a time, 1 point without a time and 1 other shape, not flown";
    assert_eq!(remarks.notes, [note]);
    assert!(remarks.warnings[0].starts_with("feature 0: the line has 1 times for 2 points"), "{remarks:?}");
    // Times that step back are told by the number of the point.
    let times = (0..9).map(|i| if i == 5 { 100 } else { 1000 + i }.to_string()).collect::<Vec<_>>().join(",");
    let coordinates = (0..9).map(|i| format!("[{},45]", -122.0 + 0.001 * f64::from(i))).collect::<Vec<_>>().join(",");
    let text = feature("LineString", &format!("[{coordinates}]"), &format!(r#"{{"times":[{times}]}}"#));
    let (_, remarks) = parse_with(&text, CourseOptions::default());
    assert!(remarks.warnings[0].contains("(the first in point 5)"), "{remarks:?}");
}

#[test]
fn bad_input_is_told_with_its_feature() {
    for (text, expected) in [
        (collection(&[]), "expected a line (LineString), or points with a time, found no shapes"),
        (
            collection(&[feature("Point", "[1,2]", "{}"), feature("Point", "[1,2]", "{}")]),
            "found 2 points without a time",
        ),
        (collection(&[feature("Polygon", "[]", "{}")]), "found 1 other shape"),
        (r#"{"type":"FeatureCollection","features":7}"#.into(), "\"features\": expected a list, found 7"),
        (r#"{"type":"FeatureCollection","features":[7]}"#.into(), "feature 0: the entry: expected a feature"),
        (feature("LineString", "7", "{}"), "the file: \"coordinates\": expected a list, found 7"),
        (
            collection(&[feature("LineString", "[[1,2],[3]]", "{}")]),
            "feature 0: \"coordinates\" 1: expected [longitude, latitude] or [longitude, latitude, height], in degrees and \
             metres, found [3]",
        ),
        (feature("LineString", "[[1,91],[3,4]]", "{}"), "\"coordinates\" 0: expected [longitude"),
        (feature("LineString", "[[1,\"2\"],[3,4]]", "{}"), "found [1,\"2\"]"),
        (feature("LineString", "[[1,1e999],[3,4]]", "{}"), "found [1,1e999]"),
        (feature("LineString", "[[1,NaN],[3,4]]", "{}"), "not valid JSON"),
        (feature("LineString", TWO, r#"{"coordTimes":["noon","midnight"]}"#), "point 0: time: expected times like"),
        (feature("MultiLineString", TWO, "{}"), "\"coordinates\" 0: expected [longitude"),
        (feature("MultiLineString", "[7]", "{}"), "\"coordinates\" 0: expected a list of points, found 7"),
    ] {
        let message = parse_text(&text).unwrap_err().to_string();
        assert!(message.contains(expected) && !message.contains('\n'), "{text}\n  {message}\n  {expected}");
    }
}

proptest! {
    #[test]
    fn any_values_never_panic(
        kind in "(FeatureCollection|Feature|GeometryCollection|LineString|MultiLineString|Point|MultiPoint)",
        coordinates in "(null|7|\\[\\]|\\[[0-9]{1,3},[0-9]{1,2}\\]|\\[\\[[0-9],[0-9]\\],\\[\\]\\]|\\[\\[\\[1,2\\],[0-9]\\]\\])",
        properties in "(null|7|\\{\"(times|time|coordTimes)\":(\\[[0-9]\\]|\\[\\[[0-9]\\],7\\]|[0-9]|null|\"[a-z]\")\\})",
    ) {
        for text in [feature(&kind, &coordinates, &properties), collection(&[feature(&kind, &coordinates, &properties)])] {
            if let Ok(path) = parse_text(&text) {
                prop_assert!(path.course.pose(0, 30.0, 1.0).is_none_or(|pose| pose.position.is_finite()));
            }
        }
    }
}
