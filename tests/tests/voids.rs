//! Rasters with gaps, from the file to depth and ground positions: what is drawn, and what is told
//! of it.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use terravision_common::shm::SharedFrame;
use terravision_common::surface::facet::facet_linear;
use terravision_testkit::floats::read_floats;
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::geotiff::write_heights;
use terravision_tests::live::{reader, shared_name};
use terravision_tests::process::Terravision;

const POSTS: usize = 129;
const SPACING_M: f64 = 10.0;
const ORIGIN: [f64; 2] = [500_000.0, 5_000_000.0];
const HEIGHT_M: f32 = 300.0;
const SIDE: usize = 160;
const SKY: [u8; 3] = [255, 0, 255];

/// The corner that a rotated raster leaves open.
fn is_rim(i: usize, j: usize) -> bool {
    3 * i + j < 150
}

/// A gap inside.
fn is_gap(i: usize, j: usize) -> bool {
    (70..=95).contains(&i) && (60..=80).contains(&j)
}

fn plain(_: usize, _: usize) -> f32 {
    HEIGHT_M
}

fn rough(i: usize, j: usize) -> f32 {
    let noise = (i * 7919 + j * 104_729) % 997;
    HEIGHT_M + 60.0 * ((i as f32 * 0.11).sin() * (j as f32 * 0.07).cos()) + 0.012 * noise as f32
}

/// Ground with both.
fn ingest(folder: &TestFolder, voids: &str, height: fn(usize, usize) -> f32) -> (std::path::PathBuf, String) {
    let is_void = |i: usize, j: usize| is_rim(i, j) || is_gap(i, j);
    let post = |i: usize, j: usize| if is_void(i, j) { f32::NAN } else { height(i, j) };
    let posts: Vec<f32> = (0..POSTS * POSTS).map(|k| post(k % POSTS, k / POSTS)).collect();
    write_heights(&folder.join("dem.tif"), POSTS, POSTS, ORIGIN, SPACING_M, &posts);
    let world = folder.join(format!("{voids}.tv"));
    let said = Terravision::verb("ingest")
        .arg("--elevation")
        .arg(folder.join("dem.tif"))
        .arg("-o")
        .arg(&world)
        .args(["--voids", voids])
        .succeed();
    (world, said.stderr)
}

/// Straight down on the middle.
fn pose() -> Pose {
    let middle = 0.5 * SPACING_M * (POSTS - 1) as f64;
    Pose::new([ORIGIN[0] + middle, ORIGIN[1] + middle, f64::from(HEIGHT_M) + 1000.0], 0.0, -90.0)
}

/// Of each pixel, whether it looks at what `is` says of posts; at its edge, within a pixel, nothing
/// is said.
fn looked_at(is: fn(usize, usize) -> bool) -> Vec<Option<bool>> {
    let metres_per_pixel = 2.0 * 1000.0 * 30f64.to_radians().tan() / SIDE as f64;
    let share = |column: f64, row: f64| {
        let middle = 0.5 * (POSTS - 1) as f64;
        let at = |v: f64| middle + v * metres_per_pixel / SPACING_M;
        let (x, y) = (at(column - SIDE as f64 / 2.0), at(SIDE as f64 / 2.0 - row));
        let (i, j) = (x.floor(), y.floor());
        let post = |i: f64, j: f64| f64::from(u8::from(i >= 0.0 && j >= 0.0 && is(i as usize, j as usize)));
        facet_linear(post(i, j), post(i + 1.0, j), post(i, j + 1.0), post(i + 1.0, j + 1.0), x - i, y - j)
    };
    let pixel = |k: usize| {
        let near = [-1.0, 0.0, 1.0].map(|v| v + 0.5);
        let around =
            near.into_iter().flat_map(|v| near.map(|u| share((k % SIDE) as f64 + u, (k / SIDE) as f64 + v) > 0.5));
        let (mut any, mut all) = (false, true);
        around.for_each(|is| (any, all) = (any || is, all && is));
        (any == all).then_some(all)
    };
    (0..SIDE * SIDE).map(pixel).collect()
}

/// Each pixel as it is expected, where something is.
fn assert_pixels(what: &str, found: &[bool], expected: &[Option<bool>]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let wrong = found.iter().zip(expected).filter(|(found, expected)| expected.is_some_and(|is| is != **found)).count();
    let count = expected.iter().filter(|expected| **expected == Some(true)).count();
    assert!(wrong == 0 && count > 100, "{what}: {wrong} pixels are wrong, {count} were expected");
}

