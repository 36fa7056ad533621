//! Depth and ground of whole flights, with their cameras: what the matrices say of a point is where
//! the pictures have it.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use rustix::process::Signal;
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use terravision_common::shm::SharedFrame;
use terravision_testkit::floats::read_floats;
use terravision_tests::flight::{Pose, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::live::{end, reader, record, sender, shared_name, step};
use terravision_tests::process::Terravision;
use terravision_tests::shot::VFOV_DEG;
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [241, 160];

/// A way over the ground on which the camera turns, tilts and leans.
fn poses(count: u64) -> Vec<Pose> {
    let world = synth_world(1024);
    let pose = |k: u64| {
        let at = k as f64;
        let pose = Pose::new(world.above(0.35 + 0.01 * at, 0.35, 900.0), 30.0 + 3.0 * at, -32.0 + at);
        Pose { roll: 4.0 * at, ..pose }
    };
    (0..count).map(pose).collect()
}

fn fly(folder: &TestFolder, frames: u64) -> Terravision {
    write_path(&folder.join("path.json"), &poses(frames), SIZE, VFOV_DEG);
    Terravision::verb("fly").arg(synth_world(1024).database()).arg("--path").arg(folder.join("path.json"))
}

/// With pictures in a folder and planes below it.
fn with_planes(command: Terravision, out: &Path) -> Terravision {
    let planes = [("--depth", out.join("depth")), ("--ground", out.join("ground"))];
    planes
        .into_iter()
        .fold(command.arg("-o").arg(out.join("")), |command, (flag, folder)| command.arg(flag).arg(folder))
}

fn json(path: PathBuf) -> Value {
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap()
}

fn numbers(listing: &Value) -> Vec<u64> {
    listing["frames"].as_array().unwrap().iter().map(|frame| frame["frame"].as_u64().unwrap()).collect()
}

/// A frame as a program reads it that has only the files.
struct Frame {
    k: Vec<Vec<f64>>,
    world_to_camera: Vec<Vec<f64>>,
    depth: Vec<f64>,
    ground: Vec<f64>,
}

impl Frame {
    fn read(folder: &Path, entry: &Value) -> Self {
        let matrix = |key: &str| -> Vec<Vec<f64>> {
            let rows = entry[key].as_array().unwrap().iter();
            rows.map(|row| row.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()).collect()
        };
        let plane = |key: &str| {
            let (width, height, values) = read_floats(&folder.join(entry[key].as_str().unwrap())).unwrap();
            assert_eq!([width as u32, height as u32], SIZE);
            values
        };
        let (k, world_to_camera) = (matrix("K"), matrix("world_to_camera"));
        Self { k, world_to_camera, depth: plane("depth"), ground: plane("ground") }
    }

    /// Column, row (a pixel's centre is at + 0.5) and depth of a point.
    fn project(&self, at: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = [0, 1, 2].map(|row| {
            let m = &self.world_to_camera[row];
            m[0] * at[0] + m[1] * at[1] + m[2] * at[2] + m[3]
        });
        [self.k[0][0] * x / z + self.k[0][2], self.k[1][1] * y / z + self.k[1][2], z]
    }

    fn at(&self, index: usize) -> [f64; 3] {
        [0, 1, 2].map(|band| self.ground[3 * index + band])
    }

    /// Where among four pixels around it this frame's ground has the easting and northing of a
    /// point that is projected to `[column, row]`: how far from there, pixels. `None` where
    /// something stands before the point, or at the edge of the picture and of what stands there.
    fn miss(&self, point: [f64; 3]) -> Option<f64> {
        let [width, height] = SIZE.map(|side| side as usize);
        let [u, v, z] = self.project(point);
        let [x, y] = [u - 0.5, v - 0.5];
        if !(z > 0.0 && x >= 0.0 && y >= 0.0 && x < width as f64 - 1.0 && y < height as f64 - 1.0) {
            return None;
        }
        let first = y as usize * width + x as usize;
        let corners = [first, first + 1, first + width, first + width + 1];
        if !corners.iter().all(|&index| (self.depth[index] / z - 1.0).abs() < 0.02) {
            return None;
        }
        let [a, b, c, d] = corners.map(|index| self.at(index));
        let (start_s, start_t) = (x.fract(), y.fract());
        let (mut s, mut t) = (start_s, start_t);
        for _ in 0..10 {
            let mix = |axis: usize| {
                (1.0 - t) * ((1.0 - s) * a[axis] + s * b[axis]) + t * ((1.0 - s) * c[axis] + s * d[axis]) - point[axis]
            };
            let by_s = |axis: usize| (1.0 - t) * (b[axis] - a[axis]) + t * (d[axis] - c[axis]);
            let by_t = |axis: usize| (1.0 - s) * (c[axis] - a[axis]) + s * (d[axis] - b[axis]);
            let determinant = by_s(0) * by_t(1) - by_s(1) * by_t(0);
            let step_s = (mix(0) * by_t(1) - mix(1) * by_t(0)) / determinant;
            let step_t = (by_s(0) * mix(1) - by_s(1) * mix(0)) / determinant;
            (s, t) = (s - step_s, t - step_t);
        }
        let miss = (s - start_s).hypot(t - start_t);
        miss.is_finite().then_some(miss)
    }
}

#[test]
fn ground_of_one_frame_lies_where_another_one_sees_it() {
    for technique in ["mesh", "rays"] {
        let folder = TestFolder::new("reproject");
        let out = folder.join("frames");
        let quality = ["--technique", technique, "--quality", "best"];
        let samples: &[&str] = if technique == "rays" { &[] } else { &["--samples", "1"] };
        let finished = with_planes(fly(&folder, 5).args(quality).args(samples), &out).succeed();
        let listing = json(out.join("frames.json"));
        assert_eq!((&listing["schema"], numbers(&listing)), (&"terravision-frames-1".into(), vec![0, 1, 2, 3, 4]));
        assert!(finished.stderr.contains("5 frames listed in"), "{}", finished.stderr);
        let frame = |number: usize| Frame::read(&out, &listing["frames"][number]);
        let (first, pose) = (frame(1), poses(5)[1]);
        let entry = &listing["frames"][1];
        for (key, expected) in ["x", "y", "z", "heading", "pitch", "roll"].into_iter().zip([
            pose.eye[0],
            pose.eye[1],
            pose.eye[2],
            pose.heading,
            pose.pitch,
            pose.roll,
        ]) {
            assert!((entry[key].as_f64().unwrap() - expected).abs() < 1e-6, "{key} of {entry}");
        }
        assert!((entry["time_s"].as_f64().unwrap() - 1.0 / 30.0).abs() < 1e-12);
        let f = f64::from(SIZE[1]) / 2.0 / (VFOV_DEG / 2.0).to_radians().tan();
        assert!((first.k[0][0] - f).abs() < 1e-9 && (first.k[0][2], first.k[1][2]) == (120.5, 80.0));
        let pixels = first.depth.len();
        // A frame's own ground is at its own pixels, at their depth.
        for index in (0..pixels).filter(|&index| first.depth[index].is_finite()) {
            let [u, v, z] = first.project(first.at(index));
            let [column, row] = [index % SIZE[0] as usize, index / SIZE[0] as usize].map(|n| n as f64 + 0.5);
            assert!((u - column).abs() < 1e-3 && (v - row).abs() < 1e-3 && (z / first.depth[index] - 1.0).abs() < 1e-6);
        }
        for number in [0, 2, 4] {
            let other = frame(number);
            let mut misses: Vec<f64> = (0..pixels).filter_map(|index| other.miss(first.at(index))).collect();
            misses.sort_by(f64::total_cmp);
            let rank = |share: f64| misses[((misses.len() - 1) as f64 * share) as usize];
            println!(
                "{technique}: frame 1 in frame {number}: {} of {pixels} points, median {:.3}, 99 % {:.3}, most {:.3} px",
                misses.len(),
                rank(0.5),
                rank(0.99),
                rank(1.0)
            );
            assert!(misses.len() > pixels / 3, "{technique}: {} points of frame 1 are seen in {number}", misses.len());
            let within = misses.iter().filter(|miss| **miss <= 0.5).count();
            assert!(
                within * 1000 >= misses.len() * 995,
                "{technique}: {within} of {} within half a pixel",
                misses.len()
            );
        }
    }
}

#[test]
fn pieces_are_listed_together_and_flown_again_from_the_listing() {
    let folder = TestFolder::new("pieces");
    let (whole, pieces) = (folder.join("whole"), folder.join("pieces"));
    with_planes(fly(&folder, 5), &whole).succeed();
    with_planes(fly(&folder, 5).args(["--frames", "3..5"]), &pieces).succeed();
    with_planes(fly(&folder, 5).args(["--frames", "0..3"]), &pieces).succeed();
    let names = |folder: &Path| -> BTreeSet<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    };
    for below in ["", "depth", "ground"] {
        let files = names(&whole.join(below));
        assert_eq!(files, names(&pieces.join(below)));
        for name in files.iter().filter(|name| name.contains('.')) {
            let [a, b] = [&whole, &pieces].map(|folder| std::fs::read(folder.join(below).join(name)).unwrap());
            assert!(a == b, "{below}/{name}");
        }
    }
    assert_eq!(names(&whole.join("depth")).len(), 5);
    let transforms = json(whole.join("transforms.json"));
    assert_eq!(transforms["frames"].as_array().unwrap().len(), 5);
    assert!(transforms["frames"][0]["transform_matrix"][0][3].as_f64().unwrap().abs() <= 500.0, "{transforms}");
    // The listing is a path: a film and its planes beside, of the same poses.
    Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .arg("--path")
        .arg(whole.join("frames.json"))
        .args(["--frames", "1..3", "-o"])
        .arg(folder.join("film.mp4"))
        .arg("--depth")
        .arg(folder.join("again"))
        .succeed();
    assert_eq!(
        names(&folder.join("again")),
        ["frame-000001.tif", "frame-000002.tif", "frames.json"].map(String::from).into()
    );
    let [a, b] =
        [&whole.join("depth"), &folder.join("again")].map(|at| read_floats(&at.join("frame-000002.tif")).unwrap().2);
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-3 || (a.is_nan() && b.is_nan())));
    let again = json(folder.join("again/frames.json"));
    assert_eq!((numbers(&again), &again["frames"][0]["color"]), (vec![1, 2], &Value::Null));
}

