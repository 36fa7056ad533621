//! Several views of one frame: each has the bytes of its camera alone, and the faces of a cube
//! meet.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

mod support;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use support::{Scene, camera, draw, keep, node, options, world};
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::rig::{Rig, RigView, View, Views};
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_common::slot::TileSlot;
use terravision_renderer::engine::{EngineOptions, Finished, ViewBounds};
use terravision_renderer::source::Recording;
use terravision_renderer::technique::NEAR_M;

/// Of views that lie within `picture`.
fn of_views(picture: [u32; 2], views: &Views) -> EngineOptions {
    let size = [0, 1].map(|axis| views.iter().map(|view| view.size()[axis]).max().unwrap());
    let views = Some(ViewBounds { size, count: views.len() });
    EngineOptions { views, has_depth: true, ..options(picture) }
}

fn rays(rays: RaysChoice, options: EngineOptions) -> EngineOptions {
    let has_validation = rays == RaysChoice::Compute;
    EngineOptions { technique: TechniqueChoice::Rays, rays, has_validation, ..options }
}

fn rough(x: f64, y: f64) -> f64 {
    60.0 * ((x * 0.031).sin() * (y * 0.023).cos() + 0.5 * (x * 0.11 + 1.0).sin() * (y * 0.13).sin())
}

/// Slow enough that a pixel's colour hardly depends on where in the pixel it is taken.
fn smooth(x: f64, y: f64) -> [u8; 3] {
    [0.011, 0.007, 0.004].map(|k| (127.0 + 60.0 * (x * k).sin() * (y * k).cos()) as u8)
}

/// One frame of all nodes of level 1.
fn recording(pose: &Camera, views: &Views) -> Arc<Recording> {
    recording_of(pose, views, &smooth)
}

fn recording_of(pose: &Camera, views: &Views, color: &dyn Fn(f64, f64) -> [u8; 3]) -> Arc<Recording> {
    let mut scene = Scene::new(world([128, 128]), &rough, color);
    let [columns, rows] = scene.world.nodes_at(1);
    let tiles: Vec<TileSlot> =
        (0..rows * columns).map(|i| scene.leaf(node(i % columns, i / columns, 1), pose, [0; 4])).collect();
    scene.frame_of_views(pose, *views, tiles);
    scene.finish()
}

/// A view's colours and depths, cut out of the frame's picture.
fn cut_out(frame: &Finished, view: &View) -> (Vec<u8>, Vec<f32>) {
    let row = frame.pixels.size()[0] as usize;
    let [left, top] = view.at.map(|at| at as usize);
    let [width, height] = view.size().map(|side| side as usize);
    let rows = (top..top + height).map(|y| y * row + left..y * row + left + width);
    let rgba = rows.clone().flat_map(|row| &frame.pixels.rgba()[4 * row.start..4 * row.end]).copied().collect();
    let depth = rows.flat_map(|row| &frame.pixels.reversed_depth().unwrap()[row]).copied().collect();
    (rgba, depth)
}

