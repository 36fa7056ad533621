//! Nothing pops (design §5): while the camera moves a little, the drawn surface moves a little,
//! also where a node is split or merged between two frames.

mod support;

use std::collections::HashSet;
use support::{Case, Mesh, Vertex};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::level::Measure;
use terravision_common::node::NodeId;
use terravision_common::surface::LatticePoint;
use terravision_common::synthetic::Relief;
use terravision_preparer::heights::vertex_height;

const FRAMES: u32 = 75;
const STEP_M: f64 = 8.0;

fn case(k: u32) -> Case {
    let at = STEP_M * f64::from(k);
    Case {
        world: support::world([1000, 1000], 8, [0, 2], 8),
        relief: Relief::Mountains { height_m: 1800.0 },
        camera: Camera::new(CameraFields {
            eye_in_world: [2500.0 + at, 500.0 + 0.7 * at, 2300.0 - 0.4 * at],
            heading_rad: 0.5,
            pitch_rad: -0.35,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 640,
            height: 400,
            timestamp_nanos: 0,
        })
        .expect("valid"),
        rig: None,
        measure: Measure::Area,
        r_px: [10.0, 2.0],
        exaggeration: 1.0,
        missing: 0,
        seed: 11,
    }
}

/// Height of the mesh above a point, metres.
fn height_at(mesh: &Mesh, eye_z: f64, x: f64, y: f64) -> Option<f64> {
    mesh.triangles.iter().find_map(|triangle| {
        let [a, b, c] = triangle.map(|(x, y, z): Vertex| [x as f64, y as f64, f64::from(f32::from_bits(z))]);
        let area = |p: [f64; 3], q: [f64; 3]| (p[0] - x) * (q[1] - y) - (p[1] - y) * (q[0] - x);
        let (wa, wb, wc) = (area(b, c), area(c, a), area(a, b));
        let is_inside = wa >= 0.0 && wb >= 0.0 && wc >= 0.0;
        is_inside.then(|| eye_z + (wa * a[2] + wb * b[2] + wc * c[2]) / (wa + wb + wc))
    })
}

#[test]
fn the_surface_moves_no_faster_than_the_camera_lets_it() {
    // Points in view all the way, off the lattice of every level.
    let points: Vec<[f64; 2]> = (0..60u32)
        .map(|i| [350.0 + f64::from(i % 8) * 40.13 + f64::from(i) * 1.71, 250.0 + f64::from(i / 8) * 60.37])
        .collect();
    let mut last: Option<(Vec<Option<f64>>, HashSet<NodeId>)> = None;
    let (mut worst_px, mut worst_total_px, mut changes) = (0f64, 0f64, 0);
    let mut first: Vec<Option<f64>> = vec![];
    for k in 0..FRAMES {
        let case = case(k);
        let tree = case.tree();
        let mesh = Mesh::of(&case.world, &case.frame(&tree, &case.tiles(&tree)), 0);
        let eye = case.camera.eye();
        let heights: Vec<Option<f64>> = points.iter().map(|[x, y]| height_at(&mesh, eye.z, *x, *y)).collect();
        let px = |i: usize, dz: f64| {
            let [x, y] = points[i];
            let distance = (glam::DVec3::new(10.0 * x, 10.0 * y, heights[i].unwrap_or(0.0)) - eye).length();
            dz.abs() * case.camera.focal_px() / distance
        };
        if let Some((before, leaves)) = &last {
            changes += u32::from(*leaves != mesh.leaves);
            for (i, (a, b)) in before.iter().zip(&heights).enumerate() {
                if let (Some(a), Some(b)) = (a, b) {
                    worst_px = worst_px.max(px(i, b - a));
                }
            }
            for (i, (a, b)) in first.iter().zip(&heights).enumerate() {
                if let (Some(a), Some(b)) = (a, b) {
                    worst_total_px = worst_total_px.max(px(i, b - a));
                }
            }
        } else {
            first.clone_from(&heights);
        }
        last = Some((heights, mesh.leaves));
    }
    println!("worst step {worst_px:.3} px, over all {worst_total_px:.2} px, {changes} trees of {FRAMES} differ");
    assert!(changes > 30, "the path splits and merges nodes, found {changes} changes");
    // Over the flight the surface moves by much more than in any step: without morphing a split
    // would show it at once.
    assert!(worst_total_px > 0.5, "the path changes the surface, found {worst_total_px} px");
    // A step of 8 m at some 2 km is 0.006 levels. At a split the levels between old vertices were
    // interpolated and are now taken at new ones: level and height both vary over a facet of 10 px,
    // by little. Measured: 0.11 px.
    assert!(worst_px < 0.2, "the surface jumped by {worst_px} px");
}

#[test]
fn a_vertex_moves_continuously_while_its_leaf_is_the_same() {
    let world = support::world([1000, 1000], 8, [0, 2], 8);
    let node = NodeId::new(60, 60, 0).expect("in range");
    let path: Vec<_> = (0..8).map(|q| TreePath::node(node.ancestor(q))).collect();
    let tiles = case(0).tiles(&path);
    let point = LatticePoint { x: 485, y: 483 };
    let height = |z: f64| {
        let mut case = case(0);
        let eye_in_world = [4850.0, 4830.0 - 3000.0, z];
        case.camera = Camera::new(CameraFields { eye_in_world, ..*case.camera.fields() }).expect("valid");
        let relative = vertex_height(&world, &case.level(), &tiles, node, point, 0).expect("resident");
        f64::from(relative) + z
    };
    // From 3 km to 30 km: L runs over more than three levels, through each of them.
    let steps = 20_000;
    let at = |k: u32| height(3000.0 * 10f64.powf(f64::from(k) / f64::from(steps)));
    let (mut last, mut worst) = (at(0), 0f64);
    for k in 1..=steps {
        let z = at(k);
        worst = worst.max((z - last).abs());
        last = z;
    }
    // 3.3 levels in 20 000 steps, at most 600 m between levels, and the rounding to f32 at 30 km.
    assert!(worst < 0.2, "a vertex jumped by {worst} m");
    assert!((at(0) - last).abs() > 1.0);
}

/// Nodes as a tree's, for the tiles of a path.
struct TreePath;

impl TreePath {
    fn node(id: NodeId) -> terravision_common::tree::TreeNode {
        terravision_common::tree::TreeNode { node: id.pack(), ..bytemuck::Zeroable::zeroed() }
    }
}
