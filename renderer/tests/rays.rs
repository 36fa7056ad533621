//! Pictures of hand-made frames by rays, with and without a device: those of the mesh.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use std::sync::Arc;
use support::{Scene, camera, draw, keep, node, options, pixel, sky_pixels, world};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::slot::TileSlot;
use terravision_renderer::engine::{self, EngineError, EngineOptions, Finished};
use terravision_renderer::run::run;
use terravision_renderer::sink::NullSink;
use terravision_renderer::sink::workers::SinkWorkers;
use terravision_renderer::source::{RecordedSource, Recording};

const SIZE: [u32; 2] = [160, 120];

fn rays(rays: RaysChoice) -> EngineOptions {
    EngineOptions { technique: TechniqueChoice::Rays, rays, has_validation: false, has_depth: true, ..options(SIZE) }
}

fn compute() -> EngineOptions {
    EngineOptions { has_validation: true, ..rays(RaysChoice::Compute) }
}

fn mesh() -> EngineOptions {
    EngineOptions { has_depth: true, ..options(SIZE) }
}

fn rough(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.031).sin() * (y * 0.023).cos() + 0.5 * (x * 0.11 + 1.0).sin() * (y * 0.13).sin())
}

fn checks(x: f64, y: f64) -> [u8; 3] {
    [40 + (x / 8.0) as u8 % 100, 60 + (y / 8.0) as u8 % 100, 90]
}

/// All nodes of a level, one frame for each camera.
fn recording(extent: [u32; 2], q: u8, cameras: &[Camera]) -> Arc<Recording> {
    recording_of(extent, q, cameras, &rough)
}

fn recording_of(extent: [u32; 2], q: u8, cameras: &[Camera], height: &dyn Fn(f64, f64) -> f64) -> Arc<Recording> {
    let mut scene = Scene::new(world(extent), height, &checks);
    for camera in cameras {
        let [columns, rows] = scene.world.nodes_at(q);
        let tiles: Vec<TileSlot> =
            (0..rows * columns).map(|i| scene.leaf(node(i % columns, i / columns, q), camera, [0; 4])).collect();
        scene.frame(camera, tiles);
    }
    scene.finish()
}

fn metres(frame: &Finished) -> Vec<f32> {
    frame.pixels.reversed_depth().unwrap().iter().map(|depth| 0.5 / depth).collect()
}

#[test]
fn exact_rays_see_the_surface_of_the_mesh() {
    let rolled =
        Camera::new(CameraFields { roll_rad: 2.0, ..*camera([200.0, 500.0, 160.0], 140.0, -25.0, SIZE).fields() })
            .expect("valid");
    let views =
        [camera([640.0, 200.0, 300.0], 10.0, -35.0, SIZE), camera([600.0, 640.0, 900.0], 80.0, -89.0, SIZE), rolled];
    // The second world's border cuts cells.
    for extent in [[128, 128], [101, 83]] {
        let recording = recording(extent, 1, &views);
        let frames = [mesh(), rays(RaysChoice::Mipmap)].map(|options| draw(&options, &recording).unwrap());
        for (index, (mesh, rays)) in frames[0].iter().zip(&frames[1]).enumerate() {
            keep(mesh, &format!("rays-{}-{index}-mesh", extent[0]));
            keep(rays, &format!("rays-{}-{index}", extent[0]));
            let (a, b) = (metres(mesh), metres(rays));
            let close = a.iter().zip(&b).filter(|(a, b)| a == b || (*a - *b).abs() < 1e-3 * *a).count();
            // A pixel at an edge may see what is before it or behind; and cells that the border
            // cuts, a twentieth of the ground of the second world, are cut into facets after that
            // by the mesh, and before it by rays.
            let fewest = if extent[0] == 128 { 0.995 } else { 0.97 };
            assert!(close as f64 > fewest * a.len() as f64, "{extent:?}, view {index}: {close} of {}", a.len());
            let skies = [mesh, rays].map(sky_pixels);
            assert!(skies[0].abs_diff(skies[1]) < 120, "{extent:?}, view {index}: {skies:?}");
            assert!(sky_pixels(mesh) < a.len() / 2);
            let center = [mesh, rays].map(|frame| pixel(frame, SIZE[0] / 2, SIZE[1] / 2));
            let furthest = (0..3).map(|c| center[0][c].abs_diff(center[1][c])).max();
            assert!(furthest < Some(12), "{center:?}");
        }
    }
}

