//! Measures the speed of search and preparation over a synthetic world, without files or other
//! processes, and counts the triangles of a frame.
//!
//! `cargo run --release -p terravision-preparer --example measure [-- ELEVATION_TILE [COLOR_TILE]]`
#![allow(clippy::unwrap_used, reason = "an example")]

use std::collections::HashMap;
use std::io::Write;
use std::time::Instant;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{Layer, NodeRanges, TileScratch, TileSource};
use terravision_common::ids::SlotKey;
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::slot::SlotContent;
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::{TreeHeader, TreeNode};
use terravision_common::world::{World, WorldFields};
use terravision_preparer::frame::{FrameBuffer, FrameMaker, FrameRequest};
use terravision_preparer::frame_tree::FrameTree;
use terravision_preparer::truncation::Tiles;
use terravision_testkit::worlds::fields;

const LIMITS: TreeLimits = TreeLimits { nodes: 65536, elevation_leaves: 8192 };
const REPEATS: u32 = 30;

/// All tiles that a view needs.
struct All(HashMap<NodeId, Vec<f32>>);

impl Tiles for All {
    fn color(&self, _: NodeId) -> Option<SlotKey> {
        Some(SlotKey::new(1, 1))
    }

    fn elevation(&self, node: NodeId) -> Option<&[f32]> {
        self.0.get(&node).map(Vec::as_slice)
    }

    fn elevation_key(&self, node: NodeId) -> Option<SlotKey> {
        self.0.contains_key(&node).then(|| SlotKey::new(1, 1))
    }
}

fn world(nz: u32, nc: u32) -> World {
    World::new(WorldFields {
        // Texels of 5 m, or the nearest possible size.
        finest_color_level: (nc / nz / 2).ilog2() as u8,
        ..fields([4096; 2], 10.0, [nz, nc])
    })
    .unwrap()
}

fn camera(z: f64, pitch_deg: f64) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [20_000.0, 6_000.0, z],
        heading_rad: 0.3,
        pitch_rad: pitch_deg.to_radians(),
        roll_rad: 0.0,
        vfov_rad: 60f64.to_radians(),
        width: 1280,
        height: 720,
        timestamp_nanos: 0,
    })
    .expect("valid")
}

/// Shortest of several runs, milliseconds.
fn shortest_ms(mut work: impl FnMut()) -> f64 {
    let time = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..REPEATS).map(time).fold(f64::INFINITY, f64::min)
}

fn measure(terrain: &SyntheticTerrain, ranges: &NodeRanges, camera: Camera, measure: Measure, r_z: f64) -> String {
    let world = terrain.world();
    let views = Views::single(&camera);
    let level = LevelFunction::new(&camera, world, 1.0, measure, r_z, 1.0);
    let mut traversal = Traversal::new(world, LIMITS);
    let mut tree = vec![<TreeNode as bytemuck::Zeroable>::zeroed(); LIMITS.nodes as usize];
    let mut stats = Default::default();
    let generate_ms = shortest_ms(|| stats = traversal.build(&views, &level, ranges, &mut tree));
    tree.truncate(stats.node_count as usize);

    let posts = world.elevation_posts().pow(2) as usize;
    let read = |node: &TreeNode| {
        let mut tile = vec![0.0; posts];
        terrain.read_elevation(node.id().unwrap(), &mut tile, &mut TileScratch::default()).unwrap();
        (node.id().unwrap(), tile)
    };
    let tiles = All(tree.iter().map(read).collect());
    let header = TreeHeader { camera: *camera.fields(), r_z_px: r_z, r_c_px: 1.0, ..bytemuck::Zeroable::zeroed() };
    let request = FrameRequest { header: &header, pose: &camera, views: &views, level: &level };
    let mut frame_tree = FrameTree::new(world, LIMITS.nodes, LIMITS.elevation_leaves);
    let mut maker = FrameMaker::new(world, LIMITS.nodes);
    let mut frame = FrameBuffer::new(LIMITS.elevation_leaves as usize, posts);
    let mut counts = Default::default();
    let prepare_ms = shortest_ms(|| {
        frame.clear();
        frame_tree.read(&tree).unwrap();
        counts = maker.make(&request, &frame_tree, &tiles, 0, &mut frame).unwrap();
    });
    let triangles = |slot: &terravision_common::slot::Slot| match slot.read() {
        Some(SlotContent::Tile(t)) => 2 * u64::from(t.end[0] - t.start[0]) * u64::from(t.end[1] - t.start[1]),
        _ => 0,
    };
    let total: u64 = frame.slots().iter().map(triangles).sum();
    let colors = frame_tree.wanted().iter().filter(|tile| tile.layer == Layer::Color).count();
    format!(
        "{:6} {:6} {:6} {:8} {colors:7} {generate_ms:9.3} {prepare_ms:9.3} {:9.1} {:9.1}",
        stats.node_count,
        counts.arrays,
        counts.tiles,
        total,
        f64::from(stats.node_count) / generate_ms / 1e3,
        prepare_ms * 1e3 / f64::from(counts.arrays.max(1)),
    )
}

fn main() {
    let argument = |i: usize, or: u32| std::env::args().nth(i).map_or(or, |text| text.parse().unwrap());
    let world = world(argument(1, 32), argument(2, 256));
    let terrain = SyntheticTerrain::new(&world, Relief::Mountains { height_m: 2400.0 }, 1);
    let ranges = terrain.ranges().unwrap();
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:16} {:5} {:4} {:>6} {:>6} {:>6} {:>8} {:>7} {:>9} {:>9} {:>9} {:>9}",
        "view",
        "",
        "r_z",
        "nodes",
        "arrays",
        "slots",
        "triang.",
        "colours",
        "gen. ms",
        "prep. ms",
        "Mnodes/s",
        "us/array"
    )
    .unwrap();
    let views = [
        ("4 km, 25 down", camera(4000.0, -25.0)),
        ("3 km, 15 down", camera(3000.0, -15.0)),
        ("2.6 km, 8 down", camera(2600.0, -8.0)),
        ("6 km, 90 down", camera(6000.0, -90.0)),
        ("12 km, 45 down", camera(12_000.0, -45.0)),
    ];
    for (name, camera) in views {
        for kind in [Measure::Min, Measure::Area, Measure::Max] {
            for r_z in [10.0, 3.0] {
                let line = measure(&terrain, &ranges, camera, kind, r_z);
                writeln!(out, "{name:16} {:5} {r_z:4} {line}", format!("{kind:?}")).unwrap();
            }
        }
    }
}
