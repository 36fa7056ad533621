//! Worlds seen from beside them: walls under the edge of the ground, by whatever draws the ground.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use std::sync::Arc;
use std::time::Duration;
use support::{SKY, Scene, camera, keep, node, options, world};
use terravision_common::camera::Camera;
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_renderer::engine::{self, EngineOptions, Finished};
use terravision_renderer::frame::FrameReader;
use terravision_renderer::skirt::Skirt;
use terravision_renderer::source::{FrameSource, RecordedSource, Recording};

const SIZE: [u32; 2] = [200, 150];
const LOW_M: f64 = -120.0;

fn rough(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.031).sin() * (y * 0.023).cos() + 0.5 * (x * 0.11 + 1.0).sin() * (y * 0.13).sin())
}

fn green(_x: f64, _y: f64) -> [u8; 3] {
    [40, 160, 60]
}

/// Two levels beside each other; an extent that is no multiple of the tiles.
fn recording(camera: &Camera) -> Arc<Recording> {
    let mut scene = Scene::new(world([60, 45]), &rough, &green);
    let fine = [0, 1].map(|m| [0, 1].map(|n| node(m, n, 0))).concat();
    let coarse = (0..4).flat_map(|m| (0..3).map(move |n| node(m, n, 1))).filter(|id| (id.m(), id.n()) != (0, 0));
    let tiles = fine.into_iter().chain(coarse);
    // Where the fine ones meet the coarse ones they have no other vertices than these.
    let snaps = |id: terravision_common::node::NodeId| match (id.q(), id.m(), id.n()) {
        (0, 0, 0) => [0; 4],
        (0, 1, 0) => [0, 1, 0, 0],
        (0, 0, 1) => [0, 0, 0, 1],
        (0, 1, 1) => [0, 1, 0, 1],
        _ => [0; 4],
    };
    let tiles = tiles.map(|id| scene.leaf(id, camera, snaps(id))).collect();
    scene.frame(camera, tiles);
    scene.finish()
}

/// The same ground at its finest level, its heights in the elevation pool.
fn recording_in_place(camera: &Camera) -> Arc<Recording> {
    let mut scene = Scene::new(world([60, 45]), &rough, &green);
    let elevations = scene.elevation_tiles(0);
    let leaves = (0..elevations.len()).filter(|at| elevations[*at].node().is_some_and(|node| node.q() == 0));
    let tiles = leaves.map(|at| scene.leaf_in_place(&elevations, at)).collect();
    scene.frame_in_place(camera, &elevations, tiles);
    scene.finish()
}

fn draw(options: &EngineOptions, camera: &Camera) -> Option<Finished> {
    draw_of(options, &recording(camera))
}

fn draw_of(options: &EngineOptions, recording: &Arc<Recording>) -> Option<Finished> {
    let mut source = RecordedSource::new(Arc::clone(recording), 1);
    let mut reader = FrameReader::new(source.shape(), options.size).unwrap();
    let mut engine = engine::open(options.clone(), &source).unwrap();
    reader.read(&mut source, true).unwrap();
    let pixels = engine.new_pixels().unwrap();
    engine.submit(reader.frame(), &mut source, pixels).unwrap();
    let mut skirt = Skirt::new(&source.shape().world, LOW_M);
    let mut borders = skirt.borders(reader.frame(), &mut source, &mut *engine).unwrap();
    let mut finished = loop {
        if let Some(finished) = engine.poll(Duration::from_secs(20)).unwrap() {
            break finished;
        }
    };
    engine.check_validation().unwrap();
    borders.pop()?.draw(&mut finished.pixels, options.samples);
    Some(finished)
}

/// What each pixel shows: sky, ground, wall.
fn kinds(finished: &Finished) -> Vec<char> {
    let kind = |texel: &[u8]| match texel {
        [r, g, b, _] if [*r, *g, *b] == SKY => 's',
        [r, g, _, _] if g > r => 'g',
        _ => 'w',
    };
    finished.pixels.rgba().chunks_exact(4).map(kind).collect()
}

