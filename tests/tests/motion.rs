//! Nothing pops: along a slow flight the picture changes by its motion and by nothing else.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use glam::DVec3;
use terravision_testkit::metrics::{Frame, largest_pop, motion_compensated_change};
use terravision_testkit::reference::{RenderOptions, render};
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::process::Terravision;
use terravision_tests::shot::VFOV_DEG;
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [960, 540];
const FRAMES: usize = 48;
/// Mean change of a block of 16 x 16 pixels, of 255, that counts as a pop when it happens in one
/// frame alone.
const POP: f64 = 4.0;

/// A slow flight, 1.5 m a frame, forward and up: nodes split and merge all the time.
fn no_frame_changes_more_than_its_neighbours_do(technique: &str) {
    let world = synth_world(1024);
    let start = Pose::new(world.above(0.4, 0.35, 220.0), 35.0, -18.0);
    let (sin, cos) = start.heading.to_radians().sin_cos();
    let poses: Vec<Pose> = (0..FRAMES).map(|k| start.moved(DVec3::new(sin, cos, 0.4) * (1.5 * k as f64))).collect();
    let folder = TestFolder::new("motion");
    write_path(&folder.join("path.json"), &poses, SIZE, VFOV_DEG);
    Terravision::verb("fly")
        .arg(world.database())
        .arg("--path")
        .arg(folder.join("path.json"))
        .arg("-o")
        .arg(folder.join("a/"))
        .args(["--technique", technique])
        .succeed();
    let options = RenderOptions { rays_per_side: 1, ..RenderOptions::default() };
    let frames: Vec<_> = poses
        .iter()
        .enumerate()
        .map(|(k, pose)| {
            let camera = pose.camera(SIZE, VFOV_DEG);
            let (_, _, rgb) = read_png(&folder.join(format!("a/frame-{k:06}.png")));
            (camera, rgb, render(world.scene(), &camera, &options).depth)
        })
        .collect();
    let frame = |k: usize| Frame { camera: &frames[k].0, rgb: &frames[k].1, depth: &frames[k].2 };
    let changes: Vec<_> = (1..FRAMES).map(|k| motion_compensated_change(frame(k - 1), frame(k))).collect();
    let mut means: Vec<f64> = changes.iter().map(|change| change.mean).collect();
    means.sort_by(f64::total_cmp);
    let median = means[means.len() / 2];
    for (k, change) in changes.iter().enumerate() {
        println!("{k:3} mean {:.3} p99 {:.2}", change.mean, change.p99);
        assert!(change.pixels > 300_000, "frames overlap");
        assert!(change.mean < 1.15 * median, "frame {}: mean change {} where others have {median}", k + 1, change.mean);
    }
    let (at, block, excess) = largest_pop(&changes).unwrap();
    println!("largest pop: {excess:.2} of 255, frame {}, block {block}", at + 1);
    assert!(excess < POP, "block {block} changes in frame {} by {excess} more than before and after", at + 1);
}

#[test]
fn no_frame_of_a_slow_flight_of_the_mesh_changes_more_than_its_neighbours_do() {
    no_frame_changes_more_than_its_neighbours_do("mesh");
}

#[test]
fn no_frame_of_a_slow_swept_flight_changes_more_than_its_neighbours_do() {
    no_frame_changes_more_than_its_neighbours_do("rays");
}
