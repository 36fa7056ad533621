//! The predicted camera, and the tiles that its view wants.

mod support;

use std::collections::HashSet;
use support::world;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, Tile};
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::rig::Views;
use terravision_common::run::Prediction;
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::TreeNode;
use terravision_prefetcher::prediction::CameraTrack;
use terravision_prefetcher::prediction::{Resolution, WantedTiles};

const SEC: u64 = 1_000_000_000;

/// A camera that flies north and turns, as functions of time in seconds.
fn camera(north: f64, heading_rad: f64, time_secs: f64) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [2500.0, north, 900.0],
        heading_rad,
        pitch_rad: -0.3,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: 320,
        height: 180,
        timestamp_nanos: (time_secs * 1e9) as u64 + SEC,
    })
    .expect("valid")
}

/// A track that has seen two seconds of a flight at 30 frames a second, and the time of the last
/// frame.
fn track(north: impl Fn(f64) -> f64, heading: impl Fn(f64) -> f64) -> (CameraTrack, u64) {
    let mut track = CameraTrack::default();
    let mut last = 0;
    for frame in 0..=60 {
        let time = f64::from(frame) / 30.0;
        let camera = camera(north(time), heading(time), time);
        track.see(&camera, 77);
        last = camera.timestamp_nanos();
    }
    (track, last)
}

#[test]
fn a_steady_flight_is_predicted_where_it_will_be() {
    // Past north, where the heading jumps from a whole turn to none.
    let heading = |time: f64| (6.0 + 0.4 * time).rem_euclid(std::f64::consts::TAU);
    let (track, now) = track(|time| 100.0 * time, heading);
    for prediction in [Prediction::Linear, Prediction::Quadratic] {
        let predicted = track.predict(now, 1.5, prediction).expect("a camera");
        assert!((predicted.fields().eye_in_world[1] - 350.0).abs() < 0.1, "{predicted:?}");
        let turned = predicted.heading_rad() - heading(3.5);
        let turned = turned - std::f64::consts::TAU * (turned / std::f64::consts::TAU).round();
        assert!(turned.abs() < 1e-3, "{turned}");
    }
}

#[test]
fn a_quadratic_prediction_follows_a_gain_of_speed_and_a_linear_one_falls_behind() {
    let (track, now) = track(|time| 20.0 * time * time, |_| 0.0);
    let north = |prediction| track.predict(now, 1.0, prediction).expect("a camera").fields().eye_in_world[1];
    assert!((north(Prediction::Quadratic) - 180.0).abs() < 0.5, "{}", north(Prediction::Quadratic));
    assert!(north(Prediction::Linear) < 165.0);
}

#[test]
fn the_field_of_view_widens_with_the_time_ahead_and_a_pixel_stays_as_wide() {
    let (track, now) = track(|time| 100.0 * time, |_| 0.0);
    let seen = camera(0.0, 0.0, 2.0);
    let mut before = seen.vfov_rad();
    for ahead in [0.5, 1.0, 2.0, 4.0] {
        let predicted = track.predict(now, ahead, Prediction::Linear).expect("a camera");
        assert!(predicted.vfov_rad() > before);
        assert!((predicted.focal_px() / seen.focal_px() - 1.0).abs() < 0.01);
        assert!(predicted.picture_plane().half()[0] > seen.picture_plane().half()[0]);
        before = predicted.vfov_rad();
    }
}

#[test]
fn a_camera_that_rests_or_jumps_or_is_new_is_predicted_where_it_is() {
    assert!(CameraTrack::default().predict(SEC, 1.0, Prediction::Linear).is_none());
    let (mut track, now) = track(|time| 100.0 * time, |_| 0.0);
    // Nothing was heard of it for two seconds.
    let resting = track.predict(now + 2 * SEC, 1.0, Prediction::Linear).expect("a camera");
    assert_eq!(resting.fields().eye_in_world[1], 200.0);
    // Another flight begins, earlier and far away.
    track.see(&camera(4000.0, 0.0, 0.5), 77);
    let jumped = track.predict(now, 1.0, Prediction::Quadratic).expect("a camera");
    assert_eq!(jumped.fields().eye_in_world[1], 4000.0);
    // Numbers that lead out of the world are passed over.
    track.see(&camera(9e11, 0.0, 0.6), 77);
    let outside = track.predict(now, 4.0, Prediction::Linear).expect("a camera");
    assert_eq!(outside.fields().eye_in_world[1], 9e11);
}

#[test]
fn a_view_wants_what_its_tree_wants_coarse_to_fine() {
    let world = world();
    let terrain = SyntheticTerrain::new(&world, Relief::Mountains { height_m: 300.0 }, 3);
    let limits = TreeLimits { nodes: 20_000, elevation_leaves: 20_000 };
    let mut lookahead = WantedTiles::new(&world, terrain, limits);
    let resolution = Resolution { r_z_px: 10.0, r_c_px: 1.0, exaggeration: 1.0, measure: Measure::Area };
    for (north, heading) in [(1000.0, 0.0), (2500.0, 2.0), (4000.0, 4.0)] {
        let camera = camera(north, heading, 0.0);
        let tiles = lookahead.tiles(&camera, &Views::single(&camera), &resolution).to_vec();
        assert!(tiles.len() > 50);
        assert_eq!(tiles[0].node, world.root());
        assert!(tiles.windows(2).all(|pair| pair[0].node.q() >= pair[1].node.q()), "coarse to fine");
        let mut nodes: Vec<TreeNode> = vec![bytemuck::Zeroable::zeroed(); 20_000];
        let level = LevelFunction::new(&camera, &world, 1.0, Measure::Area, 10.0, 1.0);
        let stats = Traversal::new(&world, limits).build(&Views::single(&camera), &level, &terrain, &mut nodes);
        let in_tree: HashSet<_> = nodes[..stats.node_count as usize].iter().map(|n| n.id().expect("an id")).collect();
        let distinct: HashSet<Tile> = tiles.iter().copied().collect();
        assert_eq!(distinct.len(), tiles.len(), "each once");
        assert!(tiles.iter().all(|tile| in_tree.contains(&tile.node)));
        // Every leaf has a wanted colour tile at or above it, every elevation leaf its own
        // elevation.
        for node in &nodes[..stats.node_count as usize] {
            let id = node.id().expect("an id");
            if node.flags & terravision_common::tree::ELEVATION_LEAF != 0 {
                assert!(distinct.contains(&Tile { layer: Layer::Elevation, node: id }));
            }
            assert!((id.q()..8).any(|q| distinct.contains(&Tile { layer: Layer::Color, node: id.ancestor(q) })));
        }
    }
}
