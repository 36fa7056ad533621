use super::*;
use crate::node::NodeId;
use glam::DVec3;
use proptest::prelude::*;
use std::collections::BTreeSet;

const BODIES: [Ellipsoid; 4] =
    [Ellipsoid::EARTH, Ellipsoid::MARS, Ellipsoid::MOON, Ellipsoid::new(3_396_190.0, 1.0 / 169.894)];
const SIDES: [(Side, Side); 4] =
    [(Side::West, Side::East), (Side::East, Side::West), (Side::South, Side::North), (Side::North, Side::South)];

fn body() -> impl Strategy<Value = Ellipsoid> {
    (0..BODIES.len()).prop_map(|at| BODIES[at])
}

fn place() -> impl Strategy<Value = Geodetic> {
    let latitude = prop_oneof![4 => -90.0f64..=90.0, 1 => Just(90.0), 1 => Just(-90.0), 1 => 89.999..90.0];
    (-180.0f64..=180.0, latitude, -8e3f64..9e3).prop_map(|(longitude, latitude, height_m)| Geodetic {
        longitude: longitude.to_radians(),
        latitude: latitude.to_radians(),
        height_m,
    })
}

fn lattice() -> impl Strategy<Value = GlobeLattice> {
    let lattice = (2u32..400, 2u32..200, 0u32..4).prop_map(|(columns, rows, log)| (columns, rows, 1 << log));
    lattice.prop_filter_map("too few columns at the poles", |(columns, rows, cells)| {
        GlobeLattice::new(columns, rows, cells)
    })
}

/// All nodes of a level.
fn level(lattice: &GlobeLattice, q: u8) -> Vec<NodeId> {
    (q..lattice.top()).fold(lattice.roots().collect(), |nodes: Vec<NodeId>, _| {
        nodes.iter().flat_map(|node| lattice.children(*node)).collect()
    })
}

/// A lattice, and a node of it.
fn node() -> impl Strategy<Value = (GlobeLattice, NodeId)> {
    (lattice(), any::<prop::sample::Index>(), any::<prop::sample::Index>()).prop_map(|(lattice, q, at)| {
        let q = q.index(usize::from(lattice.top()) + 1) as u8;
        // There may be no row down to a level as fine.
        let nodes = (q..=lattice.top()).map(|q| level(&lattice, q)).find(|nodes| !nodes.is_empty()).unwrap_or_default();
        (lattice, nodes[at.index(nodes.len())])
    })
}

fn globe(body: Ellipsoid, lattice: GlobeLattice) -> Globe {
    let step = std::f64::consts::PI / f64::from(lattice.size()[1]);
    Globe::new(body, lattice, -std::f64::consts::PI, [step - FRAC_PI_2, step]).unwrap()
}

/// The posts of an edge, canonical, from the west or the south.
fn edge(lattice: &GlobeLattice, node: NodeId, side: Side) -> Vec<[u64; 2]> {
    let cells = lattice.cells();
    let post = |k: u32| match side {
        Side::West => [lattice.column_post(node, 0), lattice.row_post(node, k)],
        Side::East => [lattice.column_post(node, cells), lattice.row_post(node, k)],
        Side::South => [lattice.column_post(node, k), lattice.row_post(node, 0)],
        Side::North => [lattice.column_post(node, k), lattice.row_post(node, cells)],
    };
    (0..=cells).map(|k| lattice.canonical(post(k))).collect()
}

/// The vertex in double precision.
fn exact(eye: &Geodetic, body: &Ellipsoid, place: Geodetic) -> DVec3 {
    Ellipsoid::east_north_up(*eye).transpose() * (body.position(place) - body.position(*eye))
}

