//! The same input gives the same bytes: again, with other threads, with less memory, in pieces.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use std::collections::BTreeMap;
use std::path::Path;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 24;

/// A low, fast, turning flight: many tiles come and go.
fn write_flight(path: &Path) {
    let world = synth_world(1024);
    let poses: Vec<Pose> = (0..FRAMES)
        .map(|k| {
            let t = k as f64 / FRAMES as f64;
            Pose::new(world.above(0.3 + 0.4 * t, 0.3 + 0.2 * t, 200.0 + 900.0 * t), 60.0 + 90.0 * t, -15.0 - 20.0 * t)
        })
        .collect();
    write_path(path, &poses, [1280, 720], 60.0);
}

fn pictures(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap();
    entries
        .map(|entry| {
            let path = entry.unwrap().path();
            (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap())
        })
        .collect()
}

fn fly(folder: &TestFolder, name: &str, change: impl FnOnce(Terravision) -> Terravision) -> BTreeMap<String, Vec<u8>> {
    let world = synth_world(1024);
    let command = Terravision::verb("fly")
        .arg(world.database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join(format!("{name}/")))
        .arg("--report")
        .arg(folder.join("report.json"));
    change(command).succeed();
    let report = read_report(folder);
    assert_eq!(report["settled"], true, "{report}");
    pictures(&folder.join(name))
}

fn assert_same(what: &str, a: &BTreeMap<String, Vec<u8>>, b: &BTreeMap<String, Vec<u8>>) {
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>(), "{what}: the same files");
    let different: Vec<_> = a.iter().filter(|(name, bytes)| b[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(different.is_empty(), "{what}: {different:?} differ");
}

#[test]
fn any_run_of_a_swept_flight_gives_the_same_bytes() {
    any_run_gives_the_same_bytes("rays");
}

#[test]
fn any_run_of_a_flight_of_the_mesh_gives_the_same_bytes() {
    any_run_gives_the_same_bytes("mesh");
}

fn any_run_gives_the_same_bytes(technique: &str) {
    let folder = TestFolder::new("determinism");
    write_flight(&folder.join("path.json"));
    let fly = |folder: &TestFolder, name: &str, change: &dyn Fn(Terravision) -> Terravision| {
        fly(folder, name, |command| change(command.args(["--technique", technique])))
    };
    let whole = fly(&folder, "a", &|command| command);
    assert_eq!(whole.len() as u64, FRAMES);
    let first = &whole["frame-000000.png"];
    assert!(whole.values().skip(1).all(|bytes| bytes != first), "the flight moves");

    assert_same("again", &whole, &fly(&folder, "b", &|command| command));
    let one =
        |command: Terravision| command.env("RAYON_NUM_THREADS", "1").args(["--threads", "1", "--memory", "256MiB"]);
    assert_same("one thread, half the memory", &whole, &fly(&folder, "c", &one));
    assert_same("as little memory as is taken", &whole, &fly(&folder, "d", &|c| c.args(["--memory", "128MiB"])));

    let piece = fly(&folder, "e", &|command| command.args(["--frames", "7..12"]));
    let wanted: BTreeMap<_, _> =
        whole.iter().filter(|(name, _)| ("frame-000007.png".."frame-000012.png").contains(&name.as_str())).collect();
    assert_eq!(piece.len(), 5);
    for (name, bytes) in &piece {
        assert!(wanted.get(name).is_some_and(|whole| *whole == bytes), "a piece of the flight: {name} differs");
    }
}

#[test]
fn a_database_is_the_same_for_any_number_of_threads() {
    let world = synth_world(1024);
    let folder = TestFolder::new("ingest-threads");
    for threads in ["1", "3"] {
        std::fs::create_dir_all(folder.join(threads)).unwrap();
        Terravision::verb("ingest")
            .arg("--elevation")
            .arg(world.dem())
            .arg("--color")
            .arg(world.ortho())
            .arg("-o")
            // A database is named after its folder.
            .arg(folder.join(threads).join("world.tv"))
            .args(["--threads", threads])
            .succeed();
    }
    assert_same("threads of ingest", &pictures(&folder.join("1/world.tv")), &pictures(&folder.join("3/world.tv")));
}
