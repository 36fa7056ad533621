//! Light and air: the same whatever draws, for any number of workers and any instructions, once on
//! a tint; labels; and what cannot be.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use std::fs;
use terravision_common::database::Manifest;
use terravision_tests::flight::{Pose, read_png};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::{Shot, oblique_poses};
use terravision_tests::worlds::{TestWorld, synth_world};

const MORNING: [&str; 5] = ["--sun=120,12", "--shadows", "--haze", "12km", "--edge=none"];

fn far_apart(a: &[[u8; 3]], b: &[[u8; 3]], by: u8) -> usize {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).filter(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > by)).count()
}

fn is_white(rgb: [u8; 3]) -> bool {
    rgb.iter().all(|value| *value > 225)
}

fn taken(shot: &Shot<'_>, arguments: &[&str]) -> Vec<[u8; 3]> {
    shot.take(arguments, false).rgb
}

#[test]
fn all_that_draws_has_the_same_light_and_air() {
    let world = synth_world(1024);
    let (_, pose) = oblique_poses(&world)[0];
    // Low enough for a skyline.
    let shot = Shot { size: [480, 270], ..Shot::new(&world, Pose { pitch: -6.0, ..pose }) };
    let of = |technique: &[&str], lit: bool| {
        let more = if lit { &MORNING[..] } else { &["--edge=none"] };
        taken(&shot, &[technique, more].concat())
    };
    let [plain, mesh] = [false, true].map(|lit| of(&["--technique", "mesh"], lit));
    assert!(far_apart(&plain, &mesh, 25) > mesh.len() / 2, "light makes a difference");
    for way in ["sweep", "mipmap", "coherent", "compute"] {
        let rays = ["--technique", "rays", "--rays", way];
        let [before, after] = [(false, &plain), (true, &mesh)].map(|(lit, mesh)| far_apart(&of(&rays, lit), mesh, 40));
        // Edges that are elsewhere, as without light.
        assert!(
            after * 200 < mesh.len() && after <= before + mesh.len() / 400,
            "{way}: {before}, {after} pixels differ"
        );
    }
    // Four samples: skylines are smooth, and the same inside.
    let samples = of(&["--technique", "mesh", "--samples", "4"], true);
    assert!(far_apart(&samples, &mesh, 40) * 40 < mesh.len());
}

#[test]
fn bytes_depend_neither_on_workers_nor_on_instructions() {
    let world = synth_world(1024);
    let shot = Shot { size: [320, 180], ..Shot::new(&world, oblique_poses(&world)[2].1) };
    let folder = TestFolder::new("light-bytes");
    let drawn = |technique: &str, threads: &str, instructions: &str| {
        let command = shot.command(&folder).args(MORNING).args(technique.split(' ')).args(["--threads", threads]);
        command.env("TERRAVISION_INSTRUCTIONS", instructions).succeed();
        fs::read(folder.join("a.png")).unwrap()
    };
    for technique in ["--technique mesh", "--rays sweep", "--rays mipmap", "--rays coherent"] {
        let first = drawn(technique, "1", "portable");
        for (threads, instructions) in [("2", "portable"), ("3", "avx2"), ("1", "avx-512")] {
            assert!(first == drawn(technique, threads, instructions), "{technique}, {threads}, {instructions}");
        }
    }
}

/// Pixels of two pictures that are not sky in the first one, and how many there are.
fn land_of(first: &[[u8; 3]], second: &[[u8; 3]], sky: [u8; 3]) -> ([Vec<[u8; 3]>; 2], usize) {
    let pairs = first.iter().zip(second).filter(|(a, _)| **a != sky);
    let (a, b): (Vec<[u8; 3]>, Vec<[u8; 3]>) = pairs.map(|(a, b)| (*a, *b)).unzip();
    let land = a.len();
    ([a, b], land)
}

#[test]
fn a_tint_is_lit_once_and_auto_is_the_light_that_it_has() {
    let world = synth_world(1024);
    let folder = TestFolder::new("light-tint");
    for file in ["dem.tif", "ortho.tif"] {
        fs::copy(world.database().with_file_name(file), folder.join(file)).unwrap();
    }
    let database = folder.join("world.tv");
    Terravision::verb("ingest").arg("--elevation").arg(folder.join("dem.tif")).arg("-o").arg(&database).succeed();
    let tinted = TestWorld::at(folder.path());
    let shot = Shot { size: [480, 270], ..Shot::new(&tinted, oblique_poses(&world)[0].1) };
    let mesh = ["--technique", "mesh"];
    let stored = taken(&shot, &mesh);
    let auto = taken(&shot, &[&mesh[..], &["--sun", "auto"]].concat());
    // With a sun the sky has a gradient.
    let sky = stored[0];
    let ([stored_land, auto_land], land) = land_of(&stored, &auto, sky);
    assert!(land * 2 > stored.len(), "{land} pixels of land");
    let apart = far_apart(&stored_land, &auto_land, 24);
    assert!(apart * 50 < land, "{apart} of {land}");
    // The other way round what was bright is dark.
    let south_east = taken(&shot, &[&mesh[..], &["--sun", "135,45"]].concat());
    assert!(far_apart(&stored, &south_east, 40) * 5 > stored.len());
    assert_eq!(taken(&shot, &[&mesh[..], &["--sun", "off"]].concat()), stored);
}

