//! Films: their codecs, their sides, and that each has one writer.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use rustix::process::Signal;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::worlds::synth_world;

fn fly(size: &str, frames: &str) -> Terravision {
    let command = Terravision::verb("fly").arg(synth_world(1024).database());
    command.args(["--path", "orbit", "--size", size, "--frames", frames])
}

/// Codec, width, height and frames.
fn probe(film: &Path) -> String {
    let words = ["-v", "error", "-count_frames", "-select_streams", "v:0", "-of", "csv=p=0", "-show_entries"];
    let output =
        Command::new("ffprobe").args(words).arg("stream=codec_name,width,height,nb_read_frames").arg(film).output();
    String::from_utf8(output.unwrap().stdout).unwrap().trim().trim_end_matches(',').to_owned()
}

#[test]
fn the_name_chooses_the_kind_of_film_and_odd_sides_are_told() {
    let folder = TestFolder::new("kinds");
    for (name, more, found) in [
        ("a.webm", &["--crf", "40"][..], "vp9,98,64,3"),
        ("a.gif", &[], "gif,98,64,3"),
        ("a.mkv", &["--codec", "ffv1"], "ffv1,98,64,3"),
    ] {
        let finished = fly("97x63", "0..3").arg("-o").arg(folder.join(name)).args(more).succeed();
        assert_eq!(probe(&folder.join(name)), found);
        let note = "terravision: note: a film has even sides: 97x63 becomes 98x64";
        assert!(finished.stderr.contains(note), "{}", finished.stderr);
    }
    let finished = fly("96x64", "0..2").arg("-o").arg(folder.join("even.mp4")).succeed();
    assert!(!finished.stderr.contains("even sides"), "{}", finished.stderr);
}

#[test]
fn paths_of_czml_and_geojson_are_flown_and_what_is_done_with_them_is_told() {
    let folder = TestFolder::new("documents");
    let fly = |name: &str, text: &str, more: &[&str]| {
        std::fs::write(folder.join(name), text).unwrap();
        let command = Terravision::verb("fly").arg(synth_world(1024).database()).arg("--path").arg(folder.join(name));
        command.args(["--size", "96x64", "-o"]).arg(folder.join(format!("{name}.mkv"))).args(more)
    };
    let sample = |t: f64, lon: f64| format!("{t},{lon},46.9,3500");
    let document = |more: &str| {
        let samples = [sample(0.0, 9.0), sample(0.2, 9.001)].join(",");
        format!(r#"[{{"id":"document"}},{{"id":"uav","position":{{"cartographicDegrees":[{samples}]}}{more}}}]"#)
    };
    let turned = document(r#","orientation":{"unitQuaternion":[0.5,0.5,0.5,0.5]},"model":{}"#);
    let finished = fly("a.czml", &turned, &[]).succeed();
    assert_eq!(probe(&folder.join("a.czml.mkv")), "h264,96,64,7");
    for note in ["above the ellipsoid", "of packet \"uav\" the way is flown, without its model"] {
        assert!(finished.stderr.contains(note), "{}", finished.stderr);
    }
    let line = r#"{"type":"LineString","coordinates":[[9.0,46.9],[9.001,46.9]]}"#;
    let finished = fly("a.geojson", line, &["--speed", "2", "--frames", "0..5"]).succeed();
    assert!(!finished.stderr.contains("ellipsoid"), "{}", finished.stderr);
    assert_eq!(probe(&folder.join("a.geojson.mkv")), "h264,96,64,5");
    let failed = fly("bad.czml", &document(r#","availability":"soon""#), &[]).run();
    let expected = "bad.czml: packet \"uav\": availability: expected an interval like";
    assert!(!failed.status.success() && failed.stderr.contains(expected), "{}", failed.stderr);
}

#[test]
fn an_ffmpeg_without_the_encoder_is_told_before_the_flight() {
    let folder = TestFolder::new("no-encoder");
    let script = "#!/bin/sh\necho ' ------'\necho ' V....D libx264 H.264'\n";
    std::fs::create_dir(folder.join("bin")).unwrap();
    std::fs::write(folder.join("bin/ffmpeg"), script).unwrap();
    std::fs::set_permissions(folder.join("bin/ffmpeg"), std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.join("bin").display(), std::env::var("PATH").unwrap());
    let finished = fly("96x64", "0..2").arg("-o").arg(folder.join("a.webm")).env("PATH", path).run();
    finished.assert_told(1);
    assert!(finished.stderr.contains("has no encoder libvpx-vp9"), "{}", finished.stderr);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the folder of the script alone");
}

#[test]
fn a_film_has_one_writer_and_the_second_is_told_who() {
    let folder = TestFolder::new("one-writer");
    let film = folder.join("a.mp4");
    let mut first = fly("640x360", "0..100000").arg("-o").arg(&film).spawn();
    first.until("the film's temporary file", |_| {
        std::fs::read_dir(folder.path()).unwrap().next().map(|_there_is_one| ())
    });
    let second = fly("64x36", "0..2").arg("-o").arg(&film).run();
    second.assert_told(2);
    let said = second.stderr.lines().last().unwrap();
    assert!(
        said.contains("is being written by another terravision") && said.contains(&first.pid().to_string()),
        "{said}"
    );
    first.signal(Signal::INT);
    first.wait().assert_told(130);
    fly("64x36", "0..2").arg("-o").arg(&film).succeed();
    assert_eq!(probe(&film), "h264,64,36,2");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}
