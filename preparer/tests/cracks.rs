//! No cracks, ever (design §5): whatever the camera, the resolutions and the tiles that are there,
//! the drawn mesh is one surface. Every edge inside of the drawn area belongs to two triangles with
//! the same two vertices, bit for bit.

mod support;

use glam::DVec3;
use proptest::prelude::*;
use std::collections::HashSet;
use support::{Case, Mesh, NODES, Vertex, case, tile_slots};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::level::Measure;
use terravision_common::node::NodeId;
use terravision_common::rig::{Rig, RigView};
use terravision_common::slot::SlotContent;
use terravision_common::synthetic::Relief;
use terravision_common::tree::{COLOR_LEAF, ELEVATION_LEAF, TreeNode};
use terravision_common::world::World;
use terravision_preparer::frame::FrameMaker;

/// A tree that no generator would make: split at random, children left out at random.
fn wild_tree(world: &World, mut seed: u64, density: u8) -> Vec<TreeNode> {
    let mut random = move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 56) as u8
    };
    let mut tree: Vec<TreeNode> = vec![];
    let mut stack = vec![0usize];
    let leaf =
        |id: NodeId| TreeNode { node: id.pack(), flags: COLOR_LEAF | ELEVATION_LEAF, ..bytemuck::Zeroable::zeroed() };
    tree.push(leaf(world.root()));
    while let Some(at) = stack.pop() {
        let id = tree[at].id().expect("an id");
        if id.q() == world.finest_elevation_level() || random() > density || tree.len() > 500 {
            continue;
        }
        let first = tree.len();
        for index in 0..4 {
            let child = id.child(index).expect("not the finest");
            if world.contains(child) && (random() > 25 || (index == 3 && tree.len() == first)) {
                tree.push(leaf(child));
            }
        }
        if tree.len() > first {
            tree[at].flags = 0;
            tree[at].first_child = first as u32;
            tree[at].child_count = (tree.len() - first) as u8;
            stack.extend((first..tree.len()).rev());
        }
    }
    tree
}

fn check(case: &Case, tree: &[TreeNode]) -> Result<(), TestCaseError> {
    let tiles = case.tiles(tree);
    let frame = case.frame(tree, &tiles);
    let mesh = Mesh::of(&case.world, &frame, 0);
    let defects = mesh.defects(&case.world);
    prop_assert!(
        defects.is_empty(),
        "{} defects in {} triangles:\n{}",
        defects.len(),
        mesh.triangles.len(),
        defects.iter().take(5).cloned().collect::<Vec<_>>().join("\n")
    );
    // No holes: each leaf of the tree is drawn once, by itself or by one node above it.
    for leaf in tree.iter().filter(|n| n.child_count == 0).map(|n| n.id().expect("an id")) {
        let drawn = (leaf.q()..case.world.levels()).filter(|q| mesh.leaves.contains(&leaf.ancestor(*q))).count();
        prop_assert_eq!(drawn, 1, "leaf {}", leaf);
    }
    let nodes: HashSet<NodeId> = tree.iter().map(|n| n.id().expect("an id")).collect();
    prop_assert!(mesh.leaves.is_subset(&nodes));
    for tile in tile_slots(&frame) {
        prop_assert!(tile.edge_snap.iter().all(|snap| 1 << snap <= case.world.elevation_tile()));
        let color = NodeId::new(
            tile.color_origin[0] / (case.world.elevation_tile() << tile.color_level),
            tile.color_origin[1] / (case.world.elevation_tile() << tile.color_level),
            tile.color_level,
        );
        let leaf = tile.node().expect("an id");
        prop_assert_eq!(Some(leaf.ancestor(tile.color_level)), color);
        prop_assert_eq!(tiles.color.get(&leaf.ancestor(tile.color_level)).map(|key| key.slot), Some(tile.color().slot));
    }
    Ok(())
}

/// Corners of a triangle, metres from the eye of a view.
fn from_eye(case: &Case, view: &Camera, triangle: &[Vertex; 3]) -> [DVec3; 3] {
    let (unit, eye) = (case.world.lattice_unit_m(), view.eye());
    let datum_m = case.camera.fields().eye_in_world[2];
    let height = |z: u32| f64::from(f32::from_bits(z)) + (datum_m - eye.z);
    triangle.map(|(x, y, z)| DVec3::new(x as f64 * unit - eye.x, y as f64 * unit - eye.y, height(z)))
}

/// Whether a ray from the eye meets the upper side of a triangle before it is at `to`.
fn is_before([a, b, c]: [DVec3; 3], to: DVec3) -> bool {
    let normal = (b - a).cross(c - a);
    let (approach, distance) = (normal.dot(to), normal.dot(a));
    // The upper side is seen by who comes down through it, and before the end of the ray.
    if approach >= 0.0 || distance <= approach {
        return false;
    }
    let at = to * (distance / approach);
    let inside = |p: DVec3, q: DVec3| (q - p).cross(at - p).dot(normal) >= -1e-9 * normal.length_squared();
    inside(a, b) && inside(b, c) && inside(c, a)
}