/// Under the edge of the ground, over it, and both in one picture; from beside the world, and from
/// a corner.
#[test]
fn from_beside_the_world_rays_look_under_its_edge_as_the_mesh_does() {
    let rolled =
        Camera::new(CameraFields { roll_rad: 1.0, ..*camera([-150.0, 300.0, 20.0], 80.0, 0.0, SIZE).fields() })
            .expect("valid");
    let views = [
        camera([600.0, -120.0, -70.0], 5.0, 8.0, SIZE),
        camera([600.0, -300.0, 10.0], 0.0, -3.0, SIZE),
        camera([600.0, -200.0, 150.0], -20.0, -20.0, SIZE),
        camera([-100.0, -100.0, -300.0], 45.0, 35.0, SIZE),
        rolled,
    ];
    for (extent, q) in [([128, 128], 1), ([128, 128], 0), ([101, 83], 1)] {
        let recording = recording(extent, q, &views);
        let [mesh, processor, device, voxels] =
            [mesh(), rays(RaysChoice::Mipmap), compute(), rays(RaysChoice::Coherent)]
                .map(|options| draw(&options, &recording).unwrap());
        for (index, mesh) in mesh.iter().enumerate() {
            keep(mesh, &format!("beside-{}-{q}-{index}-mesh", extent[0]));
            for (name, frame) in [("mipmap", &processor[index]), ("compute", &device[index])] {
                let name = format!("beside-{}-{q}-{index}-{name}", extent[0]);
                keep(frame, &name);
                let (a, b) = (metres(mesh), metres(frame));
                let is_close = |(a, b): &(&f32, &f32)| a == b || (*a - *b).abs() < 1e-3 * *a;
                let other = a.iter().zip(&b).filter(|pair| !is_close(pair)).count();
                // Edges, as elsewhere; and cells that the border cuts.
                let most = if extent[0] == 128 { a.len() / 100 } else { a.len() / 25 };
                assert!(other < most, "{name}: {other} of {} pixels see something else", a.len());
                let far = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 24;
                let colors = mesh.pixels.rgba().iter().zip(frame.pixels.rgba()).filter(|pair| far(*pair)).count();
                assert!(colors < 4 * most, "{name}: {colors} channels have another value");
            }
            let skies = [mesh, &voxels[index]].map(sky_pixels);
            assert!(skies[0].abs_diff(skies[1]) < 600, "{extent:?}, view {index}, voxels: {skies:?}");
        }
        assert!(mesh.iter().all(|frame| sky_pixels(frame) > 2000), "the views are what they are called");
    }
}

#[test]
fn a_device_casts_the_rays_that_the_processor_casts() {
    let rolled =
        Camera::new(CameraFields { roll_rad: 2.0, ..*camera([200.0, 500.0, 160.0], 140.0, -25.0, SIZE).fields() })
            .expect("valid");
    // Nearly level; straight down; rolled; and up into the sky.
    let views = [
        camera([640.0, 20.0, 120.0], 10.0, -5.0, SIZE),
        camera([600.0, 640.0, 900.0], 80.0, -90.0, SIZE),
        rolled,
        camera([640.0, 200.0, 300.0], 0.0, 80.0, SIZE),
    ];
    // Borders that cut cells along both axes, at a level above 0.
    for (extent, q) in [([128, 128], 0), ([101, 83], 1), ([101, 83], 2)] {
        let recording = recording(extent, q, &views);
        let [processor, device, mesh] =
            [rays(RaysChoice::Mipmap), compute(), mesh()].map(|options| draw(&options, &recording).unwrap());
        for (index, (a, b)) in processor.iter().zip(&device).enumerate() {
            keep(b, &format!("compute-{}-{q}-{index}", extent[0]));
            keep(&mesh[index], &format!("compute-{}-{q}-{index}-mesh", extent[0]));
            // At an edge a pixel may see what is behind.
            let depths = [metres(a), metres(b)];
            let is_close = |(a, b): &(&f32, &f32)| a == b || (*a - *b).abs() < 1e-4 * *a;
            let far = depths[0].iter().zip(&depths[1]).filter(|pair| !is_close(pair)).count();
            assert!(far <= 40, "{extent:?}, view {index}: {far} of {} depths differ", depths[0].len());
            let mesh = &mesh[index];
            let skies = [mesh, a, b].map(sky_pixels);
            assert!(skies[1..].iter().all(|sky| sky.abs_diff(skies[0]) <= 20), "{extent:?}, view {index}: {skies:?}");
            // Colours are sampled as the mesh samples them.
            let channels = |frame: &Finished| frame.pixels.rgba().to_vec();
            let differ = channels(b).into_iter().zip(channels(mesh)).filter(|(a, b)| a.abs_diff(*b) > 8).count();
            assert!(differ < 1500, "{extent:?}, view {index}: {differ} channels differ from the mesh's");
        }
        assert!(sky_pixels(&device[0]) > 1000 && sky_pixels(&device[1]) < 10_000, "the views are what they are called");
        assert_eq!(sky_pixels(&device[3]), (SIZE[0] * SIZE[1]) as usize);
    }
}