#[test]
fn what_an_interrupted_flight_leaves_is_counted_listed_and_gone_on_with() {
    let folder = TestFolder::new("broken-off");
    let out = folder.join("frames");
    let flight = || {
        let command = Terravision::verb("fly").arg(synth_world(1024).database());
        command.args(["--path", "orbit", "--size", "320x180", "--quality", "best"])
    };
    let mut running = with_planes(flight(), &out).spawn();
    running.until("the third frame", |_| Path::exists(&out.join("frame-000002.png")).then_some(()));
    running.signal(Signal::INT);
    let finished = running.wait();
    finished.assert_told(130);
    let whole = |below: &str, extension: &str| -> BTreeSet<u64> {
        let entries = std::fs::read_dir(out.join(below)).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let names: Vec<String> = names.filter(|name| !name.ends_with(".json") && !out.join(name).is_dir()).collect();
        names
            .iter()
            .map(|name| name.strip_prefix("frame-").unwrap().strip_suffix(extension).unwrap().parse().unwrap())
            .collect()
    };
    let pictures = whole("", ".png");
    let expected: BTreeSet<u64> = pictures
        .iter()
        .copied()
        .filter(|n| whole("depth", ".tif").contains(n) && whole("ground", ".tif").contains(n))
        .collect();
    assert_eq!(pictures, expected, "where there is a picture there is all of its frame");
    assert!(pictures.len() < 240, "the flight was interrupted");
    let missing = (0..240).find(|frame| !pictures.contains(frame)).unwrap();
    let said = finished.stderr.lines().last().unwrap();
    assert!(said.contains(&format!("interrupted after {} of 240 frames", pictures.len())), "{said}");
    assert!(said.contains(&format!("--frames {missing}..240 makes the rest")), "{said}");
    assert_eq!(numbers(&json(out.join("frames.json"))), Vec::from_iter(pictures.iter().copied()));
    let next = [missing, missing + 2];
    with_planes(flight().args(["--frames".into(), format!("{}..{}", next[0], next[1])]), &out).succeed();
    let all: BTreeSet<u64> = pictures.into_iter().chain(next[0]..next[1]).collect();
    assert_eq!(numbers(&json(out.join("frames.json"))), Vec::from_iter(all));
}

