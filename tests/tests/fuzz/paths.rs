//! Camera paths of all kinds, and poses that other programs send.

use crate::within;
use std::fs;
use std::path::Path;
use terravision_launcher::input::message::Message;
use terravision_launcher::path::crs::Georeference;
use terravision_launcher::path::{self, CourseOptions, Ground, Remarks};
use terravision_tests::folder::TestFolder;
use terravision_tests::fuzz::{Target, corpus};

struct Plain;

impl Ground for Plain {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        (x.is_finite() && y.is_finite()).then_some(100.0)
    }
}

/// Reads a file as a path and asks for poses here and there.
fn read(file: &Path) {
    let world = Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), Some("+proj=utm +zone=10 +datum=WGS84"));
    for agl_m in [None, Some(50.0)] {
        let (mut remarks, options) = (Remarks::default(), CourseOptions { agl_m, ..CourseOptions::default() });
        match path::load(file, &world, &Plain, options, &mut remarks) {
            Ok(path) => {
                let Ok(Some(count)) = path.course.frame_count(30.0, 1.0) else { continue };
                for frame in [0, 1, count / 3, count / 2, count.saturating_sub(1)].into_iter().filter(|at| *at < count)
                {
                    let pose = path.course.pose(frame, 30.0, 1.0).unwrap();
                    assert!(
                        pose.position.is_finite() && pose.heading_rad.is_finite() && pose.pitch_rad.is_finite(),
                        "{pose:?}"
                    );
                }
            }
            Err(error) => {
                let text = error.to_string();
                assert!(!text.is_empty() && !text.chars().any(|c| c.is_control() && c != '\n'), "{text:?}");
            }
        }
    }
}

fn run(name: &str, inputs: Vec<Vec<u8>>, words: &[&[u8]], short_round: u64) {
    let folder = TestFolder::new(&format!("fuzz-{name}"));
    let file = folder.join("path");
    let target = Target { name, inputs, words, short_round };
    target.run(|bytes| {
        fs::write(&file, bytes).unwrap();
        // A track is cut into even steps of time: a few points may make as many as a path may have.
        within(512 << 20, || read(&file));
    });
}

#[test]
fn json() {
    let words: [&[u8]; 7] =
        [b"\"crs\": \"EPSG:4326\",", b"\"keyframes\"", b"null", b"1e308", b"\"t\": -1", b"[", b"\"target\""];
    run("path-json", Vec::new(), &words, 600);
}

#[test]
fn kml() {
    let words: [&[u8]; 9] = [
        b"<gx:FlyTo>",
        b"</gx:FlyTo>",
        b"<gx:Wait>",
        b"<Camera>",
        b"<LookAt>",
        b"<gx:altitudeMode>relativeToSeaFloor</gx:altitudeMode>",
        b"<![CDATA[",
        b"<!DOCTYPE a [<!ENTITY b \"c\">]>",
        b"&#x0;",
    ];
    run("path-kml", Vec::new(), &words, 600);
}

#[test]
fn gpx() {
    let words: [&[u8]; 6] =
        [b"<trkpt", b"</trkseg>", b"<ele>", b"<time>2024-02-30T25:61:61Z</time>", b"lat=\"91\"", b"<rte>"];
    run("path-gpx", Vec::new(), &words, 600);
}

#[test]
fn czml() {
    let words: [&[u8]; 10] = [
        b"\"referenceFrame\": \"INERTIAL\",",
        b"\"cartesianVelocity\"",
        b"\"interval\": \"0000-01-01T00Z/9999-12-31T24Z\",",
        b"\"2024-05-01T24:00:00Z\",",
        b"\"HERMITE\"",
        b"\"delete\": true,",
        b"1e308",
        b"-0,",
        b"null",
        b"[",
    ];
    run("path-czml", Vec::new(), &words, 600);
}

#[test]
fn geojson() {
    let words: [&[u8]; 8] = [
        b"\"GeometryCollection\"",
        b"\"geometries\"",
        b"\"MultiPoint\"",
        b"\"EPSG:32610\"",
        b"\"times\": [[1, 2]],",
        b"1e308",
        b"null",
        b"[",
    ];
    run("path-geojson", Vec::new(), &words, 600);
}

/// A zip with one stored member, as KMZ are.
fn zip(name: &str, content: &[u8]) -> Vec<u8> {
    let crc = crc32fast::hash(content).to_le_bytes();
    let size = (content.len() as u32).to_le_bytes();
    let name_bytes = (name.len() as u16).to_le_bytes();
    let common = [&[0u8; 8][..], &crc, &size, &size, &name_bytes, &[0; 2]].concat();
    let local = [b"PK\x03\x04\x14\x00", &common[..], name.as_bytes(), content].concat();
    let central =
        [b"PK\x01\x02\x14\x00\x14\x00", &common[..], &[0; 2], &[0; 2], &[0; 2], &[0; 4], &[0; 4], name.as_bytes()]
            .concat();
    let end = [
        b"PK\x05\x06\0\0\0\0\x01\0\x01\0",
        &(central.len() as u32).to_le_bytes()[..],
        &(local.len() as u32).to_le_bytes(),
        &[0; 2],
    ]
    .concat();
    [local, central, end].concat()
}

#[test]
fn kmz() {
    let inputs: Vec<Vec<u8>> = corpus("path-kml").iter().map(|kml| zip("doc.kml", kml)).collect();
    // What is not changed is a path, so that changes are of one.
    let folder = TestFolder::new("fuzz-kmz-whole");
    fs::write(folder.join("a.kmz"), &inputs[0]).unwrap();
    let world = Georeference::new("WGS 84 / UTM zone 10N".into(), Some(32610), Some("+proj=utm +zone=10 +datum=WGS84"));
    path::load(&folder.join("a.kmz"), &world, &Plain, CourseOptions::default(), &mut Remarks::default()).unwrap();
    run("path-kmz", inputs, &[b"PK\x01\x02", b"PK\x05\x06", b"PK\x06\x06", b"../", b".kml"], 600);
}

#[test]
fn poses_by_udp() {
    let inputs = vec![
        br#"{"x": 500000.5, "y": 4.9e6, "z": 1500, "heading": 90, "pitch": -10, "roll": 0, "vfov": 50, "t": 12.5}"#
            .to_vec(),
        br#"{"end": true}"#.to_vec(),
    ];
    let target =
        Target { name: "pose-json", inputs, words: &[b"NaN", b"null", b"\"x\": 1,", b"1e999"], short_round: 5000 };
    target.run(|bytes| {
        within(1 << 20, || {
            if let Message::Pose(pose) = Message::of_json(bytes) {
                assert!(pose.position.iter().all(|v| v.is_finite()), "{pose:?}");
            }
        });
    });
}