proptest! {
    #[test]
    fn a_position_has_one_place(body in body(), place in place(), up in 0.0f64..3e7) {
        for height_m in [place.height_m, up] {
            let place = Geodetic { height_m, ..place };
            let found = body.place(body.position(place));
            let apart = (body.position(found) - body.position(place)).length();
            prop_assert!(apart < 1e-7, "{place:?} {found:?}: {apart} m");
            prop_assert!((found.height_m - height_m).abs() < 1e-7, "{place:?} {found:?}");
        }
    }

    #[test]
    fn verticals_stand_on_the_ellipsoid(body in body(), place in place()) {
        let axes = Ellipsoid::east_north_up(place);
        prop_assert!((axes.determinant() - 1.0).abs() < 1e-12);
        let place = Geodetic { height_m: 0.0, ..place };
        let at = body.position(place);
        // Its points fulfil the ellipsoid's equation, whose gradient is the vertical.
        let [a, b] = [body.semi_major_m(), body.semi_minor_m()];
        let scaled = at / DVec3::new(a, a, b);
        prop_assert!((scaled.length() - 1.0).abs() < 1e-12);
        let gradient = (scaled / DVec3::new(a, a, b)).normalize();
        prop_assert!((gradient - axes.z_axis).length() < 1e-12, "{gradient} {}", axes.z_axis);
    }

    #[test]
    fn nodes_of_a_level_share_out_the_lattice(lattice in lattice(), q: prop::sample::Index, at in prop::array::uniform2(0.0f64..1.0)) {
        let q = q.index(usize::from(lattice.top()) + 1) as u8;
        // Rows that end above the level have their last nodes there.
        let last = (q..=lattice.rows_level()).flat_map(|q| level(&lattice, q)).filter(|node| node.q() > q && lattice.children(*node).next().is_none());
        let nodes: Vec<NodeId> = level(&lattice, q).into_iter().chain(last).collect();
        let [columns, rows] = lattice.size().map(u64::from);
        let spans: Vec<_> = nodes.iter().map(|node| lattice.span(*node)).collect();
        let cells: u64 = spans.iter().map(|[c, r]| (c.end - c.start) * (r.end - r.start)).sum();
        prop_assert_eq!(cells, columns * rows);
        let cell = [(at[0] * columns as f64) as u64, (at[1] * rows as f64) as u64];
        let holding = spans.iter().filter(|[c, r]| c.contains(&cell[0]) && r.contains(&cell[1])).count();
        prop_assert_eq!(holding, 1);
        prop_assert!(nodes.iter().all(|node| lattice.contains(*node) && (node.q() == q || lattice.log_steps(*node) == [0, 0])));
        prop_assert_eq!(nodes.iter().collect::<BTreeSet<_>>().len(), nodes.len());
    }

    #[test]
    fn children_share_out_their_node((lattice, node) in node()) {
        let [columns, rows] = lattice.span(node);
        let mut cells = 0;
        for child in lattice.children(node) {
            prop_assert_eq!(lattice.parent(child), Some(node));
            let [c, r] = lattice.span(child);
            prop_assert!(columns.start <= c.start && c.end <= columns.end && rows.start <= r.start && r.end <= rows.end);
            prop_assert!(c.start < c.end && r.start < r.end);
            cells += (c.end - c.start) * (r.end - r.start);
            // Posts of the node between those of its children are among theirs.
            let [own, finer] = [lattice.log_steps(node), lattice.log_steps(child)];
            prop_assert!(finer[0] <= own[0] && finer[0] + 1 >= own[0]);
            let is_cut = match node.q() > lattice.rows_level() {
                true => finer[1] + 1 == own[1],
                false => finer[1] == 0 && finer[0] + 1 == own[0],
            };
            prop_assert!(is_cut);
        }
        prop_assert_eq!(cells == 0, lattice.log_steps(node) == [0, 0]);
        if cells > 0 {
            prop_assert_eq!(cells, (columns.end - columns.start) * (rows.end - rows.start));
        }
    }

    #[test]
    fn neighbors_are_each_others_and_name_their_edge_alike((lattice, node) in node()) {
        for (side, back) in SIDES {
            let own = edge(&lattice, node, side);
            let beside: Vec<NodeId> = lattice.neighbors(node, side).collect();
            let is_at_pole = own.iter().all(|[_, row]| *row == 0 || *row == u64::from(lattice.size()[1]));
            prop_assert_eq!(beside.is_empty(), is_at_pole && matches!(side, Side::South | Side::North));
            for other in beside {
                prop_assert!(lattice.contains(other), "{node} {side:?} {other}");
                if other.q() == node.q() {
                    prop_assert!(lattice.neighbors(other, back).any(|n| n == node), "{node} {side:?} {other}");
                } else {
                    prop_assert!(other.q() == node.q() + 1 && lattice.children(other).next().is_none());
                }
                let theirs = edge(&lattice, other, back);
                if matches!(side, Side::West | Side::East) {
                    prop_assert_eq!(&theirs, &own);
                    continue;
                }
                // Along a row one of the two may have every second post of the other; those that
                // lie within both are named by both.
                let [wide, fine] = if lattice.log_steps(node)[0] >= lattice.log_steps(other)[0] { [&own, &theirs] } else { [&theirs, &own] };
                let ([a, b], width) = ([lattice.span(node)[0].clone(), lattice.span(other)[0].clone()], u64::from(lattice.size()[0]));
                let within = a.start.max(b.start)..=a.end.min(b.end);
                let is_within = |column: u64| within.contains(&column) || column == 0 && within.contains(&width);
                for point in wide.iter().filter(|[column, _]| is_within(*column)) {
                    prop_assert!(fine.contains(point), "{node} {side:?} {other}: {point:?} of {wide:?} not in {fine:?}");
                }
                prop_assert!(fine.iter().all(|[_, row]| *row == wide[0][1]));
            }
        }
    }

    #[test]
    fn vertices_are_as_exact_as_single_precision(
        body in body(), eye in place(), above in 2.0f64..1e7, place in place(), near in prop::array::uniform2(-1.0f64..1.0), log in -7.0f64..0.0,
    ) {
        let eye = Geodetic { height_m: eye.height_m + above, ..eye };
        let sees = GlobeEye::new(body, eye);
        // Anywhere, and beside the eye.
        let beside = Geodetic {
            longitude: eye.longitude + near[0] * 10f64.powf(log),
            latitude: (eye.latitude + near[1] * 10f64.powf(log)).clamp(-FRAC_PI_2, FRAC_PI_2),
            ..place
        };
        for place in [place, beside] {
            let found = sees.vertex(sees.column(place.longitude), sees.row(place.latitude), place.height_m as f32);
            let exact = exact(&eye, &body, place);
            // Heights are rounded first: half a millimetre of 8 km.
            let apart = (found.as_dvec3() - exact).length();
            let most = 1.2e-3 * (place.height_m.abs().max(eye.height_m.abs()) / 8192.0).max(0.1) + 5e-7 * exact.length();
            prop_assert!(apart <= most, "{eye:?} {place:?}: {apart} m of {}", exact.length());
        }
    }

    #[test]
    fn a_node_lies_in_its_ball_and_hidden_is_hidden(
        (lattice, node) in node(), body in body(), heights in prop::array::uniform2(-8e3f64..9e3), shares in prop::array::uniform3(0.0f64..=1.0), eye in place(), log in 0.3f64..7.5,
    ) {
        let globe = globe(body, lattice);
        let ball = GlobeBounds::new(&globe, node, heights);
        let [columns, rows] = lattice.span(node);
        let between = |a: f64, b: f64, share: f64| a + share * (b - a);
        let longitude = between(globe.longitude(columns.start), globe.longitude(columns.end), shares[0]);
        let latitude = between(globe.latitude(rows.start), globe.latitude(rows.end), shares[1]);
        let ground = body.position(Geodetic { longitude, latitude, height_m: between(heights[0], heights[1], shares[2]) });
        let local = ball.axes.transpose() * (ground - ball.middle);
        prop_assert!(local.cmpge(ball.low).all() && local.cmple(ball.high).all(), "{local} {ball:?}");
        let place = Geodetic { height_m: 9e3 + 10f64.powf(log), ..eye };
        let eye = body.position(place);
        let distance_m = ball.distance_m(eye, place.height_m);
        prop_assert!(distance_m <= (ground - eye).length() * (1.0 + 1e-9) + 1e-6);
        // Posts are no farther apart than their node's nominal ones, as far as they are seen to be.
        let from_axis = ground.truncate().length();
        if let Some(widest) = ball.cut_by_columns {
            let seen = (from_axis - 1e4) / (ground - eye).length();
            prop_assert!(seen <= widest * ball.narrowing(eye, distance_m) / distance_m.max(1e-3) * (1.0 + 1e-6));
        }
        if ball.is_behind_limb(&body, eye, -8e3) {
            // The line of sight passes through the ball that all ground is around.
            let way = ground - eye;
            let nearest = eye + way * (-eye.dot(way) / way.length_squared()).clamp(0.0, 1.0);
            prop_assert!(nearest.length() < body.semi_minor_m() - 8e3 + 1e-3);
        }
    }
}