#[test]
fn labels_are_burnt_into_files_and_cover_nothing_else() {
    let world = synth_world(1024);
    let shot = Shot { size: [480, 270], ..Shot::new(&world, oblique_poses(&world)[0].1) };
    let plain = taken(&shot, &["--rays", "sweep"]);
    let all = ["--rays", "sweep", "--label", "Ålpine, 1:1", "--scale-bar", "--north-arrow", "--clock"];
    let labelled = taken(&shot, &all);
    let is_ink = |x: usize, y: usize| labelled[y * 480 + x] != plain[y * 480 + x] && is_white(labelled[y * 480 + x]);
    for (name, [x, y]) in [("clock", [0, 0]), ("arrow", [400, 0]), ("text", [0, 200]), ("bar", [360, 200])] {
        let ink = (0..70 * 80).filter(|k| is_ink(x + k % 80, y + k / 80)).count();
        assert!(ink > 30, "{name}: {ink} pixels");
    }
    let changed = plain.iter().zip(&labelled).filter(|(a, b)| a != b).count();
    assert!(changed < plain.len() / 20, "{changed} pixels");
    let middle = |of: &[[u8; 3]]| of[90 * 480..180 * 480].to_vec();
    assert!(middle(&plain) == middle(&labelled));
    // The clock of a flight goes on, in each frame of a folder.
    let folder = TestFolder::new("labels");
    let fly = |output: &str| {
        Terravision::verb("fly")
            .arg(world.database())
            .args(["--frames", "0..2", "--size", "240x136", "--fps", "2"])
            .args(["--rays", "sweep", "--clock", "-o"])
            .arg(folder.join(output))
    };
    fly("frames/").succeed();
    let corner = |frame: u32| {
        let (width, _, rgb) = read_png(&folder.join(format!("frames/frame-{frame:06}.png")));
        (0..24 * 90).map(|k| is_white(rgb[k / 90 * width + k % 90])).collect::<Vec<_>>()
    };
    assert!(corner(0) != corner(1) && corner(0).iter().filter(|ink| **ink).count() > 30);
}

#[test]
fn what_cannot_be_is_one_sentence() {
    let world = synth_world(1024);
    let shot = Shot { size: [64, 36], ..Shot::new(&world, oblique_poses(&world)[0].1) };
    let folder = TestFolder::new("light-bad");
    for (arguments, words) in [
        (&["--sun", "2026-02-30T10:00Z"][..], "a date and time"),
        (&["--sun", "noon"], "a date and time"),
        (&["--sun", "100,91"], "from -90 to 90 degrees"),
        (&["--haze", "0"], "at least 1 m"),
        (&["--haze", "nan"], "at least 1 m"),
        (&["--shadows"], "--shadows needs a sun"),
        (&["--label", "two\nlines"], "--label"),
    ] {
        let refused = shot.command(&folder).args(arguments).run();
        refused.assert_code(2);
        assert!(refused.stderr.contains(words), "{arguments:?}: {}", refused.stderr);
        assert!(!folder.join("a.png").exists());
    }
    let night = shot.command(&folder).args(["--sun", "2026-12-21T00:00Z"]).run();
    night.assert_code(0);
    assert!(night.stderr.contains("it is night: the sun is"), "{}", night.stderr);
    let ring = Terravision::verb("fly").arg(world.database()).args(["-o", "shared:light-labels", "--clock"]).run();
    ring.assert_code(2);
    assert!(ring.stderr.contains("labels"), "{}", ring.stderr);
}

#[test]
fn a_world_that_is_nowhere_has_no_time_of_day() {
    let world = synth_world(1024);
    let folder = TestFolder::new("light-nowhere");
    let copy = TestWorld::at(folder.path());
    fs::create_dir(copy.database()).unwrap();
    for entry in fs::read_dir(world.database()).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, copy.database().join(path.file_name().unwrap())).unwrap();
    }
    let manifest = copy.database().join("manifest.json");
    let mut fields = Manifest::parse(&fs::read_to_string(&manifest).unwrap()).unwrap().fields().clone();
    (fields.crs.proj4, fields.lonlat) = (None, None);
    fs::write(&manifest, fields.to_text().unwrap()).unwrap();
    let shot = Shot { size: [64, 36], ..Shot::new(&copy, oblique_poses(&world)[0].1) };
    let refused = shot.command(&folder).args(["--sun", "2026-06-21T12:00Z"]).run();
    refused.assert_code(2);
    assert!(refused.stderr.contains("does not say where on Earth it is"), "{}", refused.stderr);
    shot.command(&folder).args(["--sun", "120,12"]).succeed();
}
