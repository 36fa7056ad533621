//! Databases of whole bodies, from rasters over longitude and latitude.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use std::collections::HashMap;
use std::path::PathBuf;
use support::{TestFolder, Tiff, error_line, job, program, run};
use terravision_common::database::{Database, Layer, TileScratch, TileSource, color_tile_bytes};
use terravision_common::node::NodeId;
use terravision_common::surface::globe::{Ellipsoid, Geodetic};
use terravision_common::world::{COLOR_BORDER, World};
use terravision_ingest::body::BodyChoice;
use terravision_ingest::job::Job;
use terravision_ingest::source::Note;

const MOON: &str = "+proj=longlat +R=1737400 +no_defs";

fn rough(i: usize, j: usize) -> f32 {
    let hash = (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b);
    (hash.wrapping_mul(0xc2b2_ae35) >> 18) as f32 / 8.0
}

/// A grid of whole degrees times `step`, whose first pixel's middle is at these.
fn globe(size: [usize; 2], first: [f64; 2], step: f64, f: impl Fn(usize, usize) -> f32) -> Tiff<'static, f32> {
    let transform = Some([first[0] - 0.5 * step, step, 0.0, first[1] + 0.5 * step, 0.0, -step]);
    Tiff { transform, crs: Some(MOON), ..Tiff::utm(size, f) }
}

fn nodes(world: &World) -> Vec<NodeId> {
    let of_row = |q: u8, n: u32| (0..world.columns_of_row(q, n)).filter_map(move |m| NodeId::new(m, n, q));
    (0..world.levels()).flat_map(|q| (0..world.nodes_at(q)[1]).flat_map(move |n| of_row(q, n))).collect()
}

/// Heights of all posts of all levels, by level and canonical lattice point; nodes have to agree.
fn posts(database: &Database) -> HashMap<(u8, [u64; 2]), f32> {
    let world = database.world();
    let lattice = world.globe().unwrap().lattice();
    let mut all = HashMap::new();
    let (mut tile, mut scratch) = (vec![0.0; world.elevation_values()], TileScratch::default());
    for node in nodes(world) {
        database.read_elevation(node, &mut tile, &mut scratch).unwrap();
        let side = world.elevation_posts();
        for (at, height) in (0..side * side).zip(&tile) {
            let point = [lattice.column_post(node, at % side), lattice.row_post(node, at / side)];
            let other = all.entry((node.q(), lattice.canonical(point))).or_insert(*height);
            assert_eq!(other.to_bits(), height.to_bits(), "{node} and its neighbours differ at {point:?}");
        }
    }
    all
}

/// The posts of the finest level that each lattice row has.
fn finest(database: &Database) -> HashMap<[u64; 2], f32> {
    let world = database.world();
    let lattice = world.globe().unwrap().lattice();
    let all = posts(database);
    let leaves = nodes(world).into_iter().filter(|node| world.children(*node).next().is_none());
    let side = 0..=lattice.cells();
    leaves
        .flat_map(|node| side.clone().flat_map(move |l| (0..=lattice.cells()).map(move |k| (node, k, l))))
        .map(|(node, k, l)| lattice.canonical([lattice.column_post(node, k), lattice.row_post(node, l)]))
        .zip(std::iter::repeat(()))
        .collect::<HashMap<_, _>>()
        .into_keys()
        .map(|point| {
            let level = (0..world.levels()).find(|q| all.contains_key(&(*q, point))).unwrap();
            (point, all[&(level, point)])
        })
        .collect()
}

