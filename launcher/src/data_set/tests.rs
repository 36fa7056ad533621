//! The camera model against the camera's own rays, and listings that grow.

use super::geometry::{camera_to_world, intrinsics, with_opengl_axes, world_to_camera};
use super::*;
use glam::DVec3;
use serde_json::Value;
use std::fs;
use terravision_common::camera::CameraFields;

const ORIGIN: [f64; 2] = [553_000.0, 5_105_000.0];

fn camera(n: f64) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [1000.0 + 10.0 * n, 2000.0, 3000.5],
        heading_rad: (30.0 + n).to_radians(),
        pitch_rad: (-25.0f64).to_radians(),
        roll_rad: 12.0f64.to_radians(),
        vfov_rad: 50.0f64.to_radians(),
        width: 640,
        height: 361,
        timestamp_nanos: 0,
    })
    .expect("valid")
}

fn times(rows: &[[f64; 4]; 4], at: DVec3) -> DVec3 {
    let row = |n: usize| rows[n][0] * at.x + rows[n][1] * at.y + rows[n][2] * at.z + rows[n][3];
    DVec3::new(row(0), row(1), row(2))
}

#[test]
fn what_a_ray_meets_is_projected_onto_its_pixel() {
    let camera = camera(0.0);
    let (k, to_camera, to_world) =
        (intrinsics(&camera), world_to_camera(&camera, ORIGIN), camera_to_world(&camera, ORIGIN));
    for (px, py, depth) in [(0.5, 0.5, 900.0), (320.0, 180.5, 1234.0), (639.5, 12.5, 20.0), (17.5, 360.5, 4e4)] {
        let met = camera.eye() + camera.ray_in_world(px, py) * depth;
        let met = met + DVec3::new(ORIGIN[0], ORIGIN[1], 0.0);
        let seen = times(&to_camera, met);
        assert!((seen.z - depth).abs() < 1e-6, "{seen} at {depth}");
        let [x, y] = [k[0][0] * seen.x / seen.z + k[0][2], k[1][1] * seen.y / seen.z + k[1][2]];
        assert!((x - px).abs() < 1e-6 && (y - py).abs() < 1e-6, "{x} {y} is {px} {py}");
        assert!(times(&to_world, seen).distance(met) < 1e-6);
    }
    let f = 361.0 / 2.0 / 25.0f64.to_radians().tan();
    assert!((k[0][0] - f).abs() < 1e-9 && k[0][0] == k[1][1] && (k[0][2], k[1][2]) == (320.0, 180.5));
}

#[test]
fn a_level_camera_that_looks_north_has_the_matrices_of_the_documents() {
    let level = Camera::new(CameraFields { heading_rad: 0.0, pitch_rad: 0.0, roll_rad: 0.0, ..*camera(0.0).fields() })
        .expect("valid");
    let close = |a: [[f64; 4]; 4], b: [[f64; 4]; 4]| {
        a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9)
    };
    let to_world = camera_to_world(&level, [0.0; 2]);
    // Right is east, down is down, forward is north.
    assert!(close(
        to_world,
        [[1.0, 0.0, 0.0, 1000.0], [0.0, 0.0, 1.0, 2000.0], [0.0, -1.0, 0.0, 3000.5], [0.0, 0.0, 0.0, 1.0]]
    ));
    // OpenGL: right is east, up is up, backwards is south.
    assert!(close(
        with_opengl_axes(to_world),
        [[1.0, 0.0, 0.0, 1000.0], [0.0, 0.0, -1.0, 2000.0], [0.0, 1.0, 0.0, 3000.5], [0.0, 0.0, 0.0, 1.0]]
    ));
}

struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("terravision-data-set-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn data_set(&self, exaggeration: f64) -> DataSet {
        let folder = |name: &str| FrameFolder::create(&self.0.join(name), "tv-1-2").unwrap();
        DataSet {
            head: Head::new(Some("EPSG:26710".into()), "NAD27 / UTM zone 10N".into(), [640, 361], 29.97, exaggeration),
            origin: ORIGIN,
            view: None,
            depth: Some(folder("d")),
            ground: Some(folder("frames/g")),
            pictures: Some(self.0.join("frames")),
        }
    }

    /// Lists frames whose files it makes.
    fn list(&self, set: &DataSet, frames: [u64; 2]) -> Listed {
        let flown: Vec<FlownFrame> = (frames[0]..frames[1])
            .map(|frame| FlownFrame {
                frame: FrameNumber::new(frame),
                time_s: frame as f64 / 29.97,
                camera: camera(frame as f64),
            })
            .collect();
        for frame in frames[0]..frames[1] {
            for name in [
                format!("d/frame-{frame:06}.tif"),
                format!("frames/g/frame-{frame:06}.tif"),
                format!("frames/frame-{frame:06}.png"),
            ] {
                fs::write(self.0.join(name), "x").unwrap();
            }
        }
        assert_eq!(set.whole_frames(frames), (frames[0]..frames[1]).collect());
        set.list(&flown, "tv-1-2").unwrap()
    }

    fn json(&self, name: &str) -> (Value, Vec<u8>) {
        let bytes = fs::read(self.0.join("frames").join(name)).unwrap();
        (serde_json::from_slice(&bytes).unwrap(), bytes)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        fs::remove_dir_all(&self.0).ok();
    }
}

