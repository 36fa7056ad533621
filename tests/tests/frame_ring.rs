//! Frames for other programs: the same as the files', whatever readers do.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::Duration;
use terravision_common::shm::{FrameRingReader, SharedFrame, SharedName};
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{example, frame, left_of, reader, rgb, shared_name};
use terravision_tests::process::{Terravision, segments_of_launcher, signal_process};
use terravision_tests::shot::{Shot, VFOV_DEG};
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [321, 180];

fn poses(count: u64) -> Vec<Pose> {
    let world = synth_world(1024);
    let at = |k: u64| k as f64 / count as f64;
    (0..count).map(|k| Pose::new(world.above(0.3 + 0.3 * at(k), 0.4, 600.0), 60.0 + 40.0 * at(k), -18.0)).collect()
}

/// A flight into a folder of PNG that also shares its frames.
fn sharing_flight(folder: &TestFolder, name: &SharedName, frames: u64) -> Terravision {
    write_path(&folder.join("path.json"), &poses(frames), SIZE, VFOV_DEG);
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join("a/"))
        .args(["--share", &name.to_string()])
}

fn png(folder: &TestFolder, frame: u64) -> Vec<[u8; 3]> {
    let (width, height, rgb) = read_png(&folder.join(format!("a/frame-{frame:06}.png")));
    assert_eq!([width as u32, height as u32], SIZE);
    rgb
}

#[test]
fn shared_frames_are_those_of_the_png_files_and_of_still() {
    const FRAMES: u64 = 8;
    let (folder, name, world) = (TestFolder::new("shared"), shared_name("shared"), synth_world(1024));
    let mut flight = sharing_flight(&folder, &name, FRAMES).args(["--depth", "--ground"]).spawn();
    let mut ring = reader(&mut flight, &name);
    assert_eq!(ring.launcher_pid(), flight.pid());
    let (mut seen, mut shared) = (Vec::new(), SharedFrame::default());
    while seen.last().is_none_or(|(info, _): &(terravision_common::shm::FrameInfo, _)| info.frame + 1 < FRAMES) {
        let info = frame(&mut flight, &mut ring, &mut shared, |_| true);
        seen.push((info, rgb(&shared)));
    }
    flight.wait().assert_code(0);
    assert!(ring.is_ended() && left_of(&name).is_empty());
    println!("{} of {FRAMES} frames were seen", seen.len());
    for (info, rgb) in &seen {
        assert!(*rgb == png(&folder, info.frame), "frame {} in the ring is that in the file", info.frame);
        let pose = poses(FRAMES)[info.frame as usize];
        let distance = (0..3).map(|axis| (info.position[axis] - pose.eye[axis]).abs()).fold(0.0, f64::max);
        assert!(distance < 1e-6 && (info.heading_deg - pose.heading).abs() < 1e-9, "{info:?} is {pose:?}");
        assert!((info.vfov_deg - VFOV_DEG).abs() < 1e-9 && info.is_settled && info.pose_time_s.is_nan());
    }
    // What the last frame holds besides is what `still` writes into files, to the bit.
    let pose = poses(FRAMES)[FRAMES as usize - 1];
    let taken = Shot { size: SIZE, ..Shot::new(&world, pose) }.take(&[], true);
    assert!(taken.rgb == rgb(&shared), "still's picture");
    let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
    assert_eq!(taken.depth.len(), shared.depth.len());
    assert!(taken.depth.iter().zip(&shared.depth).all(|(a, b)| same(*a, f64::from(*b))), "still's depths");
    assert!(taken.depth.iter().filter(|depth| depth.is_finite()).count() > taken.depth.len() / 2);
    let ground = taken.ground.as_flattened();
    assert_eq!(ground.len(), shared.ground.len());
    assert!(ground.iter().zip(&shared.ground).all(|(a, b)| same(*a, *b)), "still's ground positions");
}

#[test]
fn readers_that_are_killed_stopped_or_slow_change_nothing() {
    const FRAMES: u64 = 60;
    let (folder, name) = (TestFolder::new("readers"), shared_name("readers"));
    let mut flight = sharing_flight(&folder, &name, FRAMES).spawn();
    let mut slow = reader(&mut flight, &name);
    let start = || example("read_frames.py").arg(name.to_string()).spawn();
    let (killed, stopped, watching) = (start(), start(), start());
    let mut shared = SharedFrame::default();
    frame(&mut flight, &mut slow, &mut shared, |info| info.frame >= 3);
    signal_process(killed.pid(), Signal::KILL);
    signal_process(stopped.pid(), Signal::STOP);
    let written = folder.join(format!("a/frame-{:06}.png", FRAMES - 1));
    flight.until("the last frame", |_| Path::exists(&written).then_some(()));
    // The slow one sees the newest now, and knows how many it missed.
    assert!(slow.read(&mut shared).unwrap());
    assert_eq!((shared.info.unwrap().frame, shared.number), (FRAMES - 1, FRAMES));
    assert!(rgb(&shared) == png(&folder, FRAMES - 1));
    flight.wait().assert_code(0);
    assert_eq!(killed.wait().code(), None);
    drop(stopped);
    let watched = watching.wait();
    watched.assert_code(0);
    assert!(watched.stderr.is_empty(), "{}", watched.stderr);
    assert!(left_of(&name).is_empty());
}