#[test]
fn samples_stay_where_the_source_has_them() {
    let folder = TestFolder::new();
    let cases = [
        ("areas", [180, 90], [-179.0, 89.0], [180, 91]),
        ("from0", [180, 90], [1.0, 89.0], [180, 91]),
        ("points", [180, 91], [-180.0, 90.0], [180, 90]),
        ("repeated", [181, 91], [-180.0, 90.0], [180, 90]),
    ];
    for (name, size, first, extent) in cases {
        let file = globe(size, first, 2.0, |i, j| rough(i % 180, j)).write(&folder.path(&format!("{name}.tif")));
        let (database, _) = run(&job(&[file], &[], folder.path(name))).unwrap();
        let world = database.world();
        assert_eq!(world.extent(), extent, "{name}");
        let west = world.fields().body.unwrap().west_deg;
        assert!((west - first[0]).abs() < 1e-9, "{name} begins at {west}");
        let finest = finest(&database);
        let last = u64::from(extent[1]);
        for column in 0..180u64 {
            for row in 1..last {
                let line = if size[1] == 91 { last - row } else { last - 1 - row };
                let place = world.globe().unwrap().place([column, row], 0.0);
                let latitude = first[1] - 2.0 * line as f64;
                assert!((place.latitude.to_degrees() - latitude).abs() < 1e-9, "{name}, row {row}");
                assert_eq!(finest[&[column, row]], rough(column as usize, line as usize), "{name} at {column}, {row}");
            }
        }
        assert!(finest.contains_key(&[0, 0]) && finest.contains_key(&[0, last]));
        assert!(database.manifest().fields().elevation.sources[0].is_exact);
    }
}