struct Taken {
    is_sky: Vec<bool>,
    /// Bands of depth and of ground.
    depth: Vec<Vec<f64>>,
    ground: Vec<Vec<f64>>,
}

/// From above, with the finest posts: those of coarser levels round the corners of holes off.
fn still(folder: &TestFolder, world: &std::path::Path, more: &[&str]) -> Taken {
    still_from(folder, world, pose(), &[&["--facet-px=1"], more].concat())
}

fn still_from(folder: &TestFolder, world: &std::path::Path, pose: Pose, more: &[&str]) -> Taken {
    let [picture, depth, ground] = ["a.png", "depth.tif", "ground.tif"].map(|name| folder.join(name));
    Terravision::verb("still")
        .arg(world)
        .args(pose.arguments())
        .args([format!("--size={SIDE}x{SIDE}"), "--sky=255,0,255".to_owned(), "--vfov=60".to_owned()])
        // One sample a pixel: sky is the colour of sky.
        .arg("--quality=default")
        .args(more)
        .arg("-o")
        .arg(&picture)
        .arg("--depth")
        .arg(&depth)
        .arg("--ground")
        .arg(&ground)
        .succeed();
    let bands = |path| {
        let (width, height, values) = read_floats(path).unwrap();
        let count = values.len() / (width * height);
        (0..count).map(|band| values.iter().skip(band).step_by(count).copied().collect()).collect()
    };
    let (_, _, rgb) = read_png(&picture);
    Taken { is_sky: rgb.into_iter().map(|rgb| rgb == SKY).collect(), depth: bands(&depth), ground: bands(&ground) }
}

fn is_nan(values: &[f64]) -> Vec<bool> {
    values.iter().map(|value| value.is_nan()).collect()
}

#[test]
fn what_was_made_up_is_told_from_what_was_measured_and_holes_are_sky() {
    let folder = TestFolder::new("voids");
    let [rim, gap] = [looked_at(is_rim), looked_at(is_gap)];
    let both: Vec<_> = rim.iter().zip(&gap).map(|(rim, gap)| rim.zip(*gap).map(|(rim, gap)| rim || gap)).collect();
    let nothing = vec![Some(false); SIDE * SIDE];
    for (voids, said, holes, made_up) in [
        ("fill", "filled", &nothing, &both),
        ("keep", "left without ground", &both, &nothing),
        ("clip", "at their corners", &rim, &gap),
    ] {
        let (world, stderr) = ingest(&folder, voids, plain);
        assert!(stderr.contains(said), "{stderr}");
        let info = String::from_utf8(Terravision::verb("info").arg(&world).succeed().stdout).unwrap();
        assert!(info.contains("without data") && info.contains(&format!("--voids {voids}")), "{info}");
        // Beyond the world's border there is sky as well.
        let beyond = looked_at(|i, j| i >= POSTS || j >= POSTS);
        let is_inside = |expected: &[Option<bool>]| -> Vec<Option<bool>> {
            expected.iter().zip(&beyond).map(|(is, beyond)| is.filter(|_| *beyond == Some(false))).collect()
        };
        for technique in [
            &["--technique=mesh"][..],
            &["--rays=mipmap"],
            &["--rays=coherent"],
            &["--rays=compute"],
            &["--rays=sweep"],
        ] {
            let what = format!("{voids} {technique:?}");
            let taken = still(&folder, &world, technique);
            let is_told: Vec<_> = holes.iter().zip(made_up).map(|(h, m)| h.zip(*m).map(|(h, m)| h || m)).collect();
            if voids != "fill" {
                assert_pixels(&format!("{what}: sky"), &taken.is_sky, &is_inside(holes));
            }
            assert_eq!((taken.depth.len(), taken.ground.len()), (1, 3));
            for band in taken.depth.iter().chain(&taken.ground) {
                assert_pixels(&format!("{what}: no number"), &is_nan(band), &is_inside(&is_told));
            }
            let marked = still(&folder, &world, &[technique, &["--made-up=mark"]].concat());
            assert_eq!((marked.depth.len(), marked.ground.len()), (2, 4));
            assert!(
                marked.depth[0].iter().zip(&marked.is_sky).all(|(depth, is_sky)| depth.is_nan() == *is_sky),
                "{what}"
            );
            for marks in [&marked.depth[1], &marked.ground[3]] {
                let is_zero: Vec<bool> = marks.iter().map(|mark| *mark == 0.0).collect();
                if voids != "keep" {
                    assert_pixels(&format!("{what}: marks"), &is_zero, &is_inside(made_up));
                }
                assert!(voids != "keep" || !is_zero.contains(&true), "{what}: all that is drawn was measured");
                assert!(marks.iter().zip(&marked.is_sky).all(|(mark, is_sky)| mark.is_nan() == *is_sky), "{what}");
            }
        }
    }
}

