//! Sources of different spacings in one world: the finest levels are only where the data are as
//! fine.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use support::{TestFolder, Tiff, job, run};
use terravision_common::database::{Database, Layer, TileScratch, TileSource, color_tile_bytes};
use terravision_common::ground::ground_height;
use terravision_common::node::NodeId;
use terravision_ingest::job::Job;

/// 64 x 64 pixels of 30 m.
const COARSE: usize = 64;
/// 120 x 120 pixels of 1 m.
const FINE: usize = 120;
/// Where the fine data begin, metres east and south of the coarse ones' corner.
const AT_M: [f64; 2] = [900.0, 800.0];
/// How much higher the fine data say that the ground is.
const STEP_M: f32 = 3.0;

fn ground(x: f64, y: f64) -> f32 {
    (500.0 + 60.0 * (x / 300.0).sin() + 40.0 * (y / 250.0).cos()) as f32
}

fn coarse(folder: &TestFolder) -> PathBuf {
    let height = |i: usize, j: usize| ground(30.0 * i as f64 + 15.0, 30.0 * j as f64 + 15.0);
    Tiff { transform: Some([500_000.0, 30.0, 0.0, 5_000_000.0, 0.0, -30.0]), ..Tiff::utm([COARSE; 2], height) }
        .write(&folder.path("coarse.tif"))
}

fn fine(folder: &TestFolder) -> PathBuf {
    let height = |i: usize, j: usize| {
        let is_void = (40..60).contains(&i) && (70..75).contains(&j);
        if is_void { -9999.0 } else { STEP_M + ground(AT_M[0] + i as f64 + 0.5, AT_M[1] + j as f64 + 0.5) }
    };
    let corner = [500_000.0 + AT_M[0], 5_000_000.0 - AT_M[1]];
    Tiff {
        transform: Some([corner[0], 1.0, 0.0, corner[1], 0.0, -1.0]),
        nodata: Some(-9999.0),
        ..Tiff::utm([FINE; 2], height)
    }
    .write(&folder.path("fine.tif"))
}

fn tiles(database: &Database) -> [u64; 2] {
    [database.manifest().fields().elevation.archive.tiles, database.manifest().fields().color.archive.tiles]
}

fn bytes(folder: &Path) -> u64 {
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
}

/// Every node has the tiles that the index says, and no others.
fn assert_whole(database: &Database) {
    let world = *database.world();
    let (mut scratch, mut texels) = (TileScratch::default(), vec![0; color_tile_bytes(&world)]);
    let mut heights = vec![0.0; (world.elevation_posts() as usize).pow(2)];
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q);
        for node in (0..columns * rows).map(|k| NodeId::new(k % columns, k / columns, q).unwrap()) {
            let elevation = database.read_elevation(node, &mut heights, &mut scratch);
            let color = database.read_color(node, &mut texels, &mut scratch);
            assert_eq!(elevation.is_ok(), database.ranges().has_tile(Layer::Elevation, node), "{node}: {elevation:?}");
            assert_eq!(color.is_ok(), database.ranges().has_tile(Layer::Color, node), "{node}: {color:?}");
            if elevation.is_ok() {
                let [low, high] = database.ranges().range(node).unwrap();
                assert!(heights.iter().all(|h| (low..=high).contains(h)), "{node}: {low} to {high}");
            }
            if q >= world.complete_level() {
                assert!(elevation.is_ok() == world.has_elevation(node) && color.is_ok() == world.has_color(node));
            }
        }
    }
}

#[test]
fn fine_data_in_coarse_data_cost_what_both_hold_and_no_step_shows() {
    let folder = TestFolder::new();
    let (coarse, fine) = (coarse(&folder), fine(&folder));
    let alone = [(&fine, "fine.tv"), (&coarse, "coarse.tv")].map(|(file, name)| {
        let (database, _) = run(&job(std::slice::from_ref(file), &[], folder.path(name))).unwrap();
        assert!(!database.manifest().is_sparse() && database.world().complete_level() == 0);
        (tiles(&database), bytes(database.path()))
    });
    let (both, notes) = run(&job(&[fine, coarse], &[], folder.path("both.tv"))).unwrap();
    assert_eq!(
        (both.manifest().fields().format_version, both.manifest().fields().features.as_slice()),
        (2, &["sparse-levels".to_owned()][..])
    );
    assert!(notes.iter().any(|note| format!("{note:?}").contains("only where")), "{notes:?}");
    assert_whole(&both);
    let found = tiles(&both);
    for (layer, found) in found.into_iter().enumerate() {
        // The rim of each level, the levels between the two spacings, and 64 nodes that are cut
        // differently.
        let most = 2 * (alone[0].0[layer] + alone[1].0[layer]) + 400;
        assert!(found <= most, "{found} tiles, expected at most {most}");
        assert!(found > alone[0].0[layer]);
    }
    assert!(bytes(both.path()) < 3 * (alone[0].1 + alone[1].1), "{} bytes, {alone:?}", bytes(both.path()));
    assert!(
        both.manifest().fields().elevation.void_area_m2 < 1.0,
        "the void of the fine data is filled from the coarse ones"
    );

    // Across the border of the fine data and through their void, metre by metre.
    let world = both.world();
    let mut scratch = TileScratch::default();
    let origin = world.fields().origin;
    let place = |x: f64, y: f64| [500_000.0 + x - origin[0], 5_000_000.0 - y - origin[1]];
    let mut height = |x: f64, y: f64| {
        let [x, y] = place(x, y);
        ground_height(&both, world, x, y, &mut scratch).unwrap().unwrap()
    };
    let mut before: Option<f64> = None;
    for k in 0..400 {
        let (x, y) = (AT_M[0] - 140.0 + f64::from(k), AT_M[1] + 72.0);
        let above = height(x, y) - f64::from(ground(x, y));
        assert!(before.is_none_or(|before| (above - before).abs() < 0.5), "{above} m after {before:?} m at {k}");
        before = Some(above);
    }
    let middle = height(AT_M[0] + 90.0, AT_M[1] + 30.0) - f64::from(ground(AT_M[0] + 90.0, AT_M[1] + 30.0));
    assert!((middle - f64::from(STEP_M)).abs() < 0.02, "{middle}");
    let outside = height(AT_M[0] - 200.0, AT_M[1]) - f64::from(ground(AT_M[0] - 200.0, AT_M[1]));
    assert!(outside.abs() < 0.5, "{outside}");
}

