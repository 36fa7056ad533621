//! What the preparer's tests share: random cases, tiles that may be missing, and the mesh as the
//! renderer draws it.
#![allow(dead_code, unreachable_pub, reason = "each test binary uses a part")]

use proptest::prelude::*;
use std::collections::{HashMap, HashSet};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::database::{TileScratch, TileSource};
use terravision_common::ids::SlotKey;
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::node::NodeId;
use terravision_common::rig::{Rig, Views};
use terravision_common::slot::{SlotContent, TileSlot};
use terravision_common::synthetic::{Relief, SyntheticTerrain};
use terravision_common::traversal::{Traversal, TreeLimits};
use terravision_common::tree::{TreeHeader, TreeNode};
use terravision_common::world::{World, WorldFields};
use terravision_preparer::frame::{FrameBuffer, FrameMaker, FrameRequest};
use terravision_preparer::frame_tree::FrameTree;
use terravision_preparer::truncation::Tiles;
use terravision_testkit::worlds::fields;

pub mod flight;
pub mod server;

pub const NODES: u32 = 20_000;

pub fn world(extent: [u32; 2], levels: u8, finest: [u8; 2], nz: u32) -> World {
    World::new(WorldFields {
        levels,
        finest_elevation_level: finest[0],
        finest_color_level: finest[1],
        ..fields(extent, 10.0, [nz, 64])
    })
    .expect("valid")
}

/// One frame's input.
#[derive(Debug, Clone)]
pub struct Case {
    pub world: World,
    pub relief: Relief,
    pub camera: Camera,
    /// The views that the camera carries; none for the camera alone.
    pub rig: Option<Rig>,
    pub measure: Measure,
    pub r_px: [f64; 2],
    pub exaggeration: f64,
    /// Share of nodes whose tiles are missing, in 1/256.
    pub missing: u8,
    pub seed: u64,
}

pub fn case() -> impl Strategy<Value = Case> {
    let camera = (prop::array::uniform3(-0.2f64..1.2), prop::array::uniform3(-3.2f64..3.2), 0.1f64..2.5);
    let measure = prop_oneof![Just(Measure::Min), Just(Measure::Area), Just(Measure::Max)];
    let finest = prop_oneof![Just([0, 0]), Just([0, 2]), Just([2, 0]), Just([1, 0])];
    let shape = (prop::array::uniform2(1u32..600), finest, prop_oneof![Just(4u32), Just(8)]);
    let missing = prop_oneof![Just(0u8), Just(4), Just(25), Just(100), Just(200)];
    let relief = (any::<bool>(), 0.0f64..1500.0);
    let rest = (prop::array::uniform2(-1.0f64..7.0), 0.25f64..4.0, missing, any::<u64>(), relief);
    (shape, camera, measure, rest).prop_map(
        |((extent, finest, nz), (eye, angles, vfov_rad), measure, (r, exaggeration, missing, seed, relief))| {
            let world = world(extent, 9, finest, nz);
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
            let (is_static, height_m) = relief;
            let relief = if is_static { Relief::Static { height_m } } else { Relief::Mountains { height_m } };
            Case { world, relief, camera, rig: None, measure, r_px: r.map(f64::exp2), exaggeration, missing, seed }
        },
    )
}

impl Case {
    pub fn terrain(&self) -> SyntheticTerrain {
        SyntheticTerrain::new(&self.world, self.relief, self.seed)
    }

    pub fn level(&self) -> LevelFunction {
        let [r_z, r_c] = self.r_px;
        LevelFunction::for_views(&self.camera, &self.views(), &self.world, self.exaggeration, self.measure, r_z, r_c)
    }

    /// The views that are drawn.
    pub fn views(&self) -> Views {
        self.rig
            .as_ref()
            .map_or_else(|| Views::single(&self.camera), |rig| rig.views_from(&self.camera).expect("valid"))
    }

    /// The generator's tree.
    pub fn tree(&self) -> Vec<TreeNode> {
        let mut out = vec![bytemuck::Zeroable::zeroed(); NODES as usize];
        let mut traversal = Traversal::new(&self.world, TreeLimits { nodes: NODES, elevation_leaves: 2_000 });
        let stats = traversal.build(&self.views(), &self.level(), &self.terrain(), &mut out);
        out.truncate(stats.node_count as usize);
        out
    }