#[test]
fn shared_frames_tell_what_was_made_up() {
    let (folder, name) = (TestFolder::new("shared-voids"), shared_name("voids"));
    let (world, _) = ingest(&folder, "clip", plain);
    write_path(&folder.join("path.json"), &[pose()], [SIDE as u32; 2], 60.0);
    let mut flight = Terravision::verb("fly")
        .arg(&world)
        .arg("--path")
        .arg(folder.join("path.json"))
        .args(["-o", &format!("shared:{name}"), "--depth", "--ground", "--made-up=mark", "--facet-px=1"])
        .spawn();
    let (mut ring, mut shared) = (reader(&mut flight, &name), SharedFrame::default());
    flight.until("the frame", |_| ring.read(&mut shared).unwrap().then_some(()));
    flight.wait().assert_code(0);
    let is_made_up: Vec<bool> = shared.rgba.chunks_exact(4).map(|texel| texel[3] == 254).collect();
    assert_pixels("marks", &is_made_up, &looked_at(is_gap));
    assert!(shared.rgba.chunks_exact(4).all(|texel| texel[3] >= 254));
    let has_depth: Vec<bool> = shared.depth.iter().map(|depth| depth.is_finite()).collect();
    assert!(is_made_up.iter().zip(&has_depth).all(|(is_made_up, has_depth)| !is_made_up || *has_depth));
}

/// Facets of ten pixels, of several levels in one picture: nothing opens but at holes, where they
/// are within a facet's size.
#[test]
fn no_sky_is_seen_away_from_holes() {
    let folder = TestFolder::new("void-cracks");
    let [filled, holed] = ["fill", "keep"].map(|voids| ingest(&folder, voids, rough).0);
    let at = |x: f64, y: f64, z: f64| [ORIGIN[0] + x, ORIGIN[1] + y, f64::from(HEIGHT_M) + z];
    let poses = [
        Pose::new(at(640.0, 150.0, 420.0), 10.0, -35.0),
        Pose::new(at(900.0, 200.0, 110.0), 350.0, -8.0),
        Pose { roll: 40.0, ..Pose::new(at(1100.0, 900.0, 260.0), 230.0, -25.0) },
    ];
    let distance_m = |x: f64, y: f64| {
        let (i, j) = ((x - ORIGIN[0]) / SPACING_M, (y - ORIGIN[1]) / SPACING_M);
        let void = |k: usize| is_rim(k % POSTS, k / POSTS) || is_gap(k % POSTS, k / POSTS);
        let voids = (0..POSTS * POSTS).filter(|k| void(*k));
        voids.map(|k| ((k % POSTS) as f64 - i).hypot((k / POSTS) as f64 - j)).fold(f64::INFINITY, f64::min) * SPACING_M
    };
    for pose in poses {
        for technique in [&["--technique=mesh"][..], &["--rays=mipmap"], &["--rays=compute"], &["--rays=sweep"]] {
            let [whole, holed] = [(&filled, "--made-up=mark"), (&holed, "--made-up=nan")]
                .map(|(world, made_up)| still_from(&folder, world, pose, &[technique, &[made_up]].concat()));
            let opened: Vec<usize> = (0..SIDE * SIDE).filter(|k| holed.is_sky[*k] && !whole.is_sky[*k]).collect();
            // Facets reach 10 pixels, and far ones are larger; a diagonal more.
            let is_away = |k: &&usize| {
                let reach_m = (2.0 * 10.0 * whole.depth[0][**k] * 2.0 * 30f64.to_radians().tan() / SIDE as f64)
                    .max(2.0 * SPACING_M);
                distance_m(whole.ground[0][**k], whole.ground[1][**k]) > reach_m
            };
            let cracks = opened.iter().filter(is_away).count();
            assert!(
                opened.len() > 150 && cracks == 0,
                "{pose:?} {technique:?}: {cracks} of {} are cracks",
                opened.len()
            );
        }
    }
}

