//! Measures search and preparation over a synthetic world, with no files and no other process.
use std::io::Write;
use std::time::Instant;
use terravision_common::camera::Camera;
use terravision_common::database::{TileScratch, TileSource};
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::slot::SlotContent;
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::{TreeHeader, TreeNode};
use terravision_common::world::{World, WorldFields};
use terravision_common::node::NodeId;
use terravision_preparer::frame::{FrameBuffer, FrameMaker};
use terravision_preparer::frame_tree::FrameTree;
use terravision_preparer::truncation::Tiles;
use std::collections::HashMap;

struct All { elevation: HashMap<NodeId, Vec<f32>> }
impl Tiles for All {
    fn color(&self, _: NodeId) -> Option<(u32, u32)> { Some((1, 1)) }
    fn elevation(&self, node: NodeId) -> Option<&[f32]> { self.elevation.get(&node).map(Vec::as_slice) }
}

fn main() {
    let mut out = std::io::stdout().lock();
    let nz: u32 = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(32);
    let levels = (4096u32.div_ceil(nz)).next_power_of_two().ilog2() as u8 + 1;
    let world = World::new(WorldFields {
        origin: [0.0; 2], lattice_unit_m: 10.0, extent: [4096, 4096], elevation_tile: nz, color_tile: std::env::args().nth(2).and_then(|a| a.parse().ok()).unwrap_or(256),
        levels, finest_elevation_level: 0, finest_color_level: 2,
    }).expect("valid");
    let terrain = SyntheticTerrain::new(&world, Relief::Mountains { height_m: 2400.0 }, 1);
    let ranges = terrain.ranges().expect("valid");
    for (name, z, pitch) in [("oblique 4 km -25", 4000.0, -25f64), ("oblique 3 km -15", 3000.0, -15.0), ("low 2.6 km -8", 2600.0, -8.0), ("down 6 km -90", 6000.0, -90.0), ("high 12 km -45", 12000.0, -45.0)] {
        for measure in [Measure::Min, Measure::Area, Measure::Max] {
            for (r_z, r_c) in [(10.0, 1.0), (3.0, 1.0)] {
            let camera = Camera { eye_in_world: [20000.0, 6000.0, z], heading_rad: 0.3, pitch_rad: pitch.to_radians(), roll_rad: 0.0, vfov_rad: 60f64.to_radians(), width: 1280, height: 720, timestamp_nanos: 0 };
            let level = LevelFunction::new(&camera, &world, 1.0, measure, r_z, r_c);
            let mut traversal = Traversal::new(&world, TreeLimits { nodes: 65536, elevation_leaves: 4096 });
            let mut tree = vec![<TreeNode as bytemuck::Zeroable>::zeroed(); 65536];
            let mut best = f64::MAX;
            let mut stats = Default::default();
            for _ in 0..20 {
                let t = Instant::now();
                stats = traversal.build(&camera, &level, &ranges, &mut tree);
                best = best.min(t.elapsed().as_secs_f64());
            }
            let nodes = &tree[..stats.node_count as usize];
            let mut tiles = All { elevation: HashMap::new() };
            for n in nodes {
                let mut posts = vec![0.0; ((nz + 1) * (nz + 1)) as usize];
                let id = n.id().expect("id");
                terrain.read_elevation(id, &mut posts, &mut TileScratch::default()).expect("always");
                tiles.elevation.insert(id, posts);
            }
            let header = TreeHeader { camera, r_z_px: 10.0, r_c_px: 1.0, ..bytemuck::Zeroable::zeroed() };
            let mut frame_tree = FrameTree::new(&world, 65536, 4096);
            let mut maker = FrameMaker::new(&world, 65536);
            let mut buffer = FrameBuffer::new(4096, ((nz + 1) * (nz + 1)) as usize);
            let mut prep = f64::MAX;
            let mut counts = Default::default();
            for _ in 0..20 {
                let t = Instant::now();
                buffer.clear();
                frame_tree.read(nodes).expect("valid");
                counts = maker.make(&header, &level, &frame_tree, &tiles, 0, &mut buffer).expect("frame");
                prep = prep.min(t.elapsed().as_secs_f64());
            }
            let mut triangles = 0u64;
            let mut levels_used = [0u32; 10];
            for slot in buffer.slots() {
                if let Some(SlotContent::Tile(t)) = slot.read() {
                    triangles += 2 * u64::from(t.end[0] - t.start[0]) * u64::from(t.end[1] - t.start[1]);
                    levels_used[t.elevation_level as usize] += 1;
                }
            }
            let colors = frame_tree.wanted().iter().filter(|t| t.layer == terravision_common::database::Layer::Color).count();
            writeln!(out, "{name:18} {measure:?} r_z {r_z}: nodes {} arrays {} slots {} triangles {}k wanted colour {colors} | generate {:.3} ms prepare {:.3} ms ({:.1} us/array) {levels_used:?}", stats.node_count, counts.arrays, counts.tiles, triangles / 1000, best * 1e3, prep * 1e3, prep * 1e6 / f64::from(counts.arrays)).expect("stdout");
            }
        }
    }
}
