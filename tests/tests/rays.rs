//! Flights drawn by rays: the picture of the mesh, with and without Vulkan, the same bytes for any
//! number of workers.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::fs;
use terravision_testkit::metrics::median_absolute_error;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::{Shot, oblique_poses, read_report};
use terravision_tests::worlds::synth_world;

/// No Vulkan driver, as the loader sees it.
const NO_DRIVERS: [&str; 2] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];

fn without_vulkan(command: Terravision) -> Terravision {
    NO_DRIVERS.iter().fold(command, |command, name| command.env(name, "/nonexistent.json"))
}

#[test]
fn rays_show_what_the_mesh_shows() {
    let world = synth_world(1024);
    for (name, pose) in oblique_poses(&world).into_iter().take(2) {
        let shot = Shot { size: [640, 360], ..Shot::new(&world, pose) };
        let mesh = shot.take(&["--technique", "mesh"], true);
        assert_eq!((&mesh.report["technique"], &mesh.report["settled"]), (&"mesh".into(), &true.into()));
        for (way, device) in [("mipmap", "CPU, "), ("compute", mesh.report["device"].as_str().unwrap())] {
            let name = format!("{name}, {way}");
            let rays = shot.take(&["--technique", "rays", "--rays", way], true);
            assert_eq!((&rays.report["technique"], &rays.report["settled"]), (&"rays".into(), &true.into()), "{name}");
            assert!(rays.report["device"].as_str().unwrap().starts_with(device), "{name}: {}", rays.report["device"]);
            assert!(rays.report["driver"].as_str().unwrap().contains(way), "{name}: {}", rays.report["driver"]);
            let pairs = || mesh.depth.iter().copied().zip(rays.depth.iter().copied());
            let error = median_absolute_error(pairs());
            assert!(error < 0.01, "{name}: depth is {error} m off");
            let torn = pairs().filter(|(a, b)| a.is_nan() != b.is_nan() || (a - b).abs() > 0.01 * a.abs()).count();
            assert!(torn * 500 < mesh.depth.len(), "{name}: {torn} pixels see something else");
            let far = mesh.rgb.iter().zip(&rays.rgb).filter(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > 40)).count();
            assert!(far * 200 < mesh.rgb.len(), "{name}: {far} pixels have another colour");
            // Ground positions come from depth: where rays meet the ground, within a texel.
            let grounds = mesh.ground.iter().zip(&rays.ground).filter(|(a, _)| !a[2].is_nan());
            let near = grounds.clone().filter(|(a, b)| (0..3).all(|c| (a[c] - b[c]).abs() < 1.0)).count();
            assert!(near * 100 > grounds.count() * 95, "{name}: {near} pixels see the same place");
        }
    }
}

