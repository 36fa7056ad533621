//! A database in an S3 bucket. Skipped, with a sentence, where no S3 server is installed.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::fs;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::s3::S3Server;
use terravision_tests::shot::{VFOV_DEG, oblique_poses};
use terravision_tests::worlds::synth_world;

fn still(world: &str, folder: &TestFolder, name: &str) -> Terravision {
    Terravision::verb("still")
        .arg(world)
        .args(oblique_poses(&synth_world(1024))[0].1.arguments())
        .args(["--size=320x180".to_owned(), format!("--vfov={VFOV_DEG}"), "-o".to_owned()])
        .arg(folder.join(name))
        .arg("--cache")
        .arg(folder.join("cache"))
}

#[test]
fn a_bucket_gives_the_picture_of_the_folder() {
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
}
