//! No cracks on bodies either: around the seam, over the poles, and where rows of nodes have different
//! numbers of columns. As on planes, every edge inside of the drawn area belongs to two triangles with
//! the same two vertices, bit for bit.

mod support;

use glam::DVec2;
use proptest::prelude::*;
use std::collections::{HashMap, HashSet};
use support::{NODES, SomeTiles, Vertex, tile_slots};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::ids::SlotKey;
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::node::NodeId;
use terravision_common::rig::Views;
use terravision_common::surface::globe::{Ellipsoid, Globe, GlobeLattice};
use terravision_common::traversal::{HeightRanges, Traversal, TreeLimits};
use terravision_common::tree::{TreeHeader, TreeNode};
use terravision_common::world::{BodyGrid, World, WorldFields};
use terravision_preparer::frame::{FrameBuffer, FrameMaker, FrameRequest};
use terravision_preparer::frame_tree::FrameTree;
use terravision_testkit::worlds::fields;

/// The highest ground, metres.
const HEIGHT_M: f32 = 4000.0;

#[derive(Debug)]
struct Case {
    world: World,
    camera: Camera,
    r_px: [f64; 2],
    /// Share of nodes whose tiles are missing, in 1/256.
    missing: u8,
    seed: u64,
}

/// Heights between these, whatever the node.
struct Everywhere(World);

impl HeightRanges for Everywhere {
    fn range(&self, node: NodeId) -> Option<[f32; 2]> {
        self.0.contains(node).then_some([0.0, HEIGHT_M])
    }
}

fn world() -> impl Strategy<Value = World> {
    let grid = (2u32..24, 0u32..9, 0usize..3, any::<bool>());
    grid.prop_filter_map("nodes are too wide", |(half, odd, body, is_centred)| {
        let (rows, cells) = (8 * half + odd, 8);
        let columns = 2 * rows - odd % 3;
        let lattice = GlobeLattice::new(columns, rows, cells)?;
        let body = [Ellipsoid::EARTH, Ellipsoid::MARS, Ellipsoid::new(1e5, 0.2)][body];
        let step = 180.0 / f64::from(rows - u32::from(is_centred));
        let first = if is_centred { 0.5 * step } else { step };
        let flattening = 1.0 - body.semi_minor_m() / body.semi_major_m();
        let grid = BodyGrid {
            semi_major_m: body.semi_major_m(),
            flattening,
            west_deg: -180.0,
            first_row_deg: first - 90.0,
            row_step_deg: step,
        };
        let rows_rad = [grid.first_row_deg, step].map(f64::to_radians);
        let globe = Globe::new(Ellipsoid::new(grid.semi_major_m, flattening), lattice, 0.0, rows_rad)?;
        let fields = WorldFields {
            origin: [-180.0, -90.0],
            levels: lattice.top() + 1,
            lattice_unit_m: globe.unit_m(),
            finest_color_level: lattice.rows_level(),
            body: Some(grid),
            ..fields([columns, rows], 1.0, [cells, 64])
        };
        World::new(fields).ok()
    })
}

fn case() -> impl Strategy<Value = Case> {
    let places = prop_oneof![
        2 => (-180.0f64..180.0, -90.0f64..90.0),
        1 => (179.9f64..180.0, -90.0f64..90.0),
        1 => (-180.0f64..180.0, 89.0f64..=90.0),
        1 => (-180.0f64..180.0, -90.0f64..=-89.0),
    ];
    let missing = prop_oneof![Just(0u8), Just(4), Just(25), Just(100), Just(200)];
    let view = (prop::array::uniform3(-3.1f64..3.1), 0.1f64..2.5, prop::array::uniform2(-1.0f64..7.0));
    (world(), places, 0.3f64..1.0, view, missing, any::<u64>()).prop_map(
        |(world, (longitude, latitude), above, (angles, vfov_rad, r), missing, seed)| {
            let radius = world.globe().expect("a body").body().semi_major_m();
            let height = f64::from(HEIGHT_M) + (3.0 * radius).powf(above);
            let camera = Camera::new(CameraFields {
                eye_in_world: [longitude, latitude, height],
                heading_rad: angles[0],
                pitch_rad: -0.6 + 0.4 * angles[1],
                roll_rad: 0.2 * angles[2],
                vfov_rad,
                width: 320,
                height: 200,
                timestamp_nanos: 0,
            })
            .expect("valid");
            Case { world, camera, r_px: r.map(f64::exp2), missing, seed }
        },
    )
}

fn hash(numbers: [u64; 4]) -> u64 {
    numbers.into_iter().fold(0x243f_6a88_85a3_08d3, |hash: u64, number| {
        let mixed = (hash ^ number).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        mixed ^ mixed >> 29
    })
}