#[test]
fn without_a_vulkan_device_rays_are_swept_as_without_a_gpu() {
    let world = synth_world(1024);
    let shot = Shot { size: [320, 180], ..Shot::new(&world, oblique_poses(&world)[0].1) };
    let folder = TestFolder::new("no-vulkan");
    let finished = without_vulkan(shot.command(&folder)).run();
    finished.assert_code(0);
    // Nothing out of the ordinary: the report says why.
    assert!(!finished.stderr.contains("warning"), "{}", finished.stderr);
    let report = read_report(&folder);
    assert_eq!((&report["technique"], &report["settings"]["facet_px"]), (&"rays".into(), &3.0.into()));
    assert_eq!(report["technique_reason"], "there is no Vulkan device that can be used");
    let alone = fs::read(folder.join("a.png")).unwrap();
    for asked in [["--technique", "rays"], ["--rays", "sweep"]] {
        without_vulkan(shot.command(&folder)).args(asked).succeed();
        assert_eq!(read_report(&folder)["technique_reason"], "asked for");
        assert!(alone == fs::read(folder.join("a.png")).unwrap(), "the same picture");
    }
    let mesh = without_vulkan(shot.command(&folder)).args(["--technique", "mesh"]).run();
    mesh.assert_told(1);
    assert!(mesh.stderr.contains("no Vulkan device was found"), "{}", mesh.stderr);
    let device = without_vulkan(shot.command(&folder)).args(["--technique", "rays", "--rays", "compute"]).run();
    device.assert_told(1);
    assert!(device.stderr.contains("no Vulkan device was found"), "{}", device.stderr);
    // The leaves are outlined without a device too.
    without_vulkan(shot.command(&folder)).args(["--technique", "rays", "--overlay", "tree"]).succeed();
    assert!(alone != fs::read(folder.join("a.png")).unwrap());
    // What rays do not have is reported when they were not requested.
    let samples = without_vulkan(shot.command(&folder)).args(["--samples", "4"]).run();
    samples.assert_told(0);
    assert!(samples.stderr.contains("one ray is cast per pixel"), "{}", samples.stderr);
    assert_eq!(read_report(&folder)["settings"]["samples"], 1);
    // Who says how rays are cast wants rays.
    without_vulkan(shot.command(&folder)).args(["--rays", "mipmap"]).succeed();
    assert_eq!(
        (&read_report(&folder)["technique"], &read_report(&folder)["settings"]["facet_px"]),
        (&"rays".into(), &10.0.into())
    );
    let doctor = without_vulkan(Terravision::verb("doctor").args(["--memory", "64MiB"])).run();
    let words = String::from_utf8_lossy(&doctor.stdout);
    assert!(words.contains("flights sweep the ground by rays"), "{words}");
}

#[test]
fn what_draws_is_chosen_by_the_device_unless_something_is_asked_for_that_it_alone_has() {
    let world = synth_world(1024);
    let shot = Shot { size: [320, 180], ..Shot::new(&world, oblique_poses(&world)[0].1) };
    let take = |arguments: &[&str]| shot.take(arguments, false);
    let mesh = take(&["--technique", "mesh"]);
    let default = take(&[]);
    // The picture of a GPU, or that of a processor.
    let is_gpu = default.report["technique"] == "mesh";
    let reason = if is_gpu { "there is a GPU" } else { "there is no GPU, only a Vulkan device in software" };
    assert_eq!(default.report["technique_reason"], reason, "{}", default.report);
    let swept = take(&["--rays", "sweep"]);
    assert!(default.rgb == if is_gpu { mesh.rgb } else { swept.rgb }, "{}", default.report);
    for (arguments, reason) in [
        (&["--samples", "4"][..], "several samples a pixel were asked for, which only the mesh has"),
        (&["--texture-compression", "on"], "compressed colour tiles were asked for, which only a device reads"),
        (&["--validation"], "the validation layer was asked for, which watches a Vulkan device"),
    ] {
        let report = take(arguments).report;
        assert_eq!((&report["technique"], &report["technique_reason"]), (&"mesh".into(), &reason.into()));
        assert_eq!(report["settings"]["facet_px"], 10.0, "{arguments:?}");
    }
    // Whatever else there is works with what draws.
    for arguments in [&["--overlay", "tree"][..], &["--quality", "best"], &["--samples", "1"], &["--edge", "none"]] {
        assert_eq!(take(arguments).report["technique"], default.report["technique"], "{arguments:?}");
    }
}

/// A barrel roll: forwards, with one full turn to the right.
fn write_roll(folder: &TestFolder, frames: u32) {
    let world = synth_world(1024);
    let pose = |k: u32| {
        let t = f64::from(k) / f64::from(frames);
        Pose { roll: 360.0 * t, ..Pose::new(world.above(0.4 + 0.1 * t, 0.3 + 0.2 * t, 500.0), 25.0, -22.0) }
    };
    let poses: Vec<Pose> = (0..frames).map(pose).collect();
    write_path(&folder.join("path.json"), &poses, [320, 200], 60.0);
}

fn fly(folder: &TestFolder, output: &str, arguments: &[&str]) -> Terravision {
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join(output))
        .arg("--report")
        .arg(folder.join("report.json"))
        .args(["--technique", "rays"])
        .args(arguments)
}