/// Triangles that were culled and are not wholly outside of one plane of a view's frustum: those
/// that are hidden.
fn hidden_triangles(case: &Case, view: &Camera, all: &[[Vertex; 3]], culled: &[[Vertex; 3]]) -> Vec<[Vertex; 3]> {
    let left: HashSet<_> = culled.iter().collect();
    let [a, b, c, d] = view.frustum_normals_in_world();
    let planes = [a, b, c, d, view.axes_in_world()[2]];
    let is_outside = |t: &[Vertex; 3]| planes.iter().any(|n| from_eye(case, view, t).iter().all(|p| n.dot(*p) < 0.0));
    all.iter().filter(|t| !left.contains(t) && !is_outside(t)).copied().collect()
}

/// Culling takes away only triangles that are, in every view, outside of one plane of its frustum,
/// or hidden by those that are left.
fn check_culling(case: &Case, tree: &[TreeNode]) -> Result<usize, TestCaseError> {
    let tiles = case.tiles(tree);
    let whole = Mesh::of(&case.world, &case.frame(tree, &tiles), 0);
    let frame = case.frame_of(FrameMaker::new(&case.world, NODES), tree, &tiles);
    let all: HashSet<[Vertex; 3]> = whole.triangles.iter().copied().collect();
    let mut hidden_count = 0;
    for (index, view) in case.views().cameras().enumerate() {
        let culled = Mesh::of(&case.world, &frame, index);
        prop_assert!(culled.triangles.iter().all(|t| all.contains(t)));
        let hidden = hidden_triangles(case, view, &whole.triangles, &culled.triangles);
        hidden_count += hidden.len();
        let planes = view.frustum_normals_in_world();
        for triangle in hidden.iter().step_by(1 + hidden.len() / 16) {
            let [a, b, c] = from_eye(case, view, triangle);
            let inner = |u: f64, v: f64| a + (b - a) * u + (c - a) * v;
            for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.3, 0.3)] {
                let to = inner(u, v);
                let is_in_picture = planes.iter().all(|n| n.dot(to) > 0.0);
                let is_hidden = || culled.triangles.iter().any(|t| is_before(from_eye(case, view, t), to));
                prop_assert!(!is_in_picture || is_hidden(), "{triangle:?} was culled and may be seen at {to}");
            }
        }
    }
    match frame.slots().last().and_then(|slot| slot.read()) {
        Some(SlotContent::End(end)) => {
            prop_assert_eq!(end.tile_count as usize, frame.slots().len() - 2 - case.views().len())
        }
        other => prop_assert!(false, "the frame ends with {:?}", other),
    }
    Ok(hidden_count)
}

fn view(name: &str, offset_m: [f64; 3], yaw_rad: f64) -> RigView {
    let (pitch_rad, roll_rad, vfov_rad) = (0.0, 0.0, 0.7);
    let (name, size, at) = (name.to_owned(), [320, 200], [0, 0]);
    RigView { name, offset_m, yaw_rad, pitch_rad, roll_rad, vfov_rad, lens_shift_px: 0.0, size, at }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_mesh_of_a_searched_tree_is_one_surface(case in case()) {
        check(&case, &case.tree())?;
    }

    #[test]
    fn what_is_culled_cannot_be_seen(case in case()) {
        check_culling(&case, &case.tree())?;
    }

    #[test]
    fn what_is_culled_cannot_be_seen_in_any_view(
        case in case(), offset_m in prop::array::uniform3(-40.0f64..40.0), turn in -1.0f64..1.0,
    ) {
        let pair = [view("pose", [0.0; 3], 0.0), view("other", offset_m, turn)];
        let case = Case { rig: Some(Rig::new(pair.into()).unwrap()), ..case };
        check_culling(&case, &case.tree())?;
    }

    #[test]
    fn the_mesh_of_any_tree_is_one_surface(case in case(), density in 100u8..250) {
        check(&case, &wild_tree(&case.world, case.seed, density))?;
    }
}

/// Low over mountains most of the ground lies behind ridges.
#[test]
fn ground_behind_a_ridge_is_culled() {
    let world = support::world([512, 512], 8, [0, 0], 8);
    let (mut hidden, mut of_pairs) = (0, 0);
    for seed in 0..8 {
        let camera = Camera::new(CameraFields {
            // Not on a line between nodes, which would lie between the eyes of a pair.
            eye_in_world: [2601.0, 303.0, 900.0],
            heading_rad: 0.1 * seed as f64 - 0.4,
            pitch_rad: -0.1,
            roll_rad: 0.1,
            vfov_rad: 1.0,
            width: 320,
            height: 200,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let relief = Relief::Mountains { height_m: 1500.0 };
        let (measure, r_px) = (Measure::Max, [4.0, 2.0]);
        let case = Case { world, relief, camera, rig: None, measure, r_px, exaggeration: 1.0, missing: 0, seed };
        hidden += check_culling(&case, &case.tree()).unwrap_or_else(|error| panic!("{error}"));
        // The eyes of a stereo pair are so near that leaves come near to far for both.
        let pair = [view("left", [-0.03, 0.0, 0.0], 0.0), view("right", [0.03, 0.0, 0.0], 0.0)];
        let case = Case { rig: Some(Rig::new(pair.into()).unwrap()), ..case };
        of_pairs += check_culling(&case, &case.tree()).unwrap_or_else(|error| panic!("{error}"));
    }
    assert!(of_pairs > 1000, "{of_pairs} triangles were found to be hidden from both eyes");
    assert!(hidden > 1000, "{hidden} triangles were found to be hidden");
}
