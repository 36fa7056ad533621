//! Films and Y4M outlive the renderer, and end with a sentence when their own end is gone.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use rustix::process::Signal;
use std::path::Path;
use std::process::Command;
use terravision_tests::folder::TestFolder;
use terravision_tests::process::{Running, Terravision, binary, segments_of_launcher, signal_process};
use terravision_tests::shot::read_report;
use terravision_tests::worlds::synth_world;

const FRAMES: u64 = 90;

fn fly(size: &str) -> Terravision {
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .args(["--path", "orbit", "--size", size])
        .args(["--frames".into(), format!("0..{FRAMES}")])
}

/// Waits until the launcher has passed on this many bytes.
fn wait_for_stream(running: &mut Running, bytes: u64) {
    running.until("pictures in the stream", |running| {
        let io = std::fs::read_to_string(format!("/proc/{}/io", running.pid())).ok()?;
        let written = io.lines().find_map(|line| line.strip_prefix("wchar: ")?.parse::<u64>().ok())?;
        (written > bytes).then_some(())
    });
}

/// Frames of a film, decoded.
fn frames_of(film: &Path) -> u64 {
    let probe = ["-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames", "-of", "csv=p=0"];
    let output = Command::new("ffprobe").args(probe).arg(film).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).trim().parse().unwrap()
}

#[test]
fn y4m_has_the_same_bytes_when_its_renderer_is_killed_on_the_way() {
    let whole = fly("321x181").args(["-o", "-"]).succeed().stdout;
    let frame = 6 + 3 * 321 * 181;
    assert_eq!(whole.iter().position(|byte| *byte == b'\n').unwrap() + 1 + FRAMES as usize * frame, whole.len());
    let folder = TestFolder::new("stream-y4m");
    let mut running =
        fly("321x181").args(["-o", "-", "--restarts", "9", "--report"]).arg(folder.join("report.json")).spawn_unread();
    for share in 1..=3 {
        let bytes = share * FRAMES / 5 * frame as u64;
        running.read_up_to(bytes);
        wait_for_stream(&mut running, bytes);
        signal_process(running.stage("renderer"), Signal::KILL);
    }
    let finished = running.wait();
    finished.assert_code(0);
    // A kill may meet a renderer that had not begun yet; it counts nevertheless.
    assert_eq!(read_report(&folder)["restarts"]["renderer"], 3, "{}", finished.stderr);
    assert!(finished.stdout == whole, "{} and {} bytes", finished.stdout.len(), whole.len());
}

#[test]
fn a_film_against_the_clock_goes_on_when_its_renderer_is_killed() {
    let folder = TestFolder::new("stream-film");
    let film = folder.join("a.mp4");
    let mut running = fly("320x180")
        .args(["--mode", "realtime", "--fps", "20", "--report"])
        .arg(folder.join("report.json"))
        .arg("-o")
        .arg(&film)
        .spawn();
    wait_for_stream(&mut running, FRAMES / 4 * 4 * 320 * 180);
    signal_process(running.stage("renderer"), Signal::KILL);
    let finished = running.wait();
    finished.assert_code(0);
    assert_eq!(read_report(&folder)["restarts"]["renderer"], 1, "{}", finished.stderr);
    assert_eq!(frames_of(&film), FRAMES);
    assert!(segments_of_launcher(finished.pid).is_empty());
}

#[test]
fn an_encoder_that_is_killed_ends_the_flight_with_a_sentence_and_leaves_nothing() {
    let folder = TestFolder::new("stream-encoder");
    let film = folder.join("a.mp4");
    // Restarts do not help: what died is not a stage.
    let mut running = fly("320x180").args(["--restarts", "5", "--quality", "best", "-o"]).arg(&film).spawn();
    wait_for_stream(&mut running, 4 * 320 * 180);
    let encoder = running.until("the encoder", |running| {
        running.children().into_iter().find(|(_, name)| name == "ffmpeg").map(|(pid, _)| pid)
    });
    signal_process(encoder, Signal::KILL);
    let finished = running.wait();
    finished.assert_told(1);
    assert!(finished.stderr.contains("ffmpeg could not make"), "{}", finished.stderr);
    assert!(!finished.stderr.contains("started again"), "{}", finished.stderr);
    assert_eq!(std::fs::read_dir(folder.join(".")).unwrap().count(), 0);
}

#[test]
fn a_reader_that_goes_ends_the_flight_with_a_sentence() {
    let script = format!(
        "set -o pipefail; '{}' fly '{}' --path orbit --size 320x180 --frames 0..60 --restarts 5 -o - | head -c 400000 | wc -c",
        binary("terravision").display(),
        synth_world(1024).database().display()
    );
    let finished = Terravision::program("bash").args(["-c", &script]).run();
    finished.assert_code(1);
    assert_eq!(finished.stdout_text().trim(), "400000");
    assert!(
        finished.stderr.contains("the program that reads standard output ended after 2 frames"),
        "{}",
        finished.stderr
    );
    assert!(!finished.stderr.contains("started again"), "{}", finished.stderr);
}
