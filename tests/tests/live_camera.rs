//! Poses from other programs: a frame for each, bad ones refused, and an end in order.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use std::net::UdpSocket;
use std::path::Path;
use std::process::Command;
use terravision_common::shm::{PoseRecord, SharedFrame, SharedName};
use terravision_tests::flight::{Pose, read_png};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{
    end, example, frame, left_of, reader, record, rgb, sender, shared_name, step, wait_attached,
};
use terravision_tests::process::{Running, Terravision, loopback_port, segments_of_launcher};
use terravision_tests::shot::{Shot, read_report};
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [320, 180];

fn live_flight(camera: &str) -> Terravision {
    Terravision::verb("fly").arg(synth_world(1024).database()).args(["--camera", camera, "--size", "320x180"])
}

fn pose(k: u64) -> Pose {
    Pose::new(synth_world(1024).above(0.35 + 0.02 * k as f64, 0.4, 500.0), 15.0 * k as f64, -20.0)
}

fn assert_nothing_left(name: &SharedName, pid: u32) {
    assert!(left_of(name).is_empty(), "{:?}", left_of(name));
    assert!(segments_of_launcher(pid).is_empty());
}

#[test]
fn in_lock_step_every_good_pose_has_its_frame_and_bad_ones_are_refused() {
    let (folder, name) = (TestFolder::new("lock-step"), shared_name("lock-step"));
    let mut flight = live_flight(&format!("shm:{name}"))
        .args(["--depth", "-o", &format!("shared:{name}"), "--report"])
        .arg(folder.join("report.json"))
        .spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    for k in 0..5u64 {
        let time = 100.0 + k as f64;
        let info = step(&mut flight, &poses, &mut ring, &mut shared, &record(&pose(k), time));
        assert_eq!((info.frame, shared.number), (k, k + 1), "a frame for each pose, in order");
        assert!(info.camera_nanos > 0 && info.published_nanos > info.camera_nanos);
        let bad = match k {
            0 => PoseRecord { heading_deg: f64::NAN, time_s: time + 0.5, ..record(&pose(k), 0.0) },
            1 => record(&pose(k), time - 50.0),
            2 => PoseRecord { pitch_deg: 100.0, time_s: time + 0.5, ..record(&pose(k), 0.0) },
            3 => PoseRecord { position: [0.0; 3], time_s: time + 0.5, ..record(&pose(k), 0.0) },
            _ => record(&pose(k), time),
        };
        let sent = poses.send(&bad);
        let answers = flight.until("the answer", |_| Some(poses.answers()).filter(|answers| answers.looked_at == sent));
        assert_eq!((answers.accepted, answers.refused), (k + 1, k + 1));
    }
    end(&poses);
    let finished = flight.wait();
    finished.assert_code(0);
    let said = &finished.stderr;
    for (cause, count) in [("not finite", 2), ("from the past", 2), ("out of range", 2), ("far outside", 2)] {
        assert_eq!(said.matches(cause).count(), count, "{cause}: told once, and in the sum:\n{said}");
    }
    assert!(said.contains("5 of 10 poses were refused") && said.contains("2 from the past"), "{said}");
    let report = read_report(&folder);
    assert_eq!((&report["frames"], &report["settled"]), (&5.into(), &true.into()), "{report}");
    assert_eq!(report["frame_ms"].as_array().unwrap().len(), 5);
    let taken = Shot { size: SIZE, ..Shot::new(&synth_world(1024), pose(4)) }.take(&[], true);
    assert!(taken.rgb == rgb(&shared), "the last frame is the picture of its pose");
    assert!(poses.is_ended() && ring.is_ended());
    assert_nothing_left(&name, finished.pid);
}

