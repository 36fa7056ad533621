//! Holes in the ground, and ground that was made up: the same by the mesh and by rays of all kinds,
//! with and without a device.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use std::sync::Arc;
use support::{SKY, Scene, camera, draw, keep, node, options, world};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::surface::facet::facet_linear;
use terravision_common::world::World;
use terravision_renderer::engine::{EngineOptions, Finished};
use terravision_renderer::source::Recording;

const SIZE: [u32; 2] = [160, 120];
const WIDTH: usize = SIZE[0] as usize;
const SPACING_M: f64 = 10.0;

fn techniques() -> [(&'static str, EngineOptions); 4] {
    let plain = EngineOptions { has_depth: true, has_validation: false, ..options(SIZE) };
    let rays = |rays| EngineOptions { technique: TechniqueChoice::Rays, rays, ..plain.clone() };
    [
        ("mesh", EngineOptions { has_validation: true, ..plain.clone() }),
        ("mipmap", rays(RaysChoice::Mipmap)),
        ("compute", EngineOptions { has_validation: true, ..rays(RaysChoice::Compute) }),
        ("coherent", rays(RaysChoice::Coherent)),
    ]
}

fn hills(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.013).sin() * (y * 0.011).cos() + 0.3 * (x * 0.05 + 1.0).sin() * (y * 0.04).sin())
}

fn checks(x: f64, y: f64) -> [u8; 3] {
    [40 + (x / 8.0) as u8 % 100, 60 + (y / 8.0) as u8 % 100, 90]
}

/// Shares of a post: a round hole, a square one, one of a single post, a rim in the north, and a
/// strip that was made up.
fn shares(x: f64, y: f64) -> [f32; 2] {
    let is_round = (x - 400.0).hypot(y - 500.0) < 130.0;
    let is_square = (700.0..=900.0).contains(&x) && (300.0..=420.0).contains(&y);
    let is_lone = x == 600.0 && y == 700.0;
    let is_hole = is_round || is_square || is_lone || y > 1100.0 + 0.1 * x;
    let is_made_up = (560.0..=660.0).contains(&x);
    if is_hole { [0.0; 2] } else { [1.0, if is_made_up { 0.0 } else { 1.0 }] }
}

fn filled(x: f64, y: f64) -> [f32; 2] {
    [1.0, shares(x, y)[1]]
}

/// A share at a point, linear over the facets of the finest posts.
fn share_at(of: fn(f64, f64) -> [f32; 2], plane: usize, x: f64, y: f64) -> f64 {
    let corner = [x, y].map(|v| (v / SPACING_M).floor() * SPACING_M);
    let at = |i: f64, j: f64| f64::from(of(corner[0] + i * SPACING_M, corner[1] + j * SPACING_M)[plane]);
    let by = [(x - corner[0]) / SPACING_M, (y - corner[1]) / SPACING_M];
    facet_linear(at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0), at(1.0, 1.0), by[0], by[1])
}

/// All nodes of the finest level, one frame for each camera.
fn recording(world: World, of: fn(f64, f64) -> [f32; 2], cameras: &[Camera]) -> Arc<Recording> {
    let mut scene = Scene::new(world, &hills, &checks).with_shares(&of);
    for camera in cameras {
        let [columns, rows] = scene.world.nodes_at(0);
        let leaves = (0..rows * columns).map(|i| node(i % columns, i / columns, 0));
        let tiles = leaves.map(|leaf| scene.leaf(leaf, camera, [0; 4])).collect();
        scene.frame(camera, tiles);
    }
    scene.finish()
}

fn views() -> Vec<Camera> {
    vec![
        camera([640.0, 640.0, 1300.0], 20.0, -90.0, SIZE),
        camera([500.0, 60.0, 420.0], 10.0, -30.0, SIZE),
        // Low: out of one hole rays come up again, or meet the ground from below.
        camera([420.0, 200.0, 75.0], 0.0, -8.0, SIZE),
        // Over the rim, where no ground is, towards the ground.
        Camera::new(CameraFields { roll_rad: 0.4, ..*camera([600.0, 1250.0, 60.0], 170.0, -10.0, SIZE).fields() })
            .expect("valid"),
    ]
}

fn is_sky(frame: &Finished) -> Vec<bool> {
    frame.pixels.rgba().chunks_exact(4).map(|texel| texel[..3] == SKY).collect()
}

fn is_made_up(frame: &Finished) -> Vec<bool> {
    frame.pixels.rgba().chunks_exact(4).map(|texel| texel[3] == 254).collect()
}

