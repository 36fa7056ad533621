use super::*;
use crate::camera::{Camera, CameraFields};
use crate::level::Measure;
use crate::tree::{COLOR_FROM_ANCESTOR, COLOR_LEAF, ELEVATION_LEAF};
use crate::world::WorldFields;
use bytemuck::Zeroable;
use proptest::prelude::*;
use std::collections::{HashMap, HashSet};

/// Heights that are a function of the level-0 node alone, with its ancestors' ranges around it.
struct Blocks {
    world: World,
    relief_m: f64,
}

impl Blocks {
    fn height(&self, m: u32, n: u32) -> f64 {
        let hash = (u64::from(m) << 32 | u64::from(n)).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        self.relief_m * (hash & 0xffff) as f64 / 65536.0
    }
}

impl HeightRanges for Blocks {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        if !self.world.contains(node) {
            return None;
        }
        // Level 0 to 2 exactly, above that the whole relief: nested, as the database's are.
        if node.q() > 2 {
            return Some([0.0, self.relief_m as f32]);
        }
        let [m, n] = [node.m(), node.n()].map(|c| c << node.q());
        let heights = (0..1 << node.q()).flat_map(|j| (0..1 << node.q()).map(move |i| (m + i, n + j)));
        let heights = heights.map(|(m, n)| self.height(m, n) as f32);
        Some(heights.fold([f32::INFINITY, f32::NEG_INFINITY], |r, z| [r[0].min(z), r[1].max(z)]))
    }
}

fn world(extent: [u32; 2], levels: u8) -> World {
    World::new(WorldFields {
        origin: [0.0; 2],
        lattice_unit_m: 10.0,
        extent,
        elevation_tile: 8,
        color_tile: 64,
        levels,
        finest_elevation_level: 1,
        finest_color_level: 0,
        body: None,
    })
    .expect("valid")
}

#[derive(Debug, Clone)]
struct Case {
    world: World,
    relief_m: f64,
    camera: Camera,
    measure: Measure,
    r_px: [f64; 2],
}

fn case() -> impl Strategy<Value = Case> {
    let camera = (prop::array::uniform3(-0.2f64..1.2), prop::array::uniform3(-3.2f64..3.2), 0.1f64..2.5);
    let measure = prop_oneof![Just(Measure::Min), Just(Measure::Area), Just(Measure::Max)];
    (prop::array::uniform2(1u32..700), 0.0f64..1500.0, camera, measure, prop::array::uniform2(-1.0f64..7.0)).prop_map(
        |(extent, relief_m, (eye, angles, vfov_rad), measure, r)| {
            let world = world(extent, 8);
            let [ex, ey] = world.extent_m();
            let camera = Camera::new(CameraFields {
                eye_in_world: [eye[0] * ex, eye[1] * ey, eye[2] * 4000.0],
                heading_rad: angles[0],
                pitch_rad: -0.6 + 0.4 * angles[1],
                roll_rad: 0.2 * angles[2],
                vfov_rad,
                width: 320,
                height: 200,
                timestamp_nanos: 0,
            })
            .expect("valid");
            Case { world, relief_m, camera, measure, r_px: r.map(f64::exp2) }
        },
    )
}

impl Case {
    fn build(&self, limits: TreeLimits) -> (Vec<TreeNode>, TreeStats) {
        let ranges = Blocks { world: self.world, relief_m: self.relief_m };
        let level = LevelFunction::new(&self.camera, &self.world, 1.0, self.measure, self.r_px[0], self.r_px[1]);
        let mut out = vec![TreeNode::zeroed(); limits.nodes as usize];
        let mut traversal = Traversal::new(&self.world, limits);
        traversal.build(&Views::single(&self.camera), &level, &ranges, &mut out);
        // Twice: nothing may be left over from the frame before.
        let stats = traversal.build(&Views::single(&self.camera), &level, &ranges, &mut out);
        out.truncate(stats.node_count as usize);
        (out, stats)
    }

    fn tree(&self) -> Vec<TreeNode> {
        self.build(TreeLimits { nodes: 40_000, elevation_leaves: 40_000 }).0
    }
}

fn ids(tree: &[TreeNode], flag: u8) -> Vec<NodeId> {
    tree.iter().filter(|n| n.flags & flag != 0).map(|n| n.id().expect("an id")).collect()
}

