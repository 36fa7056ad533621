//! Measures what the device can do at best against what the renderer does with frames of mixed
//! levels.
//!
//! `cargo run --release -p terravision-renderer --example floor [frames]`
#![allow(clippy::print_stdout, reason = "it is what the program is for")]

#[path = "../tests/support/mod.rs"]
mod support;

use std::sync::Arc;
use support::{Scene, camera};
use terravision_common::camera::Camera;
use terravision_common::node::NodeId;
use terravision_common::world::World;
use terravision_renderer::bench::{Measured, floor, replay};
use terravision_renderer::engine::EngineOptions;
use terravision_renderer::gpu::ElevationPath;
use terravision_renderer::source::Recording;
use terravision_testkit::worlds;

const SIZE: [u32; 2] = [1280, 720];

fn height(x: f64, y: f64) -> f64 {
    (1..6).map(|i| 2f64.powi(-i)).map(|s| 800.0 * s * ((x / (3000.0 * s)).sin() + (y / (2700.0 * s)).cos())).sum()
}

fn color(x: f64, y: f64) -> [u8; 3] {
    let wave = |s: f64| ((x / s).sin() * (y / s * 1.3).cos() * 60.0) as i32;
    let v = 120 + wave(170.0) + wave(23.0);
    [v.clamp(0, 255) as u8, (v + 20).clamp(0, 255) as u8, (v - 30).clamp(0, 255) as u8]
}

/// Leaves about `factor` times their side away from the eye, near to far.
fn leaves(world: &World, camera: &Camera, node: NodeId, factor: f64, out: &mut Vec<(f64, NodeId)>) {
    if !world.contains(node) {
        return;
    }
    let side = world.node_side_m(node.q());
    let origin = world.node_origin(node).map(|v| v as f64 * world.lattice_unit_m());
    let centre =
        [origin[0] + side / 2.0, origin[1] + side / 2.0, height(origin[0] + side / 2.0, origin[1] + side / 2.0)];
    let from_eye = glam::DVec3::from_array(centre) - camera.eye();
    if camera.frustum_normals_in_world().iter().any(|normal| normal.dot(from_eye) < -side) {
        return;
    }
    let distance = (from_eye.length() - side / 2.0).max(1.0);
    if node.q() > 0 && distance < factor * side {
        (0..4).filter_map(|i| node.child(i)).for_each(|child| leaves(world, camera, child, factor, out));
    } else {
        out.push((distance, node));
    }
}

fn flight(frames: u32, factor: f64) -> Arc<Recording> {
    let world = worlds::world([4096; 2], 10.0, [32, 256]);
    let mut scene = Scene::new(world, &height, &color);
    for frame in 0..frames {
        let camera = camera([12_000.0 + 30.0 * f64::from(frame), 6_000.0, 2_400.0], 20.0, -22.0, SIZE);
        let mut found = Vec::new();
        leaves(&world, &camera, world.root(), factor, &mut found);
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let tiles = found.iter().map(|(_, node)| scene.leaf(*node, &camera, [0; 4])).collect();
        scene.frame(&camera, tiles);
    }
    scene.finish()
}

fn show(measured: &Measured) {
    println!(
        "{:28} {:6} triangles  gpu {:6.2} ms (median)  cpu {:6.2}  own thread {:5.3}  wall {:6.2} ms a frame",
        measured.name,
        measured.triangles,
        measured.median_ms(),
        measured.cpu_ms_per_frame,
        measured.thread_ms_per_frame,
        measured.wall_ms_per_frame
    );
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let frames: usize = std::env::args().nth(1).map_or(Ok(40), |text| text.parse())?;
    let options = EngineOptions { size: SIZE, ..EngineOptions::default() };
    for (columns, rows) in [(1, 1), (85, 48), (171, 96)] {
        show(&floor(&options, columns, rows, frames)?);
    }
    for factor in [0.5, 0.7, 1.2] {
        let recording = flight(4, factor);
        let tiles = recording.frames()[0].tiles.len();
        for (name, change) in [
            ("one in flight", EngineOptions { frames_in_flight: 1, ..options.clone() }),
            ("two in flight", options.clone()),
            (
                "staged",
                EngineOptions { elevation_path: ElevationPath::Staged, can_import_colors: false, ..options.clone() },
            ),
        ] {
            let measured = replay(&change, &recording, (frames / 4) as u64)?;
            show(&Measured { name: format!("{name}, {tiles} tiles"), ..measured });
        }
        if let Some(folder) = std::env::var_os("TERRAVISION_TEST_PICTURES").filter(|_| tiles > 0) {
            let drawn = support::draw(&EngineOptions { has_tree_overlay: true, ..options.clone() }, &recording)?;
            drop(folder);
            support::keep(&drawn[0], &format!("bench-{tiles}"));
        }
    }
    Ok(())
}
