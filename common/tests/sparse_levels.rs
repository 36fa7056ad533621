//! Worlds whose finest levels are only in places: their index, read back and damaged, and the
//! search over it.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use bytemuck::Zeroable;
use proptest::prelude::*;
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, Layers, NodeRange, NodeRanges, NodesRecord, RangesError};
use terravision_common::level::{LevelFunction, Measure, deepest_color_below};
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::{COLOR_FROM_ANCESTOR, COLOR_LEAF, ELEVATION_LEAF, TreeNode};
use terravision_common::world::{World, WorldFields};

fn world() -> World {
    World::new(WorldFields {
        origin: [0.0; 2],
        lattice_unit_m: 1.0,
        extent: [4000, 3500],
        elevation_tile: 16,
        color_tile: 64,
        levels: 9,
        finest_elevation_level: 0,
        finest_color_level: 0,
        body: None,
    })
    .unwrap()
}

/// What a layer needs besides these nodes: parents, siblings, and around parents with elevation
/// nodes of their level.
fn closed(world: &World, seeds: &[NodeId], layer: Layer) -> HashSet<NodeId> {
    let mut all: HashSet<NodeId> = seeds.iter().copied().collect();
    for q in 0..world.levels() {
        if q > 0 {
            let parents: HashSet<NodeId> = all.iter().filter(|n| n.q() == q - 1).map(|n| n.parent()).collect();
            for parent in parents {
                all.insert(parent);
                if layer == Layer::Elevation {
                    all.extend((-1..=1).flat_map(|e| (-1..=1).filter_map(move |n| world.neighbor(parent, e, n))));
                }
            }
        }
        let here: Vec<NodeId> = all.iter().filter(|n| n.q() == q && **n != world.root()).copied().collect();
        for node in here {
            all.extend((0..4).filter_map(|k| node.parent().child(k)).filter(|c| world.contains(*c)));
        }
    }
    all
}

fn nodes_of(world: &World, elevation: &[NodeId], color: &[NodeId]) -> Vec<NodeRange> {
    // Level 6 and above everywhere.
    let whole: Vec<NodeId> = (0..world.nodes_at(6)[0])
        .flat_map(|m| (0..world.nodes_at(6)[1]).filter_map(move |n| NodeId::new(m, n, 6)))
        .collect();
    let color = closed(world, &[color, &whole].concat(), Layer::Color);
    let above: Vec<NodeId> =
        color.iter().map(|n| n.ancestor((n.q() + deepest_color_below(world)).min(world.root().q()))).collect();
    let elevation = closed(world, &[elevation, &above, &whole].concat(), Layer::Elevation);
    let all: HashSet<NodeId> = elevation.union(&color).copied().collect();
    all.into_iter()
        .map(|node| NodeRange {
            node,
            range: [0.0, 100.0],
            layers: Layers { elevation: elevation.contains(&node), color: color.contains(&node) },
        })
        .collect()
}

fn node(world: &World, at: [f64; 2], q: u8) -> NodeId {
    let [m, n] = [0, 1].map(|a| (at[a] * f64::from(world.nodes_at(q)[a] - 1)) as u32);
    NodeId::new(m, n, q).unwrap()
}

fn temporary() -> PathBuf {
    static COUNT: AtomicU32 = AtomicU32::new(0);
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    std::env::temp_dir().join(format!("tv-sparse-nodes-{}-{number}", std::process::id()))
}

#[test]
fn the_index_follows_the_data_and_reads_back() {
    let world = world();
    let nodes = nodes_of(&world, &[node(&world, [0.3, 0.6], 0)], &[node(&world, [0.8, 0.2], 1)]);
    let ranges = NodeRanges::from_nodes(&world, nodes.clone()).unwrap();
    assert_eq!(ranges.world().complete_level(), 6);
    let path = temporary();
    let record = ranges.write(&path).unwrap();
    let dense = *NodeRanges::file_bytes(&world, false).end();
    assert!(record.bytes < dense / 20, "{} bytes, {dense} for all nodes", record.bytes);
    let sparse = world.with_complete_level(6);
    let read = NodeRanges::read(&path, &sparse, &record, true).unwrap();
    assert_eq!(read, ranges);
    for found in &nodes {
        assert_eq!(read.range(found.node), Some(found.range));
        assert_eq!(read.has_tile(Layer::Elevation, found.node), found.layers.elevation);
        assert_eq!(read.has_tile(Layer::Color, found.node), found.layers.color);
    }
    let absent = node(&world, [0.9, 0.9], 0);
    assert!(read.range(absent).is_none() && !read.has_tile(Layer::Elevation, absent));
    // The manifest says another level.
    let error = NodeRanges::read(&path, &world.with_complete_level(4), &record, true).unwrap_err();
    assert!(matches!(error, RangesError::Complete { expected: 4, found: 6 }), "{error}");
    std::fs::remove_file(&path).unwrap();
}

