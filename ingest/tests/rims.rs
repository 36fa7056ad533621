//! `--voids clip`: areas beyond files and at their corners become holes, a gap within a file is
//! filled wherever it lies.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use std::path::PathBuf;
use support::{TestFolder, Tiff, job, run};
use terravision_common::database::{Database, TileScratch};
use terravision_common::ground::ground_at;
use terravision_common::validity::Validity;

const VOID: f32 = -9999.0;
const POST_M2: f64 = 100.0;

fn world(folder: &TestFolder, files: &[PathBuf]) -> Database {
    run(&job(files, &[], folder.path("w.tv"))).unwrap().0
}

/// Areas without data and without ground.
fn areas_m2(database: &Database) -> [f64; 2] {
    let elevation = &database.manifest().fields().elevation;
    [elevation.void_area_m2, elevation.voids.map_or(0.0, |voids| voids.hole_area_m2)]
}

#[test]
fn sheets_are_clipped_beyond_and_at_outer_corners_and_filled_at_sides_and_where_they_meet() {
    let folder = TestFolder::new();
    // Two sheets of 60 x 60 posts; the eastern one begins 30 rows further south. Columns and rows
    // from the north west.
    let west_gaps = |i: usize, j: usize| {
        let at_side = (20..30).contains(&i) && j < 5;
        let where_they_meet = (50..60).contains(&i) && (55..60).contains(&j);
        at_side || where_they_meet
    };
    let east_rim = |i: usize, j: usize| i + j > 100;
    let east_gap = |i: usize, j: usize| i > 52 && (10..20).contains(&j);
    let sheet = |is_void: &dyn Fn(usize, usize) -> bool, east: f64, south: f64, name: &str| {
        let height = |i: usize, j: usize| if is_void(i, j) { VOID } else { 300.0 + i as f32 + j as f32 };
        let transform = Some([500_000.0 + east, 10.0, 0.0, 5_000_000.0 - south, 0.0, -10.0]);
        let tiff = Tiff { nodata: Some(f64::from(VOID)), transform, ..Tiff::utm([60, 60], height) };
        tiff.write(&folder.path(name))
    };
    let west = sheet(&west_gaps, 0.0, 0.0, "west.tif");
    let east = sheet(&|i, j| east_rim(i, j) || east_gap(i, j), 600.0, 300.0, "east.tif");
    let database = world(&folder, &[west, east]);
    let count = |is: &dyn Fn(usize, usize) -> bool| (0..60 * 60).filter(|k| is(k % 60, k / 60)).count() as f64;
    let holes = 2.0 * 60.0 * 30.0 + count(&east_rim);
    let voids = holes + count(&west_gaps) + count(&east_gap);
    assert_eq!(areas_m2(&database), [voids * POST_M2, holes * POST_M2]);
    let expected = [
        ([25, 0], Validity::MadeUp),
        ([25, 4], Validity::MadeUp),
        ([55, 57], Validity::MadeUp),
        ([115, 45], Validity::MadeUp),
        ([10, 10], Validity::Measured),
        ([90, 60], Validity::Measured),
        ([90, 10], Validity::Hole),
        ([20, 80], Validity::Hole),
        ([118, 88], Validity::Hole),
    ];
    for ([i, j], expected) in expected {
        let (x, y) = (10.0 * f64::from(i), 10.0 * f64::from(89 - j));
        let ground = ground_at(&database, database.world(), x, y, &mut TileScratch::default()).unwrap().unwrap();
        assert_eq!(ground.validity, expected, "at {i}, {j}");
    }
}

#[test]
fn a_gap_that_meets_the_rim_of_a_reprojected_file_does_not_go_with_it() {
    let folder = TestFolder::new();
    let geographic = |is_void: &dyn Fn(usize, usize) -> bool, name: &str| {
        let height = |i: usize, j: usize| if is_void(i, j) { VOID } else { 800.0 + 2.0 * i as f32 };
        // Far from the zone's middle, so that the file lies askew in the world.
        let transform = Some([11.5, 0.001, 0.0, 60.0, 0.0, -0.001]);
        let crs = Some("EPSG:4326");
        let tiff = Tiff { nodata: Some(f64::from(VOID)), transform, crs, ..Tiff::utm([200, 200], height) };
        tiff.write(&folder.path(name))
    };
    let whole = areas_m2(&world(&folder, &[geographic(&|_, _| false, "whole.tif")]));
    let mut again = job(&[], &[], folder.path("w.tv"));
    again.may_overwrite = true;
    let mut areas = |file: PathBuf| {
        again.elevation = vec![file];
        areas_m2(&run(&again).unwrap().0)
    };
    assert!(whole[1] > 0.0 && whole[0] == whole[1], "all that is void lies beyond the file: {whole:?}");
    // Along much of a side, but at no corner.
    let gap = areas(geographic(&|i, j| (60..190).contains(&i) && j < 30, "gap.tif"));
    assert!(gap[0] > whole[0] && gap[1] == whole[1], "{gap:?}");
    // The rim of a raster that was cut askew: at a corner.
    let rim = areas(geographic(&|i, j| 3 * i + j < 90, "rim.tif"));
    assert!(rim[0] == rim[1] && rim[1] > whole[1], "{rim:?}");
}