    pub fn header(&self, tree: &[TreeNode]) -> TreeHeader {
        TreeHeader {
            frame: 7,
            camera: *self.camera.fields(),
            r_z_px: self.r_px[0],
            r_c_px: self.r_px[1],
            node_count: tree.len() as u32,
            ..bytemuck::Zeroable::zeroed()
        }
    }

    /// Tiles of the tree's nodes, some of them missing, the root's never.
    pub fn tiles(&self, tree: &[TreeNode]) -> SomeTiles {
        let terrain = self.terrain();
        let mut tiles = SomeTiles { elevation: HashMap::new(), color: HashMap::new() };
        let posts = (self.world.elevation_posts() as usize).pow(2);
        for node in tree.iter().map(|n| n.id().expect("an id")) {
            let hash = |salt: u64| ((node.pack() ^ self.seed ^ salt).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56) as u8;
            let is_there = |salt| node == self.world.root() || hash(salt) >= self.missing;
            if self.world.has_color(node) && is_there(1) {
                tiles.color.insert(node, SlotKey::new(hash(3).into(), 1));
            }
            if self.world.has_elevation(node) && is_there(2) {
                let mut out = vec![0.0; posts];
                terrain.read_elevation(node, &mut out, &mut TileScratch::default()).expect("always");
                tiles.elevation.insert(node, out);
            }
        }
        tiles
    }

    /// The frame that the preparer makes of a tree, with nothing culled.
    pub fn frame(&self, tree: &[TreeNode], tiles: &SomeTiles) -> FrameBuffer {
        self.frame_of(FrameMaker::new(&self.world, NODES).with_whole_blocks(), tree, tiles)
    }

    /// The frame that a maker makes of a tree.
    pub fn frame_of(&self, mut maker: FrameMaker, tree: &[TreeNode], tiles: &SomeTiles) -> FrameBuffer {
        let mut frame_tree = FrameTree::new(&self.world, NODES, NODES);
        frame_tree.read(tree).expect("a valid tree");
        let mut out = FrameBuffer::new(16, (self.world.elevation_posts() as usize).pow(2));
        let (header, views, level) = (self.header(tree), self.views(), self.level());
        let request = FrameRequest { header: &header, pose: &self.camera, views: &views, level: &level };
        maker.make(&request, &frame_tree, tiles, 0, &mut out).expect("a frame");
        out
    }
}

/// Tiles in memory.
#[derive(Debug, Clone)]
pub struct SomeTiles {
    pub elevation: HashMap<NodeId, Vec<f32>>,
    pub color: HashMap<NodeId, SlotKey>,
}

impl Tiles for SomeTiles {
    fn color(&self, node: NodeId) -> Option<SlotKey> {
        self.color.get(&node).copied()
    }

    fn elevation(&self, node: NodeId) -> Option<&[f32]> {
        self.elevation.get(&node).map(Vec::as_slice)
    }

    fn elevation_key(&self, node: NodeId) -> Option<SlotKey> {
        self.elevation.contains_key(&node).then(|| SlotKey::new(u32::from(node.q()), 1 + node.m()))
    }
}

/// A vertex: lattice coordinates, and the bits of its height.
pub type Vertex = (u64, u64, u32);

/// The mesh, as the renderer draws the slots in a view: without those of which it sees nothing.
#[derive(Debug, Default)]
pub struct Mesh {
    pub triangles: Vec<[Vertex; 3]>,
    /// Colour leaves.
    pub leaves: HashSet<NodeId>,
}

pub fn tile_slots(frame: &FrameBuffer) -> Vec<TileSlot> {
    let slots = frame.slots().iter().map(|slot| slot.read().expect("a slot"));
    slots.filter_map(|slot| if let SlotContent::Tile(tile) = slot { Some(tile) } else { None }).collect()
}

