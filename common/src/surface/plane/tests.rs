use super::*;
use crate::camera::{Camera, CameraFields};
use crate::node::NodeId;
use crate::surface::{LatticePoint, SIDES, VertexTerms};
use glam::DVec2;
use glam::Vec3;
use proptest::prelude::*;

const SIDE: u32 = 8;

fn plane() -> impl Strategy<Value = Plane> {
    (0.01f64..100.0, prop::array::uniform2(1u32..500)).prop_map(|(unit_m, extent)| Plane::new(unit_m, extent, SIDE))
}

/// A plane, and a node of it that some ground is in.
fn node() -> impl Strategy<Value = (Plane, NodeId)> {
    (plane(), 0u8..7, any::<[prop::sample::Index; 2]>()).prop_map(|(plane, q, at)| {
        let [columns, rows] = plane.nodes_at(q);
        (plane, NodeId::new(at[0].index(columns as usize) as u32, at[1].index(rows as usize) as u32, q).unwrap())
    })
}

fn camera(eye: [f64; 3], angles: [f64; 3]) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: eye,
        heading_rad: angles[0],
        pitch_rad: angles[1],
        roll_rad: angles[2],
        vfov_rad: 1.0,
        width: 320,
        height: 200,
        timestamp_nanos: 0,
    })
    .expect("valid")
}

proptest! {
    #[test]
    fn vertices_lie_in_the_bounds_of_their_node(
        (plane, node) in node(), i in 0usize..=8, j in 0usize..=8, share in 0.0f64..=1.0, heights: [i16; 2],
    ) {
        let [a, b] = heights.map(f64::from);
        let bounds = plane.node_bounds(node, [a, b]);
        let point = LatticePoint {
            x: plane.posts(node, 0).nth(i).unwrap(),
            y: plane.posts(node, 1).nth(j).unwrap(),
        };
        let vertex = plane.vertex(point, (a + share * (b - a)).clamp(a.min(b), a.max(b)));
        prop_assert!(vertex.cmpge(bounds.min).all() && vertex.cmple(bounds.max).all(), "{vertex} {bounds:?}");
        prop_assert!(plane.is_over(vertex));
        // What is over a foot is found again.
        prop_assert_eq!(plane.position(plane.foot(vertex), plane.height_m(vertex)), vertex);
        prop_assert_eq!(plane.height_above(vertex + 2.0 * plane.up(vertex), vertex.z), 2.0);
    }

    #[test]
    fn both_leaves_at_an_edge_name_its_vertices_alike((plane, node) in node(), k in 0usize..=8) {
        for (side, (east, north)) in SIDES.into_iter().enumerate() {
            let Some(beside) = plane.neighbor(node, east, north) else { continue };
            prop_assert_eq!(plane.neighbor(beside, -east, -north), Some(node));
            let (axis, own, other) = (side / 2, if side % 2 == 0 { 0 } else { 8 }, if side % 2 == 0 { 8 } else { 0 });
            let at = |node, axis, k| plane.posts(node, axis).nth(k).unwrap();
            prop_assert_eq!(at(node, axis, own), at(beside, axis, other));
            prop_assert_eq!(at(node, 1 - axis, k), at(beside, 1 - axis, k));
        }
    }

    #[test]
    fn a_foot_is_in_its_node((plane, node) in node(), share in prop::array::uniform2(0.0f64..1.0)) {
        let bounds = plane.node_bounds(node, [0.0; 2]);
        let size = bounds.max - bounds.min;
        let foot = plane.foot(bounds.min + size * DVec2::from_array(share).extend(0.0));
        prop_assert!(plane.holds(foot));
        let found = plane.node_at(foot, node.q()).unwrap();
        // Rounding may take a foot on an edge to the other side of it.
        prop_assert!(found == node || share.iter().any(|s| !(1e-9..1.0 - 1e-9).contains(s)), "{found} {node}");
        let place = plane.place_in_node(foot, node);
        prop_assert!(place.cmpge(DVec2::splat(-1e-9)).all() && place.cmple(DVec2::splat(8.0 + 1e-9)).all());
        let again = plane.foot_of_lattice(plane.lattice_of_foot(foot));
        prop_assert!((again - foot).abs().max_element() <= 1e-9 * foot.max_element());
    }

    #[test]
    fn children_come_near_to_far((plane, node) in node(), eye in prop::array::uniform3(-1e4f64..6e4)) {
        prop_assume!(node.q() > 0);
        let eye = DVec3::from_array(eye);
        let order = plane.near_to_far(node, eye);
        let mut seen = order;
        seen.sort_unstable();
        prop_assert_eq!(seen, [0, 1, 2, 3]);
        // Without the clipping of the extent: of whole squares.
        let whole = Plane::new(plane.unit_m(), [u32::MAX; 2], SIDE);
        let distance = |index: u8| {
            let bounds = whole.node_bounds(node.child(index).unwrap(), [eye.z; 2]);
            bounds.seen_from(eye).nearest().length()
        };
        let distances = order.map(distance);
        prop_assert!(distances.is_sorted_by(|a, b| a <= &(b + 1e-9)), "{distances:?}");
    }

    #[test]
    fn rows_and_columns_make_the_vertices_that_the_eye_sees(
        (plane, node) in node(), eye in prop::array::uniform3(-500f64..500.0), angles in prop::array::uniform3(-3.0f64..3.0),
        heights in prop::collection::vec(-100f64..100.0, 81),
    ) {
        let camera = camera(eye, angles);
        let forward = camera.axes_in_world()[2];
        let frame = plane.seen_by(camera.eye(), forward);
        let lattice = [0, 1].map(|axis| plane.posts(node, axis).take(9).collect::<Vec<u64>>());
        let columns: Vec<f32> = lattice[0].iter().map(|x| frame.column_from_eye(plane.column(*x))).collect();
        let rows: Vec<f32> = lattice[1].iter().map(|y| frame.row_from_eye(plane.row(*y))).collect();
        let from_eye: Vec<f32> = heights.iter().map(|z| frame.height_from_eye(*z)).collect();
        let terms = VertexTerms::of_plane(columns.clone(), rows.clone());
        let vertices = terms.with_heights(&from_eye);
        let bound = frame.bound(&plane.node_bounds(node, [-100.0, 100.0]));
        for j in 0..9 {
            let mut row = Vec::new();
            vertices.for_row(j, |i, vertex| row.push((i, vertex)));
            for (i, vertex) in row {
                let point = LatticePoint { x: lattice[0][i], y: lattice[1][j] };
                let exact = plane.vertex(point, heights[9 * j + i]);
                prop_assert_eq!(vertex, vertices.at(i, j));
                prop_assert_eq!(vertex, frame.from_eye(exact));
                let sight = frame.sight(frame.row(plane.row(point.y)), plane.column(point.x), exact.z);
                let way = exact - frame.eye();
                prop_assert!((sight.depth - way.dot(forward)).abs() < 1e-7);
                prop_assert!((sight.distance2 - way.length_squared()).abs() <= 1e-9 * (1.0 + sight.distance2));
                prop_assert!(bound.depth <= sight.depth + 1e-7 && bound.distance2 <= sight.distance2);
                prop_assert!(bound.horizontal2 <= sight.horizontal2 && bound.vertical2 >= sight.vertical2);
            }
        }
        let [low, high] = [vertices.level_corners()[0], vertices.level_corners()[3]];
        prop_assert_eq!((low, high), (Vec3::new(columns[0], rows[0], 0.0), Vec3::new(columns[8], rows[8], 0.0)));
    }

    #[test]
    fn an_eye_is_in_its_cell(plane in plane(), eye in prop::array::uniform3(-1e5f64..1e5)) {
        let cell = plane.eye_cell(DVec3::from_array(eye));
        for ((eye, corner), within) in eye.iter().zip(cell.corner).zip(cell.eye_m) {
            let again = corner as f64 * plane.unit_m() + f64::from(within);
            prop_assert!((again - eye).abs() < 1e-4 && (0.0..=plane.unit_m() as f32 + 1e-4).contains(&within));
        }
        prop_assert_eq!(i64::from(cell.count(0, 0)), -cell.corner[0]);
    }
}