#[test]
fn poses_of_another_program_are_listed_as_they_were_sent() {
    let (folder, name) = (TestFolder::new("live-planes"), shared_name("live-planes"));
    let mut flight = Terravision::verb("fly")
        .arg(synth_world(1024).database())
        .args(["--camera", &format!("shm:{name}"), "-o", &format!("shared:{name}"), "--size", "64x36", "--ground"])
        .arg(folder.join("ground"))
        .spawn();
    let poses_in = sender(&mut flight, &name);
    let mut ring = reader(&mut flight, &name);
    let mut shared = SharedFrame::default();
    for (k, pose) in poses(3).iter().enumerate() {
        step(&mut flight, &poses_in, &mut ring, &mut shared, &record(pose, 50.0 + 2.0 * k as f64));
    }
    end(&poses_in);
    flight.wait().assert_code(0);
    let listing = json(folder.join("ground/frames.json"));
    for (k, pose) in poses(3).iter().enumerate() {
        let entry = &listing["frames"][k];
        assert_eq!((&entry["frame"], entry["time_s"].as_f64()), (&k.into(), Some(50.0 + 2.0 * k as f64)));
        assert!((entry["y"].as_f64().unwrap() - pose.eye[1]).abs() < 1e-6);
    }
    // Files and shared frames have the same ground.
    let file = read_floats(&folder.join("ground/frame-000002.tif")).unwrap().2;
    assert_eq!(file.len(), shared.ground.len());
    assert!(file.iter().zip(&shared.ground).all(|(a, b)| a == b || (a.is_nan() && b.is_nan())));
}