#[test]
fn pictures_have_the_size_that_their_poses_ask_for() {
    for technique in ["mesh", "rays"] {
        let name = shared_name("sizes");
        let mut flight = live_flight(&format!("shm:{name}"))
            .args(["--technique", technique, "--depth", "-o", &format!("shared:{name}")])
            .spawn();
        let poses = sender(&mut flight, &name);
        let mut ring = reader(&mut flight, &name);
        let mut shared = SharedFrame::default();
        for (k, size) in (0u64..).zip([[0, 0], [160, 90], [200, 180], [320, 180], [33, 7]]) {
            let sent = PoseRecord { size, ..record(&pose(k), 1.0 + k as f64) };
            let info = step(&mut flight, &poses, &mut ring, &mut shared, &sent);
            let expected = if size == [0; 2] { SIZE } else { size };
            assert_eq!((info.size, shared.depth.len() as u32), (expected, expected[0] * expected[1]));
            if k % 2 == 1 {
                let world = synth_world(1024);
                let shot = Shot { size: expected, ..Shot::new(&world, pose(k)) };
                let taken = shot.take(&["--technique", technique], true);
                assert!(taken.rgb == rgb(&shared), "{technique}: as a still of {size:?}");
            }
        }
        // One that is too large is refused, and the flight goes on.
        poses.send(&PoseRecord { size: [321, 180], ..record(&pose(9), 9.0) });
        let sent = PoseRecord { size: [64, 64], ..record(&pose(9), 10.0) };
        assert_eq!(step(&mut flight, &poses, &mut ring, &mut shared, &sent).size, [64, 64]);
        end(&poses);
        let finished = flight.wait();
        finished.assert_code(0);
        assert_nothing_left(&name, finished.pid);
    }
}

#[test]
fn against_the_clock_frames_go_on_without_poses_and_show_the_newest() {
    let (folder, name) = (TestFolder::new("live-clock"), shared_name("live-clock"));
    let mut flight = live_flight(&format!("shm:{name}"))
        .args(["--mode", "realtime", "--fps", "10", "-o", &format!("shared:{name}"), "--report"])
        .arg(folder.join("report.json"))
        .spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    let mut frames = Vec::new();
    for k in 0..3u64 {
        let sent = record(&pose(k), 10.0 + k as f64);
        let seen = step(&mut flight, &poses, &mut ring, &mut shared, &sent);
        assert_eq!(seen.position, sent.position);
        // No poses are sent, and the pictures go on.
        let next = frame(&mut flight, &mut ring, &mut shared, |info| info.frame >= seen.frame + 2);
        assert_eq!((next.pose_time_s, next.camera_nanos), (sent.time_s, seen.camera_nanos));
        frames.extend([seen.frame, next.frame]);
    }
    assert_eq!(frames[0], 0);
    assert!(frames.is_sorted_by(|a, b| a < b), "{frames:?}");
    // What a pose shows when the camera rests is what it shows in exact mode, once all is there.
    let settled = frame(&mut flight, &mut ring, &mut shared, |info| info.is_settled);
    assert_eq!(settled.pose_time_s, 12.0);
    end(&poses);
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(poses.is_ended() && ring.is_ended());
    assert_nothing_left(&name, finished.pid);
    let report = read_report(&folder);
    let realtime = &report["realtime"];
    let count = |key: &str| realtime[key].as_u64().unwrap();
    assert_eq!((&report["mode"], &report["frames"]), (&"realtime".into(), &realtime["frames"]), "{report}");
    assert!(count("frames") > settled.frame, "{report}");
    assert_eq!(count("on_time") + count("late") + count("skipped"), count("frames"));
    let latencies = realtime["drawn"]["latency_ms"].as_array().unwrap();
    let new = latencies.iter().filter(|latency| latency.as_f64().unwrap() > 0.0).count();
    assert_eq!(new, 3, "a latency for each pose, none for those who show it again: {realtime}");
}

#[test]
fn a_flight_of_poses_against_the_clock_may_be_a_film() {
    let (folder, name) = (TestFolder::new("live-clock-film"), shared_name("live-clock-film"));
    let film = folder.join("a.mp4");
    let mut flight = live_flight(&format!("shm:{name}"))
        .args(["--mode", "realtime", "--fps", "10", "--share", &name.to_string(), "-o"])
        .arg(&film)
        .spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    poses.send(&record(&pose(0), 1.0));
    let last = frame(&mut flight, &mut ring, &mut SharedFrame::default(), |info| info.frame >= 3);
    terravision_tests::process::signal_process(flight.pid(), Signal::INT);
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(count_frames(&film) > last.frame, "a picture for each moment until the end");
    assert_nothing_left(&name, finished.pid);
}

/// Pictures in a film.
fn count_frames(film: &Path) -> u64 {
    let mut probe = Command::new("ffprobe");
    probe.args(["-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames", "-of", "csv=p=0"]).arg(film);
    let probed = probe.output().unwrap();
    String::from_utf8_lossy(&probed.stdout).trim().trim_end_matches(',').parse().unwrap()
}

/// The port that a process listens at.
fn udp_port(flight: &mut Running) -> u16 {
    flight.until("the port", |flight| loopback_port(flight.pid(), "udp"))
}