#[test]
fn cells_past_the_extent_are_none_and_one_that_it_cuts_counts() {
    let plane = Plane::new(10.0, [20, 13], SIDE);
    assert_eq!(plane.cells_inside([16, 8], 0), [Some(4), Some(5)]);
    assert_eq!(plane.cells_inside([16, 8], 2), [Some(1), Some(2)]);
    assert_eq!(plane.cells_inside([20, 16], 1), [Some(0), None]);
    assert_eq!((plane.canonical(0, 24), plane.canonical(1, 12)), (20, 12));
}

#[test]
fn an_eye_on_the_border_is_over_the_world_and_one_beyond_it_is_not() {
    let plane = Plane::new(10.0, [20, 13], SIDE);
    for (eye, is_over) in [
        ([0.0, 0.0, -5.0], true),
        ([200.0, 130.0, 1e6], true),
        ([200.1, 0.0, 0.0], false),
        ([0.0, -0.1, 0.0], false),
        ([f64::NAN, 0.0, 0.0], false),
    ] {
        assert_eq!(plane.is_over(DVec3::from_array(eye)), is_over, "{eye:?}");
    }
    assert_eq!(plane.lattice_under(DVec3::new(-7.0, 25.0, 3.0)), LatticePoint { x: 0, y: 2 });
    let border = plane.node_bounds(NodeId::new(2, 0, 0).unwrap(), [0.0, 1.0]);
    assert!(plane.reaches_border(&border) && border.max.x == 200.0);
    assert!(
        !Plane::new(10.0, [40, 40], SIDE)
            .reaches_border(&Plane::new(10.0, [40, 40], SIDE).node_bounds(NodeId::new(1, 1, 0).unwrap(), [0.0; 2]))
    );
}
