//! Everything that reads foreign bytes, given bytes that were changed (`terravision_tests::fuzz`):
//! whatever comes, a reader says so, and neither panics nor takes more memory than what it reads is
//! worth. Segments of a run are fuzzed where they are read (`common/src/shm/tests/garbage.rs`).

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod database;
mod elsewhere;
mod memory;
mod paths;
mod rasters;

use std::path::PathBuf;
use std::sync::OnceLock;
use terravision_tests::folder::target_tmp;
use terravision_tests::geotiff::write_heights;
use terravision_tests::process::Terravision;

/// Fails when `read` takes more memory at a time than `most` bytes. What other threads take does
/// not count.
fn within(most: u64, read: impl FnOnce()) {
    let taken = allocation_counter::measure(read).bytes_max;
    assert!(taken <= most, "{taken} bytes of memory, expected at most {most}");
}

/// A small database, made once: with voids, and with sparse levels.
fn databases() -> &'static [PathBuf; 2] {
    static MADE: OnceLock<[PathBuf; 2]> = OnceLock::new();
    MADE.get_or_init(|| {
        let folder = target_tmp().join(format!("fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let raster = |name: &str, side: usize, at_m: f64, spacing_m: f64, is_void: fn(usize) -> bool| {
            let post =
                |k: usize| if is_void(k) { f32::NAN } else { 300.0 + (k % side) as f32 * 1.5 + (k / side % 7) as f32 };
            let posts: Vec<f32> = (0..side * side).map(post).collect();
            let origin = [500_000.0 + at_m, 5_000_000.0 + at_m];
            write_heights(&folder.join(name), side, side, origin, spacing_m, &posts);
            folder.join(name)
        };
        let ingest = |name: &str, files: &[PathBuf]| {
            let made = folder.join(name);
            Terravision::verb("ingest")
                .arg("--elevation")
                .args(files)
                .arg("-o")
                .arg(&made)
                .arg("--overwrite")
                .succeed();
            made
        };
        let holed = raster("holed.tif", 50, 0.0, 10.0, |k| k % 50 < 9 && k / 50 < 12);
        let coarse = raster("coarse.tif", 40, 0.0, 32.0, |_| false);
        let fine = raster("fine.tif", 40, 500.0, 4.0, |_| false);
        [ingest("holed.tv", &[holed]), ingest("sparse.tv", &[fine, coarse])]
    })
}
