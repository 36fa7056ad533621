#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::*;
use crate::model::Triangle;
use terravision_common::camera::{Camera, CameraFields};

/// A box: 6 m long, 2 m wide and 3 m high above its origin.
fn model() -> Model {
    let (low, high) = (Vec3::new(-3.0, -1.0, 0.0), Vec3::new(3.0, 1.0, 3.0));
    let at = |x: usize, y: usize, z: usize| Vec3::new([low, high][x].x, [low, high][y].y, [low, high][z].z);
    let faces = [
        ([at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1)], Vec3::X),
        ([at(0, 0, 0), at(0, 0, 1), at(0, 1, 1), at(0, 1, 0)], -Vec3::X),
        ([at(0, 1, 0), at(0, 1, 1), at(1, 1, 1), at(1, 1, 0)], Vec3::Y),
        ([at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)], -Vec3::Y),
        ([at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)], Vec3::Z),
        ([at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0)], -Vec3::Z),
    ];
    let mut mesh = Mesh::default();
    for (corners, normal) in faces {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(corners.map(|position| Vertex { position, normal, uv: [0.0; 2] }));
        for vertices in [[0, 1, 2], [0, 2, 3]] {
            mesh.triangles.push(Triangle { vertices: vertices.map(|v| first + v), material: 0 });
        }
    }
    let materials = vec![Material { rgb: [1.0, 0.0, 0.0], texture: None, is_double_sided: false }];
    let (middle, radius_m) = (0.5 * (low + high), 0.5 * (high - low).length());
    Model { levels: vec![mesh], materials, textures: vec![], middle, radius_m, length_m: 6.0 }
}

const SIZE: [u32; 2] = [200, 150];

fn camera(eye_in_world: [f64; 3]) -> Camera {
    Camera::new(CameraFields {
        eye_in_world,
        heading_rad: 0.0,
        pitch_rad: 0.0,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: SIZE[0],
        height: SIZE[1],
        timestamp_nanos: 0,
    })
    .unwrap()
}

/// What a camera at (0, 0, 1.5) that looks north sees of a vehicle: pixels with their nearness.
fn picture(position: DVec3, attitude: Quat, camera: &Camera, behind: f32) -> (Vec<u8>, Vec<f32>) {
    let look = VehicleLook { model: Some(0), scale: 1.0, point_px: 3.0, rgb: [0, 0, 255] };
    let painter = Painter::of_models(vec![model()], vec![look], None, 0.5);
    let count = (SIZE[0] * SIZE[1]) as usize;
    let (mut rgba, mut nearness) = (vec![0; 4 * count], vec![behind; count]);
    let view = View { camera: *camera, at: [0; 2] };
    let record = VehicleRecord::new(0, position, attitude);
    painter.draw((&mut rgba, &mut nearness), SIZE[0] as usize, &[view], &[record]);
    (rgba, nearness)
}

fn drawn(nearness: &[f32], behind: f32) -> Vec<[usize; 2]> {
    let width = SIZE[0] as usize;
    (0..nearness.len()).filter(|i| nearness[*i] != behind).map(|i| [i % width, i / width]).collect()
}

#[test]
fn a_vehicle_is_where_its_box_is_and_as_far() {
    let camera = camera([0.0, 0.0, 1.5]);
    // Heading north: seen from behind, 2 m wide and 3 m high, 17 m away.
    let north = Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
    let (rgba, nearness) = picture(DVec3::new(0.0, 20.0, 0.0), north, &camera, 0.0);
    let pixels = drawn(&nearness, 0.0);
    let focal = camera.focal_px();
    let expected = (2.0 * focal / 17.0) * (3.0 * focal / 17.0);
    assert!((pixels.len() as f64 - expected).abs() < 0.1 * expected, "{} of {expected}", pixels.len());
    let at = 75 * 200 + 100;
    assert!((0.5 / nearness[at] - 17.0).abs() < 1e-3);
    assert!(rgba[4 * at] > 50 && rgba[4 * at + 1] == 0 && rgba[4 * at + 3] == 255);
}

#[test]
fn what_is_nearer_hides_it_and_what_is_out_of_sight_is_not_drawn() {
    let camera = camera([0.0, 0.0, 1.5]);
    let place = DVec3::new(0.0, 20.0, 0.0);
    let behind_ridge = 0.5 / 15.0;
    let (_, nearness) = picture(place, Quat::IDENTITY, &camera, behind_ridge);
    assert!(drawn(&nearness, behind_ridge).is_empty());
    let before_ridge = 0.5 / 30.0;
    let (_, nearness) = picture(place, Quat::IDENTITY, &camera, before_ridge);
    assert!(drawn(&nearness, before_ridge).len() > 100);
    for place in [[0.0, -20.0, 0.0], [40.0, 20.0, 0.0], [0.0, 20.0, 30.0]] {
        let (_, nearness) = picture(DVec3::from_array(place), Quat::IDENTITY, &camera, 0.0);
        assert!(drawn(&nearness, 0.0).is_empty(), "{place:?}");
    }
}

#[test]
fn far_away_it_is_a_point_and_around_the_camera_it_is_cut() {
    let camera = camera([0.0, 0.0, 1.5]);
    let (rgba, nearness) = picture(DVec3::new(0.0, 3000.0, 0.0), Quat::IDENTITY, &camera, 0.0);
    let pixels = drawn(&nearness, 0.0);
    assert_eq!(pixels.len(), 9, "{pixels:?}");
    assert_eq!(rgba[4 * (75 * 200 + 100)..][..4], [0, 0, 255, 255]);
    // From within, backs are not drawn; before a wall, what is behind the eye is cut.
    let (_, nearness) = picture(DVec3::ZERO, Quat::IDENTITY, &camera, 0.0);
    assert!(drawn(&nearness, 0.0).is_empty());
    let (_, nearness) = picture(DVec3::new(0.0, 1.5, 1.4), Quat::IDENTITY, &camera, 0.0);
    assert!(drawn(&nearness, 0.0).len() > 100);
}

#[test]
fn a_picture_from_above_is_lit_by_the_sun() {
    let fields = *camera([0.0, 0.0, 30.0]).fields();
    let above = Camera::new(CameraFields { pitch_rad: -std::f64::consts::FRAC_PI_2, ..fields }).unwrap();
    let at = 4 * (75 * 200 + 100);
    let level = picture(DVec3::ZERO, Quat::IDENTITY, &above, 0.0).0[at];
    // The usual sun stands in the north west: what leans there is brighter, what leans away darker.
    let leaning = |axis: Vec3, angle: f32| {
        let attitude = Quat::from_axis_angle(axis, angle);
        // With the middle of its roof below the camera.
        picture(-(attitude * (3.0 * Vec3::Z)).as_dvec3(), attitude, &above, 0.0).0[at]
    };
    assert_eq!(level, 255, "level ground keeps its colours, and so does a roof");
    let away = leaning(Vec3::new(1.0, 1.0, 0.0).normalize(), 0.6);
    assert!(away < 200, "{away}");
}
