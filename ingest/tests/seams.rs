//! Sheets that lie side by side without overlap, resampled: what comes out is what one file of them
//! all gives.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use std::path::PathBuf;
use support::{TestFolder, Tiff, colors, heights, job, run};
use terravision_common::database::Database;
use terravision_ingest::job::Job;
use terravision_ingest::plan::PlanOptions;

const SIDE: usize = 60;

fn rough(i: usize, j: usize) -> f32 {
    let hash = (i as u32).wrapping_mul(0x9e37_79b9) ^ (j as u32).wrapping_mul(0x85eb_ca6b);
    2000.0 + 20.0 * i as f32 + (hash.wrapping_mul(0xc2b2_ae35) >> 16) as f32 / 655.36
}

/// A part of a raster of 10 m pixels that begins at column and row `at` of it; `None` is no data.
fn sheet(
    folder: &TestFolder,
    name: &str,
    at: [usize; 2],
    size: [usize; 2],
    f: impl Fn(usize, usize) -> Option<f32>,
) -> PathBuf {
    let corner = [500_000.0 + 10.0 * at[0] as f64, 5_000_000.0 - 10.0 * at[1] as f64];
    Tiff {
        transform: Some([corner[0], 10.0, 0.0, corner[1], 0.0, -10.0]),
        nodata: Some(-9999.0),
        ..Tiff::utm(size, |i, j| f(at[0] + i, at[1] + j).unwrap_or(-9999.0))
    }
    .write(&folder.path(name))
}

fn finest_heights(database: &Database) -> Vec<f32> {
    heights(database, database.world().finest_elevation_level()).0
}

fn resampled(folder: &TestFolder, name: &str, elevation: &[PathBuf], spacing_m: f64, crs: Option<&str>) -> Database {
    let base = job(elevation, &[], folder.path(name));
    let plan = PlanOptions { spacing_m: Some(spacing_m), ..base.plan };
    run(&Job { crs: crs.map(str::to_owned), plan, ..base }).unwrap().0
}

fn assert_same(a: &Database, b: &Database) {
    assert_eq!(a.world(), b.world());
    let (a, b) = (finest_heights(a), finest_heights(b));
    let worst = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 0.02, "heights differ by {worst} m");
}

#[test]
fn sheets_side_by_side_are_filtered_as_one_corners_too() {
    let folder = TestFolder::new();
    let whole = sheet(&folder, "whole.tif", [0, 0], [2 * SIDE; 2], |i, j| Some(rough(i, j)));
    let quarters: Vec<PathBuf> = [[0, 0], [SIDE, 0], [0, SIDE], [SIDE, SIDE]]
        .into_iter()
        .enumerate()
        .map(|(k, at)| sheet(&folder, &format!("{k}.tif"), at, [SIDE; 2], |i, j| Some(rough(i, j))))
        .collect();
    // A little coarser, finer, and so coarse that the kernel averages.
    for (name, spacing_m) in [("near", 10.4), ("finer", 7.0), ("coarse", 31.0)] {
        let one = resampled(&folder, &format!("{name}-one.tv"), std::slice::from_ref(&whole), spacing_m, None);
        let four = resampled(&folder, &format!("{name}-four.tv"), &quarters, spacing_m, None);
        assert_same(&one, &four);
    }
}

#[test]
fn a_sheet_that_is_void_there_or_missing_ends_as_a_raster_ends() {
    let folder = TestFolder::new();
    let is_hole = |i: usize, j: usize| (SIDE - 4..SIDE + 9).contains(&i) && (20..30).contains(&j);
    let height = |i: usize, j: usize| (!is_hole(i, j)).then(|| rough(i, j));
    let one = sheet(&folder, "one.tif", [0, 0], [2 * SIDE, SIDE], height);
    let west = sheet(&folder, "west.tif", [0, 0], [SIDE, SIDE], height);
    let east = sheet(&folder, "east.tif", [SIDE, 0], [SIDE, SIDE], height);
    let a = resampled(&folder, "a.tv", &[one], 10.4, None);
    let b = resampled(&folder, "b.tv", &[west, east], 10.4, None);
    assert_same(&a, &b);
}