#[test]
fn random_bytes_over_the_header_harm_nobody_and_readers_refuse_the_ring() {
    const FRAMES: u64 = 40;
    let (folder, name) = (TestFolder::new("garbage"), shared_name("garbage"));
    let mut flight = sharing_flight(&folder, &name, FRAMES).arg("--depth").spawn();
    let mut attached = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    frame(&mut flight, &mut attached, &mut shared, |_| true);
    let file = std::fs::OpenOptions::new().write(true).open(Path::new("/dev/shm").join(name.ring_file())).unwrap();
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let garbage: Vec<u8> = (0..4096).map(|_| random() as u8).collect();
    file.write_all_at(&garbage, 0).unwrap();
    assert!(FrameRingReader::open(&name).is_err(), "a new reader refuses the ring");
    let python = example("read_frames.py").args([name.to_string(), "1".into()]).run();
    assert!(python.code() == Some(1) && python.stderr.contains("no frame ring"), "{}", python.stderr);
    // One that was attached gets an error at worst, until the next frame mends what it looks at.
    let last = frame_or_error(&mut attached, &mut shared, &mut flight, FRAMES - 1);
    assert!(rgb(&shared) == png_later(&folder, last));
    let finished = flight.wait();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert!(rgb(&shared) == png(&folder, last), "the picture is what it would have been");
    assert!(left_of(&name).is_empty() && segments_of_launcher(finished.pid).is_empty());
}

fn frame_or_error(
    ring: &mut FrameRingReader,
    shared: &mut SharedFrame,
    flight: &mut terravision_tests::process::Running,
    last: u64,
) -> u64 {
    flight.until("a frame after the garbage", |_| match ring.read(shared) {
        Ok(true) => shared.info.map(|info| info.frame).filter(|frame| *frame <= last),
        Ok(false) | Err(_) => None,
    })
}

/// The PNG is written behind the ring.
fn png_later(folder: &TestFolder, frame: u64) -> Vec<[u8; 3]> {
    let until = std::time::Instant::now() + Duration::from_secs(60);
    let path = folder.join(format!("a/frame-{frame:06}.png"));
    while !path.exists() && std::time::Instant::now() < until {
        std::thread::sleep(Duration::from_millis(5));
    }
    png(folder, frame)
}

#[test]
fn a_name_belongs_to_one_flight_and_a_killed_one_gives_it_back() {
    let (folder, name) = (TestFolder::new("names"), shared_name("names"));
    let mut first = sharing_flight(&folder, &name, 2000).spawn();
    let ring = reader(&mut first, &name);
    let other = TestFolder::new("names");
    let finished = sharing_flight(&other, &name, 2).run();
    finished.assert_told(2);
    let said = finished.stderr.lines().last().unwrap();
    assert!(said.contains("is taken by another flight") && said.contains(&first.pid().to_string()), "{said}");
    let first_pid = first.pid();
    first.signal(Signal::KILL);
    assert_eq!(first.wait().code(), None);
    assert!(!ring.is_ended(), "a killed launcher says nothing");
    assert_eq!(left_of(&name).len(), 1);
    // The next one may have the name at once; the reader of the dead flight's ring keeps what it has.
    sharing_flight(&other, &name, 2).run().assert_code(0);
    assert!(left_of(&name).is_empty());
    assert_eq!(ring.launcher_pid(), first_pid);
}

#[test]
fn wrong_wishes_are_told_in_a_sentence() {
    let world = synth_world(1024);
    for (arguments, expected) in [
        (&["-o", "shared:a/b"][..], "no name to share frames by"),
        (&["-o", "shared:"], "no name to share frames by"),
        (&["-o", "shared:a", "--share", "b"], "frames go to -o shared:a already"),
        (&["-o", "x/", "--depth"], "--depth and --ground are for shared frames"),
        (&["-o", "shared:a", "--camera", "udp:10.0.0.1:5"], "udp:127.0.0.1:PORT"),
        (&["-o", "shared:a", "--camera", "shm:a", "--path", "orbit"], "cannot be used with"),
        (&["-o", "shared:a", "--idle-timeout", "3"], "--camera"),
        (&["-o", "shared:a", "--camera", "shm:a", "--idle-timeout", "0"], "--idle-timeout 0"),
    ] {
        let finished = Terravision::verb("fly").arg(world.database()).args(arguments).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(expected), "{arguments:?}: {}", finished.stderr);
    }
    assert!(!Path::new("/dev/shm/terravision-a").exists());
}
