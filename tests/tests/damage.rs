//! Damaged and wrong input: a sentence and the right exit code, or the picture with what is left of
//! the data.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::fs;
use std::path::Path;
use std::time::Duration;
use terravision_tests::flight::read_png;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Finished, Terravision};
use terravision_tests::shot::{Shot, VFOV_DEG, oblique_poses, read_report};
use terravision_tests::worlds::{TestWorld, synth_world};

const FILES: [&str; 4] = ["manifest.json", "nodes.tvn", "elevation.pmtiles", "color.pmtiles"];

fn copy_of(world: &TestWorld, folder: &TestFolder) -> std::path::PathBuf {
    let copy = folder.join("copy.tv");
    fs::create_dir_all(&copy).unwrap();
    for file in FILES {
        fs::copy(world.database().join(file), copy.join(file)).unwrap();
    }
    copy
}

fn still(database: &Path, world: &TestWorld, folder: &TestFolder) -> Finished {
    Terravision::verb("still")
        .arg("--quality=default")
        .arg(database)
        .args(oblique_poses(world)[0].1.arguments())
        .args(["--size=320x180".to_owned(), format!("--vfov={VFOV_DEG}")])
        .arg("-o")
        .arg(folder.join("a.png"))
        .arg("--report")
        .arg(folder.join("report.json"))
        .deadline(Duration::from_secs(60))
        .run()
}

/// Offset and length of the tile data of a PMTiles archive (specification v3, header bytes 56 and
/// 64).
fn tile_data(bytes: &[u8]) -> std::ops::Range<usize> {
    let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    number(56)..number(56) + number(64)
}

#[test]
fn corrupt_tiles_are_listed_and_their_parents_drawn() {
    let world = synth_world(1024);
    for archive in ["color.pmtiles", "elevation.pmtiles"] {
        let folder = TestFolder::new("corrupt");
        let database = copy_of(&world, &folder);
        let path = database.join(archive);
        let mut bytes = fs::read(&path).unwrap();
        // Tiles lie in the order of their ids, coarse levels first: the last half holds nothing but
        // finest tiles.
        let data = tile_data(&bytes);
        for at in (data.start + data.len() / 2..data.end).step_by(256) {
            bytes[at] ^= 0x5a;
        }
        fs::write(&path, bytes).unwrap();
        let shot = Shot { size: [960, 540], ..Shot::new(&world, oblique_poses(&world)[1].1) };
        let whole = shot.take(&[], false);
        let finished = Terravision::verb("still")
            .arg("--quality=default")
            .arg(&database)
            .args(shot.pose.arguments())
            .args(["--size=960x540".to_owned(), format!("--vfov={VFOV_DEG}"), "-o".to_owned()])
            .arg(folder.join("a.png"))
            .arg("--report")
            .arg(folder.join("report.json"))
            .run();
        finished.assert_told(3);
        let report = read_report(&folder);
        let listed = report["tiles"]["unavailable"].as_array().expect("the report lists unavailable tiles").len();
        assert!(listed > 0, "{archive}: {report}");
        assert_eq!(report["settled"], false, "{archive}: {report}");
        let (_, _, rgb) = read_png(&folder.join("a.png"));
        let sky = |rgb: &[[u8; 3]]| rgb.iter().filter(|p| **p == shot.sky_rgb).count();
        let (before, after) = (sky(&whole.rgb), sky(&rgb));
        println!("{archive}: {listed} tiles unavailable, sky pixels {before} before and {after} after");
        assert!(after.abs_diff(before) * 200 < rgb.len(), "{archive}: the picture is complete");
        assert!(rgb != whole.rgb, "{archive}: the damage shows");
        // Coarser, but the same picture.
        let difference: f64 =
            rgb.iter().zip(&whole.rgb).map(|(a, b)| f64::from(a[1].abs_diff(b[1]))).sum::<f64>() / rgb.len() as f64;
        assert!(difference < 15.0, "{archive}: pictures differ by {difference} on average");
    }
}

/// Without any elevation there is no picture: not of a still, and not of a flight that would see
/// nothing but sky.
#[test]
fn elevation_that_cannot_be_read_at_all_ends_still_and_flight_alike() {
    let world = synth_world(1024);
    let folder = TestFolder::new("no-elevation");
    let database = copy_of(&world, &folder);
    let path = database.join("elevation.pmtiles");
    let mut bytes = fs::read(&path).unwrap();
    let data = tile_data(&bytes);
    bytes[data].iter_mut().for_each(|byte| *byte ^= 0x5a);
    fs::write(&path, bytes).unwrap();
    still(&database, &world, &folder).assert_told(1);
    for mode in ["exact", "realtime"] {
        let film = folder.join("a.mp4");
        let flight = Terravision::verb("fly")
            .arg(&database)
            .args(["--path", "orbit", "--frames", "0..5", "--size", "320x180", "--mode", mode, "-o"])
            .arg(&film)
            .run();
        flight.assert_told(1);
        assert!(flight.stderr.contains("elevation tile of the root"), "{mode}: {}", flight.stderr);
        assert!(!film.exists(), "{mode}");
    }
    let left = fs::read_dir(folder.path()).unwrap().flatten().filter(|entry| entry.file_name() != "copy.tv");
    assert_eq!(left.count(), 0);
}

