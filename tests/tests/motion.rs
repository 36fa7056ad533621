//! Nothing pops: along a slow flight the picture changes by its motion and by nothing else.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use glam::DVec3;
use terravision_testkit::metrics::{Frame, MotionChange, largest_pop, motion_compensated_change};
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
#[test]
fn no_frame_of_a_slow_flight_changes_more_than_its_neighbours_do() {
    let world = synth_world(1024);
    let start = Pose::new(world.above(0.4, 0.35, 220.0), 35.0, -18.0);
    let (sin, cos) = start.heading.to_radians().sin_cos();
    let poses: Vec<Pose> = (0..FRAMES).map(|k| start.moved(DVec3::new(sin, cos, 0.4) * (1.5 * k as f64))).collect();
    let options = RenderOptions { rays_per_side: 1, ..RenderOptions::default() };
    let truth = |pose: &Pose| {
        let camera = pose.camera(SIZE, VFOV_DEG);
        let depth = render(world.scene(), &camera, &options).depth;
        (camera, depth)
    };
    let truths: Vec<_> = poses.iter().map(truth).collect();
    let folder = TestFolder::new("motion");
    write_path(&folder.join("path.json"), &poses, SIZE, VFOV_DEG);
    for technique in ["mesh", "rays"] {
        let frames = folder.join(technique);
        Terravision::verb("fly")
            .arg(world.database())
            .arg("--path")
            .arg(folder.join("path.json"))
            .arg("-o")
            .arg(frames.join(""))
            .args(["--technique", technique])
            .succeed();
        let rgb: Vec<_> = (0..FRAMES).map(|k| read_png(&frames.join(format!("frame-{k:06}.png"))).2).collect();
        let frame = |k: usize| Frame { camera: &truths[k].0, rgb: &rgb[k], depth: &truths[k].1 };
        let changes: Vec<_> = (1..FRAMES).map(|k| motion_compensated_change(frame(k - 1), frame(k))).collect();
        nothing_pops(technique, &changes);
    }
}

fn nothing_pops(technique: &str, changes: &[MotionChange]) {
    let mut means: Vec<f64> = changes.iter().map(|change| change.mean).collect();
    means.sort_by(f64::total_cmp);
    let median = means[means.len() / 2];
    for (change, number) in changes.iter().zip(1..) {
        println!("{technique} {number:3} mean {:.3} p99 {:.2}", change.mean, change.p99);
        assert!(change.pixels > 300_000, "frames overlap");
        let mean = change.mean;
        assert!(mean < 1.15 * median, "{technique}, frame {number}: mean change {mean} where others have {median}");
    }
    let (at, block, excess) = largest_pop(changes).unwrap();
    println!("{technique}: largest pop: {excess:.2} of 255, frame {}, block {block}", at + 1);
    assert!(
        excess < POP,
        "{technique}: block {block} changes in frame {} by {excess} more than before and after",
        at + 1
    );
}