fn rays(rays: RaysChoice) -> EngineOptions {
    EngineOptions { technique: TechniqueChoice::Rays, rays, has_depth: true, ..options(SIZE) }
}

fn ways() -> [EngineOptions; 3] {
    [
        EngineOptions { has_depth: true, ..options(SIZE) },
        EngineOptions { has_validation: false, ..rays(RaysChoice::Mipmap) },
        rays(RaysChoice::Compute),
    ]
}

/// From the south west, over a corner; from the north; from below the edge, looking up.
fn views() -> [Camera; 3] {
    [
        camera([-300.0, -250.0, 260.0], 50.0, -18.0, SIZE),
        camera([250.0, 900.0, 120.0], 175.0, -12.0, SIZE),
        camera([900.0, 200.0, -60.0], 275.0, 2.0, SIZE),
    ]
}

#[test]
fn walls_go_down_from_the_edge_that_a_sweep_draws_in_place() {
    let sweep = EngineOptions { has_validation: false, ..rays(RaysChoice::Sweep) };
    for (index, view) in views().iter().enumerate() {
        let picture = draw_of(&sweep, &recording_in_place(view)).unwrap();
        keep(&picture, &format!("skirt-in-place-{index}"));
        let kinds = kinds(&picture);
        let count = |kind| kinds.iter().filter(|k| **k == kind).count();
        assert!(count('w') > 2000 && count('g') > 300, "view {index}: {} {}", count('w'), count('g'));
        let columns = (0..SIZE[0] as usize)
            .map(|x| -> String { (0..SIZE[1] as usize).map(|y| kinds[y * SIZE[0] as usize + x]).collect() });
        let (mut torn, mut cut) = (Vec::new(), 0);
        for (x, column) in columns.enumerate() {
            let inner = column.trim_matches('s');
            let is_cut = inner.matches('s').count() == 1;
            cut += usize::from(is_cut);
            if inner.contains("wg") || (inner.contains('s') && !is_cut) {
                torn.push((x, column));
            }
        }
        assert!(torn.is_empty(), "view {index}: {torn:?}");
        // Between the two planes at its sides, a corner of the world is cut off.
        assert!(cut <= 2, "view {index}: a pixel of sky between ground and wall in {cut} columns");
    }
}

#[test]
fn under_the_edge_of_the_ground_is_a_wall_and_nothing_between() {
    for (index, view) in views().iter().enumerate() {
        let pictures = ways().map(|options| draw(&options, view).unwrap());
        let all = pictures.each_ref().map(kinds);
        keep(&pictures[0], &format!("skirt-{index}"));
        for (way, kinds) in all.iter().enumerate() {
            let count = |kind| kinds.iter().filter(|k| **k == kind).count();
            assert!(count('w') > 2000 && count('g') > 300, "view {index}, way {way}: {} {}", count('w'), count('g'));
            // Down a column there is sky, ground, wall, sky: no sky, and no ground's underside,
            // within.
            for x in 0..SIZE[0] as usize {
                let column: String = (0..SIZE[1] as usize).map(|y| kinds[y * SIZE[0] as usize + x]).collect();
                let inner = column.trim_matches('s');
                assert!(!inner.contains('s') && !inner.contains("wg"), "view {index}, way {way}, column {x}: {column}");
            }
        }
        // The wall does not depend on who draws the ground.
        let walls = |kinds: &[char]| kinds.iter().map(|kind| *kind == 'w').collect::<Vec<_>>();
        assert!(all.iter().all(|kinds| walls(kinds) == walls(&all[0])), "view {index}");
        let depths = pictures.each_ref().map(|picture| picture.pixels.reversed_depth().unwrap().to_vec());
        let far = |at: usize| depths.iter().any(|depth| depth[at] != depths[0][at]);
        assert!(!(0..depths[0].len()).any(|at| all[0][at] == 'w' && far(at)), "view {index}");
    }
}

#[test]
fn an_eye_over_the_world_sees_no_wall() {
    assert!(draw(&ways()[1], &camera([300.0, 200.0, 300.0], 40.0, -30.0, SIZE)).is_none());
}