#[test]
fn places_are_those_of_the_textbook() {
    // A well-known point: 45 degrees north on the meridian of Greenwich.
    let at = Ellipsoid::EARTH.position(Geodetic { longitude: 0.0, latitude: 45f64.to_radians(), height_m: 0.0 });
    assert!((at - DVec3::new(4_517_590.878_8, 0.0, 4_487_348.408_9)).length() < 1e-3, "{at}");
    assert!((Ellipsoid::EARTH.semi_minor_m() - 6_356_752.314_245).abs() < 1e-6);
}

#[test]
fn poles_and_seam_are_single_points() {
    let lattice = GlobeLattice::new(48, 24, 4).unwrap();
    assert_eq!((lattice.rows_level(), lattice.top()), (2, 4));
    let globe = globe(Ellipsoid::MARS, lattice);
    let eye = GlobeEye::new(Ellipsoid::MARS, Geodetic { longitude: 0.3, latitude: 1.2, height_m: 500.0 });
    let at = |point: [u64; 2]| eye.lattice_vertex(&globe, point, 120.0);
    for row in 0..=24 {
        assert_eq!(at([48, row]), at([0, row]));
        assert_eq!(at([row, 0]), at([0, 0]));
        assert_eq!(at([row, 24]), at([7, 24]));
    }
    assert_ne!(at([1, 1]), at([0, 1]));
    // Three columns of polar nodes at all levels, the rows beside them twice as many, and so on.
    let columns = |q: u8, n: u32| level(&lattice, q).iter().filter(|node| node.n() == n).count();
    assert_eq!([columns(4, 0), columns(3, 0), columns(2, 0)], [3, 3, 3]);
    assert_eq!([columns(3, 1), columns(2, 1), columns(2, 2)], [6, 6, 12]);
    // And below, where rows end, down to the lattice's own columns, each row by itself.
    assert_eq!([columns(1, 0), columns(0, 0), columns(1, 1), columns(0, 1), columns(1, 2)], [6, 12, 12, 0, 0]);
}