/// Reads bytes as an index whose checksum is right, as if written by someone who means harm.
fn read(bytes: &[u8]) -> Result<NodeRanges, RangesError> {
    let path = temporary();
    std::fs::write(&path, bytes).unwrap();
    let record = NodesRecord { bytes: bytes.len() as u64, crc32: crc32fast::hash(bytes) };
    let read = NodeRanges::read(&path, &world().with_complete_level(6), &record, true);
    std::fs::remove_file(&path).unwrap();
    read
}

#[test]
fn counts_that_the_file_cannot_hold_and_nodes_that_make_no_tree_are_errors() {
    let world = world();
    let nodes = nodes_of(&world, &[node(&world, [0.3, 0.6], 0)], &[node(&world, [0.3, 0.6], 0)]);
    let path = temporary();
    NodeRanges::from_nodes(&world, nodes.clone()).unwrap().write(&path).unwrap();
    let good = std::fs::read(&path).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert!(read(&good).is_ok());
    for count in [u64::MAX, 1 << 40, 5, 3, 0] {
        let mut bytes = good.clone();
        bytes[8..16].copy_from_slice(&count.to_le_bytes());
        let error = read(&bytes).unwrap_err().to_string();
        assert!(error.len() > 20, "{error}");
    }
    for length in 0..good.len() {
        assert!(read(&good[..length]).is_err(), "{length} bytes of {}", good.len());
    }
    // Each of the four nodes of level 0 alone without elevation, without colour, gone, moved, or
    // with an invalid range.
    for at in (16..96).step_by(20) {
        for (offset, byte) in [(16, 1), (16, 2), (16, 0), (16, 7), (0, 0xff), (4, 0xff), (15, 0xff)] {
            let mut bytes = good.clone();
            if bytes[at + offset] != byte {
                bytes[at + offset] = byte;
                assert!(read(&bytes).is_err(), "byte {offset} of the node at {at} is {byte}");
            }
        }
    }
    for left_out in 0..nodes.len() {
        let mut fewer = nodes.clone();
        fewer.remove(left_out);
        let NodeRange { node, .. } = nodes[left_out];
        // Nothing but a node of a whole group of siblings without children and neighbours' need
        // could be missing.
        assert!(NodeRanges::from_nodes(&world, fewer).is_err(), "without {node}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn trees_name_only_tiles_that_exist_and_stay_restricted(
        seeds in prop::collection::vec((prop::array::uniform2(0.0f64..1.0), 0u8..5), 1..4),
        colors in prop::collection::vec((prop::array::uniform2(0.0f64..1.0), 0u8..5), 0..3),
        target in 0usize..4,
        away in prop::array::uniform2(-200.0f64..200.0),
        height in 3.0f64..600.0,
        heading in 0.0f64..6.3,
        pitch in -1.5f64..0.1,
    ) {
        let world = world();
        let place = |(at, q): &([f64; 2], u8)| node(&world, *at, *q);
        let (seeds, colors): (Vec<_>, Vec<_>) = (seeds.iter().map(place).collect(), colors.iter().map(place).collect());
        let ranges = NodeRanges::from_nodes(&world, nodes_of(&world, &seeds, &colors)).unwrap();
        let near = world.node_origin(seeds[target % seeds.len()]).map(|v| v as f64);
        let camera = Camera::new(CameraFields {
            eye_in_world: [near[0] + away[0], near[1] + away[1], 100.0 + height], heading_rad: heading, pitch_rad: pitch,
            roll_rad: 0.0, vfov_rad: 1.0, width: 640, height: 480, timestamp_nanos: 0,
        }).expect("valid");
        let level = LevelFunction::new(&camera, &world, 1.0, Measure::Min, 4.0, 1.0);
        let limits = TreeLimits { nodes: 1 << 16, elevation_leaves: 1 << 12 };
        let mut out = vec![TreeNode::zeroed(); 1 << 16];
        let stats = Traversal::new(&world, limits).build(&Views::single(&camera), &level, &ranges, &mut out);
        prop_assert!(!stats.is_cut_short);
        let tree = &out[..stats.node_count as usize];
        let mut leaves = HashMap::new();
        let mut below = HashSet::new();
        for (index, found) in tree.iter().enumerate() {
            let id = found.id().unwrap();
            let is_below = below.contains(&index);
            if !is_below {
                prop_assert!(ranges.has_tile(Layer::Elevation, id), "{} has no elevation", id);
            }
            if found.flags & COLOR_FROM_ANCESTOR == 0 {
                prop_assert!(ranges.has_tile(Layer::Color, id), "{} has no colour", id);
            }
            if found.flags & ELEVATION_LEAF != 0 {
                leaves.insert(id, found.flags & COLOR_LEAF);
            }
            if is_below || found.flags & ELEVATION_LEAF != 0 {
                below.extend(found.children(index as u32, stats.node_count).unwrap().map(|c| c as usize));
            }
        }
        for leaf in leaves.keys() {
            for (east, north) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let Some(mut beside) = world.neighbor(*leaf, east, north) else { continue };
                while !leaves.contains_key(&beside) && beside != world.root() {
                    beside = beside.parent();
                }
                if leaves.contains_key(&beside) {
                    prop_assert!(beside.q() <= leaf.q() + 1, "{} beside {}", leaf, beside);
                }
            }
        }
    }
}