#[test]
fn wrong_wishes_are_told_before_anything_is_made() {
    let folder = TestFolder::new("wishes");
    let (d, frames) = (folder.join("d"), folder.join("a/"));
    let [d, out] = [d, frames].map(|path| path.display().to_string());
    for (arguments, expected) in [
        (&["-o", &out, "--depth", &d, "--ground", &format!("{d}/")][..], "each needs its own folder"),
        (&["-o", &out, "--depth", "d.png"], "expected a folder, e.g. --depth depth/"),
        (&["-o", &out, "--ground", "g.tif"], "expected a folder, e.g. --ground ground/"),
        (&["-o", &out, "--depth"], "for files add a folder"),
        (&["-o", &out, "--depth", &d, "--mode", "realtime"], "a flight against the clock leaves frames out"),
        (&["-o", "a.jpg"], "expected a folder for them, e.g. -o a/"),
        (&["-o", &out, "--codec", "h265"], "--codec applies to films"),
        (&["-o", "a.webm", "--codec", "h264"], "expected vp9 or av1"),
    ] {
        let finished =
            Terravision::verb("fly").arg(synth_world(1024).database()).args(arguments).current_dir(folder.path()).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(expected), "{arguments:?}: {}", finished.stderr);
    }
    let eye = format!("--eye={}", poses(1)[0].eye.map(|value| value.to_string()).join(","));
    for (arguments, expected) in [
        (&["-o", "a.jpg"][..], "expected a PNG file, e.g. a.png"),
        (&["-o", "a.png", "--depth", "d.png"], "expected a TIFF file, e.g. depth.tif"),
        (&["-o", "a.png", "--ground", "g.jpg"], "expected a TIFF file, e.g. ground.tif"),
    ] {
        let still = Terravision::verb("still").arg("--quality=default").arg(synth_world(1024).database()).arg(&eye);
        let finished = still.args(["--heading=0", "--pitch=-20"]).args(arguments).current_dir(folder.path()).run();
        finished.assert_told(2);
        assert!(finished.stderr.contains(expected), "{arguments:?}: {}", finished.stderr);
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.is_empty(), "{left:?}");
}
