//! A world of two spacings: 1 m over 200 m inside 30 m over 6 km. No crack and no step where the
//! finest levels end, by mesh and by rays, and an exact flight lacks nothing.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::path::{Path, PathBuf};
use std::time::Duration;
use terravision_testkit::floats::read_floats;
use terravision_tests::flight::{Pose, read_png};
use terravision_tests::folder::TestFolder;
use terravision_tests::geotiff::write_heights;
use terravision_tests::process::Terravision;
use terravision_tests::shot::read_report;

const COARSE: usize = 200;
const FINE: usize = 200;
/// The fine data's south west corner, metres from the coarse ones' first post.
const AT_M: [f64; 2] = [2900.0, 2800.0];
const ORIGIN: [f64; 2] = [500_000.0, 5_000_000.0];
/// Width of the pictures, pixels.
const WIDTH: usize = 480;
/// No ground has this colour.
const SKY: [u8; 3] = [255, 0, 255];

/// Hills of some hundred metres, and a ripple that only the fine data have.
fn ground(x: f64, y: f64) -> f64 {
    600.0 + 120.0 * (x / 700.0).sin() * (y / 900.0).cos() + 30.0 * (x / 170.0).cos() * (y / 210.0).sin()
}

fn ripple(x: f64, y: f64) -> f64 {
    1.5 * (x / 3.0).sin() * (y / 4.0).sin()
}

fn world(folder: &TestFolder) -> PathBuf {
    let posts = |side: usize, at: [f64; 2], spacing: f64, height: &dyn Fn(f64, f64) -> f64| -> Vec<f32> {
        let place = |k: usize, axis: usize| at[axis] + spacing * k as f64;
        (0..side * side).map(|k| height(place(k % side, 0), place(k / side, 1)) as f32).collect()
    };
    let coarse = posts(COARSE, [0.0; 2], 30.0, &ground);
    // Two metres higher: another survey.
    let fine = posts(FINE, AT_M, 1.0, &|x, y| ground(x, y) + ripple(x, y) + 2.0);
    let (coarse_file, fine_file) = (folder.join("coarse.tif"), folder.join("fine.tif"));
    write_heights(&coarse_file, COARSE, COARSE, ORIGIN, 30.0, &coarse);
    write_heights(&fine_file, FINE, FINE, [ORIGIN[0] + AT_M[0], ORIGIN[1] + AT_M[1]], 1.0, &fine);
    let database = folder.join("both.tv");
    Terravision::verb("ingest")
        .arg("--elevation")
        .arg(&fine_file)
        .arg(&coarse_file)
        .arg("-o")
        .arg(&database)
        .deadline(Duration::from_secs(600))
        .succeed();
    database
}

/// Views of the border: across it from within and from without, along it, from above and from close
/// by.
fn poses() -> Vec<Pose> {
    let [x, y] = [ORIGIN[0] + AT_M[0], ORIGIN[1] + AT_M[1]];
    let eye =
        |east: f64, north: f64, above: f64| [x + east, y + north, ground(AT_M[0] + east, AT_M[1] + north) + above];
    vec![
        Pose::new(eye(100.0, 100.0, 400.0), 0.0, -90.0),
        Pose::new(eye(-120.0, 100.0, 60.0), 90.0, -28.0),
        Pose::new(eye(100.0, 90.0, 25.0), 270.0, -32.0),
        Pose::new(eye(0.0, -60.0, 20.0), 0.0, -30.0),
        Pose::new(eye(3.0, 100.0, 9.0), 40.0, -50.0),
        Pose::new(eye(-600.0, -500.0, 500.0), 50.0, -35.0),
    ]
}

fn still(database: &Path, folder: &TestFolder, pose: &Pose, more: &[&str]) -> Vec<[u8; 3]> {
    Terravision::verb("still")
        .arg(database)
        .args(pose.arguments())
        .args(["--size=480x320", "--sky=255,0,255"])
        .args(more)
        .arg("-o")
        .arg(folder.join("a.png"))
        .arg("--ground")
        .arg(folder.join("g.tif"))
        .arg("--report")
        .arg(folder.join("report.json"))
        .succeed();
    let report = read_report(folder);
    assert_eq!((&report["settled"], &report["tiles"]["unavailable_count"]), (&true.into(), &0.into()), "{report}");
    read_png(&folder.join("a.png")).2
}

