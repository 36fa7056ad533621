//! The synthetic world.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod support;

use gdal::Dataset;
use std::fs;
use std::process::Command;
use std::sync::Arc;
use support::{TestFolder, heights, job, run};
use terravision_ingest::synth::body::{BodyModel, SynthBodyOptions};
use terravision_ingest::synth::{SynthOptions, body, write};

fn options(folder: &TestFolder, name: &str, size: u32, threads: usize) -> SynthOptions {
    SynthOptions { output: folder.path(name), size, spacing_m: 10.0, seed: 1, threads, may_overwrite: false }
}

#[test]
fn the_same_options_give_the_same_files_for_any_number_of_threads() {
    let folder = TestFolder::new();
    for (name, threads) in [("a", 1), ("b", 3)] {
        write(&options(&folder, name, 300, threads), Arc::default(), false).unwrap();
    }
    for file in ["dem.tif", "ortho.tif"] {
        let [a, b] = ["a", "b"].map(|name| fs::read(folder.path(name).join(file)).unwrap());
        assert!(a == b, "{file} differs");
    }
    assert_eq!(fs::read_dir(folder.path("a")).unwrap().count(), 2);
}

#[test]
fn files_that_are_there_are_replaced_only_when_told() {
    let folder = TestFolder::new();
    fs::create_dir_all(folder.path("w")).unwrap();
    fs::write(folder.path("w").join("dem.tif"), "somebody's own").unwrap();
    let message = write(&options(&folder, "w", 64, 1), Arc::default(), false).unwrap_err().to_string();
    assert!(message.contains("dem.tif is there already"), "{message}");
    assert_eq!(fs::read(folder.path("w").join("dem.tif")).unwrap(), b"somebody's own");
    write(&SynthOptions { may_overwrite: true, ..options(&folder, "w", 64, 1) }, Arc::default(), false).unwrap();
    assert!(Dataset::open(folder.path("w").join("dem.tif")).is_ok());
}

/// A disk that fills up, as a limit on the size of files: GDAL writes blocks late, when no call is
/// there to fail.
#[test]
fn a_full_disk_is_told_and_leaves_nothing() {
    let folder = TestFolder::new();
    let script = format!(
        "trap '' XFSZ; ulimit -f 64; exec '{}' synth --size 512 -o '{}'",
        env!("CARGO_BIN_EXE_terravision-ingest"),
        folder.path("w").display()
    );
    let done = Command::new("bash").args(["-c", &script]).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(1), "{said}");
    assert!(said.contains("cannot write"), "{said}");
    assert_eq!(fs::read_dir(folder.path("w")).unwrap().count(), 0, "{said}");
}

#[test]
fn photo_and_dem_lie_over_each_other_and_are_ingested_without_resampling() {
    let folder = TestFolder::new();
    write(&options(&folder, "w", 256, 2), Arc::default(), false).unwrap();
    let [dem, photo] = ["dem.tif", "ortho.tif"].map(|file| folder.path("w").join(file));
    let transforms = [&dem, &photo].map(|path| Dataset::open(path).unwrap().geo_transform().unwrap());
    assert_eq!([transforms[0][0] + 5.0, transforms[0][3] - 5.0], [transforms[1][0], transforms[1][3]]);
    let (database, notes) = run(&job(std::slice::from_ref(&dem), &[photo], folder.path("w.tv"))).unwrap();
    assert_eq!(notes, []);
    let manifest = database.manifest().fields();
    assert!(manifest.elevation.sources[0].is_exact && manifest.color.sources[0].is_exact);
    assert_eq!(manifest.crs.epsg, Some(32632));
    let band = Dataset::open(&dem).unwrap().rasterband(1).unwrap().read_band_as::<f32>().unwrap();
    let (posts, width) = heights(&database, 0);
    for j in 0..257 {
        for i in 0..257 {
            assert_eq!(posts[j * width + i], band.data()[(256 - j) * 257 + i]);
        }
    }
}

#[test]
fn an_interrupted_synth_leaves_no_file() {
    let folder = TestFolder::new();
    let stop = Arc::new(std::sync::atomic::AtomicBool::new(true));
    let error = write(&options(&folder, "w", 300, 1), stop, false).unwrap_err();
    assert_eq!(error.exit_code(), 130);
    assert_eq!(fs::read_dir(folder.path("w")).unwrap().count(), 0);
}

#[test]
fn a_body_is_made_the_same_with_any_number_of_threads_and_becomes_a_world() {
    let folder = TestFolder::new();
    let make = |name: &str, threads: usize| {
        let options = SynthBodyOptions {
            output: folder.path(name),
            model: BodyModel::Moon,
            columns: 256,
            seed: 1,
            threads,
            may_overwrite: false,
        };
        body::write(&options, Arc::default(), false).unwrap();
        ["dem.tif", "ortho.tif"].map(|file| folder.path(name).join(file))
    };
    let (one, two) = (make("one", 1), make("two", 2));
    for (a, b) in one.iter().zip(&two) {
        assert!(std::fs::read(a).unwrap() == std::fs::read(b).unwrap(), "{}", a.display());
    }
    let [dem, ortho] = one;
    let (database, _) = run(&job(&[dem], &[ortho], folder.path("moon.tv"))).unwrap();
    assert_eq!(database.world().extent(), [256, 129]);
    assert_eq!(database.manifest().fields().body.name, "Moon");
    let [low, high] = database.manifest().fields().elevation.range_m;
    assert!(low < -1000.0 && high > 1000.0, "{low} to {high}");
}
