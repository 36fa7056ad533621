//! Frames for other programs: the same as the files', whatever readers do.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::time::{Duration, Instant};
use terravision_common::shm::{FrameRingReader, SharedFrame, SharedName};
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, example, left_of, reader, record, rgb, sender, shared_name, step, wait_attached};
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
    let until = Instant::now() + Duration::from_secs(170);
    loop {
        // In this order: what was published before the end is seen.
        let is_ended = ring.is_ended();
        if ring.read(&mut shared).unwrap() {
            seen.push((shared.info.unwrap(), rgb(&shared)));
        } else if is_ended {
            break;
        }
        assert!(Instant::now() < until, "the flight does not end");
        std::thread::sleep(Duration::from_millis(1));
    }
    flight.wait().assert_code(0);
    assert_eq!(seen.last().unwrap().0.frame, FRAMES - 1, "the last frame stays");
    assert!(ring.is_ended() && left_of(&name).is_empty());
    println!("{} of {FRAMES} frames were seen", seen.len());
    for (info, rgb) in &seen {
        assert!(*rgb == png(&folder, info.frame), "frame {} in the ring is that in the file", info.frame);
        let pose = poses(FRAMES)[info.frame as usize];
        let distance = (0..3).map(|axis| (info.position[axis] - pose.eye[axis]).abs()).fold(0.0, f64::max);
        assert!(distance < 1e-6 && (info.heading_deg - pose.heading).abs() < 1e-9, "{info:?} is {pose:?}");
        assert!((info.vfov_deg - VFOV_DEG).abs() < 1e-9 && info.is_settled && info.pose_time_s.is_nan());
    }
    // What the last frame holds besides is what `still` writes into files.
    let pose = poses(FRAMES)[FRAMES as usize - 1];
    let taken = Shot { size: SIZE, ..Shot::new(&world, pose) }.take(&[], true);
    assert!(taken.rgb == rgb(&shared), "still's picture");
    let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
    // The path's JSON brings the eye to the last bit but one.
    let close = |a: f64, b: f64| (a - b).abs() < 1e-6 || (a.is_nan() && b.is_nan());
    assert_eq!(taken.depth.len(), shared.depth.len());
    assert!(taken.depth.iter().zip(&shared.depth).all(|(a, b)| same(*a, f64::from(*b))), "still's depths");
    assert!(taken.depth.iter().filter(|depth| depth.is_finite()).count() > taken.depth.len() / 2);
    let ground = taken.ground.as_flattened();
    assert_eq!(ground.len(), shared.ground.len());
    assert!(ground.iter().zip(&shared.ground).all(|(a, b)| close(*a, *b)), "still's ground positions");
}

/// A flight into a folder of PNG that also shares its frames, of the poses that the test sends.
fn steered_flight(folder: &TestFolder, name: &SharedName) -> Terravision {
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("-o")
        .arg(folder.join("a/"))
        .args(["--share", &name.to_string(), "--camera", &format!("shm:{name}")])
        .args(["--size", &format!("{}x{}", SIZE[0], SIZE[1])])
}

#[test]
fn readers_that_are_killed_stopped_or_slow_change_nothing() {
    const FRAMES: u64 = 24;
    let (folder, name) = (TestFolder::new("readers"), shared_name("readers"));
    let mut flight = steered_flight(&folder, &name).spawn();
    let poses_in = sender(&mut flight, &name);
    let (mut ring, mut slow) = (reader(&mut flight, &name), reader(&mut flight, &name));
    let start = || example("read_frames.py").arg(name.to_string()).spawn();
    let (killed, stopped, watching) = (start(), start(), start());
    for program in [&killed, &stopped, &watching] {
        wait_attached(&mut flight, program, &name);
    }
    let (mut shared, mut last) = (SharedFrame::default(), SharedFrame::default());
    for (k, pose) in poses(FRAMES).iter().enumerate() {
        let info = step(&mut flight, &poses_in, &mut ring, &mut shared, &record(pose, k as f64));
        assert_eq!(info.frame, k as u64);
        match k {
            2 => assert!(slow.read(&mut last).unwrap()),
            3 => signal_process(killed.pid(), Signal::KILL),
            4 => signal_process(stopped.pid(), Signal::STOP),
            _ => {}
        }
    }
    // The slow one sees the newest now, and knows how many it missed.
    assert_eq!(last.number, 3);
    assert!(slow.read(&mut last).unwrap());
    assert_eq!((last.info.unwrap().frame, last.number), (FRAMES - 1, FRAMES));
    end(&poses_in);
    flight.wait().assert_code(0);
    assert!(rgb(&last) == png(&folder, FRAMES - 1));
    assert_eq!(killed.wait().code(), None);
    drop(stopped);
    let watched = watching.wait();
    watched.assert_code(0);
    assert!(watched.stderr.is_empty() && watched.stdout_text().contains("frame 23 at"), "{watched:?}");
    assert!(left_of(&name).is_empty());
}