impl Case {
    fn level(&self) -> LevelFunction {
        LevelFunction::new(&self.camera, &self.world, 1.0, Measure::Max, self.r_px[0], self.r_px[1])
    }

    fn tree(&self) -> Vec<TreeNode> {
        let mut out = vec![bytemuck::Zeroable::zeroed(); NODES as usize];
        let mut traversal = Traversal::new(&self.world, TreeLimits { nodes: NODES, elevation_leaves: 2_000 });
        let views = Views::single(&self.camera);
        let stats = traversal.build(&views, &self.level(), &Everywhere(self.world), &mut out);
        out.truncate(stats.node_count as usize);
        out
    }

    /// Every point of every level is at a height of its own.
    fn tiles(&self, tree: &[TreeNode]) -> SomeTiles {
        let (mut tiles, surface) =
            (SomeTiles { elevation: HashMap::new(), color: HashMap::new() }, self.world.surface());
        for node in tree.iter().map(|n| n.id().expect("an id")).filter(|node| self.world.contains(*node)) {
            let is_there = |salt: u64| {
                self.world.is_root(node) || (hash([node.pack(), self.seed, salt, 0]) >> 56) as u8 >= self.missing
            };
            if self.world.has_color(node) && is_there(1) {
                tiles.color.insert(node, SlotKey::new(1, 1));
            }
            if is_there(2) {
                let lines = surface.post_lines(node);
                let posts = 0..self.world.elevation_posts();
                let heights =
                    posts.clone().flat_map(|l| posts.clone().map(move |k| [lines[0].post(k), lines[1].post(l)]));
                let height = |at: [i64; 2]| {
                    let [x, y] = self.point(at.map(i64::cast_unsigned));
                    let share = (hash([self.seed, u64::from(node.q()), x, y]) >> 40) as f32 / (1u32 << 24) as f32;
                    (share * HEIGHT_M * 128.0).round() / 128.0
                };
                tiles.elevation.insert(node, heights.map(height).collect());
            }
        }
        tiles
    }

    /// The one name of a lattice point.
    fn point(&self, at: [u64; 2]) -> [u64; 2] {
        self.world.globe().expect("a body").lattice().canonical(at)
    }

    fn frame(&self, tree: &[TreeNode], tiles: &SomeTiles) -> FrameBuffer {
        let mut frame_tree = FrameTree::new(&self.world, NODES, NODES);
        frame_tree.read(tree).expect("a valid tree");
        let mut out = FrameBuffer::new(16, (self.world.elevation_posts() as usize).pow(2));
        let header = TreeHeader {
            frame: 7,
            camera: *self.camera.fields(),
            r_z_px: self.r_px[0],
            r_c_px: self.r_px[1],
            node_count: tree.len() as u32,
            ..bytemuck::Zeroable::zeroed()
        };
        let (views, level) = (Views::single(&self.camera), self.level());
        let request = FrameRequest { header: &header, pose: &self.camera, views: &views, level: &level };
        let mut maker = FrameMaker::new(&self.world, NODES).with_whole_blocks();
        maker.make(&request, &frame_tree, tiles, 0, &mut out).expect("a frame");
        out
    }
}

/// The mesh of a frame, as the renderer draws it, and the leaves that it is of.
fn mesh(case: &Case, frame: &FrameBuffer) -> (Vec<[Vertex; 3]>, HashSet<NodeId>) {
    let surface = case.world.surface();
    let (mut triangles, mut leaves) = (Vec::new(), HashSet::new());
    for tile in tile_slots(frame) {
        let node = tile.node().expect("an id");
        leaves.insert(node);
        let array = frame.array(tile.elevation_position).expect("an array");
        let leaf = surface.ancestor(node, tile.elevation_level);
        let lines = surface.post_lines(leaf);
        let last = case.world.elevation_tile();
        let vertex = |i: u32, j: u32| -> Vertex {
            let [west, east, south, north] = tile.edge_snap.map(|snap| !((1u32 << snap) - 1));
            // Posts beyond an edge of the ground are the edge's own.
            let [_, end, bottom, top] = surface.edge_posts(leaf);
            let i = if i >= end { last } else { i };
            let j = if j <= bottom {
                0
            } else if j >= top {
                last
            } else {
                j
            };
            let mut at = [i, j];
            let edges = [(i == 0, 1, west), (i == last, 1, east), (j == 0, 0, south), (j == last, 0, north)];
            for (_, axis, mask) in edges.into_iter().filter(|(is_on, ..)| *is_on) {
                at[axis] &= mask;
            }
            let [i, j] = at;
            let [x, y] = case.point([lines[0].post(i), lines[1].post(j)].map(i64::cast_unsigned));
            (x, y, array[(j * (last + 1) + i) as usize].to_bits())
        };
        let step = 1 << tile.grid_snap;
        for j in (tile.start[1].into()..u32::from(tile.end[1])).step_by(step as usize) {
            for i in (tile.start[0].into()..u32::from(tile.end[0])).step_by(step as usize) {
                let (e, n) = (i + step, j + step);
                let [sw, se, nw, ne] = [vertex(i, j), vertex(e, j), vertex(i, n), vertex(e, n)];
                let place = |v: &Vertex| (v.0, v.1);
                let is_flat = |t: &[Vertex; 3]| {
                    let [a, b, c] = [0, 1, 2].map(|k| place(&t[k]));
                    a == b || b == c || c == a
                };
                triangles.extend([[sw, se, ne], [sw, ne, nw]].into_iter().filter(|t| !is_flat(t)));
            }
        }
    }
    (triangles, leaves)
}