/// Indices of the colour leaves in the order of a depth first walk.
fn walk(tree: &[TreeNode]) -> Vec<u32> {
    let mut leaves = vec![];
    let mut stack = if tree.is_empty() { vec![] } else { vec![0u32] };
    while let Some(at) = stack.pop() {
        let node = tree[at as usize];
        if node.child_count == 0 {
            leaves.push(at);
        }
        stack.extend(node.children(at, tree.len() as u32).expect("valid").rev());
    }
    leaves
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn the_flat_tree_is_well_formed(case in case()) {
        let (tree, stats) = case.build(TreeLimits { nodes: 40_000, elevation_leaves: 40_000 });
        prop_assert_eq!(stats.elevation_leaf_count as usize, ids(&tree, ELEVATION_LEAF).len());
        prop_assert_eq!(stats.color_leaf_count as usize, ids(&tree, COLOR_LEAF).len());
        let mut next = 1u32;
        let mut stack = if tree.is_empty() { vec![] } else { vec![(0u32, false, 0u8)] };
        let mut seen = HashSet::new();
        while let Some((at, has_elevation, inherited)) = stack.pop() {
            let node = tree[at as usize];
            let id = node.id().expect("an id");
            prop_assert!(case.world.contains(id) && seen.insert(id));
            let is_elevation = node.flags & ELEVATION_LEAF != 0;
            prop_assert!(!(has_elevation && is_elevation));
            prop_assert!(!is_elevation || id.q() >= case.world.finest_elevation_level());
            prop_assert_eq!(node.flags & COLOR_LEAF != 0, node.child_count == 0);
            prop_assert!(node.child_count > 0 || has_elevation || is_elevation);
            prop_assert_eq!(node.flags & inherited, inherited);
            prop_assert_eq!(node.reserved, [0; 10]);
            let children = node.children(at, tree.len() as u32).expect("valid");
            if !children.is_empty() {
                // Depth first: the block of children is the next one in the array.
                prop_assert_eq!(children.start, next);
                next = children.end;
            }
            for child in children.rev() {
                prop_assert_eq!(tree[child as usize].id().expect("an id").parent(), id);
                stack.push((child, has_elevation || is_elevation, node.flags & COLOR_FROM_ANCESTOR));
            }
        }
        prop_assert_eq!(seen.len(), tree.len());
        prop_assert!(tree.is_empty() || tree[0].flags & COLOR_FROM_ANCESTOR == 0);
    }

    #[test]
    fn every_visible_point_is_covered_once_by_each_kind_of_leaf(
        case in case(), points in prop::collection::vec(prop::array::uniform2(0.0f64..1.0), 200),
    ) {
        let tree = case.tree();
        let blocks = Blocks { world: case.world, relief_m: case.relief_m };
        let colors: HashSet<NodeId> = ids(&tree, COLOR_LEAF).into_iter().collect();
        let elevations: HashSet<NodeId> = ids(&tree, ELEVATION_LEAF).into_iter().collect();
        let [right, up, forward] = case.camera.axes_in_world();
        let [tx, ty] = case.camera.picture_plane().half();
        for [s, t] in points {
            let [x, y] = [s * case.world.extent_m()[0], t * case.world.extent_m()[1]];
            let finest = NodeId::new((x / 80.0) as u32, (y / 80.0) as u32, 0).expect("in range");
            let p = glam::DVec3::new(x, y, blocks.height(finest.m(), finest.n())) - case.camera.eye();
            let depth = p.dot(forward);
            let is_visible = depth > 0.01 && p.dot(right).abs() < tx * depth && p.dot(up).abs() < ty * depth;
            let count = |leaves: &HashSet<NodeId>| (0..8).filter(|q| leaves.contains(&finest.ancestor(*q))).count();
            prop_assert!(count(&colors) <= 1 && count(&elevations) <= 1);
            if is_visible {
                prop_assert_eq!((count(&colors), count(&elevations)), (1, 1), "at {} {}", x, y);
            }
        }
    }

    #[test]
    fn elevation_leaves_across_an_edge_differ_by_one_level_at_most(case in case()) {
        let tree = case.tree();
        let leaves: HashSet<NodeId> = ids(&tree, ELEVATION_LEAF).into_iter().collect();
        for leaf in &leaves {
            for (east, north) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let Some(neighbor) = case.world.neighbor(*leaf, east, north) else { continue };
                for q in neighbor.q() + 2..case.world.levels() {
                    prop_assert!(!leaves.contains(&neighbor.ancestor(q)), "{leaf} beside {}", neighbor.ancestor(q));
                }
            }
        }
    }

    #[test]
    fn no_ray_from_the_eye_meets_leaves_out_of_order(
        case in case(), rays in prop::collection::vec(0.0f64..std::f64::consts::TAU, 20),
    ) {
        let tree = case.tree();
        let order: HashMap<NodeId, usize> =
            walk(&tree).into_iter().enumerate().map(|(i, at)| (tree[at as usize].id().expect("an id"), i)).collect();
        for angle in rays {
            let mut last = 0;
            for step in 0..3000 {
                let p = case.camera.eye() + glam::DVec3::new(angle.sin(), angle.cos(), 0.0) * (f64::from(step) * 4.0);
                if p.x < 0.0 || p.y < 0.0 {
                    continue;
                }
                let Some(finest) = NodeId::new((p.x / 80.0) as u32, (p.y / 80.0) as u32, 0) else { continue };
                if let Some(&at) = (0..8).find_map(|q| order.get(&finest.ancestor(q))) {
                    prop_assert!(at >= last);
                    last = at;
                }
            }
        }
    }

    #[test]
    fn a_node_is_split_where_the_level_functions_ask_for_it(case in case()) {
        let tree = case.tree();
        let ranges = Blocks { world: case.world, relief_m: case.relief_m };
        let level = LevelFunction::new(&case.camera, &case.world, 1.0, case.measure, case.r_px[0], case.r_px[1]);
        for node in &tree {
            let id = node.id().expect("an id");
            let bounds = node_box(&case.world, &ranges, 1.0, id).expect("exists");
            if node.flags & ELEVATION_LEAF != 0 {
                let finest = case.world.finest_elevation_level();
                prop_assert!(id.q() == finest || f64::from(id.q()) <= level.elevation_bound(&bounds));
            }
            if node.flags & COLOR_LEAF != 0 {
                let finest = case.world.finest_color_level();
                // Tiles of 8: blocks of two cells lie two levels below.
                let is_smallest = id.q() + 2 < 8 && ids(&tree, ELEVATION_LEAF).contains(&id.ancestor(id.q() + 2));
                prop_assert!(id.q() == finest || is_smallest || f64::from(id.q()) <= level.color_bound(&bounds));
            }
        }
    }

    #[test]
    fn a_larger_database_adds_nothing_but_the_path_from_its_root(
        x in 0.4f64..0.6, y in 0.4f64..0.6, z in 600.0f64..4000.0, heading in -3.0f64..3.0, pitch in -1.57f64..-1.2,
        // Coarser facets make leaves as large as the small world.
        r in prop::array::uniform2(-1.0f64..5.0),
    ) {
        let camera = Camera::new(CameraFields {
            eye_in_world: [x * 10240.0, y * 10240.0, z], heading_rad: heading, pitch_rad: pitch, roll_rad: 0.0,
            vfov_rad: 0.5, width: 320, height: 200, timestamp_nanos: 0,
        }).expect("valid");
        let small = Case { world: world([1024, 1024], 8), relief_m: 500.0, camera, measure: Measure::Area, r_px: r.map(f64::exp2) };
        let large = Case { world: world([16384, 9000], 12), ..small.clone() };
        let (a, b) = (small.tree(), large.tree());
        prop_assert_eq!(b.len(), a.len() + 4);
        for (a, b) in a.iter().zip(&b[4..]) {
            prop_assert_eq!((a.node, a.child_count), (b.node, b.child_count));
            // The path above may be fine enough in colour already, and then lends it.
            prop_assert_eq!(a.flags | (b.flags & COLOR_FROM_ANCESTOR), b.flags);
        }
    }

    #[test]
    fn limits_make_the_tree_coarser_and_still_restricted(case in case(), nodes in 1u32..400, leaves in 1u32..100) {
        let limits = TreeLimits { nodes, elevation_leaves: leaves };
        let (full, _) = case.build(TreeLimits { nodes: 40_000, elevation_leaves: 40_000 });
        let (tree, stats) = case.build(limits);
        prop_assert!(tree.len() <= nodes as usize && ids(&tree, ELEVATION_LEAF).len() <= leaves as usize);
        prop_assert!(stats.is_cut_short || tree == full);
        prop_assert!(!(stats.is_cut_short && full.len() + 4 < nodes as usize / 4 && full.len() < leaves as usize));
        // The other way round: a coarse node's box may be in view where those of its children are
        // not.
        prop_assert!(!tree.is_empty() || full.is_empty());
    }
}

#[test]
fn a_camera_that_sees_no_terrain_gives_an_empty_tree() {
    let camera = Camera::new(CameraFields {
        eye_in_world: [500.0, 500.0, 5000.0],
        heading_rad: 0.0,
        pitch_rad: 1.0,
        roll_rad: 0.0,
        vfov_rad: 1.0,
        width: 320,
        height: 200,
        timestamp_nanos: 0,
    })
    .expect("valid");
    let case = Case { world: world([100, 100], 8), relief_m: 100.0, camera, measure: Measure::Area, r_px: [8.0, 1.0] };
    assert_eq!(case.build(TreeLimits { nodes: 100, elevation_leaves: 100 }), (vec![], TreeStats::default()));
}