#[test]
fn json_lines_by_udp_become_the_frames_of_a_film_or_a_folder() {
    let folder = TestFolder::new("udp");
    let mut flight = live_flight("udp:127.0.0.1:0").arg("-o").arg(folder.join("a/")).spawn();
    let port = udp_port(&mut flight);
    // The port is taken now.
    let second = live_flight(&format!("udp:127.0.0.1:{port}")).arg("-o").arg(folder.join("b/")).run();
    second.assert_told(2);
    assert!(second.stderr.contains("cannot listen there"), "{}", second.stderr);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let send = |text: &str| assert_eq!(socket.send_to(text.as_bytes(), ("127.0.0.1", port)).unwrap(), text.len());
    let line = |k: u64, t: &str| {
        let Pose { eye: [x, y, z], heading, pitch, .. } = pose(k);
        format!(r#"{{"x":{x},"y":{y},"z":{z},"heading":{heading},"pitch":{pitch},"t":{t}}}"#)
    };
    send(&format!("{}\n{}\n", line(0, "1"), line(1, "2")));
    send("nonsense");
    send(r#"{"x":NaN,"y":1,"z":2,"heading":0,"pitch":0,"t":9}"#);
    send(&line(2, "1.5"));
    send(&line(2, "3"));
    send(r#"{"end": true}"#);
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(finished.stderr.contains("3 of 6 poses were refused"), "{}", finished.stderr);
    let frames: Vec<_> = std::fs::read_dir(folder.join("a")).unwrap().collect();
    assert_eq!(frames.len(), 3, "{frames:?}");
    for k in 0..3 {
        let (_, _, picture) = read_png(&folder.join(format!("a/frame-{k:06}.png")));
        let taken = Shot { size: SIZE, ..Shot::new(&synth_world(1024), pose(k)) }.take(&[], false);
        assert!(picture == taken.rgb, "frame {k} is the picture of pose {k}");
    }
}

#[test]
fn silence_ends_a_flight_after_the_idle_time() {
    let folder = TestFolder::new("idle");
    let name = shared_name("idle");
    let camera = format!("shm:{name}");
    let nobody = live_flight(&camera).args(["--idle-timeout", "0.3", "-o"]).arg(folder.join("a.mp4")).run();
    nobody.assert_told(1);
    assert!(nobody.stderr.contains("no pose came"), "{}", nobody.stderr);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "no half film");
    let mut flight = live_flight(&camera).args(["--idle-timeout", "10", "-o"]).arg(folder.join("a/")).spawn();
    sender(&mut flight, &name).send(&record(&pose(0), 1.0));
    let finished = flight.wait();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert_eq!(std::fs::read_dir(folder.join("a")).unwrap().count(), 1);
    assert_nothing_left(&name, finished.pid);
}

#[test]
fn an_interrupt_ends_a_live_flight_in_order_and_its_film_is_whole() {
    let (folder, name) = (TestFolder::new("live-interrupt"), shared_name("live-interrupt"));
    let film = folder.join("a.mp4");
    let mut flight = live_flight(&format!("shm:{name}")).args(["--share", &name.to_string(), "-o"]).arg(&film).spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    for k in 0..4u64 {
        step(&mut flight, &poses, &mut ring, &mut shared, &record(&pose(k), k as f64));
    }
    // As a terminal does it: to all processes of the flight's group. ffmpeg has one of its own.
    let children = flight.children().into_iter().filter(|(_, name)| name != "ffmpeg").map(|(pid, _)| pid);
    let pids: Vec<u32> = children.chain([flight.pid()]).collect();
    for pid in pids {
        terravision_tests::process::signal_process(pid, Signal::INT);
    }
    let finished = flight.wait();
    finished.assert_code(0);
    assert!(finished.stderr.contains("4 frames"), "{}", finished.stderr);
    assert_eq!(count_frames(&film), 4);
    assert_nothing_left(&name, finished.pid);
}

#[test]
fn a_killed_stage_ends_a_live_flight_with_a_message() {
    let name = shared_name("live-kill");
    let mut flight = live_flight(&format!("shm:{name}")).args(["-o", &format!("shared:{name}")]).spawn();
    let poses = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    step(&mut flight, &poses, &mut ring, &mut SharedFrame::default(), &record(&pose(0), 0.0));
    terravision_tests::process::signal_process(flight.stage("renderer"), Signal::KILL);
    let finished = flight.wait();
    finished.assert_told(1);
    assert!(finished.stderr.contains("renderer"), "{}", finished.stderr);
    assert!(ring.is_ended() && poses.is_ended());
    assert_nothing_left(&name, finished.pid);
}

/// Float32 values of a file that numpy has saved.
fn read_npy(path: &Path) -> Vec<f32> {
    let bytes = std::fs::read(path).unwrap();
    assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
    let header = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    bytes[10 + header..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

#[test]
fn a_circle_flown_from_python_gives_the_depth_image_that_still_gives() {
    const STEPS: u32 = 12;
    let (folder, name, world) = (TestFolder::new("circle"), shared_name("circle"), synth_world(1024));
    let [x, y, z] = world.above(0.5, 0.5, 900.0);
    let radius = 1500.0;
    let mut flight = live_flight(&format!("shm:{name}"))
        .args(["--depth", "--share", &name.to_string(), "-o"])
        .arg(folder.join("a/"))
        .spawn();
    flight.until("the frame ring", |_| Path::exists(&Path::new("/dev/shm").join(name.ring_file())).then_some(()));
    let statistics = example("read_frames.py").arg(name.to_string()).spawn();
    wait_attached(&mut flight, &statistics, &name);
    let circle = example("fly_circle.py")
        .args([name.to_string(), x.to_string(), y.to_string(), radius.to_string(), z.to_string(), STEPS.to_string()])
        .arg(folder.path())
        .run();
    circle.assert_code(0);
    assert_eq!(circle.stdout_text().lines().count(), STEPS as usize);
    let statistics = statistics.wait();
    statistics.assert_code(0);
    let finished = flight.wait();
    finished.assert_code(0);
    finished.assert_no_warning();
    assert_nothing_left(&name, finished.pid);

    // The pose of the last step, as the script computes it.
    let angle = 2.0 * std::f64::consts::PI * f64::from(STEPS - 1) / f64::from(STEPS);
    let eye = [x + radius * angle.sin(), y + radius * angle.cos(), z];
    let taken =
        Shot { size: SIZE, ..Shot::new(&world, Pose::new(eye, angle.to_degrees() + 180.0, -25.0)) }.take(&[], true);
    let depth = read_npy(&folder.join("depth.npy"));
    assert_eq!(depth.len(), taken.depth.len());
    let is_same = |(a, b): (&f32, &f64)| (f64::from(*a) - b).abs() <= 1e-5 * b || (a.is_nan() && b.is_nan());
    let same = depth.iter().zip(&taken.depth).filter(|pair| is_same(*pair)).count();
    // Python's sine may differ from ours in the last bit: a pixel at a ridge may see the other
    // side.
    assert!(same * 1000 >= depth.len() * 999, "{same} of {} depths are still's", depth.len());
    let image = image::open(folder.join("depth.png")).unwrap().into_luma8();
    assert_eq!([image.width(), image.height()], SIZE);
    let (low, high) = image.pixels().fold((255, 0), |(low, high), p| (low.min(p.0[0]), high.max(p.0[0])));
    assert!(high > 200 && low < 20, "the image shows near and far: {low} to {high}");
    let (_, _, colors) = read_png(&folder.join("color.png"));
    assert!(colors == read_png(&folder.join(format!("a/frame-{:06}.png", STEPS - 1))).2);

    // What the reader printed of each frame is so in the frame's file.
    let text = statistics.stdout_text();
    assert!(text.lines().count() >= 1, "the reader saw frames");
    println!("the reader saw {} of {STEPS} frames", text.lines().count());
    for line in text.lines() {
        let numbers: Vec<f64> = line.split([' ', ':', ',']).filter_map(|word| word.parse().ok()).collect();
        let [number, _, _, _, red, green, blue, near, far] = numbers[..] else { panic!("{line}") };
        let (_, _, picture) = read_png(&folder.join(format!("a/frame-{:06}.png", number as u64)));
        for (channel, said) in [red, green, blue].into_iter().enumerate() {
            let mean = picture.iter().map(|rgb| f64::from(rgb[channel])).sum::<f64>() / picture.len() as f64;
            assert!((mean - said).abs() < 0.006, "{line}: the file's mean is {mean}");
        }
        assert!(0.0 < near && near < far, "{line}");
        if number as u32 == STEPS - 1 {
            let sight = taken.depth.iter().filter(|depth| depth.is_finite());
            let (low, high) = sight.fold((f64::INFINITY, 0.0f64), |(low, high), d| (low.min(*d), high.max(*d)));
            assert!(
                (near - low).abs() < 0.1 + 1e-3 * low && (far - high).abs() < 0.1 + 1e-2 * high,
                "{line}: {low} {high}"
            );
        }
    }
}
