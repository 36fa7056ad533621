//! `--views` from the command line: one picture or several, depth and ground of each, and what it
//! refuses.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;
use terravision_testkit::floats::read_floats;
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::VFOV_DEG;
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [120, 90];

/// The pose's own camera, one 30 m to its right, and a small one that looks down.
const VIEWS: &str = r#""views": [
    {"name": "ahead"},
    {"name": "beside", "right_m": 30},
    {"name": "down", "pitch_deg": -90, "vfov_deg": 80, "width": 50, "height": 60}]"#;

fn pose(k: u64) -> Pose {
    let world = synth_world(1024);
    Pose::new(world.above(0.35 + 0.01 * k as f64, 0.35, 900.0), 30.0, -20.0)
}

fn rig(folder: &TestFolder, pictures: &str) -> std::path::PathBuf {
    let path = folder.join(format!("{pictures}.json"));
    std::fs::write(&path, format!(r#"{{"pictures": "{pictures}", {VIEWS}}}"#)).unwrap();
    path
}

fn still(folder: &TestFolder, output: &str) -> Terravision {
    let command = Terravision::verb("still").arg(synth_world(1024).database()).args(pose(0).arguments());
    command.args(["--size", "120x90", "--quality", "default", "-o"]).arg(folder.join(output))
}

fn part(path: &Path, at: [usize; 2], size: [usize; 2]) -> Vec<[u8; 3]> {
    let (width, _, rgb) = read_png(path);
    (at[1]..at[1] + size[1]).flat_map(|y| rgb[y * width + at[0]..][..size[0]].to_vec()).collect()
}

#[test]
fn a_still_of_several_views_is_one_picture_or_one_each() {
    let folder = TestFolder::new("views-still");
    let planes = |command: Terravision| {
        let depth = command.arg("--depth").arg(folder.join("d.tif"));
        depth.arg("--ground").arg(folder.join("g.tif"))
    };
    for technique in ["mesh", "rays"] {
        let of = |command: Terravision| command.args(["--technique", technique]);
        let together = of(still(&folder, "a.png")).arg("--views").arg(rig(&folder, "side-by-side"));
        planes(together).succeed();
        of(still(&folder, "b.png")).arg("--views").arg(rig(&folder, "separate")).succeed();
        let places = [("ahead", [0, 0], [120, 90]), ("beside", [120, 0], [120, 90]), ("down", [240, 0], [50, 60])];
        assert_eq!(read_png(&folder.join("a.png")).0, 290);
        for (name, at, size) in places {
            let (width, height, rgb) = read_png(&folder.join(format!("b-{name}.png")));
            assert_eq!([width, height], size);
            assert!(part(&folder.join("a.png"), at, size) == rgb, "{technique}: {name}");
            let (width, height, depth) = read_floats(&folder.join(format!("d-{name}.tif"))).unwrap();
            assert!(
                [width, height] == size && depth.iter().filter(|depth| depth.is_finite()).count() > depth.len() / 4
            );
        }
        // Straight down the ground under the pose is in the middle, as far away as it is high.
        let (_, _, depth) = read_floats(&folder.join("d-down.tif")).unwrap();
        let (_, _, ground) = read_floats(&folder.join("g-ahead.tif")).unwrap();
        assert!(depth.iter().all(|depth| depth.is_finite()) && ground.iter().any(|v| v.is_finite()));
    }
}

#[test]
fn a_flight_of_separate_views_has_a_folder_and_a_listing_for_each() {
    let folder = TestFolder::new("views-fly");
    write_path(&folder.join("path.json"), &[pose(0), pose(1)], SIZE, VFOV_DEG);
    let fly = |output: &str| {
        let command =
            Terravision::verb("fly").arg(synth_world(1024).database()).arg("--path").arg(folder.join("path.json"));
        command.arg("-o").arg(folder.join(output))
    };
    let separate = || rig(&folder, "separate");
    let flown = fly("out/").arg("--views").arg(separate()).arg("--depth").arg(folder.join("depth/")).succeed();
    flown.assert_no_warning();
    // The view that is the pose's own camera, from a tree that serves all of them, is a picture of
    // the same ground.
    fly("alone/").succeed();
    let count = |name: &str| std::fs::read_dir(folder.join(name)).map_or(0, Iterator::count);
    for (name, size) in [("ahead", [120, 90]), ("beside", [120, 90]), ("down", [50, 60])] {
        let view = |file: &str| folder.join(format!("out/view-{name}/{file}"));
        let (width, height, _) = read_png(&view("frame-000001.png"));
        assert_eq!([width, height], size);
        assert_eq!(count(&format!("depth/view-{name}")), 2);
        let listing: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(view("frames.json")).unwrap()).unwrap();
        assert_eq!(listing["frames"].as_array().unwrap().len(), 2);
    }
    let pictures = ["out/view-ahead", "alone"].map(|name| read_png(&folder.join(name).join("frame-000000.png")).2);
    let near = pictures[0].iter().zip(&pictures[1]).filter(|(a, b)| (0..3).all(|c| a[c].abs_diff(b[c]) < 24)).count();
    assert!(near * 100 > 95 * pictures[0].len(), "{near} of {} pixels are near", pictures[0].len());
    assert_eq!(std::fs::read_dir(folder.join("out")).unwrap().count(), 3, "nothing else is in the folder");
}

#[test]
fn in_real_time_views_are_drawn_too() {
    let folder = TestFolder::new("views-realtime");
    write_path(&folder.join("path.json"), &[pose(0), pose(1), pose(2)], SIZE, VFOV_DEG);
    let command =
        Terravision::verb("fly").arg(synth_world(1024).database()).arg("--path").arg(folder.join("path.json"));
    let command = command.args(["--mode", "realtime", "--fps", "2", "-o"]).arg(folder.join("out/"));
    command.arg("--views").arg(rig(&folder, "separate")).succeed();
    for name in ["ahead", "beside", "down"] {
        let pictures = std::fs::read_dir(folder.join(format!("out/view-{name}"))).unwrap().count();
        assert_eq!(pictures, 3, "{name}");
    }
}

#[test]
fn what_views_cannot_be_is_refused_in_a_sentence_with_exit_code_2() {
    let folder = TestFolder::new("views-refused");
    std::fs::write(folder.join("bad.json"), r#"{"views": [{"name": "a", "yaw": 90}]}"#).unwrap();
    let world = synth_world(1024).database().to_owned();
    let fly = |output: &str, views: &Path| {
        Terravision::verb("fly").arg(&world).args(["--frames", "0..1", "-o", output, "--views"]).arg(views)
    };
    let cases = [
        (fly("/dev/null", &folder.join("bad.json")), "unknown field `yaw`"),
        (fly("/dev/null", &folder.join("none.json")), "No such file"),
        (fly("/dev/null", folder.path()), "it is a folder, expected a regular file"),
        (fly(folder.join("a.mp4").to_str().unwrap(), &rig(&folder, "separate")), "expected a folder"),
        (fly("shared:views-refused", &rig(&folder, "side-by-side")), "a shared frame has one camera"),
    ];
    for (command, sentence) in cases {
        let finished = command.run();
        finished.assert_code(2);
        assert!(finished.stderr.contains(sentence), "{:?} does not say {sentence:?}", finished.stderr);
    }
    assert!(!folder.join("a.mp4").exists());
}