#[test]
fn a_barrel_roll_has_the_same_bytes_for_any_number_of_workers() {
    const FRAMES: u32 = 6;
    let folder = TestFolder::new("roll");
    write_roll(&folder, FRAMES);
    for rays in ["mipmap", "coherent", "sweep"] {
        for workers in ["1", "3"] {
            fly(&folder, &format!("{rays}-{workers}/"), &["--rays", rays, "--threads", workers]).succeed();
            let report = read_report(&folder);
            assert_eq!(report["settled"], true, "{report}");
            assert!(report["driver"].as_str().unwrap().starts_with(rays), "{report}");
        }
        for frame in 0..FRAMES {
            let [one, three] = ["1", "3"]
                .map(|workers| fs::read(folder.join(format!("{rays}-{workers}/frame-{frame:06}.png"))).unwrap());
            assert!(one == three, "{rays}, frame {frame}");
        }
    }
    // In exact mode the choice is not left to the clock.
    fly(&folder, "auto/", &["--rays", "auto", "--frames", "0..1"]).succeed();
    let [auto, mipmap] = ["auto", "mipmap-1"].map(|way| fs::read(folder.join(way).join("frame-000000.png")).unwrap());
    assert!(auto == mipmap);
}

#[test]
fn a_realtime_flight_of_rays_comes_to_its_end_and_says_how_it_was_cast() {
    let folder = TestFolder::new("rays-realtime");
    write_roll(&folder, 20);
    let finished = fly(&folder, "live/", &["--rays", "auto", "--mode", "realtime", "--fps", "10"]).succeed();
    let report = read_report(&folder);
    assert_eq!((&report["technique"], &report["frames"]), (&"rays".into(), &20.into()), "{report}");
    // What was chosen, or that nothing was, is said once.
    let driver = report["driver"].as_str().unwrap();
    assert!(driver.contains("tried on one frame") || driver.starts_with("not tried yet"), "{report}");
    let told: Vec<&str> = finished.stderr.lines().filter(|line| line.contains("--rays auto")).collect();
    assert!(told.len() == 1 && told[0].ends_with(driver), "{told:?}, {driver}");
}

/// Eyes beside the world to which walls are in sight, and the edge of the ground above them is not.
#[test]
fn walls_are_drawn_under_ground_that_is_out_of_sight() {
    let world = synth_world(1024);
    // In the middle of the south and of the east side.
    let (south, east) = (world.above(0.5, 0.0, -120.0), world.above(1.0, 0.5, -80.0));
    let beside = |[x, y, z]: [f64; 3], [dx, dy]: [f64; 2]| [x + dx, y + dy, z];
    let level = Pose::new(beside(south, [0.0, -60.0]), 0.0, -10.0);
    let along = Pose { roll: 50.0, ..Pose::new(beside(south, [0.0, -100.0]), 60.0, -5.0) };
    let down = Pose::new(beside(east, [20.0, 0.0]), 200.0, -45.0);
    let is_wall = |rgb: &&[u8; 3]| [[102, 91, 79], [93, 82, 71], [122, 108, 94], [81, 71, 62]].contains(*rgb);
    for (name, pose) in [("level", level), ("along", along), ("down", down)] {
        let shot = Shot { size: [320, 180], ..Shot::new(&world, pose) };
        let ways: [&[&str]; 3] = [&["--technique=mesh"], &["--rays=mipmap"], &["--rays=sweep"]];
        let walls =
            ways.map(|way| shot.take(&[way, &["--facet-px=3"]].concat(), false).rgb.iter().filter(is_wall).count());
        println!("{name}: {walls:?} pixels of walls");
        assert!(walls[0] > 320 * 180 / 8, "{name}: {walls:?}");
        assert!(walls.iter().all(|count| count.abs_diff(walls[0]) * 100 < walls[0]), "{name}: {walls:?}");
    }
}
