//! Pictures of hand-made frames: colours, geometry, edges, depth; with validation, by every path to
//! the device.

mod support;

use support::{Scene, camera, draw, keep, node, options, paths, pixel, sky_pixels, world};
use terravision_common::camera::Camera;
use terravision_common::node::NodeId;
use terravision_common::slot::TileSlot;
use terravision_common::texels::TexelFormat;
use terravision_renderer::engine::{DeviceEngine, EngineOptions};
use terravision_renderer::source::RecordedSource;

const SIZE: [u32; 2] = [160, 120];

fn flat(_: f64, _: f64) -> f64 {
    0.0
}

/// Rough enough that a crack shows from any side.
fn rough(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.031).sin() * (y * 0.023).cos() + 0.5 * (x * 0.11 + 1.0).sin() * (y * 0.13).sin())
}

fn green(_: f64, _: f64) -> [u8; 3] {
    [40, 160, 60]
}

fn quadrants(x: f64, y: f64) -> [u8; 3] {
    [if x < 80.0 { 20 } else { 220 }, if y < 80.0 { 20 } else { 220 }, 0]
}

/// All nodes of a level.
fn level(scene: &mut Scene<'_>, q: u8, camera: &Camera) -> Vec<TileSlot> {
    let [columns, rows] = scene.world.nodes_at(q);
    (0..rows * columns).map(|i| scene.leaf(node(i % columns, i / columns, q), camera, [0; 4])).collect()
}

#[test]
fn colours_lie_where_they_belong_seen_from_above() {
    let mut scene = Scene::new(world([16, 16]), &flat, &quadrants);
    let camera = camera([80.0, 80.0, 200.0], 0.0, -90.0, SIZE);
    let tiles = level(&mut scene, 0, &camera);
    scene.frame(&camera, tiles);
    let recording = scene.finish();
    for (index, options) in paths(&options(SIZE)).iter().enumerate() {
        let frames = draw(options, &recording).unwrap();
        keep(&frames[0], &format!("quadrants-{index}"));
        // North is up: the upper left quarter is west and north.
        let [w, h] = SIZE;
        assert_eq!(pixel(&frames[0], w / 2 - 20, h / 2 - 20), [20, 220, 0]);
        assert_eq!(pixel(&frames[0], w / 2 + 20, h / 2 - 20), [220, 220, 0]);
        assert_eq!(pixel(&frames[0], w / 2 - 20, h / 2 + 20), [20, 20, 0]);
        assert_eq!(pixel(&frames[0], w / 2 + 20, h / 2 + 20), [220, 20, 0]);
        // 160 m at 200 m with a focal length of 60 / tan 30 degrees: 83.1 px a side.
        let ground = (w * h) as usize - sky_pixels(&frames[0]);
        assert!(ground.abs_diff(6912) < 200, "{ground} pixels of ground");
        assert_eq!(frames[0].costs.triangles(), 4 * 128);
    }
}

#[test]
fn both_paths_and_two_runs_give_the_same_bytes() {
    let mut scene = Scene::new(world([64, 64]), &rough, &|x, y| [(x / 3.0) as u8, (y / 3.0) as u8, 99]);
    for step in 0..4 {
        let camera = camera([320.0 + f64::from(step), -100.0, 220.0], 3.0 * f64::from(step), -25.0, SIZE);
        let tiles = level(&mut scene, 0, &camera);
        scene.frame(&camera, tiles);
    }
    let recording = scene.finish();
    let one_by_one = EngineOptions { frames_in_flight: 1, ..options(SIZE) };
    let mut all = Vec::new();
    for options in paths(&options(SIZE)).iter().chain([&options(SIZE), &one_by_one]) {
        let frames = draw(options, &recording).unwrap();
        all.push(frames.iter().map(|frame| frame.pixels.rgba().to_vec()).collect::<Vec<_>>());
    }
    assert!(all.iter().all(|frames| frames == &all[0]));
    assert!(all[0].windows(2).all(|pair| pair[0] != pair[1]));
}