#[test]
fn summits_and_pits_are_kept_and_a_step_does_not_ring() {
    let folder = TestFolder::new();
    let cone =
        |i: usize, j: usize, [x, y]: [f32; 2]| 90.0 - 25.0 * ((i as f32 - x).powi(2) + (j as f32 - y).powi(2)).sqrt();
    let height = |i: usize, j: usize| {
        let step = if i + j / 3 > 80 { 600.0 } else { 300.0 };
        let summits = [[20.0, 30.0], [31.0, 80.0], [100.0, 77.0], [60.0, 12.0]].map(|at| cone(i, j, at).max(0.0));
        Some(step + summits.iter().sum::<f32>() - cone(i, j, [95.0, 30.0]).max(0.0))
    };
    let file = sheet(&folder, "step.tif", [0, 0], [2 * SIDE; 2], height);
    let database = resampled(&folder, "step.tv", &[file], 10.4, Some("EPSG:32633"));
    let heights = finest_heights(&database);
    assert_eq!(database.manifest().fields().elevation.range_m, [300.0, 690.0]);
    // 390 m on the lower side, 510 m in the pit of the upper one.
    let has = |height: f32| heights.contains(&height);
    assert!(has(390.0) && has(510.0));
    assert_eq!(database.manifest().fields().elevation.source_range_m, None);
}

#[test]
fn what_a_coarser_spacing_takes_off_a_summit_is_told() {
    let folder = TestFolder::new();
    let height = |i: usize, j: usize| Some(if (i, j) == (33, 40) { 800.0 } else { 500.0 });
    let file = sheet(&folder, "peak.tif", [0, 0], [2 * SIDE; 2], height);
    let base = job(&[file], &[], folder.path("peak.tv"));
    let plan = PlanOptions { spacing_m: Some(40.0), ..base.plan };
    let (database, notes) = run(&Job { plan, ..base }).unwrap();
    let manifest = database.manifest().fields();
    let notes: Vec<String> = notes.iter().map(|note| format!("{note:?}")).collect();
    assert_eq!(manifest.elevation.source_range_m, Some([500.0, 800.0]));
    assert!(notes.iter().any(|note| note.contains("800 m") && note.contains("--spacing")), "{notes:?}");
}

#[test]
fn pictures_side_by_side_are_filtered_as_one() {
    let folder = TestFolder::new();
    let dem = sheet(&folder, "dem.tif", [0, 0], [2 * SIDE; 2], |i, j| Some((i + j) as f32));
    let photo = |name: &str, at: [usize; 2], size: [usize; 2]| {
        let band = |c: usize| {
            let texel = |k: usize| (((at[0] + k % size[0]) * 37 + (at[1] + k / size[0]) * 11 + 50 * c) % 256) as u8;
            (0..size[0] * size[1]).map(texel).collect()
        };
        let corner = [500_000.0 + 10.0 * at[0] as f64, 5_000_000.0 - 10.0 * at[1] as f64];
        Tiff {
            transform: Some([corner[0], 10.0, 0.0, corner[1], 0.0, -10.0]),
            bands: (0..3).map(band).collect(),
            ..Tiff::utm(size, |_, _| 0u8)
        }
        .write(&folder.path(name))
    };
    let make = |name: &str, color: &[PathBuf]| {
        let base = job(std::slice::from_ref(&dem), color, folder.path(name));
        let plan = PlanOptions { spacing_m: Some(10.4), ..base.plan };
        run(&Job { plan, ..base }).unwrap().0
    };
    let one = make("one.tv", &[photo("one.tif", [0, 0], [2 * SIDE; 2])]);
    let two = [photo("w.tif", [0, 0], [SIDE, 2 * SIDE]), photo("e.tif", [SIDE, 0], [SIDE, 2 * SIDE])];
    let two = make("two.tv", &two);
    let level = one.world().finest_color_level();
    assert_eq!(colors(&one, level), colors(&two, level));
}