/// All nodes of level 0, whose heights lie in the elevation pool with those of all levels above, one
/// frame for each camera.
fn recording_in_place(extent: [u32; 2], cameras: &[Camera], height: &dyn Fn(f64, f64) -> f64) -> Arc<Recording> {
    let mut scene = Scene::new(world(extent), height, &checks);
    let elevations = scene.elevation_tiles(0);
    for camera in cameras {
        let leaves = (0..elevations.len()).filter(|at| elevations[*at].node().is_some_and(|node| node.q() == 0));
        let tiles = leaves.map(|at| scene.leaf_in_place(&elevations, at)).collect();
        scene.frame_in_place(camera, &elevations, tiles);
    }
    scene.finish()
}

#[test]
fn heights_in_the_elevation_pool_are_swept_as_those_of_arrays() {
    let rolled =
        Camera::new(CameraFields { roll_rad: 2.0, ..*camera([200.0, 500.0, 160.0], 140.0, -25.0, SIZE).fields() })
            .expect("valid");
    let views =
        [camera([640.0, 200.0, 300.0], 10.0, -35.0, SIZE), camera([600.0, 640.0, 900.0], 80.0, -89.0, SIZE), rolled];
    // So smooth that coarse levels of it, whose cells are 14 pixels wide, are the same.
    let smooth = |x: f64, y: f64| 50.0 * (x * 0.009).sin() * (y * 0.007).cos();
    // The second world's border cuts cells.
    for extent in [[128, 128], [101, 83]] {
        let mesh = draw(&mesh(), &recording_of(extent, 0, &views, &smooth)).unwrap();
        let in_place = recording_in_place(extent, &views, &smooth);
        let swept = draw(&rays(RaysChoice::Sweep), &in_place).unwrap();
        // Half as high, and drawn twice as high.
        let low = recording_in_place(extent, &views, &|x, y| 0.5 * smooth(x, y));
        let raised = EngineOptions { exaggeration: 2.0, workers: 3, ..rays(RaysChoice::Sweep) };
        let raised = draw(&raised, &low).unwrap();
        for (index, (mesh, swept)) in mesh.iter().zip(&swept).enumerate() {
            keep(mesh, &format!("in-place-{}-{index}-mesh", extent[0]));
            keep(swept, &format!("in-place-{}-{index}", extent[0]));
            let (a, b) = (metres(mesh), metres(swept));
            let close = a.iter().zip(&b).filter(|(a, b)| a == b || (*a - *b).abs() < 0.02 * *a).count();
            assert!(close as f64 > 0.95 * a.len() as f64, "{extent:?}, view {index}: {close} of {}", a.len());
            let skies = [mesh, swept].map(sky_pixels);
            assert!(skies[0].abs_diff(skies[1]) < 300, "{extent:?}, view {index}: {skies:?}");
            assert!(swept.pixels.rgba() == raised[index].pixels.rgba(), "{extent:?}, view {index}: raised");
        }
    }
}

#[test]
fn damaged_tiles_of_the_elevation_pool_are_refused() {
    let camera = camera([80.0, 80.0, 300.0], 0.0, -80.0, SIZE);
    let error = draw(&rays(RaysChoice::Sweep), &recording_in_place([16, 16], &[camera], &|_, _| f64::NAN)).unwrap_err();
    assert!(error.to_string().contains("elevation tile 0 of frame 0") && error.to_string().contains("finite number"));
    let mut scene = Scene::new(world([16, 16]), &rough, &checks);
    let mut elevations = scene.elevation_tiles(0);
    let leaf = scene.leaf_in_place(&elevations, 1);
    elevations[1].generation = 9;
    scene.frame_in_place(&camera, &elevations, vec![leaf]);
    let error = draw(&rays(RaysChoice::Sweep), &scene.finish()).unwrap_err().to_string();
    assert!(error.contains("elevation tile 1 of frame 0") && error.contains("another generation"), "{error}");
    let mut scene = Scene::new(world([16, 16]), &rough, &checks);
    let elevations = scene.elevation_tiles(0);
    let leaf = scene.leaf_in_place(&elevations[1..], 0);
    scene.frame_in_place(&camera, &elevations[1..], vec![leaf]);
    let error = draw(&rays(RaysChoice::Sweep), &scene.finish()).unwrap_err().to_string();
    assert!(error.contains("elevation tile 0 of frame 0") && error.contains("the one above it is missing"), "{error}");
}