#[test]
fn shared_memory_is_read_in_place_where_the_device_can() {
    let mut scene = Scene::new(world([16, 16]), &flat, &green);
    let camera = camera([80.0, 80.0, 200.0], 0.0, -90.0, SIZE);
    let tiles = level(&mut scene, 0, &camera);
    scene.frame(&camera, tiles);
    let source = RecordedSource::new(scene.finish(), 1);
    let [best, staged] = paths(&options(SIZE)).map(|options| DeviceEngine::new(options, &source).unwrap());
    let can_import = best.device().capabilities().host_import_alignment.is_some();
    assert_eq!(best.imports(), [can_import; 2]);
    assert_eq!(staged.imports(), [false; 2]);
}

/// A coarse leaf among fine ones, `difference` levels finer, whose edges towards it collapse.
fn mixed_levels(scene: &mut Scene<'_>, difference: u8, camera: &Camera) -> Vec<TileSlot> {
    let top = scene.world.levels() - 2;
    let fine = top - difference;
    let mut tiles = vec![scene.leaf(node(0, 0, top), camera, [0; 4])];
    let per_side = 1u32 << difference;
    for quarter in [(1, 0), (0, 1), (1, 1)] {
        for i in 0..per_side * per_side {
            let (m, n) = (quarter.0 * per_side + i % per_side, quarter.1 * per_side + i / per_side);
            let mut snap = [0; 4];
            if quarter == (1, 0) && m == per_side {
                snap[0] = difference;
            }
            if quarter == (0, 1) && n == per_side {
                snap[2] = difference;
            }
            tiles.push(scene.leaf(node(m, n, fine), camera, snap));
        }
    }
    tiles
}

#[test]
fn no_sky_shows_through_edges_between_levels() {
    for difference in [1, 2, 3] {
        let mut scene = Scene::new(world([128, 128]), &rough, &green);
        let views = [
            camera([640.0, 640.0, 500.0], 10.0, -89.0, SIZE),
            camera([645.0, 500.0, 130.0], 2.0, -50.0, SIZE),
            camera([800.0, 810.0, 140.0], 225.0, -45.0, SIZE),
        ];
        for camera in &views {
            let tiles = mixed_levels(&mut scene, difference, camera);
            scene.frame(camera, tiles);
        }
        let recording = scene.finish();
        for samples in [1, 4] {
            let frames = draw(&EngineOptions { samples, ..options(SIZE) }, &recording).unwrap();
            for (index, frame) in frames.iter().enumerate() {
                keep(frame, &format!("levels-{difference}-{index}-{samples}"));
                let foreign = frame.pixels.rgba().chunks_exact(4).filter(|texel| texel[..3] != green(0.0, 0.0));
                assert_eq!(foreign.count(), 0, "{difference} levels, view {index}, {samples} samples");
            }
        }
    }
}

#[test]
fn without_the_snap_there_would_be_cracks() {
    // The test above sees cracks: here they are.
    let mut scene = Scene::new(world([128, 128]), &rough, &green);
    let camera = camera([800.0, 810.0, 140.0], 225.0, -45.0, SIZE);
    let mut tiles = mixed_levels(&mut scene, 3, &camera);
    tiles.iter_mut().for_each(|tile| tile.edge_snap = [0; 4]);
    scene.frame(&camera, tiles);
    let frames = draw(&options(SIZE), &scene.finish()).unwrap();
    assert!(sky_pixels(&frames[0]) > 0);
}

#[test]
fn partial_nodes_end_at_the_extent() {
    // 13 x 10 lattice units: the eastern and northern nodes are cut.
    let mut scene = Scene::new(world([13, 10]), &flat, &green);
    let camera = camera([80.0, 80.0, 200.0], 0.0, -90.0, SIZE);
    let tiles = level(&mut scene, 0, &camera);
    assert_eq!(tiles.len(), 4);
    scene.frame(&camera, tiles);
    let frames = draw(&options(SIZE), &scene.finish()).unwrap();
    // 0.5196 px a metre: x from -80 m to 50 m, y from -80 m to 20 m around the centre.
    let is_ground =
        |x: f64, y: f64| pixel(&frames[0], (80.0 + x * 0.5196) as u32, (60.0 - y * 0.5196) as u32) != support::SKY;
    assert!(is_ground(46.0, 0.0) && !is_ground(54.0, 0.0));
    assert!(is_ground(0.0, 16.0) && !is_ground(0.0, 24.0));
    assert!(is_ground(-76.0, -76.0) && !is_ground(-84.0, 0.0));
}

