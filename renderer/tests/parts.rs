//! Several draws, of one technique or of several, share a view's picture and its depth.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use glam::DVec3;
use std::sync::Arc;
use support::{Scene, camera, draw, draw_on, keep, node, options, world};
use terravision_common::camera::Camera;
use terravision_common::rig::{View, Views};
use terravision_common::run::TechniqueChoice::{Mesh, Rays};
use terravision_common::slot::TileSlot;
use terravision_common::traversal::Frustum;
use terravision_renderer::engine::{DeviceEngine, EngineOptions, Finished, Parts, ViewBounds};
use terravision_renderer::source::{RecordedSource, Recording};

const SIZE: [u32; 2] = [160, 120];

fn rough(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.031).sin() * (y * 0.023).cos() + 0.5 * (x * 0.11 + 1.0).sin() * (y * 0.13).sin())
}

fn checks(x: f64, y: f64) -> [u8; 3] {
    [0.11, 0.07, 0.04].map(|k| (127.0 + 60.0 * (x * k).sin() * (y * k).cos()) as u8)
}

/// One frame of all nodes of level 1; `change` may change its tiles.
fn recording(pose: &Camera, views: &Views, change: &dyn Fn(&mut TileSlot)) -> Arc<Recording> {
    let mut scene = Scene::new(world([128, 128]), &rough, &checks);
    let [columns, rows] = scene.world.nodes_at(1);
    let mut tiles: Vec<TileSlot> =
        (0..rows * columns).map(|i| scene.leaf(node(i % columns, i / columns, 1), pose, [0; 4])).collect();
    tiles.iter_mut().for_each(change);
    scene.frame_of_views(pose, *views, tiles);
    scene.finish()
}

fn draw_parts(options: &EngineOptions, recording: &Arc<Recording>, parts: Parts) -> Finished {
    let mut source = RecordedSource::new(Arc::clone(recording), 1);
    let mut engine = DeviceEngine::of_parts(options.clone(), &source, parts).unwrap();
    draw_on(&mut engine, options, &mut source).unwrap().pop().unwrap()
}

/// A board of two parts.
fn field(tile: &TileSlot) -> usize {
    tile.node().map_or(0, |node| (node.m() + node.n()) as usize % 2)
}

fn planes(frame: &Finished) -> (&[u8], &[f32]) {
    (frame.pixels.rgba(), frame.pixels.reversed_depth().unwrap())
}

fn low() -> Camera {
    camera([600.0, 100.0, 160.0], 20.0, -12.0, SIZE)
}

#[test]
fn two_halves_of_the_tiles_are_the_whole_to_the_byte() {
    let pose = low();
    let recording = recording(&pose, &Views::single(&pose), &|_| {});
    for samples in [1, 4] {
        let options = EngineOptions { has_depth: true, samples, ..options(SIZE) };
        let whole = draw(&options, &recording).unwrap().pop().unwrap();
        let halves = Parts { techniques: vec![Mesh, Mesh], part_of: field };
        let halves = draw_parts(&options, &recording, halves);
        assert!(planes(&whole) == planes(&halves), "{samples} samples");
        let [one, both] = [&whole, &halves].map(|frame| frame.costs.iter().copied().collect::<Vec<_>>());
        assert_eq!((one.len(), both.len()), (1, 2));
        assert_eq!(one[0].tiles, both[0].tiles + both[1].tiles);
        assert_eq!(both[0].tiles, both[1].tiles, "half of the fields of a board");
        assert_eq!(whole.costs.triangles(), halves.costs.triangles());
        // Each draw has a time where the device has a clock, and no more than the frame together.
        let whole_nanos = halves.gpu_nanos;
        assert!(both.iter().all(|cost| cost.nanos.is_some() == whole_nanos.is_some()));
        let sum: u64 = both.iter().filter_map(|cost| cost.nanos).sum();
        assert!(sum > 0 || whole_nanos.is_none());
        assert!(whole_nanos.is_none_or(|nanos| sum as f64 <= nanos * 1.001), "{sum} of {whole_nanos:?}");
    }
}

