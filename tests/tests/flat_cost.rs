//! What a frame costs depends on the view alone, never on the size of the database: the same view
//! over 1, 16 and 256 times the area gives the same leaves. Counts are asserted; times are printed.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use bytemuck::Zeroable;
use std::collections::BTreeSet;
use std::time::Instant;
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::rig::Views;
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::{Traversal, TreeLimits, TreeStats};
use terravision_common::tree::{COLOR_LEAF, ELEVATION_LEAF, TreeNode};
use terravision_common::world::{World, WorldFields};
use terravision_testkit::worlds::fields;
use terravision_tests::flight::Pose;

const NODES: u32 = 65_536;

fn terrain(posts: u32) -> SyntheticTerrain {
    let world = World::new(WorldFields { finest_color_level: 2, ..fields([posts; 2], 10.0, [32, 256]) }).unwrap();
    SyntheticTerrain::new(&world, Relief::Mountains { height_m: 800.0 }, 5)
}

/// A view down into the south west corner of the world, which is there in all sizes: nothing beyond
/// it is visible.
fn pose() -> Pose {
    Pose::new([4_000.0, 4_000.0, 2_200.0], 10.0, -62.0)
}

fn search(posts: u32) -> (TreeStats, BTreeSet<(u64, u8)>, f64) {
    let terrain = terrain(posts);
    let camera = pose().camera([1280, 720], 60.0);
    let world = terrain.world();
    let level = LevelFunction::new(&camera, world, 1.0, Measure::default(), 10.0, 1.0);
    let limits = TreeLimits { nodes: NODES, elevation_leaves: 4096 };
    let mut traversal = Traversal::new(world, limits);
    let mut out = vec![TreeNode::zeroed(); NODES as usize];
    let start = Instant::now();
    let mut stats = TreeStats::default();
    for _ in 0..20 {
        stats = traversal.build(&Views::single(&camera), &level, &terrain, &mut out);
    }
    let micros = start.elapsed().as_secs_f64() * 1e6 / 20.0;
    let leaves = out[..stats.node_count as usize]
        .iter()
        .filter(|node| node.flags & (COLOR_LEAF | ELEVATION_LEAF) != 0)
        .map(|node| (node.node, node.flags & (COLOR_LEAF | ELEVATION_LEAF)))
        .collect();
    (stats, leaves, micros)
}

#[test]
fn the_same_view_of_a_larger_database_is_the_same_tree() {
    let (stats, leaves, micros) = search(1024);
    println!("  1 x: {stats:?} in {micros:.0} us");
    assert!(leaves.len() > 40 && !stats.is_cut_short, "the view has a tree: {stats:?}");
    for (times, posts) in [(16u32, 4096), (256, 16_384), (65_536, 262_144)] {
        let (larger, same_leaves, micros) = search(posts);
        println!("{times:3} x: {larger:?} in {micros:.0} us");
        assert_eq!(same_leaves, leaves, "{times} times the area");
        // The root lies higher: one node more per level, and nothing else.
        let levels = posts.ilog2() - 1024u32.ilog2();
        assert_eq!(larger.node_count, stats.node_count + levels, "{times} times the area");
        assert_eq!(larger.color_leaf_count, stats.color_leaf_count);
        assert_eq!(larger.elevation_leaf_count, stats.elevation_leaf_count);
    }
}