#[test]
fn every_run_and_any_number_of_threads_makes_the_same_bytes() {
    let folder = TestFolder::new();
    let file = globe([180, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("a.tif"));
    let bytes = |name: &str, threads: usize| {
        let output = folder.path(name).join("w.tv");
        std::fs::create_dir_all(folder.path(name)).unwrap();
        run(&Job { threads, ..job(std::slice::from_ref(&file), &[], output.clone()) }).unwrap();
        ["manifest.json", "elevation.pmtiles", "color.pmtiles", "nodes.tvn"]
            .map(|f| std::fs::read(output.join(f)).unwrap())
    };
    let one = bytes("one", 1);
    assert!(one == bytes("two", 2) && one == bytes("again", 2));
}

#[test]
fn ranges_bound_the_ground_of_all_levels() {
    let folder = TestFolder::new();
    let file = globe([180, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("a.tif"));
    let (database, _) = run(&job(&[file], &[], folder.path("w.tv"))).unwrap();
    let world = *database.world();
    let lattice = *world.globe().unwrap().lattice();
    let all = posts(&database);
    for node in nodes(&world) {
        let [low, high] = database.ranges().range(node).unwrap();
        let [columns, rows] = lattice.span(node);
        for ((_, [column, row]), height) in &all {
            if columns.contains(column) && rows.contains(row) && *row > 0 {
                assert!((low..=high).contains(height), "{node}: {height} at {column}, {row}, of {low} to {high}");
            }
        }
    }
}

/// A smooth picture of the sphere.
fn shade(longitude: f64, latitude: f64) -> [f64; 3] {
    let up = Ellipsoid::up(Geodetic { longitude, latitude, height_m: 0.0 });
    [up.x, up.y, up.z].map(|v| 127.0 + 100.0 * v)
}

#[test]
fn colours_lie_where_the_picture_has_them_all_around_and_beyond_the_poles() {
    let folder = TestFolder::new();
    let elevation = globe([180, 90], [-179.0, 89.0], 2.0, |_, _| 5.0).write(&folder.path("a.tif"));
    let size = [720, 360];
    let at = |c: usize| {
        move |i: usize, j: usize| {
            let (lon, lat) = (-180.0 + (i as f64 + 0.5) * 0.5, 90.0 - (j as f64 + 0.5) * 0.5);
            shade(lon.to_radians(), lat.to_radians())[c].round() as u8
        }
    };
    let band = |c: usize| Tiff::utm(size, at(c)).bands.remove(0);
    // Without any position: it is taken to cover the whole body.
    let picture = Tiff { transform: None, crs: None, bands: (0..3).map(band).collect(), ..Tiff::utm(size, at(0)) };
    let picture = picture.write(&folder.path("p.tif"));
    let (database, notes) = run(&job(&[elevation], &[picture], folder.path("w.tv"))).unwrap();
    assert!(notes.iter().any(|n| matches!(n, Note::Info(t) if t.contains("twice as wide as high"))), "{notes:?}");
    let world = *database.world();
    let globe = *world.globe().unwrap();
    let (stored, border) = (world.color_stored() as usize, f64::from(COLOR_BORDER));
    let (mut tile, mut scratch) = (vec![0; color_tile_bytes(&world)], TileScratch::default());
    let finest = world.finest_color_level();
    let mut checked = 0;
    for node in nodes(&world).into_iter().filter(|node| node.q() >= finest && node.q() < finest + 3) {
        assert!(database.ranges().has_tile(Layer::Color, node));
        database.read_color(node, &mut tile, &mut scratch).unwrap();
        let [width, height] = globe.lattice().log_steps(node).map(|log| f64::from(globe.lattice().cells() << log));
        let numbers = world.nodes_at(node.q())[1];
        let last = f64::from(world.extent()[1]);
        let south = match node.n() < numbers / 2 {
            true => f64::from(node.n()) * height,
            false => last - f64::from(numbers - node.n()) * height,
        };
        let texels = f64::from(world.color_tile());
        for (at, texel) in tile[..stored * stored * 4].chunks_exact(4).enumerate() {
            let along = (at % stored) as f64 - border + 0.5;
            let up = texels + border - 0.5 - (at / stored) as f64;
            let column = f64::from(node.m()) * width + along * width / texels;
            let mut row = south + up * height / texels;
            let longitude = globe.longitude(0) + column / f64::from(world.extent()[0]) * std::f64::consts::TAU;
            let mut turned = longitude;
            if row < 0.0 || row > last {
                row = if row < 0.0 { -row } else { 2.0 * last - row };
                turned += std::f64::consts::PI;
            }
            let (below, share) = (row.floor() as u64, row - row.floor());
            let latitude = globe.latitude(below) + share * (globe.latitude(below + 1) - globe.latitude(below));
            let expected = shade(turned, latitude);
            let error = (0..3).map(|c| (f64::from(texel[c]) - expected[c]).abs()).fold(0.0, f64::max);
            // At a pole the mean is taken over many longitudes.
            assert!(error < 12.0, "{node}, texel {at}: {texel:?}, expected {expected:?} at latitude {latitude}");
            checked += 1;
        }
    }
    assert!(checked > 50_000, "{checked}");
}

#[test]
fn a_body_that_is_named_serves_files_without_a_crs() {
    let folder = TestFolder::new();
    let file = Tiff { crs: None, ..globe([180, 90], [1.0, 89.0], 2.0, rough) }.write(&folder.path("a.tif"));
    let body = BodyChoice::parse("mars").unwrap();
    let (database, _) = run(&Job { body, ..job(&[file], &[], folder.path("w.tv")) }).unwrap();
    assert_eq!(database.manifest().fields().body.name, "Mars");
    assert_eq!(database.world().fields().body.unwrap().semi_major_m, 3_396_190.0);
}

#[test]
fn gaps_at_the_poles_are_told_and_filled() {
    let folder = TestFolder::new();
    let file = globe([180, 88], [-179.0, 87.0], 2.0, |_, _| 7.0).write(&folder.path("a.tif"));
    let (database, notes) = run(&job(&[file], &[], folder.path("w.tv"))).unwrap();
    assert!(notes.iter().any(|n| matches!(n, Note::Info(t) if t.contains("made up"))), "{notes:?}");
    assert_eq!(database.world().extent(), [180, 91]);
    assert!(posts(&database).values().all(|height| *height == 7.0));
}

#[test]
fn tiles_of_one_grid_make_one_body() {
    let folder = TestFolder::new();
    let whole = globe([180, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("whole.tif"));
    let part = |name: &str, first: [f64; 2], from: [usize; 2]| {
        globe([90, 45], first, 2.0, |i, j| rough(i + from[0], j + from[1])).write(&folder.path(name))
    };
    let parts = [
        part("a.tif", [-179.0, 89.0], [0, 0]),
        part("b.tif", [1.0, 89.0], [90, 0]),
        part("c.tif", [-179.0, -1.0], [0, 45]),
        part("d.tif", [1.0, -1.0], [90, 45]),
    ];
    let (whole, _) = run(&job(&[whole], &[], folder.path("whole.tv"))).unwrap();
    let (parts, _) = run(&job(&parts, &[], folder.path("parts.tv"))).unwrap();
    assert_eq!(posts(&whole), posts(&parts));
}

fn refused(folder: &TestFolder, arguments: &[&str], words: &[&str]) {
    let output = folder.path("refused.tv");
    let mut all = vec!["ingest"];
    all.extend_from_slice(arguments);
    all.extend_from_slice(&["-o", output.to_str().unwrap()]);
    let result = program(&all);
    let line = error_line(&result);
    assert_eq!(result.status.code(), Some(2), "{line}");
    assert!(words.iter().all(|word| line.contains(word)), "{line}");
    assert!(!output.exists(), "{line}");
}

#[test]
fn data_that_make_no_body_are_refused_in_one_sentence() {
    let folder = TestFolder::new();
    let text = |path: PathBuf| path.to_str().unwrap().to_owned();
    let whole = text(globe([180, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("whole.tif")));
    refused(&folder, &["--elevation", &whole, "--body", "pluto"], &["pluto", "earth, mars, moon"]);
    refused(&folder, &["--elevation", &whole, "--body", "mars"], &["radius", "1737 km", "3396 km"]);
    refused(&folder, &["--elevation", &whole, "--body", "moon", "--spacing", "100"], &["--spacing"]);
    let half = text(globe([90, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("half.tif")));
    refused(&folder, &["--elevation", &half, "--body", "moon"], &["half.tif", "all around"]);
    let low = text(globe([180, 60], [-179.0, 59.0], 2.0, rough).write(&folder.path("low.tif")));
    refused(&folder, &["--elevation", &low, "--geographic"], &["low.tif", "before a pole", "--plane"]);
    let twice = text(globe([200, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("twice.tif")));
    refused(&folder, &["--elevation", &twice, "--body", "moon"], &["twice.tif", "more than once"]);
    let high = text(globe([180, 92], [-179.0, 91.0], 2.0, rough).write(&folder.path("high.tif")));
    refused(&folder, &["--elevation", &high, "--body", "moon"], &["high.tif", "latitude"]);
    let holed = |i: usize, j: usize| if (i, j) == (90, 40) { -9999.0 } else { rough(i, j) };
    let holed = Tiff { nodata: Some(-9999.0), ..globe([180, 90], [-179.0, 89.0], 2.0, holed) };
    let holed = text(holed.write(&folder.path("holed.tif")));
    refused(&folder, &["--elevation", &holed], &["holed.tif", "no data", "gdal_fillnodata.py"]);
    let nameless = Tiff { crs: None, ..globe([180, 90], [-179.0, 89.0], 2.0, rough) };
    let nameless = text(nameless.write(&folder.path("nameless.tif")));
    refused(&folder, &["--elevation", &nameless], &["nameless.tif", "--source-crs"]);
    let small = text(Tiff::utm([40, 40], rough).write(&folder.path("small.tif")));
    refused(&folder, &["--elevation", &small, "--body", "earth"], &["small.tif", "longitude and latitude"]);
    let strip = text(globe([180, 45], [-179.0, 89.0], 2.0, rough).write(&folder.path("strip.tif")));
    refused(&folder, &["--elevation", &whole, "--color", &strip], &["strip.tif", "colour", "latitude"]);
}

#[test]
fn a_plane_is_still_to_be_had_and_parts_of_bodies_become_one() {
    let folder = TestFolder::new();
    let whole = globe([180, 90], [-179.0, 89.0], 2.0, rough).write(&folder.path("whole.tif"));
    let plane = Job { body: BodyChoice::Plane, ..job(&[whole], &[], folder.path("plane.tv")) };
    assert!(run(&plane).unwrap().0.world().globe().is_none());
    let part = globe([30, 30], [-9.0, 9.0], 1.0, rough).write(&folder.path("part.tif"));
    let (part, notes) = run(&job(&[part], &[], folder.path("part.tv"))).unwrap();
    assert!(part.world().globe().is_none());
    assert!(notes.iter().any(|n| matches!(n, Note::Info(t) if t.contains("a part of its body"))), "{notes:?}");
}