#[test]
fn a_device_outlines_the_leaves_of_rays() {
    let recording = recording([64, 64], 1, &[camera([320.0, 320.0, 700.0], 0.0, -90.0, SIZE)]);
    let counts = [compute(), mesh()].map(|options| {
        let overlay = EngineOptions { has_tree_overlay: true, ..options };
        let frame = &draw(&overlay, &recording).unwrap()[0];
        keep(frame, "overlay");
        // The outlines of level 1, which no texture has.
        frame.pixels.rgba().chunks_exact(4).filter(|c| c[0] > 200 && c[2] < 60).count()
    });
    assert!(counts[1] > 300 && counts[0].abs_diff(counts[1]) < counts[1] / 4, "rays, mesh: {counts:?}");
}

#[test]
fn outlines_of_rays_lie_where_those_of_the_mesh_do() {
    let views = [camera([320.0, 320.0, 700.0], 0.0, -90.0, SIZE), camera([300.0, -100.0, 250.0], 8.0, -30.0, SIZE)];
    let recording = recording([64, 64], 1, &views);
    let overlay = |options: EngineOptions| EngineOptions { has_tree_overlay: true, ..options };
    let is_outline = |frame: &Finished| -> Vec<bool> {
        frame.pixels.rgba().chunks_exact(4).map(|c| c[0] > 180 && c[2] < 80).collect()
    };
    let mesh = draw(&overlay(mesh()), &recording).unwrap();
    for choice in [RaysChoice::Mipmap, RaysChoice::Coherent, RaysChoice::Sweep] {
        let [one, three] =
            [1, 3].map(|workers| draw(&EngineOptions { workers, ..overlay(rays(choice)) }, &recording).unwrap());
        for (index, (mesh, rays)) in mesh.iter().zip(&one).enumerate() {
            keep(mesh, &format!("outlines-{index}-mesh"));
            keep(rays, &format!("outlines-{index}-{choice:?}"));
            assert!(rays.pixels.rgba() == three[index].pixels.rgba(), "{choice:?}, view {index}: workers show");
            let [a, b] = [mesh, rays].map(is_outline);
            let is_near = |other: &[bool], at: usize| {
                let [x, y] = [at % SIZE[0] as usize, at / SIZE[0] as usize];
                let around = |at: usize, end: u32| at.saturating_sub(1)..(at + 2).min(end as usize);
                around(y, SIZE[1]).any(|y| around(x, SIZE[0]).any(|x| other[y * SIZE[0] as usize + x]))
            };
            for (name, these, others) in [("mesh", &a, &b), ("rays", &b, &a)] {
                let all = these.iter().filter(|is_line| **is_line).count();
                let alone = (0..these.len()).filter(|at| these[*at] && !is_near(others, *at)).count();
                let words = format!("{choice:?}, view {index}: {alone} of {all} outline pixels of {name} are alone");
                let share = match choice {
                    // Where slopes are steep voxels lie elsewhere.
                    RaysChoice::Coherent => 4,
                    // Drawn between planes that lie two pixels apart.
                    RaysChoice::Sweep => 5,
                    _ => 50,
                };
                assert!(all > 300 && alone * share < all, "{words}");
            }
        }
    }
}

#[test]
fn voxels_lie_within_a_voxel_of_the_mesh() {
    // Down; and level, along hills before the sky, which samples of rays pass through the tops of.
    let views = [
        camera([640.0, 200.0, 300.0], 10.0, -35.0, SIZE),
        camera([640.0, 20.0, 120.0], 10.0, -5.0, SIZE),
        camera([60.0, 640.0, 100.0], 95.0, -2.0, SIZE),
        Camera::new(CameraFields { roll_rad: 0.6, ..*camera([1200.0, 1100.0, 110.0], 220.0, -4.0, SIZE).fields() })
            .expect("valid"),
    ];
    let recording = recording([128, 128], 0, &views);
    let frames = [mesh(), rays(RaysChoice::Coherent)].map(|options| draw(&options, &recording).unwrap());
    for (index, (mesh, rays)) in frames[0].iter().zip(&frames[1]).enumerate() {
        keep(mesh, &format!("voxels-{index}-mesh"));
        keep(rays, &format!("voxels-{index}"));
        let pairs: Vec<(f32, f32)> = metres(mesh).into_iter().zip(metres(rays)).collect();
        // Of 160 columns each, with a fifth of a pixel in most: voxels are trilinear, facets are
        // not. Without a look between samples it is 30 to 43.
        let torn = pairs.iter().filter(|(a, b)| a.is_finite() != b.is_finite()).count();
        assert!(torn < 35, "view {index}: {torn} pixels are sky in one picture and land in the other");
        let mut errors: Vec<f32> = pairs.iter().filter(|(a, _)| a.is_finite()).map(|(a, b)| (a - b).abs()).collect();
        errors.sort_by(f32::total_cmp);
        assert!(errors[errors.len() / 2] < 1.0, "view {index}: median {}", errors[errors.len() / 2]);
    }
    assert!(frames[0].iter().skip(1).all(|frame| sky_pixels(frame) > 1000), "hills are before the sky");
}