#[test]
fn of_two_techniques_each_pixel_shows_what_is_nearer() {
    let pose = low();
    let recording = recording(&pose, &Views::single(&pose), &|_| {});
    let options = EngineOptions { has_depth: true, ..options(SIZE) };
    let part = |techniques: &[_], part_of| Parts { techniques: techniques.to_vec(), part_of };
    let together = draw_parts(&options, &recording, part(&[Mesh, Rays], field));
    keep(&together, "parts-mesh-and-rays");
    // Tiles of no part are not drawn.
    let mesh = draw_parts(&options, &recording, part(&[Mesh], field));
    let rays = draw_parts(&options, &recording, part(&[Rays], |tile| 1 - field(tile)));
    let [(both, depths), (mesh, mesh_depths), (rays, ray_depths)] = [&together, &mesh, &rays].map(planes);
    let (mut of_mesh, mut of_rays) = (0, 0);
    for (at, depth) in depths.iter().enumerate() {
        let nearer = mesh_depths[at].max(ray_depths[at]);
        assert_eq!(*depth, nearer, "pixel {at}");
        let is_mesh = mesh_depths[at] >= ray_depths[at];
        let expected = if is_mesh { mesh } else { rays };
        assert_eq!(both[4 * at..4 * at + 4], expected[4 * at..4 * at + 4], "pixel {at}");
        if nearer > 0.0 {
            (of_mesh, of_rays) = (of_mesh + u32::from(is_mesh), of_rays + u32::from(!is_mesh));
        }
    }
    assert!(of_mesh > 2000 && of_rays > 2000, "{of_mesh} pixels of the mesh, {of_rays} of rays");
    // Where ground is does not depend on who draws it.
    let alone = draw(&options, &recording).unwrap().pop().unwrap();
    let ground = |depths: &[f32]| depths.iter().filter(|depth| **depth > 0.0).count();
    assert!(ground(planes(&alone).1).abs_diff(ground(depths)) < 20);
    let techniques: Vec<_> = together.costs.iter().map(|cost| cost.technique).collect();
    assert_eq!(techniques, [Mesh, Rays]);
}

#[test]
fn a_view_draws_the_tiles_that_it_may_see_and_has_the_same_bytes() {
    let pose = low();
    let down = camera([700.0, 700.0, 160.0], 0.0, -90.0, [90, 100]);
    let views = Views::new([View { camera: pose, at: [0, 0] }, View { camera: down, at: [SIZE[0], 0] }]).unwrap();
    let world = world([128, 128]);
    let frusta: Vec<_> = views.cameras().map(Frustum::new).collect();
    let mark = |tile: &mut TileSlot| {
        let bounds = world.surface().node_bounds(tile.node().unwrap(), [-100.0, 100.0]);
        let sees = |view: usize| {
            let frame = world.surface().seen_by(views[view].camera.eye(), DVec3::Y);
            frusta[view].may_see(&frame.box_from_eye(&bounds))
        };
        tile.unseen_by = (0..2).map(|view| u8::from(!sees(view)) << view).sum();
    };
    let size = [0, 1].map(|axis| views.iter().map(|view| view.size()[axis]).max().unwrap());
    let bounds = Some(ViewBounds { size, count: 2 });
    let options = EngineOptions { views: bounds, has_depth: true, ..options(views.picture()) };
    let all = draw(&options, &recording(&pose, &views, &|_| {})).unwrap().pop().unwrap();
    let seen = draw(&options, &recording(&pose, &views, &mark)).unwrap().pop().unwrap();
    assert!(planes(&all) == planes(&seen));
    let tiles = |frame: &Finished| frame.costs.iter().map(|cost| cost.tiles).collect::<Vec<_>>();
    let (all, seen) = (tiles(&all), tiles(&seen));
    assert_eq!(all, [64, 64]);
    assert!(seen[0] < 50 && seen[1] < 20, "{seen:?} tiles are drawn");
}
