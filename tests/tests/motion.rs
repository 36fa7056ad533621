//! Nothing pops: along a slow flight the picture changes by its motion and by nothing else.

#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "helpers of tests fail by panicking and print figures")]

use glam::DVec3;
use terravision_tests::flight::{Pose, read_png, write_path};
use terravision_tests::folder::TestFolder;
use terravision_tests::metrics::{Frame, motion_compensated_change};
use terravision_tests::process::Terravision;
use terravision_tests::reference::{RenderOptions, render};
use terravision_tests::shot::VFOV_DEG;
use terravision_tests::worlds::synth_world;

const SIZE: [u32; 2] = [960, 540];
const FRAMES: usize = 48;

/// A slow flight, 1.5 m a frame, forward and up: nodes split and merge all the time.
#[test]
fn no_frame_of_a_slow_flight_changes_more_than_its_neighbours_do() {
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
    for (k, change) in changes.iter().enumerate() {
        println!("{k:3} mean {:.3} p99 {:.2} worst block {:.2}", change.mean, change.p99, change.worst_block);
        assert!(change.pixels > 300_000, "frames overlap");
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let mean = median(changes.iter().map(|c| c.mean).collect());
    let block = median(changes.iter().map(|c| c.worst_block).collect());
    for (k, change) in changes.iter().enumerate() {
        assert!(change.mean < 1.3 * mean, "frame {}: mean change {} where others have {mean}", k + 1, change.mean);
        assert!(
            change.worst_block < 2.0 * block,
            "frame {}: a block changes by {} where others change by {block} at most",
            k + 1,
            change.worst_block
        );
    }
}