#[test]
fn a_block_takes_its_part_of_an_ancestors_array_and_colours() {
    // Four blocks of one elevation leaf of level 1, two with colour tiles of their own (level 0),
    // two with the parent's.
    let mut scene = Scene::new(world([16, 16]), &flat, &quadrants);
    let camera = camera([80.0, 80.0, 200.0], 0.0, -90.0, SIZE);
    let whole = scene.leaf(node(0, 0, 1), &camera, [0; 4]);
    let tiles: Vec<TileSlot> = (0..4u16)
        .map(|i| {
            let child: NodeId = node(0, 0, 1).child(i as u8).unwrap();
            let start = [4 * (i % 2), 4 * (i / 2)];
            let mut tile = TileSlot { node: child.pack(), start, end: start.map(|v| v + 4), ..whole };
            if i < 2 {
                tile.color_slot = scene.add_color(child);
                tile.color_origin = scene.world.node_origin(child).map(|v| v as u32);
                tile.color_level = 0;
            }
            tile
        })
        .collect();
    scene.frame(&camera, tiles);
    let frames = draw(&options(SIZE), &scene.finish()).unwrap();
    assert_eq!(pixel(&frames[0], 60, 40), [20, 220, 0]);
    assert_eq!(pixel(&frames[0], 100, 40), [220, 220, 0]);
    assert_eq!(pixel(&frames[0], 60, 80), [20, 20, 0]);
    assert_eq!(pixel(&frames[0], 100, 80), [220, 20, 0]);
    assert_eq!(frames[0].costs.triangles(), 4 * 32);
}

#[test]
fn blocks_of_any_width_are_drawn() {
    let mut scene = Scene::new(world([8, 8]), &flat, &green);
    let camera = camera([40.0, 40.0, 100.0], 0.0, -90.0, SIZE);
    let whole = scene.leaf(node(0, 0, 0), &camera, [0; 4]);
    let block = |start: [u16; 2], end: [u16; 2]| TileSlot { start, end, ..whole };
    scene.frame(&camera, vec![block([0, 0], [3, 8]), block([3, 0], [8, 5]), block([3, 5], [8, 8])]);
    let whole = scene.leaf(node(0, 0, 0), &camera, [0; 4]);
    scene.frame(&camera, vec![whole]);
    let frames = draw(&options(SIZE), &scene.finish()).unwrap();
    assert_eq!(frames[0].pixels.rgba(), frames[1].pixels.rgba());
    assert_eq!(frames[0].costs.triangles(), 128);
}

/// Depth along the view axis of the ground under a point of the picture, pixels, for flat ground at
/// height 0.
fn flat_depth(camera: &Camera, x: f64, y: f64) -> f64 {
    let ray = camera.ray_in_world(x, y);
    -camera.fields().eye_in_world[2] / ray.z
}

/// Vertices lie on this grid.
const GRID_PX: f64 = 1.0 / 256.0;

#[test]
fn depth_is_exact_with_one_sample_and_with_four() {
    let mut scene = Scene::new(world([512, 512]), &flat, &green);
    let camera = camera([2500.0, -400.0, 300.0], 5.0, -20.0, SIZE);
    let tiles = level(&mut scene, 2, &camera);
    scene.frame(&camera, tiles);
    let recording = scene.finish();
    for samples in [1, 4] {
        let options = EngineOptions { samples, has_depth: true, ..options(SIZE) };
        let frames = draw(&options, &recording).unwrap();
        keep(&frames[0], &format!("depth-{samples}"));
        let depths = frames[0].pixels.reversed_depth().unwrap();
        let (mut ground, mut worst) = (0, 0.0f64);
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let reversed = depths[(y * SIZE[0] + x) as usize];
                if reversed > 0.0 {
                    let [x, y] = [x, y].map(|at| f64::from(at) + 0.5);
                    let exact = flat_depth(&camera, x, y);
                    // The rasterizer's grid moves the ground by half of its step.
                    let moved = (flat_depth(&camera, x, y - GRID_PX / 2.0) / exact - 1.0).abs();
                    worst = worst.max((0.5 / f64::from(reversed) / exact - 1.0).abs() - moved);
                    ground += 1;
                }
            }
        }
        assert!(ground > 9_000, "{ground} pixels of ground");
        assert!(worst < 2e-5, "relative error {worst} with {samples} samples");
    }
}