/// One flipped bit at places all over each file: the picture is unchanged, or the program says what
/// is wrong.
#[test]
fn a_flipped_bit_anywhere_never_passes_unnoticed_and_never_panics() {
    const PLACES: usize = 14;
    let world = synth_world(1024);
    let folder = TestFolder::new("flipped");
    let database = copy_of(&world, &folder);
    still(&database, &world, &folder).assert_code(0);
    let (_, _, picture) = read_png(&folder.join("a.png"));
    let mut noticed = 0;
    for file in FILES {
        let path = database.join(file);
        let good = fs::read(&path).unwrap();
        for place in 0..PLACES {
            // Places crowd at the start, where headers and directories are.
            let share = (place as f64 / PLACES as f64).powi(3);
            let at = ((good.len() as f64 * share) as usize + 7 * place + 3).min(good.len() - 1);
            let mut bad = good.clone();
            bad[at] ^= 1 << (place % 8);
            fs::write(&path, bad).unwrap();
            fs::remove_file(folder.join("a.png")).ok();
            let finished = still(&database, &world, &folder);
            let what = format!("{file}, bit {} of byte {at} of {}", place % 8, good.len());
            match finished.code() {
                Some(0) => {
                    let (_, _, found) = read_png(&folder.join("a.png"));
                    assert!(found == picture, "{what}: another picture and not a word");
                }
                Some(code @ (1..=3)) => {
                    noticed += 1;
                    println!("{what}: {code}, {}", finished.stderr.lines().last().unwrap_or_default());
                    finished.assert_told(code);
                }
                _ => panic!("{what}: {} {:?}", finished.status, finished.stderr),
            }
        }
        for length in [0, 1, good.len() / 3, good.len() - 1] {
            fs::write(&path, &good[..length]).unwrap();
            let finished = still(&database, &world, &folder);
            assert!(matches!(finished.code(), Some(1..=3)), "{file} cut to {length}: {}", finished.status);
            finished.assert_told(finished.code().unwrap_or_default());
        }
        fs::remove_file(&path).unwrap();
        still(&database, &world, &folder).assert_told(2);
        fs::write(&path, &good).unwrap();
    }
    still(&database, &world, &folder).assert_code(0);
    assert!(noticed >= 20, "only {noticed} of {} flips were noticed", FILES.len() * PLACES);
}

#[test]
fn a_database_of_a_newer_version_is_refused_by_its_version() {
    let world = synth_world(1024);
    let folder = TestFolder::new("newer");
    let database = copy_of(&world, &folder);
    let path = database.join("manifest.json");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.replace("\"format_version\": 1", "\"format_version\": 77")).unwrap();
    let finished = still(&database, &world, &folder);
    finished.assert_told(2);
    assert!(finished.stderr.contains("77"), "{}", finished.stderr);
}

#[test]
fn wrong_requests_are_told_in_one_sentence() {
    let world = synth_world(1024);
    let folder = TestFolder::new("wrong");
    let pose = oblique_poses(&world)[0].1;
    let still = || Terravision::verb("still").arg("--quality=default").arg(world.database()).args(pose.arguments());
    let out = || folder.join("x.png").display().to_string();
    let cases: Vec<(&str, Terravision, i32)> = vec![
        ("an empty picture", still().args(["--size", "0x0", "-o", &out()]), 2),
        ("a picture larger than the device", still().args(["--size", "60000x60000", "-o", &out()]), 2),
        ("rays larger than they can be", still().args(["--technique=rays", "--size=60000x60000", "-o", &out()]), 2),
        ("rays with samples", still().args(["--technique=rays", "--samples=4", "-o", &out()]), 2),
        ("a device's rays of a mesh", still().args(["--technique=mesh", "--rays=compute", "-o", &out()]), 2),
        (
            "samples of a device's rays",
            still().args(["--technique=rays", "--rays=compute", "--samples=4", "-o", &out()]),
            2,
        ),
        ("a mesh of rays", still().args(["--technique=mesh", "--rays=mipmap", "-o", &out()]), 2),
        ("an output in no folder", still().args(["--size", "320x180", "-o", "/nonexistent/a.png"]), 2),
        ("a full disk", still().args(["--size", "320x180", "-o", "/dev/full"]), 1),
        (
            "no Vulkan device",
            still()
                .args(["--technique", "mesh", "--size", "320x180", "-o", &out()])
                .env("VK_ICD_FILENAMES", "/nonexistent.json"),
            1,
        ),
        ("no such world", Terravision::verb("fly").args(["/nonexistent.tv", "-o"]).arg(folder.join("a/")), 2),
        ("a folder that is no world", Terravision::verb("fly").arg(folder.path()).arg("-o").arg(folder.join("a/")), 2),
    ];
    for (name, command, code) in cases {
        let finished = command.run();
        println!("{name}: {:?} {}", finished.code(), finished.stderr.trim());
        // Some failures are found by one program and some by another: 1 or 2, never a panic, never
        // silence.
        assert!(matches!(finished.code(), Some(1 | 2)), "{name}: {} {}", finished.status, finished.stderr);
        assert_eq!(finished.code(), Some(code), "{name}: {}", finished.stderr);
        finished.assert_told(code);
        let lines = finished.stderr.lines().filter(|line| !line.trim().is_empty()).count();
        assert!(lines <= 4, "{name}: more than a sentence:\n{}", finished.stderr);
    }
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().flatten().map(|e| e.file_name()).collect();
    assert!(left.is_empty(), "failed runs left {left:?}");
}