/// Whether a triangle is along a meridian. Beside a pole they fill the gaps between an edge that has
/// fewer vertices and the column of posts beside it.
fn is_wall(t: &[Vertex; 3], rows: u64) -> bool {
    let mut columns: Vec<u64> = t.iter().filter(|v| v.1 != 0 && v.1 != rows).map(|v| v.0).collect();
    columns.dedup();
    columns.len() < 2
}

fn defects(case: &Case, triangles: &[[Vertex; 3]], leaves: &HashSet<NodeId>) -> Vec<String> {
    let lattice = case.world.globe().expect("a body").lattice();
    let [columns, rows] = lattice.size().map(u64::from);
    let (mut defects, mut heights, mut edges) = (vec![], HashMap::new(), HashMap::<(Vertex, Vertex), [i32; 2]>::new());
    for t in triangles {
        for (x, y, z) in t {
            if let Some(other) = heights.insert((x, y), *z)
                && other != *z
            {
                defects.push(format!("({x}, {y}) is at {} and {}", f32::from_bits(*z), f32::from_bits(other)));
            }
        }
        for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
            let [whole, all] = edges.entry((a, b)).or_default();
            *all += 1;
            *whole += i32::from(!is_wall(t, rows));
            if *whole > 1 {
                defects.push(format!("two triangles lie on the same side of {a:?} {b:?}"));
            }
        }
    }
    let is_drawn = |x: f64, y: f64| {
        let x = x.rem_euclid(columns as f64);
        let finest = lattice.node_at(DVec2::new(x, y), 0).expect("a node");
        (finest.q()..=lattice.top()).any(|q| leaves.contains(&case.world.surface().ancestor(finest, q)))
    };
    let count = |a: &Vertex, b: &Vertex| edges.get(&(*a, *b)).map_or(0, |[_, all]| *all);
    for (a, b) in edges.keys() {
        if count(a, b) <= count(b, a) {
            continue;
        }
        // The way around that is shorter; the outside is on the right.
        let half = columns as f64 / 2.0;
        let across = (b.0 as f64 - a.0 as f64 + half).rem_euclid(columns as f64) - half;
        let (x, y) = (a.0 as f64 + 0.5 * across, 0.5 * (a.1 + b.1) as f64);
        let is_pole = |v: &Vertex| v.1 == 0 || v.1 == rows;
        let beyond = if a.1 == b.1 {
            (x, y + if across > 0.0 { -0.5 } else { 0.5 })
        } else if a.0 == b.0 || is_pole(a) || is_pole(b) {
            let column = if is_pole(a) { b.0 } else { a.0 } as f64;
            (column + if b.1 > a.1 { 0.5 } else { -0.5 }, y)
        } else {
            defects.push(format!("edge {a:?} {b:?} inside of a tile has one triangle"));
            continue;
        };
        if is_drawn(beyond.0, beyond.1) {
            defects.push(format!("edge {a:?} {b:?} has one triangle, but beyond it is terrain"));
        }
    }
    defects
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn a_body_is_one_surface_whatever_is_there_of_it(case in case()) {
        let tree = case.tree();
        let tiles = case.tiles(&tree);
        let frame = case.frame(&tree, &tiles);
        let (triangles, leaves) = mesh(&case, &frame);
        let defects = defects(&case, &triangles, &leaves);
        prop_assert!(
            defects.is_empty(),
            "{} defects in {} triangles:\n{}",
            defects.len(),
            triangles.len(),
            defects.iter().take(5).cloned().collect::<Vec<_>>().join("\n")
        );
        // Each leaf of the tree is drawn once, by itself or by one node above it.
        let surface = case.world.surface();
        for leaf in tree.iter().filter(|n| n.child_count == 0).map(|n| n.id().expect("an id")) {
            let drawn = (leaf.q()..case.world.levels()).filter(|q| leaves.contains(&surface.ancestor(leaf, *q))).count();
            prop_assert_eq!(drawn, 1, "leaf {}", leaf);
        }
    }
}