#[test]
fn one_pixel_and_odd_sizes_work() {
    for size in [[1, 1], [7, 3], [161, 91]] {
        let mut scene = Scene::new(world([16, 16]), &flat, &green);
        let camera = camera([80.0, 80.0, 100.0], 0.0, -90.0, size);
        let tiles = level(&mut scene, 1, &camera);
        scene.frame(&camera, tiles);
        let recording = scene.finish();
        for samples in [1, 4] {
            let frames = draw(&EngineOptions { samples, has_depth: true, ..options(size) }, &recording).unwrap();
            assert_eq!(frames[0].pixels.rgba().len(), (size[0] * size[1] * 4) as usize);
            assert_eq!(pixel(&frames[0], size[0] / 2, size[1] / 2), green(0.0, 0.0));
        }
    }
}

#[test]
fn edges_are_smooth_with_four_samples() {
    let mut scene = Scene::new(world([16, 16]), &flat, &green);
    let camera = camera([80.0, 80.0, 200.0], 20.0, -90.0, SIZE);
    let tiles = level(&mut scene, 0, &camera);
    scene.frame(&camera, tiles);
    let recording = scene.finish();
    let shades = |samples| {
        let frames = draw(&EngineOptions { samples, ..options(SIZE) }, &recording).unwrap();
        let colors: std::collections::HashSet<Vec<u8>> =
            frames[0].pixels.rgba().chunks_exact(4).map(<[u8]>::to_vec).collect();
        colors.len()
    };
    assert_eq!(shades(1), 2);
    assert_eq!(shades(4), 5);
}

#[test]
fn the_overlay_outlines_colour_leaves_by_level() {
    let mut scene = Scene::new(world([128, 128]), &flat, &green);
    let camera = camera([640.0, 640.0, 1000.0], 0.0, -90.0, SIZE);
    let tiles = mixed_levels(&mut scene, 2, &camera);
    scene.frame(&camera, tiles);
    let recording = scene.finish();
    let frames = draw(&EngineOptions { has_tree_overlay: true, ..options(SIZE) }, &recording).unwrap();
    keep(&frames[0], "overlay");
    let count = |color: [i32; 3]| {
        let near = |texel: &[u8]| (0..3).all(|c| (i32::from(texel[c]) - color[c]).abs() < 60);
        frames[0].pixels.rgba().chunks_exact(4).filter(|texel| near(texel)).count()
    };
    // Level 3 is light blue, level 1 yellow; between the lines the picture is as it was.
    assert!(
        count([0, 220, 255]) > 50 && count([255, 200, 0]) > 500,
        "{} {}",
        count([0, 220, 255]),
        count([255, 200, 0])
    );
    assert!(count([40, 160, 60]) > 1000);
}

#[test]
fn precision_holds_far_from_the_origin() {
    // A world of 1,300 km: the eye stands at its far corner and sees a small thing well.
    let fields =
        terravision_common::world::WorldFields { extent: [1 << 17, 1 << 17], levels: 15, ..*world([16, 16]).fields() };
    let world = terravision_common::world::World::new(fields).unwrap();
    let (x0, y0) = (f64::from((1 << 17) - 16) * 10.0, f64::from((1 << 17) - 16) * 10.0);
    let stripes =
        move |x: f64, _: f64| if ((x - x0) / 10.0).rem_euclid(2.0) < 1.0 { [250, 250, 250] } else { [0, 0, 0] };
    let mut scene = Scene::new(world, &flat, &stripes);
    let camera = camera([x0 + 80.3, y0 + 79.6, 50.0], 0.0, -90.0, SIZE);
    let first = (1 << 14) - 2;
    let tiles = (0..4).map(|i| scene.leaf(node(first + i % 2, first + i / 2, 0), &camera, [0; 4])).collect();
    scene.frame(&camera, tiles);
    let frames = draw(&options(SIZE), &scene.finish()).unwrap();
    keep(&frames[0], "far");
    // Stripes of 10 m are 20.8 px; their edges stand where the camera says, to a pixel.
    let px = |x: f64| 80.0 + (x - 80.3) * 2.0785;
    for stripe in [5, 6, 7, 8, 9, 10] {
        let at = px(f64::from(stripe) * 10.0 + 5.0);
        let expected = if stripe % 2 == 0 { 250 } else { 0 };
        let row: Vec<u8> = [-4.0, 0.0, 4.0].map(|d| pixel(&frames[0], (at + d) as u32, 60)[0]).to_vec();
        assert!(row.iter().all(|v| v.abs_diff(expected) < 40), "stripe {stripe}: {row:?}");
    }
}

