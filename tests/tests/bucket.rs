//! A database in an S3 bucket: a picture, a flight against the clock, and the same from an archive.
//! Skipped, with a sentence, where no S3 server is installed.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::fs;
use std::process::Command;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::s3::S3Server;
use terravision_tests::shot::{VFOV_DEG, oblique_poses, read_report};
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 40;

fn still(world: &str, folder: &TestFolder, name: &str) -> Terravision {
    Terravision::verb("still")
        .arg("--quality=default")
        .arg(world)
        .args(oblique_poses(&synth_world(1024))[0].1.arguments())
        .args(["--size=320x180".to_owned(), format!("--vfov={VFOV_DEG}"), "-o".to_owned()])
        .arg(folder.join(name))
        .arg("--cache")
        .arg(folder.join("cache"))
}

#[test]
fn a_bucket_gives_what_the_folder_gives() {
    let Some(server) = S3Server::start() else {
        println!("skipped: moto_server is not installed (scripts/setup.sh --tests installs it)");
        return;
    };
    let (world, folder) = (synth_world(1024).database(), TestFolder::new("bucket"));
    server.upload("terrain", "maps/world.tv", &world);
    still(&world.display().to_string(), &folder, "local.png").succeed();
    let with_keys = |command: Terravision| {
        command
            .env("AWS_ENDPOINT_URL", server.endpoint())
            .env("AWS_ACCESS_KEY_ID", "testing")
            .env("AWS_SECRET_ACCESS_KEY", "testing")
    };
    let finished = with_keys(still("s3://terrain/maps/world.tv", &folder, "bucket.png")).run();
    finished.assert_code(0);
    finished.assert_no_warning();
    let read = |name: &str| fs::read(folder.join(name)).unwrap();
    assert!(read("local.png") == read("bucket.png"), "the picture is that of the folder");

    for (world, words) in [
        ("s3://terrain/maps/other.tv", "no finished terrain database"),
        ("s3://nowhere/maps/world.tv", "no finished terrain database"),
    ] {
        let finished = with_keys(Terravision::verb("info").arg(world)).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(words), "{}", finished.stderr);
    }

    let archive = folder.join("world.tar");
    let (parent, name) = (world.parent().unwrap(), world.file_name().unwrap());
    let tar = Command::new("tar").arg("-cf").arg(&archive).arg("-C").arg(parent).arg(name).status().unwrap();
    assert!(tar.success());
    server.put("terrain/maps/world.tar", &fs::read(&archive).unwrap());
    let finished = with_keys(still("s3://terrain/maps/world.tar", &folder, "archive.png")).run();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert!(read("local.png") == read("archive.png"), "the picture of the archive is that of the folder");

    // Against the clock, from an empty cache. How sharp it is depends on the machine; what came and
    // that nothing failed does not.
    let at = |k: u64| synth_world(1024).above(0.2 + 0.6 * k as f64 / FRAMES as f64, 0.4, 300.0);
    let poses: Vec<Pose> = (0..FRAMES).map(|k| Pose::new(at(k), 90.0, -20.0)).collect();
    write_path(&folder.join("path.json"), &poses, [320, 180], 60.0);
    let flight = Terravision::verb("fly")
        .args(["s3://terrain/maps/world.tv", "--mode", "realtime", "--fps", "10", "-o", "/dev/null", "--path"])
        .arg(folder.join("path.json"))
        .arg("--report")
        .arg(folder.join("report.json"))
        .arg("--cache")
        .arg(folder.join("another cache"));
    let finished = with_keys(flight).run();
    finished.assert_code(0);
    finished.assert_no_warning();
    let report = read_report(&folder);
    let count = |name: &str| report["realtime"][name].as_u64().unwrap();
    assert_eq!([count("frames"), count("on_time") + count("late") + count("skipped")], [FRAMES; 2]);
    let network = &report["network"];
    assert!(network["requests"].as_u64() > Some(10) && network["bytes"].as_u64() > Some(100_000), "{network}");
    assert!(network["failures"].as_array().unwrap().is_empty(), "{network}");
    let resident = report["realtime"]["drawn"]["tiles_resident"].as_array().unwrap();
    assert!(resident.iter().all(|count| count.as_u64() > Some(0)), "{report}");
}