#[test]
fn a_small_picture_in_large_elevation_makes_no_large_tint() {
    let folder = TestFolder::new();
    let dem = coarse(&folder);
    let corner = [500_000.0 + AT_M[0], 5_000_000.0 - AT_M[1]];
    let photo = Tiff {
        transform: Some([corner[0], 1.0, 0.0, corner[1], 0.0, -1.0]),
        bands: vec![vec![200u8; FINE * FINE], vec![40; FINE * FINE], vec![20; FINE * FINE]],
        ..Tiff::utm([FINE; 2], |_, _| 0u8)
    }
    .write(&folder.path("photo.tif"));
    let (plain, _) = run(&job(std::slice::from_ref(&dem), &[], folder.path("plain.tv"))).unwrap();
    let (both, notes) = run(&job(&[dem], &[photo], folder.path("both.tv"))).unwrap();
    assert_whole(&both);
    let (world, [elevation, color]) = (both.world(), tiles(&both));
    let [columns, rows] = world.nodes_at(world.finest_color_level()).map(u64::from);
    assert!(color < columns * rows / 4, "{color} colour tiles of {columns} x {rows}");
    assert!(elevation < 2 * tiles(&plain)[0] + 200, "{elevation} elevation tiles");
    let text = format!("{notes:?}");
    assert!(text.contains("colour has no data for 99.6 %"), "{text}");
    // A texel in the middle of the picture, at the finest level.
    let level = world.finest_color_level();
    let side = world.node_side_m(level);
    let at = [
        AT_M[0] + 60.0 + 500_000.0 - world.fields().origin[0],
        5_000_000.0 - AT_M[1] - 60.0 - world.fields().origin[1],
    ];
    let node = NodeId::new((at[0] / side) as u32, (at[1] / side) as u32, level).unwrap();
    let mut texels = vec![0; color_tile_bytes(world)];
    both.read_color(node, &mut texels, &mut TileScratch::default()).unwrap();
    let stored = world.color_stored() as usize;
    let middle = &texels[(stored / 2 * stored + stored / 2) * 4..][..3];
    assert!(middle.iter().zip([200u8, 40, 20]).all(|(a, b)| a.abs_diff(b) < 12), "{middle:?}");
}

#[test]
fn crests_are_raised_where_there_is_finer_ground_alone() {
    let folder = TestFolder::new();
    let files = [fine(&folder), coarse(&folder)];
    let [filtered, raised] = [false, true].map(|raises_crests| {
        let path = folder.path(if raises_crests { "raised.tv" } else { "filtered.tv" });
        run(&Job { raises_crests, ..job(&files, &[], path) }).unwrap().0
    });
    assert_whole(&raised);
    let world = *raised.world();
    let (posts, mut scratch) = (world.elevation_posts() as usize, TileScratch::default());
    let mut read = |database: &Database, node| {
        let mut heights = vec![0.0; posts * posts];
        database.read_elevation(node, &mut heights, &mut scratch).is_ok().then_some(heights)
    };
    // Borders are seen from both sides: nodes with children have the posts of those without.
    let (mut count, mut shared) = (0, BTreeMap::new());
    for q in 0..world.levels() {
        let [columns, rows] = world.nodes_at(q);
        for node in (0..columns * rows).map(|k| NodeId::new(k % columns, k / columns, q).unwrap()) {
            let (before, after) = (read(&filtered, node), read(&raised, node));
            let (Some(before), Some(after)) = (before, after) else { continue };
            let has_children = raised.ranges().has_children(Layer::Elevation, node);
            assert!(has_children || before == after, "{node} has no children and has changed");
            count += before.iter().zip(&after).filter(|(before, after)| before != after).count();
            for (k, height) in after.into_iter().enumerate() {
                let at = [node.m() as usize * (posts - 1) + k % posts, node.n() as usize * (posts - 1) + k / posts];
                assert_eq!(*shared.entry((q, at)).or_insert(height), height, "{node}, post {k}");
            }
        }
    }
    assert!(count > 50, "{count} posts were raised");
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let folder = TestFolder::new();
    let files = [fine(&folder), coarse(&folder)];
    let made = [1, 3].map(|threads| {
        let path = folder.path("same.tv");
        let job = Job { threads, may_overwrite: true, raises_crests: true, ..job(&files, &[], path.clone()) };
        run(&job).unwrap();
        let mut files: Vec<_> = std::fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files.iter().map(|file| std::fs::read(file).unwrap()).collect::<Vec<_>>()
    });
    assert!(made[0] == made[1]);
}