#[test]
fn info_tells_how_much_of_the_world_has_which_spacing() {
    let folder = TestFolder::new("sparse-info");
    let database = world(&folder);
    let told = Terravision::verb("info").arg(&database).arg("--json").succeed().stdout;
    let info: serde_json::Value = serde_json::from_slice(&told).unwrap();
    let parts: Vec<[f64; 2]> = info["spacings"]["elevation"]
        .as_array()
        .unwrap()
        .iter()
        .map(|part| [&part["spacing_m"], &part["share"]].map(|v| v.as_f64().unwrap()))
        .collect();
    assert!((parts.iter().map(|[_, share]| share).sum::<f64>() - 1.0).abs() < 1e-9, "{parts:?}");
    assert!(parts.windows(2).all(|pair| pair[0][0] < pair[1][0]), "{parts:?}");
    let world_m2 = ((COARSE - 1) as f64 * 30.0).powi(2);
    let [fine, last] = [parts[0], parts[parts.len() - 1]];
    // Whole tiles of 32 m and their siblings around what the fine data cover.
    let (least, most) = ((FINE as f64 - 1.0).powi(2) / world_m2, (FINE as f64 + 2.0 * 64.0).powi(2) / world_m2);
    assert!(fine[0] == 1.0 && (least..most).contains(&fine[1]), "{fine:?}, expected {least} to {most}");
    // A rim of every level in between lies around them.
    assert!(last[0] == 32.0 && last[1] > 0.6, "{last:?}");
    let text = String::from_utf8(Terravision::verb("info").arg(&database).succeed().stdout).unwrap();
    assert!(text.contains("spacing: 1 m over 0.") && text.contains("32 m over "), "{text}");
    // 30 m data are resampled to posts every 32 m: the files' range stands beside the world's where
    // they differ.
    let manifest = &info["manifest"]["elevation"];
    assert_eq!(text.contains("samples of the files"), manifest.get("source_range_m").is_some(), "{text}");
}

#[test]
fn no_crack_and_no_step_where_the_finest_levels_end() {
    let folder = TestFolder::new("sparse");
    let database = world(&folder);
    let mesh = ["--technique", "mesh"];
    let settings =
        [&mesh[..], &[&mesh[..], &["--facet-px", "2"]].concat(), &["--rays", "mipmap"], &["--rays", "sweep"]];
    for (number, pose) in poses().iter().enumerate() {
        for more in settings {
            let rgb = still(&database, &folder, pose, more);
            // Ground is a height field and the camera not rolled: below ground there is only
            // ground.
            let is_sky = |k: usize| rgb[k] == SKY;
            let above_ground = |k: usize| (0..k / WIDTH).any(|row| !is_sky(row * WIDTH + k % WIDTH));
            let holes = (0..rgb.len()).filter(|k| is_sky(*k) && above_ground(*k)).count();
            assert_eq!(holes, 0, "view {number} with {more:?}: sky is seen through the ground");
        }
    }
}

#[test]
fn heights_pass_from_one_spacing_to_the_other_without_a_step() {
    let folder = TestFolder::new("sparse");
    let database = world(&folder);
    let [x, y] = [ORIGIN[0] + AT_M[0], ORIGIN[1] + AT_M[1]];
    // From above the western border: 0.15 m a pixel, facets of one pixel.
    let pose = Pose::new([x, y + 100.0, ground(AT_M[0], AT_M[1] + 100.0) + 60.0], 0.0, -90.0);
    still(&database, &folder, &pose, &["--facet-px", "1"]);
    let (width, height, values) = read_floats(&folder.join("g.tif")).unwrap();
    let at = |k: usize| [values[3 * k] - ORIGIN[0], values[3 * k + 1] - ORIGIN[1], values[3 * k + 2]];
    let above = |k: usize| at(k)[2] - ground(at(k)[0], at(k)[1]);
    let (mut steepest, mut inside, mut outside) = (0.0f64, (0.0f64, 0.0f64), (0.0f64, 0.0f64));
    for k in (0..width * height).filter(|k| k % width > 0) {
        let run = (at(k)[0] - at(k - 1)[0]).hypot(at(k)[1] - at(k - 1)[1]);
        steepest = steepest.max((above(k) - above(k - 1)).abs() / run.max(0.05));
        let place = at(k)[0] - AT_M[0];
        if place > 18.0 {
            let error = above(k) - 2.0 - ripple(at(k)[0], at(k)[1]);
            inside = (inside.0 + error * error, inside.1 + 1.0);
        } else if place < -1.0 {
            outside = (outside.0 + above(k).powi(2), outside.1 + 1.0);
        }
    }
    let rms = |(sum, count): (f64, f64)| (sum / count).sqrt();
    println!("steepest {steepest:.2} m/m, RMS inside {:.3} m, outside {:.3} m", rms(inside), rms(outside));
    // The ripple rises by 0.5 m a metre, the passing over by 0.2.
    assert!(steepest < 1.0, "a step of {steepest} m a metre");
    assert!(inside.1 > 1000.0 && outside.1 > 1000.0);
    assert!(rms(inside) < 0.1 && rms(outside) < 0.5, "{} m inside, {} m outside", rms(inside), rms(outside));
}
