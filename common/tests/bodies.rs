//! Worlds that are whole bodies: their fields, nodes, manifest and height ranges.

mod support;

use std::collections::HashSet;
use terravision_common::database::{
    FEATURE_BODY, Layer, MANIFEST_FILE, Manifest, ManifestError, NodeRanges, tile_coord,
};
use terravision_common::node::NodeId;
use terravision_common::world::{BodyGrid, World, WorldFields};

fn fields() -> WorldFields {
    let row_step_deg = 0.5;
    let semi_major_m = 1_737_400.0;
    WorldFields {
        origin: [-180.0, -90.0],
        // Three levels cut rows (180 rows to the equator, 32 cells): 2^3.
        lattice_unit_m: semi_major_m * f64::to_radians(row_step_deg) / 8.0,
        extent: [720, 361],
        elevation_tile: 32,
        color_tile: 64,
        levels: 7,
        finest_elevation_level: 0,
        finest_color_level: 3,
        body: Some(BodyGrid { semi_major_m, flattening: 0.0, west_deg: -180.0, first_row_deg: -89.75, row_step_deg }),
    }
}

fn nodes_of(world: &World, q: u8) -> Vec<NodeId> {
    let rows = 0..world.nodes_at(q)[1];
    rows.flat_map(|n| (0..world.columns_of_row(q, n)).filter_map(move |m| NodeId::new(m, n, q))).collect()
}

#[test]
fn a_body_has_the_nodes_of_its_lattice() {
    let world = World::new(fields()).unwrap();
    let globe = world.globe().unwrap();
    assert_eq!(globe.lattice().size(), [720, 361]);
    let mut level: HashSet<NodeId> = world.roots().collect();
    for q in (0..world.levels()).rev() {
        let nodes = nodes_of(&world, q);
        assert_eq!(nodes.iter().copied().collect::<HashSet<_>>(), level, "level {q}");
        assert_eq!(nodes.len() as u64, world.node_count(q));
        let coords: HashSet<u64> =
            nodes.iter().map(|node| pmtiles::TileId::from(tile_coord(&world, *node).unwrap()).value()).collect();
        assert_eq!(coords.len(), nodes.len(), "every node has a place of its own in an archive");
        for node in &nodes {
            assert!(world.has_elevation(*node) && world.has_color(*node) == (q >= 3));
            assert!(world.children(*node).all(|child| world.parent(child) == Some(*node)));
            assert!(world.ancestor(*node, world.levels() - 1).is_some_and(|root| world.parent(root).is_none()));
        }
        level = nodes.iter().flat_map(|node| world.children(*node)).collect();
    }
}

#[test]
fn numbers_that_make_no_body_are_refused() {
    let grid = fields().body.unwrap();
    let with = |change: fn(&mut BodyGrid)| {
        let mut grid = grid;
        change(&mut grid);
        WorldFields { body: Some(grid), ..fields() }
    };
    let bad = [
        ("body.semi_major_m", with(|g| g.semi_major_m = f64::NAN)),
        ("body.flattening", with(|g| g.flattening = 0.7)),
        ("body.west_deg", with(|g| g.west_deg = 1e9)),
        ("body.row_step_deg", with(|g| g.row_step_deg = 0.0)),
        ("body.first_row_deg", with(|g| g.first_row_deg = -89.0)),
        ("lattice_unit_m", WorldFields { lattice_unit_m: 1.0, ..fields() }),
        ("levels", WorldFields { levels: 8, ..fields() }),
        ("extent", WorldFields { extent: [60, 361], ..fields() }),
        ("origin", WorldFields { origin: [0.0, -90.0], ..fields() }),
        ("finest_elevation_level", WorldFields { finest_elevation_level: 1, ..fields() }),
        ("finest_color_level", WorldFields { finest_color_level: 2, ..fields() }),
    ];
    for (field, fields) in bad {
        let error = World::new(fields).unwrap_err().to_string();
        assert!(error.starts_with(&format!("{field} is ")), "{error}");
    }
}

#[test]
fn the_manifest_of_a_body_names_the_feature() {
    let folder = support::temporary("body-manifest");
    support::write_database(&folder);
    let text = std::fs::read_to_string(folder.join(MANIFEST_FILE)).unwrap();
    std::fs::remove_dir_all(&folder).unwrap();
    let mut manifest = Manifest::parse(&text).unwrap().fields().clone();
    let plane = manifest.to_text().unwrap();
    assert!(!plane.contains("\"west_deg\""));
    manifest.world = fields();
    assert!(matches!(Manifest::new(manifest.clone()), Err(ManifestError::Features { .. })));
    manifest.features.push(FEATURE_BODY.to_owned());
    let read = Manifest::parse(&manifest.to_text().unwrap()).unwrap();
    assert_eq!(read.world().fields().body, fields().body);
    assert_eq!(read.world().globe().unwrap().lattice().size(), [720, 361]);
    manifest.world = support::fields();
    assert!(matches!(Manifest::new(manifest), Err(ManifestError::Features { .. })));
}

#[test]
fn height_ranges_are_those_of_the_nodes_that_exist() {
    let world = World::new(fields()).unwrap();
    let ranges_of = |q: u8| nodes_of(&world, q).iter().map(|n| [n.m() as f32, 1000.0 + n.n() as f32]).collect();
    let levels: Vec<Vec<[f32; 2]>> = (0..world.levels()).map(ranges_of).collect();
    let ranges = NodeRanges::from_parts(&world, levels.clone()).unwrap();
    let folder = support::temporary("body-ranges");
    let path = folder.join("nodes.tvn");
    let record = ranges.write(&path).unwrap();
    assert_eq!(NodeRanges::read(&path, &world, &record, false).unwrap(), ranges);
    for q in 0..world.levels() {
        assert_eq!(ranges.nodes(q).collect::<Vec<_>>(), nodes_of(&world, q));
        for node in nodes_of(&world, q) {
            assert_eq!(ranges.range(node), Some([node.m() as f32, 1000.0 + node.n() as f32]));
            assert_eq!(ranges.has_children(Layer::Elevation, node), world.children(node).next().is_some());
        }
    }
    assert_eq!(ranges.range(NodeId::new(5, 0, 6).unwrap()), None);
    let mut short = levels.clone();
    short[3].pop();
    assert!(NodeRanges::from_parts(&world, short).is_err());
    let mut empty = levels;
    empty[3][7] = [1.0, 0.0];
    assert!(NodeRanges::from_parts(&world, empty).is_err());
    std::fs::write(&path, &std::fs::read(&path).unwrap()[..100]).unwrap();
    assert!(NodeRanges::read(&path, &world, &record, false).is_err());
    std::fs::remove_dir_all(&folder).unwrap();
}