#[test]
fn pictures_of_rays_do_not_depend_on_the_number_of_workers() {
    let recording = recording([64, 64], 0, &[camera([320.0, 10.0, 300.0], 5.0, -35.0, SIZE)]);
    for choice in [RaysChoice::Mipmap, RaysChoice::Coherent] {
        let bytes = [1, 2, 3].map(|workers| {
            let frames = draw(&EngineOptions { workers, ..rays(choice) }, &recording).unwrap();
            (frames[0].pixels.rgba().to_vec(), frames[0].pixels.reversed_depth().unwrap().to_vec())
        });
        assert!(sky_pixels(&draw(&rays(choice), &recording).unwrap()[0]) < 15_000);
        assert!(bytes[0] == bytes[1] && bytes[0] == bytes[2], "{choice:?}");
    }
}

#[test]
fn rays_refuse_what_only_the_mesh_does() {
    let source = RecordedSource::new(recording([16, 16], 0, &[camera([80.0, 80.0, 300.0], 0.0, -80.0, SIZE)]), 1);
    let usual = rays(RaysChoice::Mipmap);
    for options in
        [EngineOptions { samples: 4, ..usual.clone() }, EngineOptions { size: [60_000, 10], ..usual.clone() }]
    {
        let error = engine::open(options, &source).unwrap_err();
        assert!(matches!(error, EngineError::MeshOnly { .. } | EngineError::PictureSize { .. }), "{error}");
    }
    let error = engine::open(EngineOptions { samples: 4, ..compute() }, &source).unwrap_err();
    assert!(matches!(error, EngineError::MeshOnly { .. }), "{error}");
    let described = engine::open(compute(), &source).unwrap().describe();
    assert!(described.technique == "rays" && described.driver.contains("compute"), "{described:?}");
    let described = engine::open(EngineOptions { workers: 2, ..usual }, &source).unwrap().describe();
    assert_eq!((described.technique, described.device.as_str()), ("rays", "CPU, 2 workers"));
}

#[test]
fn a_height_that_is_no_number_is_refused() {
    let mut scene = Scene::new(world([16, 16]), &|_, _| f64::NAN, &checks);
    let camera = camera([80.0, 80.0, 300.0], 0.0, -80.0, SIZE);
    let tiles = vec![scene.leaf(node(0, 0, 0), &camera, [0; 4])];
    scene.frame(&camera, tiles);
    let error = draw(&rays(RaysChoice::Mipmap), &scene.finish()).unwrap_err().to_string();
    assert!(error.contains("not a finite number"), "{error}");
}

#[test]
fn more_frames_of_rays_take_no_more_allocations() {
    let camera = camera([80.0, 10.0, 150.0], 5.0, -35.0, SIZE);
    let arrays = recording([16, 16], 0, &[camera]);
    let in_place = recording_in_place([16, 16], &[camera], &rough);
    for (choice, has_tree_overlay, recording) in [
        (RaysChoice::Mipmap, false, &arrays),
        (RaysChoice::Mipmap, true, &arrays),
        (RaysChoice::Coherent, false, &arrays),
        (RaysChoice::Compute, false, &arrays),
        (RaysChoice::Sweep, false, &arrays),
        (RaysChoice::Sweep, true, &in_place),
    ] {
        let allocations = |laps: u64| {
            let mut source = RecordedSource::new(Arc::clone(recording), laps);
            let workers = SinkWorkers::start(vec![Box::new(NullSink)]).unwrap();
            let info = allocation_counter::measure(|| {
                let options = EngineOptions { has_tree_overlay, ..rays(choice) };
                run(options, &mut source, workers, &mut |_, _| {}, &mut |_| {}).unwrap();
            });
            info.count_total
        };
        allocations(3);
        let (short, long) = (allocations(4), allocations(24));
        // As with the mesh: a queue allocates the first time that somebody waits at it.
        assert!(long <= short + 4, "{choice:?}: 20 more frames allocated {} times", long as i64 - short as i64);
    }
}