/// Pixels around one, itself among them.
fn around(at: usize) -> impl Iterator<Item = usize> {
    let near = |v: usize, end: usize| v.saturating_sub(1)..(v + 2).min(end);
    let (x, y) = (at % WIDTH, at / WIDTH);
    near(y, SIZE[1] as usize).flat_map(move |y| near(x, WIDTH).map(move |x| y * WIDTH + x))
}

/// Pixels that are other than expected, and not at an edge of what is expected.
fn misplaced(found: &[bool], expected: &[bool]) -> usize {
    (0..found.len())
        .filter(|at| found[*at] != expected[*at] && around(*at).all(|k| expected[k] == expected[*at]))
        .count()
}

#[test]
fn from_above_holes_and_made_up_ground_lie_where_their_posts_say() {
    let view = views()[0];
    let whole = recording(world([128, 128]), filled, &[view]);
    let holed = recording(world([128, 128]).with_validity(true), shares, &[view]);
    for (name, options) in techniques() {
        let surface = draw(&options, &whole).unwrap().remove(0);
        let frame = draw(&options, &holed).unwrap().remove(0);
        keep(&frame, &format!("holes-above-{name}"));
        // Where each pixel's ray meets the surface, holes and all.
        let depths = surface.pixels.reversed_depth().unwrap();
        let place = |(at, depth): (usize, &f32)| {
            let ray = view.ray_in_world((at % WIDTH) as f64 + 0.5, (at / WIDTH) as f64 + 0.5);
            (*depth > 0.0).then(|| view.eye() + ray * (0.5 / f64::from(*depth)))
        };
        let places: Vec<_> = depths.iter().enumerate().map(place).collect();
        let is = |plane| places.iter().map(|p| p.map(|p| share_at(shares, plane, p.x, p.y) < 0.5)).collect::<Vec<_>>();
        let expected_sky: Vec<bool> = is(0).into_iter().map(|is_hole| is_hole.unwrap_or(true)).collect();
        let expected_mark: Vec<bool> = is(1)
            .into_iter()
            .zip(&expected_sky)
            .map(|(is_unmeasured, is_sky)| is_unmeasured == Some(true) && !is_sky)
            .collect();
        let counts = [&expected_sky, &expected_mark].map(|expected| expected.iter().filter(|is| **is).count());
        assert!(counts[0] > 1500 && counts[1] > 300, "{name}: the view shows both, {counts:?}");
        assert_eq!(misplaced(&is_sky(&frame), &expected_sky), 0, "{name}: sky");
        assert_eq!(misplaced(&is_made_up(&frame), &expected_mark), 0, "{name}: marks");
        // At the edges, too, it is hardly ever another pixel.
        let other = is_sky(&frame).iter().zip(&expected_sky).filter(|(found, expected)| found != expected).count();
        assert!(other <= if name == "coherent" { 60 } else { 12 }, "{name}: {other} pixels of the rims");
        let is_finite = |depth: &f32| *depth > 0.0;
        let has_depth: Vec<bool> = frame.pixels.reversed_depth().unwrap().iter().map(is_finite).collect();
        assert!(has_depth.iter().zip(is_sky(&frame)).all(|(has_depth, is_sky)| *has_depth != is_sky), "{name}: depth");
    }
}

#[test]
fn through_holes_all_techniques_see_the_same() {
    let recording = recording(world([128, 128]).with_validity(true), shares, &views());
    let drawn = techniques().map(|(name, options)| (name, draw(&options, &recording).unwrap()));
    let (_, mesh) = &drawn[0];
    for (name, frames) in &drawn[1..] {
        for (index, (mesh, frame)) in mesh.iter().zip(frames).enumerate() {
            keep(mesh, &format!("holes-{index}-mesh"));
            keep(frame, &format!("holes-{index}-{name}"));
            let skies = [mesh, frame].map(is_sky);
            let sky = skies[0].iter().filter(|is_sky| **is_sky).count();
            assert!((1000..18_000).contains(&sky), "view {index} shows holes and ground: {sky}");
            // Voxels lie within a voxel of facets, which is several pixels near by.
            let most = if *name == "coherent" { 160 } else { 4 };
            let torn = misplaced(&skies[1], &skies[0]);
            assert!(torn <= most, "{name}, view {index}: {torn} pixels away from edges are sky in one picture alone");
            let marks = [mesh, frame].map(is_made_up);
            let other = misplaced(&marks[1], &marks[0]);
            assert!(other <= most, "{name}, view {index}: {other} pixels have another mark");
        }
    }
}