/// Ground with some of everything: a slope of tones, and edges.
fn motley(x: f64, y: f64) -> [u8; 3] {
    let tone = 90.0 + 60.0 * (x * 0.02).sin() * (y * 0.017).cos();
    let field = if ((x / 23.0).floor() + (y / 31.0).floor()) as i64 % 2 == 0 { 25.0 } else { 0.0 };
    [tone + field, tone * 0.8 + 40.0, tone * 0.5 + field].map(|v| v as u8)
}

#[test]
fn compressed_colours_give_nearly_the_same_picture() {
    // From far above to close by: all mip levels, also the last, whose side (10 texels) is no
    // multiple of a block. Flat colours tell blocks that were put in a wrong place from those that
    // lose a little.
    let views = [
        camera([320.0, 320.0, 900.0], 0.0, -90.0, SIZE),
        camera([320.0, -60.0, 150.0], 0.0, -25.0, SIZE),
        camera([100.0, 100.0, 110.0], 30.0, -40.0, SIZE),
    ];
    let recording = |texels: TexelFormat| {
        let mut scene = Scene::new(world([64, 64]), &rough, &motley).with_texels(texels);
        for camera in &views {
            let tiles = level(&mut scene, 0, camera);
            scene.frame(camera, tiles);
        }
        scene.finish()
    };
    let plain = draw(&options(SIZE), &recording(TexelFormat::Rgba8)).unwrap();
    let compressed = recording(TexelFormat::Bc1);
    let [imported, staged] = paths(&options(SIZE)).map(|options| draw(&options, &compressed).unwrap());
    for (index, (plain, compressed)) in plain.iter().zip(&imported).enumerate() {
        keep(compressed, &format!("compressed-{index}"));
        assert_eq!(compressed.pixels.rgba(), staged[index].pixels.rgba(), "both paths give the same bytes");
        assert_eq!(sky_pixels(plain), sky_pixels(compressed));
        let ground = plain.pixels.rgba().chunks_exact(4).zip(compressed.pixels.rgba().chunks_exact(4));
        let squares: Vec<f64> = ground
            .filter(|(texel, _)| texel[..3] != support::SKY)
            .flat_map(|(a, b)| (0..3).map(|c| (f64::from(a[c]) - f64::from(b[c])).powi(2)))
            .collect();
        let psnr = 10.0 * (255.0f64.powi(2) / (squares.iter().sum::<f64>() / squares.len() as f64)).log10();
        assert!(psnr > 36.0 && psnr < 80.0, "view {index}: {psnr} dB");
    }
}

#[test]
fn compressed_colours_lie_where_they_belong() {
    let recording = |texels| {
        let mut scene = Scene::new(world([16, 16]), &flat, &quadrants).with_texels(texels);
        let camera = camera([80.0, 80.0, 200.0], 0.0, -90.0, SIZE);
        let tiles = level(&mut scene, 0, &camera);
        scene.frame(&camera, tiles);
        scene.finish()
    };
    let [plain, compressed] =
        [TexelFormat::Rgba8, TexelFormat::Bc1].map(|texels| draw(&options(SIZE), &recording(texels)).unwrap());
    // 5 and 6 bits a channel: 20 and 220 are off by 5 at most, wherever they are.
    let pairs = plain[0].pixels.rgba().iter().zip(compressed[0].pixels.rgba());
    let worst = pairs.map(|(a, b)| a.abs_diff(*b)).max();
    assert!(worst <= Some(5), "{worst:?}");
}
