use super::*;
use terravision_common::camera::CameraFields;
use terravision_common::surface::VertexTerms;
use terravision_common::world::WorldFields;

const POSTS: usize = 5;

/// A view to the north from the middle of a world of 6.4 km.
fn horizon() -> Horizon {
    let world = World::new(WorldFields {
        origin: [0.0; 2],
        lattice_unit_m: 10.0,
        extent: [640, 640],
        elevation_tile: POSTS as u32 - 1,
        color_tile: 64,
        levels: 9,
        finest_elevation_level: 0,
        finest_color_level: 0,
        body: None,
    });
    let mut horizon = Horizon::new(&world.expect("valid"));
    let camera = Camera::new(CameraFields {
        eye_in_world: [3200.0, 3200.0, 100.0],
        heading_rad: 0.0,
        pitch_rad: -0.1,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: 320,
        height: 200,
        timestamp_nanos: 0,
    })
    .expect("valid");
    horizon.look(&camera, Some(0.0));
    horizon
}

/// Enters a level leaf of 400 m a side and says whether all of it is hidden.
fn enter(horizon: &mut Horizon, [west, south]: [f32; 2], up: f32) -> bool {
    let metres = |from: f32| [0.0, 100.0, 200.0, 300.0, 400.0].map(|m| from + m);
    let terms = VertexTerms::of_plane(metres(west).to_vec(), metres(south).to_vec());
    let heights = [up; POSTS * POSTS];
    let vertices = terms.with_heights(&heights);
    horizon.enter(vertices, 1, [1; 4]);
    let is_hidden = horizon.is_hidden([0, 0], [POSTS - 1, POSTS - 1]);
    horizon.leave();
    is_hidden
}

#[test]
fn low_ground_behind_high_ground_is_hidden_and_high_ground_is_not() {
    let mut horizon = horizon();
    assert!(!enter(&mut horizon, [-200.0, 400.0], -20.0));
    assert!(enter(&mut horizon, [-100.0, 1000.0], -80.0));
    assert!(!enter(&mut horizon, [-100.0, 1400.0], -10.0), "it rises above the horizon");
    assert!(!enter(&mut horizon, [1300.0, 1800.0], -80.0), "it is not behind what was drawn");
}

#[test]
fn nothing_is_hidden_by_a_leaf_with_a_hole_nor_by_what_is_behind_it() {
    let enter_holed = |horizon: &mut Horizon, [west, south]: [f32; 2], up: f32| {
        let metres = |from: f32| [0.0, 100.0, 200.0, 300.0, 400.0].map(|m| from + m);
        let terms = VertexTerms::of_plane(metres(west).to_vec(), metres(south).to_vec());
        let heights = [up; POSTS * POSTS];
        let vertices = terms.with_heights(&heights);
        horizon.enter(vertices, 1, [1; 4]);
        horizon.enter_hole();
        horizon.leave();
    };
    let mut horizon = horizon();
    enter_holed(&mut horizon, [-200.0, 400.0], -20.0);
    assert!(!enter(&mut horizon, [-200.0, 900.0], -20.0));
    assert!(!enter(&mut horizon, [-100.0, 1400.0], -80.0), "seen through the hole, from under the leaf before it");
    // Nearer ground still hides it.
    let mut horizon = self::horizon();
    assert!(!enter(&mut horizon, [-200.0, 400.0], -20.0));
    enter_holed(&mut horizon, [-200.0, 900.0], -20.0);
    assert!(enter(&mut horizon, [-100.0, 1400.0], -80.0));
    // A hole under the eye is in all directions.
    let mut horizon = self::horizon();
    enter_holed(&mut horizon, [-200.0, -200.0], -100.0);
    assert!(!enter(&mut horizon, [-200.0, 400.0], -20.0));
    assert!(!enter(&mut horizon, [-100.0, 1000.0], -80.0));
}

#[test]
fn nothing_is_hidden_by_ground_that_the_eye_is_under() {
    let mut horizon = horizon();
    assert!(!enter(&mut horizon, [-200.0, -200.0], 5.0));
    assert!(!enter(&mut horizon, [-200.0, 400.0], 20.0));
    assert!(!enter(&mut horizon, [-100.0, 1000.0], -80.0));
}
