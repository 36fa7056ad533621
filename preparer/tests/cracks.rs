//! No cracks, ever (design §5): whatever the camera, the resolutions and the tiles that are there, the drawn mesh is one
//! surface. Every edge inside of the drawn area belongs to two triangles with the same two vertices, bit for bit.

mod support;

use proptest::prelude::*;
use std::collections::HashSet;
use support::{Case, Mesh, NODES, Vertex, case, tile_slots};
use terravision_common::node::NodeId;
use terravision_common::slot::SlotContent;
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
    let mesh = Mesh::of(&case.world, &frame);
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
        let leaf = NodeId::unpack(tile.node).expect("an id");
        prop_assert_eq!(Some(leaf.ancestor(tile.color_level)), color);
        prop_assert_eq!(tiles.color.get(&leaf.ancestor(tile.color_level)).map(|c| c.0), Some(tile.color_slot));
    }
    Ok(())
}

/// Trimming takes away only triangles that are outside of one plane of the frustum.
fn check_trimming(case: &Case, tree: &[TreeNode]) -> Result<(), TestCaseError> {
    let tiles = case.tiles(tree);
    let whole = Mesh::of(&case.world, &case.frame(tree, &tiles));
    let frame = case.frame_of(FrameMaker::new(&case.world, NODES), tree, &tiles);
    let trimmed: HashSet<[Vertex; 3]> = Mesh::of(&case.world, &frame).triangles.into_iter().collect();
    let all: HashSet<[Vertex; 3]> = whole.triangles.iter().copied().collect();
    prop_assert!(trimmed.is_subset(&all));
    let [a, b, c, d] = case.camera.frustum_normals_in_world();
    let planes = [a, b, c, d, case.camera.axes_in_world()[2]];
    let eye = case.camera.eye();
    for triangle in all.difference(&trimmed) {
        let points = triangle.map(|(x, y, z)| {
            glam::DVec3::new(x as f64 * 10.0 - eye.x, y as f64 * 10.0 - eye.y, f32::from_bits(z).into())
        });
        let is_outside = planes.iter().any(|n| points.iter().all(|p| n.dot(*p) < 0.0));
        prop_assert!(is_outside, "{triangle:?} was trimmed and may be seen");
    }
    match frame.slots().last().and_then(|slot| slot.read()) {
        Some(SlotContent::End(end)) => prop_assert_eq!(end.tile_count as usize, frame.slots().len() - 2),
        other => prop_assert!(false, "the frame ends with {:?}", other),
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_mesh_of_a_searched_tree_is_one_surface(case in case()) {
        check(&case, &case.tree())?;
    }

    #[test]
    fn what_is_trimmed_cannot_be_seen(case in case()) {
        check_trimming(&case, &case.tree())?;
    }

    #[test]
    fn the_mesh_of_any_tree_is_one_surface(case in case(), density in 100u8..250) {
        check(&case, &wild_tree(&case.world, case.seed, density))?;
    }
}