#[test]
fn ground_that_was_filled_is_drawn_as_it_always_was() {
    let plain = recording(world([128, 128]), filled, &views());
    let known = recording(world([128, 128]).with_validity(false), filled, &views());
    for (name, options) in techniques() {
        let samples = if name == "mesh" { vec![1, 4] } else { vec![1] };
        for samples in samples {
            let options = EngineOptions { samples, ..options.clone() };
            let frames = [&plain, &known].map(|recording| draw(&options, recording).unwrap());
            for (index, (plain, known)) in frames[0].iter().zip(&frames[1]).enumerate() {
                let rgb = |frame: &Finished| {
                    frame.pixels.rgba().chunks_exact(4).flat_map(|t| t[..3].to_vec()).collect::<Vec<_>>()
                };
                assert!(rgb(plain) == rgb(known), "{name}, view {index}: colours");
                assert!(plain.pixels.reversed_depth() == known.pixels.reversed_depth(), "{name}, view {index}: depth");
                assert!(
                    is_made_up(known).contains(&true) && !is_made_up(plain).contains(&true),
                    "{name}, view {index}"
                );
            }
        }
    }
}

#[test]
fn with_four_samples_holes_are_where_depth_has_them() {
    let recording = recording(world([128, 128]).with_validity(true), shares, &views()[..1]);
    let (_, options) = &techniques()[0];
    let [one, four] =
        [1, 4].map(|samples| draw(&EngineOptions { samples, ..options.clone() }, &recording).unwrap().remove(0));
    keep(&four, "holes-four-samples");
    assert!(one.pixels.reversed_depth() == four.pixels.reversed_depth());
    let [one, four] = [is_sky(&one), is_sky(&four)];
    assert_eq!(misplaced(&four, &one), 0);
}

#[test]
fn pictures_with_holes_do_not_depend_on_the_number_of_workers() {
    let recording = recording(world([128, 128]).with_validity(true), shares, &views());
    for (name, options) in techniques().into_iter().filter(|(name, _)| matches!(*name, "mipmap" | "coherent")) {
        let [one, three] =
            [1, 3].map(|workers| draw(&EngineOptions { workers, ..options.clone() }, &recording).unwrap());
        for (a, b) in one.iter().zip(&three) {
            assert!(
                a.pixels.rgba() == b.pixels.rgba() && a.pixels.reversed_depth() == b.pixels.reversed_depth(),
                "{name}"
            );
        }
    }
}

#[test]
fn outlines_end_at_holes() {
    let recording = recording(world([128, 128]).with_validity(true), shares, &views()[..1]);
    for (name, options) in techniques().into_iter().take(3) {
        let [plain, outlined] = [false, true].map(|has_tree_overlay| {
            draw(&EngineOptions { has_tree_overlay, ..options.clone() }, &recording).unwrap().remove(0)
        });
        assert!(is_sky(&plain) == is_sky(&outlined), "{name}");
        assert!(plain.pixels.rgba() != outlined.pixels.rgba(), "{name}: there are outlines");
    }
}

#[test]
fn no_pixel_of_a_rim_stays_in_the_sky() {
    /// Rises towards the border, so that the whole surface ends in the sky.
    fn slope(x: f64, y: f64) -> f64 {
        0.12 * y + 0.2 * hills(3.0 * x, 2.0 * y)
    }
    fn rim(_: f64, y: f64) -> [f32; 2] {
        if y > 1150.0 { [0.0; 2] } else { [1.0; 2] }
    }
    let mut scene = Scene::new(world([128, 128]).with_validity(true), &slope, &checks).with_shares(&rim);
    for heading in [0.0, 7.0, -20.0, 33.0] {
        let camera = camera([640.0, 100.0, 90.0], heading, 2.0, SIZE);
        let [columns, rows] = scene.world.nodes_at(0);
        let leaves = (0..rows * columns).map(|i| node(i % columns, i / columns, 0));
        let leaves = leaves.map(|leaf| scene.leaf(leaf, &camera, [0; 4])).collect();
        scene.frame(&camera, leaves);
    }
    let recording = scene.finish();
    let plain = EngineOptions { has_depth: true, has_validation: false, ..options(SIZE) };
    for rays in [RaysChoice::Mipmap, RaysChoice::Sweep] {
        let options = EngineOptions { technique: TechniqueChoice::Rays, rays, ..plain.clone() };
        for (index, frame) in draw(&options, &recording).unwrap().iter().enumerate() {
            keep(frame, &format!("rim-{index}-{rays:?}"));
            let is_sky = is_sky(frame);
            assert!(is_sky.contains(&true) && is_sky.contains(&false), "{rays:?}, view {index}");
            let alone = (0..is_sky.len()).filter(|at| !is_sky[*at] && around(*at).all(|k| k == *at || is_sky[k]));
            assert_eq!(alone.count(), 0, "{rays:?}, view {index}: pixels of ground in the sky");
        }
    }
}