#[test]
fn examples_say_in_a_sentence_what_is_wrong() {
    for script in ["fly_circle.py", "read_frames.py"] {
        let told = example(script).run();
        assert!(told.code() == Some(1) && told.stderr.contains(&format!("{script} NAME")), "{}", told.stderr);
        assert!(!told.stderr.contains("Traceback"), "{}", told.stderr);
    }
    let circle = |name: &SharedName, x: &str| {
        let arguments = [name.to_string(), x.to_owned(), "0".into(), "1".into(), "1000".into(), "2".into()];
        example("fly_circle.py").args(arguments).run()
    };
    let (folder, name) = (TestFolder::new("examples"), shared_name("examples"));
    for (has_depth, words) in
        [(false, "fly with --depth"), (true, "the flight refused the pose of time 0: a number is not")]
    {
        let mut flight = steered_flight(&folder, &name).args(has_depth.then_some("--depth")).spawn();
        // The example waits for the flight, but not for ever.
        sender(&mut flight, &name);
        let told = circle(&name, "nan");
        assert!(told.code() == Some(1) && told.stderr.contains(words), "{}", told.stderr);
        assert_eq!(told.stderr.trim_end().lines().count(), 1, "{}", told.stderr);
        flight.signal(Signal::INT);
        drop(flight.wait());
    }
}

#[test]
fn random_bytes_over_the_header_harm_nobody_and_readers_refuse_the_ring() {
    let (folder, name) = (TestFolder::new("garbage"), shared_name("garbage"));
    let mut flight = steered_flight(&folder, &name).arg("--depth").spawn();
    let poses_in = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    step(&mut flight, &poses_in, &mut ring, &mut shared, &record(&poses(6)[0], 0.0));
    let file = std::fs::OpenOptions::new().write(true).open(Path::new("/dev/shm").join(name.ring_file())).unwrap();
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    // The header, and the first words of the slots.
    let size = file.metadata().unwrap().len();
    let slot_bytes = (size - 135_168) / 4;
    for offset in [0, 135_168, 135_168 + slot_bytes, 135_168 + 2 * slot_bytes, 135_168 + 3 * slot_bytes] {
        let garbage: Vec<u8> = (0..256).map(|_| random() as u8).collect();
        file.write_all_at(&garbage, offset).unwrap();
    }
    assert!(FrameRingReader::open(&name).is_err(), "a new reader refuses the ring");
    let python = example("read_frames.py").args([name.to_string(), "1".into()]).run();
    assert!(python.code() == Some(1) && python.stderr.contains("no frame ring"), "{}", python.stderr);
    // One that was attached gets an error, until the next frame mends what it looks at.
    assert!(ring.read(&mut shared).is_err());
    for (k, pose) in poses(6).iter().enumerate().skip(1) {
        poses_in.send(&record(pose, k as f64));
        flight.until("a frame after the garbage", |_| {
            let is_new = ring.read(&mut shared).unwrap_or(false);
            shared.info.filter(|info| is_new && info.pose_time_s == k as f64)
        });
    }
    end(&poses_in);
    let finished = flight.wait();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert!(rgb(&shared) == png(&folder, 5), "the picture is what it would have been");
    assert!(left_of(&name).is_empty() && segments_of_launcher(finished.pid).is_empty());
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
    // The next one may have the name at once, unless another test's flight has removed it already;
    // the reader of the dead flight's ring keeps what it has.
    sharing_flight(&other, &name, 2).run().assert_code(0);
    assert!(left_of(&name).is_empty());
    assert_eq!(ring.launcher_pid(), first_pid);
}

#[test]
fn wrong_wishes_are_told_in_a_sentence() {
    let world = synth_world(1024);
    for (arguments, expected) in [
        (&["-o", "shared:a/b"][..], "is not a name to share frames by"),
        (&["-o", "shared:"], "is not a name to share frames by"),
        (&["-o", "shared:a", "--share", "b"], "frames already go to -o shared:a"),
        (&["-o", "x/", "--depth"], "--depth without a folder applies to shared frames"),
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