/// Rays by a sweep against exact ones: through holes, and from beside the world, where ground is seen
/// from below.
#[test]
fn a_sweep_sees_through_holes_what_exact_rays_see() {
    let folder = TestFolder::new("void-sweep");
    // Wider than tiles: the west, and a strip in the middle.
    let is_void = |i: usize, j: usize| i < 36 || ((60..100).contains(&j) && i > 80) || is_gap(i, j);
    let posts: Vec<f32> = (0..POSTS * POSTS)
        .map(|k| (k % POSTS, k / POSTS))
        .map(|(i, j)| if is_void(i, j) { f32::NAN } else { rough(i, j) })
        .collect();
    write_heights(&folder.join("dem.tif"), POSTS, POSTS, ORIGIN, SPACING_M, &posts);
    let world = folder.join("w.tv");
    let dem = folder.join("dem.tif");
    let ingest =
        Terravision::verb("ingest").arg("--elevation").arg(&dem).args(["--voids", "keep", "--elevation-tile=16"]);
    ingest.arg("-o").arg(&world).succeed();
    let at = |x: f64, y: f64, z: f64| [ORIGIN[0] + x, ORIGIN[1] + y, f64::from(HEIGHT_M) + z];
    let poses = [
        Pose::new(at(640.0, 150.0, 420.0), 350.0, -35.0),
        Pose { roll: 40.0, ..Pose::new(at(1100.0, 1000.0, 200.0), 230.0, -20.0) },
        // From the west, across the hole: from above, from below, and up to the ground's underside.
        Pose::new(at(-300.0, 640.0, 200.0), 90.0, -12.0),
        Pose::new(at(-300.0, 640.0, -200.0), 90.0, 5.0),
        Pose { roll: -30.0, ..Pose::new(at(-100.0, 500.0, -700.0), 80.0, 40.0) },
    ];
    for pose in poses {
        let [swept, exact] = ["--rays=sweep", "--rays=mipmap"]
            .map(|rays| still_from(&folder, &world, pose, &["--facet-px=1", "--made-up=mark", rays]));
        let is_other = |k: &usize| {
            let [a, b] = [&swept, &exact].map(|taken| taken.depth[0][*k]);
            a.is_nan() != b.is_nan() || (a - b).abs() > 0.03 * b
        };
        let (others, ground) =
            ((0..SIDE * SIDE).filter(is_other).count(), exact.is_sky.iter().filter(|is_sky| !**is_sky).count());
        // Those along silhouettes, of which a ground full of holes has many.
        assert!(ground > 2000 && others * 50 < SIDE * SIDE, "{pose:?}: {others} of {ground} pixels see something else");
        let best = still_from(&folder, &world, pose, &["--quality=best", "--made-up=mark", "--rays=sweep"]);
        // Not next to ground, sky is sky: hidden borders of holes are no edges.
        let is_ground_near = |k: usize| {
            let near = |v: usize| v.saturating_sub(1)..=(v + 1).min(SIDE - 1);
            near(k / SIDE).any(|row| near(k % SIDE).any(|column| !best.depth[0][row * SIDE + column].is_nan()))
        };
        let lines = (0..SIDE * SIDE).filter(|k| !best.is_sky[*k] && !is_ground_near(*k)).count();
        assert!(lines < 10, "{pose:?}: {lines} pixels of sky have another color");
    }
}

#[test]
fn info_of_a_world_with_voids_names_points_that_were_measured() {
    let folder = TestFolder::new("voids-info");
    for voids in ["clip", "fill", "keep"] {
        let (world, _) = ingest(&folder, voids, rough);
        let told = Terravision::verb("info").arg(&world).arg("--json").succeed().stdout;
        let info: serde_json::Value = serde_json::from_slice(&told).unwrap();
        let highest = &info["highest"];
        let [x, y] = [0, 1].map(|axis| highest["place"][axis].as_f64().unwrap_or(f64::NAN));
        let (i, j) = (((x - ORIGIN[0]) / SPACING_M).round() as usize, ((y - ORIGIN[1]) / SPACING_M).round() as usize);
        assert!(!is_rim(i, j) && !is_gap(i, j), "{voids}: {highest}");
        assert!(
            (highest["height_m"].as_f64().unwrap_or(0.0) - f64::from(rough(i, j))).abs() < 0.01,
            "{voids}: {highest}"
        );
    }
}