/// All ways to draw a frame of these views.
fn ways(picture: [u32; 2], views: &Views) -> [(&'static str, EngineOptions); 6] {
    let plain = of_views(picture, views);
    [
        ("mesh", plain.clone()),
        ("mesh of four samples", EngineOptions { samples: 4, ..plain.clone() }),
        ("exact rays", rays(RaysChoice::Mipmap, plain.clone())),
        ("coherent rays", rays(RaysChoice::Coherent, plain.clone())),
        ("swept planes", rays(RaysChoice::Sweep, plain.clone())),
        ("rays of a device", rays(RaysChoice::Compute, plain)),
    ]
}

#[test]
fn every_view_has_the_bytes_of_its_camera_alone() {
    let pose = camera([600.0, 300.0, 260.0], 20.0, -25.0, [90, 70]);
    let mut right = *pose.fields();
    right.eye_in_world[0] += 7.3;
    let down = CameraFields { pitch_rad: -FRAC_PI_2, vfov_rad: 0.8, width: 50, height: 101, ..*pose.fields() };
    let [right, down] = [right, down].map(|fields| Camera::new(fields).unwrap());
    let views = Views::new([
        View { camera: pose, at: [3, 5] },
        View { camera: right, at: [97, 0] },
        View { camera: down, at: [190, 20] },
    ])
    .unwrap();
    for (name, options) in ways(views.picture(), &views) {
        let together = draw(&options, &recording(&pose, &views)).unwrap().pop().unwrap();
        keep(&together, &format!("views-{name}"));
        assert_eq!((together.views, together.pose), (views, pose));
        for (index, view) in views.iter().enumerate() {
            let single = Views::single(&view.camera);
            let options = EngineOptions { size: view.size(), views: None, ..options.clone() };
            let alone = draw(&options, &recording(&pose, &single)).unwrap().pop().unwrap();
            let (rgba, depth) = cut_out(&together, view);
            assert!(rgba == alone.pixels.rgba(), "{name}: view {index} has other colours than alone");
            assert!(
                Some(&depth[..]) == alone.pixels.reversed_depth(),
                "{name}: view {index} has other depths than alone"
            );
            assert!(depth.iter().filter(|depth| **depth > 0.0).count() > depth.len() / 3, "{name}: ground is seen");
        }
        // Around them all is black.
        let outside = &together.pixels.rgba()[..4];
        assert_eq!((outside, together.pixels.reversed_depth().unwrap()[0]), (&[0, 0, 0, 255][..], 0.0), "{name}");
    }
}

#[test]
fn a_view_from_higher_up_sees_the_same_ground() {
    let pose = camera([600.0, 300.0, 260.0], 20.0, -35.0, [120, 90]);
    let mut above = *pose.fields();
    above.eye_in_world[2] += 40.0;
    let above = Camera::new(above).unwrap();
    let views = Views::new([View { camera: pose, at: [0, 0] }, View { camera: above, at: [120, 0] }]).unwrap();
    // Voxels are chosen by their distance from the pose.
    for (name, options) in ways([240, 90], &views).into_iter().filter(|(name, _)| *name != "coherent rays") {
        let together = draw(&options, &recording(&pose, &views)).unwrap().pop().unwrap();
        let options = EngineOptions { size: [120, 90], views: None, ..options };
        let alone = draw(&options, &recording(&above, &Views::single(&above))).unwrap().pop().unwrap();
        let (rgba, depth) = cut_out(&together, &views[1]);
        // Heights were rounded from another eye: by a few micrometres.
        let near =
            depth.iter().zip(alone.pixels.reversed_depth().unwrap()).filter(|(a, b)| (*a - *b).abs() <= 1e-4 * *b);
        assert!(near.count() * 1000 >= depth.len() * 995, "{name}: depths");
        let same = rgba.iter().zip(alone.pixels.rgba()).filter(|(a, b)| a.abs_diff(**b) <= 1);
        assert!(same.count() * 1000 >= rgba.len() * 995, "{name}: colours");
    }
}

#[test]
fn a_shifted_lens_shows_a_part_of_a_wider_picture() {
    let wide = camera([600.0, 300.0, 260.0], 20.0, -25.0, [130, 70]);
    for shift in [14, -14] {
        let narrow = Camera::new(CameraFields { width: 90, ..*wide.fields() }).unwrap();
        let narrow = narrow.with_lens_shift(f64::from(shift)).unwrap();
        let views = Views::new([View { camera: wide, at: [0, 0] }, View { camera: narrow, at: [130, 0] }]).unwrap();
        let first = (20 + shift) as u32;
        let part = Camera::new(CameraFields { width: 90, ..*wide.fields() }).unwrap();
        let part = View { camera: part, at: [first, 0] };
        for (name, options) in ways(views.picture(), &views) {
            let frame = draw(&options, &recording(&wide, &views)).unwrap().pop().unwrap();
            keep(&frame, &format!("shifted-{shift}-{name}"));
            let ((rgba, depth), (whole_rgba, whole_depth)) = (cut_out(&frame, &views[1]), cut_out(&frame, &part));
            // Lines of swept planes, and samples of voxels, are at other places.
            let (within, percent) = match name {
                "swept planes" => (0.05, 85),
                "coherent rays" => (0.01, 90),
                _ => (0.01, 98),
            };
            let near = depth.iter().zip(&whole_depth).filter(|(a, b)| (*a - *b).abs() <= within * **b).count();
            let same = rgba.iter().zip(&whole_rgba).filter(|(a, b)| a.abs_diff(**b) <= 2).count();
            let told = format!("{name}, {shift}: {near} of {} depths, {same} of {} colours", depth.len(), rgba.len());
            println!("{told}");
            assert!(near * 100 >= depth.len() * percent && same * 100 >= rgba.len() * percent, "{told}");
            assert!(depth.iter().filter(|depth| **depth > 0.0).count() > depth.len() / 3, "{name}: ground is seen");
        }
    }
}

/// Detail of some ten metres, nowhere twice the same.
fn detailed(x: f64, y: f64) -> [u8; 3] {
    let of = |a: f64, b: f64| (127.0 + 50.0 * ((x * a).sin() + (y * b + x * 0.05).sin())) as u8;
    [of(0.21, 0.17), of(0.13, 0.29), of(0.33, 0.11)]
}

/// Where in the right picture the surroundings of a pixel of the left one are found, in its row:
/// columns to the left.
fn disparity([left, right]: [&[u8]; 2], width: usize, [x, y]: [usize; 2], most: i32) -> f64 {
    let cost = |shift: i32| {
        let of = |dx: i32, dy: i32| {
            let row = (y as i32 + dy) as usize * width;
            let [from, to] = [x as i32 + dx, x as i32 + dx - shift].map(|column| 4 * (row + column as usize));
            (0..3)
                .map(|channel| (f64::from(left[from + channel]) - f64::from(right[to + channel])).powi(2))
                .sum::<f64>()
        };
        (-4..=4).flat_map(|dy| (-4..=4).map(move |dx| (dx, dy))).map(|(dx, dy)| of(dx, dy)).sum::<f64>()
    };
    let best = (-most..=most).min_by(|a, b| cost(*a).total_cmp(&cost(*b))).unwrap();
    // The lowest point of a parabola through three costs.
    let [before, here, after] = [best - 1, best, best + 1].map(cost);
    f64::from(best) + 0.5 * (before - after) / (before - 2.0 * here + after)
}

#[test]
fn depth_from_the_disparity_of_a_stereo_pair_is_that_of_the_depth_output() {
    let (separation, converge) = (16.0, 300.0);
    let pose = camera([600.0, 200.0, 200.0], 20.0, -25.0, [200, 150]);
    let shift = 0.5 * separation * pose.focal_px() / converge;
    let eye = |name: &str, side: f64, x| RigView {
        name: name.to_owned(),
        offset_m: [0.5 * separation * side, 0.0, 0.0],
        yaw_rad: 0.0,
        pitch_rad: 0.0,
        roll_rad: 0.0,
        vfov_rad: pose.vfov_rad(),
        lens_shift_px: -shift * side,
        size: [200, 150],
        at: [x, 0],
    };
    let views = Rig::new(vec![eye("left", -1.0, 0), eye("right", 1.0, 200)]).unwrap().views_from(&pose).unwrap();
    let recording = recording_of(&pose, &views, &detailed);
    for (name, options) in ways([400, 150], &views) {
        let frame = draw(&options, &recording).unwrap().pop().unwrap();
        keep(&frame, &format!("stereo-{name}"));
        let [(left, depth), (right, _)] = [0, 1].map(|eye| cut_out(&frame, &views[eye]));
        let mut errors: Vec<f64> = Vec::new();
        for (x, y) in (24..176).step_by(8).flat_map(|x| (6..144).step_by(8).map(move |y| (x, y))) {
            let reversed = f64::from(depth[y * 200 + x]);
            if reversed > 0.0 {
                let seen = disparity([&left, &right], 200, [x, y], 14);
                let found = pose.focal_px() * separation / (seen + 2.0 * shift);
                errors.push((found * reversed / NEAR_M - 1.0).abs());
            }
        }
        errors.sort_by(f64::total_cmp);
        let (count, median) = (errors.len(), errors[errors.len() / 2]);
        println!("{name}: depth from disparity at {count} places, median error {:.2} %", 100.0 * median);
        assert!(count > 100 && median < 0.03, "{name}: {count} places, median error {median}");
    }
}

const SIDE: u32 = 65;

/// A cube's six faces, side by side, a little wider than 90 degrees: the centres of the outermost
/// pixels lie on its edges, so that two faces share the rays along their edge.
fn cube() -> Rig {
    let turned = |(index, (name, yaw, pitch)): (u32, (&str, f64, f64))| RigView {
        name: name.to_owned(),
        offset_m: [0.0; 3],
        yaw_rad: yaw * FRAC_PI_2,
        pitch_rad: pitch * FRAC_PI_2,
        roll_rad: 0.0,
        vfov_rad: 2.0 * (f64::from(SIDE) / f64::from(SIDE - 1)).atan(),
        lens_shift_px: 0.0,
        size: [SIDE; 2],
        at: [index * SIDE, 0],
    };
    let faces = [
        ("front", 0.0, 0.0),
        ("right", 1.0, 0.0),
        ("back", 2.0, 0.0),
        ("left", -1.0, 0.0),
        ("up", 0.0, 1.0),
        ("down", 0.0, -1.0),
    ];
    Rig::new((0..).zip(faces).map(turned).collect()).unwrap()
}

/// The pixels on a side of a face, in order: top and bottom from the left, left and right from the
/// top.
fn side(name: &str) -> Vec<[u32; 2]> {
    let last = SIDE - 1;
    let at = |k: u32| match name {
        "top" => [k, 0],
        "bottom" => [k, last],
        "left" => [0, k],
        _ => [last, k],
    };
    (0..SIDE).map(at).collect()
}

#[test]
fn the_faces_of_a_cube_meet_along_their_edges() {
    // Level: half of all edges is ground. And tilted: nothing lies along an axis.
    for pose in
        [camera([640.0, 640.0, 120.0], 0.0, 0.0, [64, 64]), camera([640.0, 600.0, 130.0], 33.0, -20.0, [64, 64])]
    {
        let rig = cube();
        let views = rig.views_from(&pose).unwrap();
        // Face, side, face, side, and whether the second runs the other way.
        let edges = [
            (0, "right", 1, "left", false),
            (1, "right", 2, "left", false),
            (2, "right", 3, "left", false),
            (3, "right", 0, "left", false),
            (0, "top", 4, "bottom", false),
            (1, "top", 4, "right", true),
            (2, "top", 4, "top", true),
            (3, "top", 4, "left", false),
            (0, "bottom", 5, "top", false),
            (1, "bottom", 5, "right", false),
            (2, "bottom", 5, "bottom", true),
            (3, "bottom", 5, "left", true),
        ];
        let recording = recording(&pose, &views);
        for (name, options) in ways(views.picture(), &views) {
            let frame = draw(&options, &recording).unwrap().pop().unwrap();
            keep(&frame, &format!("cube-{name}"));
            let of = |face: usize, [x, y]: [u32; 2]| {
                let at = ((views[face].at[1] + y) * frame.pixels.size()[0] + views[face].at[0] + x) as usize;
                (&frame.pixels.rgba()[4 * at..4 * at + 3], frame.pixels.reversed_depth().unwrap()[at])
            };
            let (mut same, mut near, mut all, mut ground) = (0, 0, 0, 0);
            for (face, on, other, at, is_turned) in edges {
                let mut others = side(at);
                if is_turned {
                    others.reverse();
                }
                for (a, b) in side(on).into_iter().zip(others) {
                    let ((a, depth), (b, _)) = (of(face, a), of(other, b));
                    let furthest = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
                    (all, ground) = (all + 1, ground + u32::from(depth > 0.0));
                    (same, near) = (same + u32::from(furthest == 0), near + u32::from(furthest <= 1));
                }
            }
            let told =
                format!("{name}: of {all} pixels on edges, {ground} of them ground, {same} are equal, {near} within 1");
            println!("{told}");
            // One ray, but not to the bit: each face has axes of its own. So a ray along a crest
            // may pass it in one face. Samples beside the centre are other rays in each face, and
            // voxels are sampled at other places along them.
            let (fewest_equal, fewest_near) = match name {
                "exact rays" => (all - 2, all - 2),
                "mesh" | "rays of a device" => (all * 97 / 100, all - 2),
                // Drawn between planes that lie two pixels apart, elsewhere in each face.
                "swept planes" => (all * 65 / 100, all * 80 / 100),
                _ => (all * 85 / 100, all * 97 / 100),
            };
            assert!(same >= fewest_equal && near >= fewest_near, "{told}");
            assert!(ground > all / 3 && ground < all, "{name}: {ground} of {all}");
        }
    }
}