impl Mesh {
    pub fn of(world: &World, frame: &FrameBuffer, view: usize) -> Mesh {
        let mut mesh = Mesh::default();
        for tile in tile_slots(frame).into_iter().filter(|tile| tile.may_be_seen_by(view)) {
            mesh.leaves.insert(tile.node().expect("an id"));
            let array = frame.array(tile.elevation_position).expect("an array");
            let last = world.elevation_tile();
            let vertex = |i: u32, j: u32| -> Vertex {
                let [west, east, south, north] = tile.edge_snap.map(|snap| !((1u32 << snap) - 1));
                let j = if i == 0 {
                    j & west
                } else if i == last {
                    j & east
                } else {
                    j
                };
                let i = if j == 0 {
                    i & south
                } else if j == last {
                    i & north
                } else {
                    i
                };
                let at = |axis: usize, index: u32| {
                    (u64::from(tile.elevation_origin[axis]) + (u64::from(index) << tile.elevation_level))
                        .min(world.extent()[axis].into())
                };
                (at(0, i), at(1, j), array[(j * (last + 1) + i) as usize].to_bits())
            };
            let step = 1 << tile.grid_snap;
            for j in (tile.start[1].into()..u32::from(tile.end[1])).step_by(step as usize) {
                for i in (tile.start[0].into()..u32::from(tile.end[0])).step_by(step as usize) {
                    let (e, n) = (i + step, j + step);
                    let [sw, se, nw, ne] = [vertex(i, j), vertex(e, j), vertex(i, n), vertex(e, n)];
                    mesh.triangles.extend([[sw, se, ne], [sw, ne, nw]].into_iter().filter(|t| area(t) != 0));
                }
            }
        }
        mesh
    }

    pub fn covers(&self, world: &World, x: u64, y: u64) -> bool {
        let nz = u64::from(world.elevation_tile());
        let finest = NodeId::new((x / nz) as u32, (y / nz) as u32, 0).expect("in range");
        (0..world.levels()).any(|q| self.leaves.contains(&finest.ancestor(q)))
    }

    /// What is wrong with it as a surface: a lattice point with two heights, an edge that two
    /// triangles do not share although both its sides are drawn, triangles that overlap or are
    /// turned over.
    pub fn defects(&self, world: &World) -> Vec<String> {
        let mut defects = vec![];
        let mut heights = HashMap::new();
        let mut edges = HashSet::new();
        for t in &self.triangles {
            if area(t) < 0 {
                defects.push(format!("{t:?} is turned over"));
            }
            for (x, y, z) in t {
                if let Some(other) = heights.insert((x, y), *z)
                    && other != *z
                {
                    defects.push(format!("({x}, {y}) is at {} and {}", f32::from_bits(*z), f32::from_bits(other)));
                }
            }
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                if !edges.insert((a, b)) {
                    defects.push(format!("two triangles lie on the same side of {a:?} {b:?}"));
                }
            }
        }
        for (a, b) in &edges {
            if edges.contains(&(*b, *a)) {
                continue;
            }
            // The outside is on the right. On a border of the terrain there is nothing; inside, a
            // border runs along an axis, and the lattice cell beyond its middle must not be drawn.
            let [w, h] = world.extent().map(u64::from);
            let (x, y) = (u64::midpoint(a.0, b.0), u64::midpoint(a.1, b.1));
            let outside = if a.1 == b.1 {
                if b.0 > a.0 { y.checked_sub(1).map(|y| (x, y)) } else { (y < h).then_some((x, y)) }
            } else if a.0 == b.0 {
                if b.1 > a.1 { (x < w).then_some((x, y)) } else { x.checked_sub(1).map(|x| (x, y)) }
            } else {
                defects.push(format!("edge {a:?} {b:?} inside of a tile has one triangle"));
                continue;
            };
            if let Some((x, y)) = outside
                && self.covers(world, x, y)
            {
                defects.push(format!("edge {a:?} {b:?} has one triangle, but beyond it is terrain"));
            }
        }
        defects
    }
}

/// Twice the area on the map, positive when counterclockwise.
fn area([a, b, c]: &[Vertex; 3]) -> i64 {
    let d = |p: &Vertex| (p.0 as i64 - a.0 as i64, p.1 as i64 - a.1 as i64);
    let ((bx, by), (cx, cy)) = (d(b), d(c));
    bx * cy - by * cx
}