#[test]
fn pieces_of_a_flight_list_the_bytes_of_the_whole() {
    let (whole, pieces) = (Scratch::new("whole"), Scratch::new("pieces"));
    let listed = whole.list(&whole.data_set(1.5), [0, 8]);
    assert_eq!(listed, Listed { frames: 8, dropped: 0, has_transforms: true });
    pieces.list(&pieces.data_set(1.5), [3, 8]);
    pieces.list(&pieces.data_set(1.5), [0, 3]);
    for name in [FRAMES_FILE, TRANSFORMS_FILE] {
        assert!(whole.json(name).1 == pieces.json(name).1, "{name}");
    }
    let frames = whole.json(FRAMES_FILE).0;
    let seventh = &frames["frames"][7];
    assert_eq!(seventh["frame"], 7);
    assert_eq!(
        (&seventh["color"], &seventh["depth"], &seventh["ground"]),
        (&"frame-000007.png".into(), &"../d/frame-000007.tif".into(), &"g/frame-000007.tif".into())
    );
    assert_eq!((&seventh["heading"], &seventh["x"]), (&37.0.into(), &554_070.0.into()));
    assert_eq!((&frames["width"], &frames["height"], &frames["exaggeration"]), (&640.into(), &361.into(), &1.5.into()));
}

#[test]
fn transforms_are_small_numbers_and_an_offset() {
    let scratch = Scratch::new("transforms");
    scratch.list(&scratch.data_set(1.0), [2, 4]);
    let transforms = scratch.json(TRANSFORMS_FILE).0;
    assert_eq!(transforms["crs_offset"], serde_json::json!([554_000.0, 5_107_000.0, 0.0]));
    assert_eq!((&transforms["w"], &transforms["h"]), (&640.into(), &361.into()));
    assert_eq!((transforms["cx"].as_f64(), transforms["cy"].as_f64()), (Some(320.0), Some(180.5)));
    assert!((transforms["fl_x"].as_f64().unwrap() - camera(0.0).focal_px()).abs() < 1e-9);
    let frame = &transforms["frames"][0];
    assert_eq!(
        (&frame["file_path"], &frame["depth_file_path"]),
        (&"frame-000002.png".into(), &"../d/frame-000002.tif".into())
    );
    let matrix = &frame["transform_matrix"];
    assert_eq!(
        (matrix[0][3].as_f64(), matrix[1][3].as_f64(), matrix[2][3].as_f64()),
        (Some(20.0), Some(0.0), Some(3000.5))
    );
    let backwards = -camera(2.0).axes_in_world()[2];
    for (row, expected) in backwards.to_array().into_iter().enumerate() {
        assert!((matrix[row][2].as_f64().unwrap() - expected).abs() < 1e-12);
    }
}

#[test]
fn frames_of_another_flight_or_without_files_are_not_listed() {
    let scratch = Scratch::new("other");
    scratch.list(&scratch.data_set(1.0), [0, 4]);
    fs::remove_file(scratch.0.join("d/frame-000001.tif")).unwrap();
    assert_eq!(scratch.list(&scratch.data_set(1.0), [3, 5]).frames, 4);
    let numbers = |value: Value| -> Vec<u64> {
        value["frames"].as_array().unwrap().iter().map(|frame| frame["frame"].as_u64().unwrap()).collect()
    };
    assert_eq!(numbers(scratch.json(FRAMES_FILE).0), [0, 2, 3, 4]);
    let listed = scratch.list(&scratch.data_set(2.0), [0, 1]);
    assert_eq!(listed, Listed { frames: 1, dropped: 4, has_transforms: true });
    fs::write(scratch.0.join("frames").join(FRAMES_FILE), "nonsense").unwrap();
    assert_eq!(scratch.list(&scratch.data_set(2.0), [6, 7]).frames, 1);
}