#[test]
fn grids_that_are_too_small_or_out_of_order_are_none() {
    for (columns, rows, cells) in [(48, 1, 4), (48, 24, 3), (0, 24, 4), (8, 24, 4), (u32::MAX, u32::MAX, 1)] {
        assert_eq!(GlobeLattice::new(columns, rows, cells), None, "{columns} x {rows}, {cells}");
    }
    let lattice = GlobeLattice::new(48, 24, 4).unwrap();
    for rows in [[-1.0, 0.2], [-1.5, -0.1], [-1.6, 0.1], [f64::NAN, 0.1]] {
        assert_eq!(Globe::new(Ellipsoid::MOON, lattice, 0.0, rows), None, "{rows:?}");
    }
}

/// Leaves that a view asks for which sees all around: nodes are split while their posts are more than
/// 10 pixels apart, 623 pixels being as wide as they are far away.
fn leaves(globe: &Globe, eye: Geodetic, culls: bool) -> usize {
    let position = globe.body().position(eye);
    let mut nodes: Vec<NodeId> = globe.lattice().roots().collect();
    let mut count = 0;
    while let Some(node) = nodes.pop() {
        let ball = GlobeBounds::new(globe, node, [0.0; 2]);
        if culls && ball.is_behind_limb(globe.body(), position, 0.0) {
            continue;
        }
        let distance_m = ball.distance_m(position, eye.height_m);
        let spacing_m = globe.unit_m() * f64::from(1u32 << node.q()) * ball.narrowing(position, distance_m);
        let mut children = globe.lattice().children(node).peekable();
        if children.peek().is_some() && spacing_m > 10.0 / 623.0 * distance_m {
            nodes.extend(children);
        } else {
            count += 1;
        }
    }
    count
}

#[test]
fn a_pole_takes_no_more_leaves_than_other_places() {
    // MOLA at 128 samples a degree.
    let globe = globe(Ellipsoid::MARS, GlobeLattice::new(46_080, 23_040, 64).unwrap());
    for latitude in [-90.0, -89.0, 0.0, 45.0, 90.0f64] {
        for height_m in [10.0, 1e3, 1e5, 1e7] {
            let place = Geodetic { longitude: 0.4, latitude: latitude.to_radians(), height_m };
            let (all, seen) = (leaves(&globe, place, false), leaves(&globe, place, true));
            assert!(
                seen <= all && all <= 300,
                "{latitude} degrees, {height_m} m: {all} leaves, {seen} before the limb"
            );
        }
    }
}
