//! The sweep against the surface that it samples: on hills, cliffs and beyond the world's edge, in
//! any attitude. Ten thousand poses with `TERRAVISION_SWEEP_POSES=10000`, a part of them with a range
//! (`2000..4000`): runs of parts side by side are all of them.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use glam::{DVec2, DVec3};
use std::ops::Range;
use terravision_common::camera::Camera;
use terravision_common::simd::Instructions;
use terravision_raycast::model::{Filter, Ground};
use terravision_raycast::{CastOptions, CastTask, Caster, Method, Picture, SweepDetail};
use terravision_testkit::rays::{AnyMethod, Field, PooledField, UNIT_M, camera, noise};

const SIZE: [u32; 2] = [56, 42];
const DETAIL: SweepDetail =
    SweepDetail { step_px: 2.0, lines_per_px: 1.0, has_soft_edges: true, ..SweepDetail::DEFAULT };

fn options() -> CastOptions {
    CastOptions { method: Method::Sweep, sweep: DETAIL, ..CastOptions::default() }
}

/// The surface that is sampled: its cells a side, and its height at a place.
struct Plane<'a> {
    cells: usize,
    at: &'a dyn Fn(DVec2) -> Option<f64>,
}

/// The lowest and the highest ground around a place, no further away than `radius_m`, and whether
/// the world ends there.
fn around(field: &Plane<'_>, place: DVec2, radius_m: f64) -> ([f64; 2], bool) {
    let (mut low, mut high, mut is_border) = (f64::INFINITY, f64::NEG_INFINITY, false);
    let mut look = |at: DVec2| match (field.at)(at) {
        Some(height) => {
            low = low.min(height);
            high = high.max(height);
        }
        None => is_border = true,
    };
    for i in -2..=2 {
        for j in -2..=2 {
            look(place + DVec2::new(f64::from(i), f64::from(j)) * 0.5 * radius_m);
        }
    }
    let [first, last] = [-radius_m, radius_m]
        .map(|by| ((place + by) / UNIT_M).round().clamp(DVec2::ZERO, DVec2::splat(field.cells as f64)));
    for i in first.x as u32..=last.x as u32 {
        for j in first.y as u32..=last.y as u32 {
            look(DVec2::new(f64::from(i), f64::from(j)) * UNIT_M);
        }
    }
    ([low, high], is_border)
}

/// Whether a ray comes over the ground lower than its edge: it goes on under it.
fn is_under_edge(field: &Plane<'_>, eye: DVec3, direction: DVec3, focal: f64) -> bool {
    let end = field.cells as f64 * UNIT_M;
    let (mut entry, mut exit) = (0.0f64, f64::INFINITY);
    for axis in 0..2 {
        let ways = [0.0, end].map(|border| (border - eye[axis]) / direction[axis]);
        entry = entry.max(ways[0].min(ways[1]));
        exit = exit.min(ways[0].max(ways[1]));
    }
    if entry == 0.0 || entry >= exit {
        return false;
    }
    let point = eye + direction * entry;
    let pixel = entry / focal;
    let ([_, edge], _) = around(field, point.truncate().clamp(DVec2::ZERO, DVec2::splat(end)), UNIT_M + 2.0 * pixel);
    // A pixel further on, a steep line of sight is much lower.
    point.z < edge + pixel * (1.0 + direction.z.abs() / direction.truncate().length().max(1e-9))
}

/// Pixels that show what is further than a step from what plain rays could meet: ground that is not
/// there, or ground behind ground. Every fifth pixel of pose `seed` is looked at; of thousands of
/// poses fewer, other ones of each.
fn strays(field: &Plane<'_>, camera: &Camera, depths: &[f32], seed: u64) -> Vec<String> {
    let every = if poses().end > 1000 { 29 } else { 5 };
    let eye = camera.eye();
    let focal = camera.focal_px();
    let mut strays = Vec::new();
    for (k, depth) in depths.iter().enumerate().skip((seed % every) as usize).step_by(every as usize) {
        let [x, y] = [k as u32 % SIZE[0], k as u32 / SIZE[0]];
        let direction = camera.ray_in_world(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let across = direction.truncate().length().max(1e-9);
        if is_under_edge(field, eye, direction, focal) {
            continue;
        }
        // A step outwards, and the pixel between two lines.
        let radius = |t: f64| (0.5 * UNIT_M).max(2.0 * t * across / focal) + 2.0 * t / focal + 0.1;
        let hit = if depth.is_nan() { f64::INFINITY } else { f64::from(*depth) };
        if hit.is_finite() {
            let point = eye + direction * hit;
            // Between lines nearness is interpolated, up to a fiftieth of it.
            let ([low, high], is_border) = around(field, point.truncate(), radius(hit) + 0.02 * hit * across);
            // Half a pixel beside the middle, on the next line, the line of sight is higher or
            // lower.
            let margin = 0.02 * hit * direction.z.abs() + 0.6 * hit / focal + 0.1;
            if !is_border && !(low - margin..=high + margin).contains(&point.z) {
                strays.push(format!("pixel {x}, {y} at {hit}: height {} is not from {low} to {high}", point.z));
                continue;
            }
        }
        let mut t = 0.0;
        while t < hit.min(3000.0) * 0.97 - 2.0 * radius(t) / across {
            let point = eye + direction * t;
            let ([low, _], is_border) = around(field, point.truncate(), radius(t) + 0.02 * t * across);
            if !is_border && point.z < low - 0.6 * t / focal - 0.1 {
                strays.push(format!("pixel {x}, {y} at {hit}: passes ground at {t}, {} m below it", low - point.z));
                break;
            }
            t += (0.7 * radius(t) / direction.length()).max(1.0);
        }
    }
    strays
}

/// Seeds of poses.
fn poses() -> Range<u64> {
    let asked = std::env::var("TERRAVISION_SWEEP_POSES").unwrap_or_else(|_| "120".to_owned());
    let (first, end) = asked.split_once("..").unwrap_or(("0", &asked));
    let number = |text: &str| text.parse().expect("TERRAVISION_SWEEP_POSES is a number, or two as in 2000..4000");
    number(first)..number(end)
}

/// A pose over the exaggerated field, or beside it: any heading and roll, any pitch.
fn pose(field: &Field, exaggeration: f64, seed: u64) -> Camera {
    let random = |n: u64| noise(seed, n, 77);
    let side = field.cells as f64 * UNIT_M;
    let place = [0, 1].map(|n| (random(n) * 1.2 - 0.1) * side);
    let ground = field.at(place[0], place[1]).map_or(60.0, |height| height * exaggeration);
    let angles = [random(2) * 360.0, random(3) * 180.0 - 110.0, random(4) * 360.0 - 180.0];
    let angles = if seed.is_multiple_of(11) { [angles[0], -90.0, (angles[2] / 45.0).round() * 45.0] } else { angles };
    camera([place[0], place[1], ground + 8.0 + 400.0 * random(5) * random(5)], angles, 30.0 + 60.0 * random(6), SIZE)
}

#[test]
fn no_pixel_is_further_than_a_step_from_the_ground_and_none_is_left_out() {
    let fields = [Field::hills(90, 250.0, 3), Field::towers(90, 120.0, 5)];
    let grounds: Vec<Ground> = fields.iter().map(|field| field.ground(16, None)).collect();
    let colors = fields.each_ref().map(Field::colors);
    let mut caster = Caster::new(1).unwrap();
    // Of this color is no pixel that was drawn: neither sky nor ground.
    let unset = camera([1e7, 0.0, 100.0], [90.0, 0.0, 0.0], 60.0, SIZE);
    for seed in poses() {
        let which = seed as usize % 2;
        let (field, ground) = (&fields[which], &grounds[which]);
        let camera = pose(field, 1.0, seed);
        let picture = Picture::new(SIZE);
        let blank = CastOptions { sky_rgb: [1, 254, 3], ..options() };
        caster.draw(&CastTask {
            ground,
            colors: &[&colors[which][..]],
            heights: &[],
            camera: &unset,
            options: &blank,
            picture: &picture,
        });
        let is_unset = |color: u32| color == u32::from_le_bytes([1, 254, 3, 255]);
        assert!(picture.rgba().all(is_unset), "a camera that sees no ground");
        caster.draw(&CastTask {
            ground,
            colors: &[&colors[which][..]],
            heights: &[],
            camera: &camera,
            options: &options(),
            picture: &picture,
        });
        assert!(!picture.rgba().any(is_unset), "pose {seed}: a pixel is left out");
        let depths: Vec<f32> = picture.depth().collect();
        assert!(depths.iter().all(|depth| depth.is_nan() || *depth > 0.0), "pose {seed}");
        let surface = Plane { cells: field.cells, at: &|place| field.at(place.x, place.y) };
        let strays = strays(&surface, &camera, &depths, seed);
        assert!(strays.is_empty(), "pose {seed}, {camera:?}: {} strays, the first: {}", strays.len(), strays[0]);
    }
}

#[test]
fn a_loop_leaves_no_pixel_out_and_shows_the_ground_that_is_there() {
    let field = Field::hills(90, 250.0, 3);
    let (ground, colors) = (field.ground(16, None), field.colors());
    let mut caster = Caster::new(1).unwrap();
    let side = field.cells as f64 * UNIT_M;
    for frame in 0..24 {
        let angle = f64::from(frame) * 15.0;
        // Nose up, over the top on its back, straight down, and level again.
        let angles = match angle {
            0.0..=90.0 => [30.0, angle, 0.0],
            90.0..=270.0 => [210.0, 180.0 - angle, 180.0],
            _ => [30.0, angle - 360.0, 0.0],
        };
        let (sin, cos) = angle.to_radians().sin_cos();
        let eye = [0.5 * side, 0.5 * side + 120.0 * sin, 320.0 + 120.0 * (1.0 - cos)];
        let camera = camera(eye, angles, 60.0, SIZE);
        let picture = Picture::new(SIZE);
        // Nothing has written the colors that a picture is made with: opaque ones are drawn.
        caster.draw(&CastTask {
            ground: &ground,
            colors: &[&colors[..]],
            heights: &[],
            camera: &camera,
            options: &options(),
            picture: &picture,
        });
        assert!(picture.rgba().all(|color| color >> 24 == 255), "{angle} degrees: a pixel is left out");
        let depths: Vec<f32> = picture.depth().collect();
        let sky = depths.iter().filter(|depth| depth.is_nan()).count();
        assert!(angle != 90.0 || sky == depths.len(), "straight up there is sky alone, {sky} pixels");
        assert!(angle != 270.0 || sky == 0, "straight down there is ground alone, {sky} pixels of sky");
        let surface = Plane { cells: field.cells, at: &|place| field.at(place.x, place.y) };
        let strays = strays(&surface, &camera, &depths, 0);
        assert!(strays.is_empty(), "{angle} degrees: {} strays, the first: {}", strays.len(), strays[0]);
    }
}

/// Draws a ground in place; colors and depths.
fn draw_in_place(caster: &mut Caster, pooled: &PooledField, ground: &Ground, camera: &Camera) -> (Vec<u32>, Vec<f32>) {
    let picture = Picture::new(SIZE);
    let colors = pooled.finest().colors();
    let sky_rgb = [1, 254, 3];
    caster.draw(&CastTask {
        ground,
        colors: &[&colors[..]],
        heights: &pooled.heights,
        camera,
        options: &CastOptions { sky_rgb, ..options() },
        picture: &picture,
    });
    (picture.rgba().collect(), picture.depth().collect())
}

#[test]
fn levels_in_place_are_swept_as_near_to_the_surface_that_they_blend_to() {
    const EXAGGERATIONS: [f64; 2] = [1.0, 1.5];
    let (hills, towers) = (Field::hills(128, 250.0, 3), Field::towers(128, 60.0, 5));
    let pooled = [PooledField::new(hills, EXAGGERATIONS[0]), PooledField::new(towers, EXAGGERATIONS[1])];
    let mut grounds = pooled.each_ref().map(PooledField::ground);
    let mut caster = Caster::new(1).unwrap();
    let post_px = f64::from(DETAIL.post_px);
    for seed in poses().step_by(2).map(|seed| seed / 2) {
        let which = seed as usize % 2;
        let (pooled, ground) = (&pooled[which], &mut grounds[which]);
        let camera = pose(pooled.finest(), EXAGGERATIONS[which], 1000 + seed);
        pooled.fill(ground, &camera, post_px, |_, _| false);
        let (_, depths) = draw_in_place(&mut caster, pooled, ground, &camera);
        let at = |place: DVec2| pooled.at(&camera, post_px, place);
        let strays = strays(&Plane { cells: 128, at: &at }, &camera, &depths, seed);
        assert!(strays.is_empty(), "pose {seed}, {camera:?}: {} strays, the first: {}", strays.len(), strays[0]);
    }
}

/// Has the same picture drawn of random poses by all instructions and numbers of workers; how many
/// pixels saw ground that is marked as filled, and how many see none.
fn draw_by_all(pooled: &PooledField) -> [usize; 2] {
    let mut ground = pooled.ground();
    let mut casters = [1, 3].map(|workers| Caster::new(workers).unwrap());
    let mut seen = [0; 2];
    for seed in 0..20 {
        let camera = pose(pooled.finest(), 1.0, seed);
        // Where tiles are missing leaves of several levels meet.
        let is_missing = |level: usize, [m, n]: [usize; 2]| noise((8 * m + n) as u64, level as u64, seed) > 0.9;
        pooled.fill(&mut ground, &camera, f64::from(DETAIL.post_px), is_missing);
        let mut pictures = Vec::new();
        for caster in &mut casters {
            for instructions in Instructions::all() {
                caster.set_instructions(instructions);
                let (colors, depths) = draw_in_place(caster, pooled, &ground, &camera);
                pictures.push((colors, depths.into_iter().map(f32::to_bits).collect::<Vec<_>>()));
            }
        }
        assert!(pictures.windows(2).all(|pair| pair[0] == pair[1]), "pose {seed}");
        let (colors, depths) = &pictures[0];
        seen[0] += colors.iter().filter(|color| *color >> 24 == 254).count();
        seen[1] += depths.iter().filter(|depth| f32::from_bits(**depth).is_nan()).count();
    }
    seen
}

#[test]
fn levels_in_place_give_the_same_picture_by_any_instructions_and_workers() {
    draw_by_all(&PooledField::new(Field::hills(128, 250.0, 9), 1.0));
}

#[test]
fn holes_in_place_give_the_same_picture_by_any_instructions_and_workers() {
    let [whole, holed] = [false, true].map(|has_holes| {
        // Stripes of ground, and of filled ground across them.
        let is_ground = |at: DVec2| !has_holes || (at.x / (9.0 * UNIT_M)).fract() < 0.6;
        let is_measured = |at: DVec2| !has_holes || (at.y / (13.0 * UNIT_M)).fract() < 0.7;
        draw_by_all(&PooledField::with_holes(Field::hills(128, 250.0, 9), 1.0, [&is_ground, &is_measured]))
    });
    assert!(whole[0] == 0 && holed[0] > 1000, "filled: {whole:?}, {holed:?}");
    assert!(holed[1] > whole[1] + 1000, "sky: {whole:?}, {holed:?}");
}

#[test]
fn nothing_pops_between_levels_in_place() {
    // Away from the ground, by less than a hundredth of its distance at a time: leaves are merged on
    // the way, and no pixel's depth jumps.
    let pooled = PooledField::new(Field::hills(256, 250.0, 21), 1.0);
    let mut ground = pooled.ground();
    let mut caster = Caster::new(1).unwrap();
    let (mut before, mut leaves): (Option<Vec<f32>>, Vec<usize>) = (None, Vec::new());
    for step in 0..130 {
        let height = 400.0 * 1.008f64.powi(step);
        let camera = camera([1280.0, 1280.0, height], [30.0, -80.0, 20.0], 50.0, SIZE);
        pooled.fill(&mut ground, &camera, f64::from(DETAIL.post_px), |_, _| false);
        leaves.push(ground.tile_count());
        let (_, depths) = draw_in_place(&mut caster, &pooled, &ground, &camera);
        if let Some(before) = &before {
            for (k, (a, b)) in before.iter().zip(&depths).enumerate() {
                assert!((a - b).abs() < 0.02 * a, "step {step}, pixel {k}: {a} m, then {b} m");
            }
        }
        before = Some(depths);
    }
    leaves.dedup();
    assert!(leaves.len() > 2, "leaves are merged: {leaves:?}");
}

#[test]
fn pictures_do_not_depend_on_the_instructions() {
    let field = Field::hills(100, 250.0, 1);
    let ground = field.ground(32, Filter::OrientedBox);
    let colors = field.colors();
    let mut caster = Caster::new(1).unwrap();
    let all = Instructions::all();
    assert!(all[0] == Instructions::PORTABLE && all.last() == Some(&caster.instructions()));
    for seed in 0..40 {
        let camera = pose(&field, 1.0, seed);
        for detail in [SweepDetail::DEFAULT, SweepDetail::BEST] {
            let mut draw = |instructions: Instructions| -> Vec<(u32, u32)> {
                let picture = Picture::new(SIZE);
                caster.set_instructions(instructions);
                let options = CastOptions { sweep: detail, ..options() };
                caster.draw(&CastTask {
                    ground: &ground,
                    colors: &[&colors[..]],
                    heights: &[],
                    camera: &camera,
                    options: &options,
                    picture: &picture,
                });
                picture.rgba().zip(picture.depth().map(f32::to_bits)).collect()
            };
            let portable = draw(Instructions::PORTABLE);
            for other in &all[1..] {
                assert!(draw(*other) == portable, "pose {seed} by {}", other.name());
            }
        }
    }
}

#[test]
fn depth_is_that_of_exact_rays() {
    let field = Field::hills(100, 250.0, 11);
    let eye = [300.0, 200.0, field.at(300.0, 200.0).unwrap() + 150.0];
    for (side, angles) in
        [(128, [30.0, -25.0, 0.0]), (16, [30.0, -25.0, 0.0]), (32, [60.0, -50.0, 100.0]), (16, [0.0, -90.0, 5.0])]
    {
        let camera = camera(eye, angles, 60.0, SIZE);
        let ground = field.ground(side, None);
        let [exact, swept] = [AnyMethod::Mipmap, AnyMethod::Sweep].map(|method| {
            let picture = Picture::new(SIZE);
            let options = CastOptions { sweep: DETAIL, ..CastOptions::default() };
            method.draw(
                &mut Caster::new(1).unwrap(),
                &CastTask {
                    ground: &ground,
                    colors: &[&field.colors()[..]],
                    heights: &[],
                    camera: &camera,
                    options: &options,
                    picture: &picture,
                },
            );
            picture.depth().collect::<Vec<f32>>()
        });
        let both = exact.iter().zip(&swept);
        let torn = both.clone().filter(|(exact, swept)| exact.is_nan() != swept.is_nan()).count();
        let mut errors: Vec<f32> =
            both.map(|(exact, swept)| (exact - swept).abs()).filter(|error| error.is_finite()).collect();
        errors.sort_by(f32::total_cmp);
        let median = f64::from(errors[errors.len() / 2]);
        assert!(median < 0.1 * UNIT_M && torn < 20, "{angles:?}: {median} m, {torn} pixels");
    }
}

#[test]
fn beside_the_world_its_lower_side_is_seen_as_exact_rays_see_it() {
    let field = Field::hills(60, 250.0, 4);
    let ground = field.ground(16, None);
    // Ground ends where its tiles do: the eye counts as beside the world when it is beside them
    // west or south.
    for (eye, angles) in [([-200.0, 300.0, 20.0], [80.0, 5.0, 0.0]), ([300.0, -150.0, 60.0], [10.0, -10.0, 30.0])] {
        let camera = camera(eye, angles, 60.0, SIZE);
        let [exact, swept] = [AnyMethod::Mipmap, AnyMethod::Sweep].map(|method| {
            let picture = Picture::new(SIZE);
            let options = CastOptions { sweep: DETAIL, has_undersides: true, ..CastOptions::default() };
            method.draw(
                &mut Caster::new(1).unwrap(),
                &CastTask {
                    ground: &ground,
                    colors: &[&field.colors()[..]],
                    heights: &[],
                    camera: &camera,
                    options: &options,
                    picture: &picture,
                },
            );
            picture.depth().collect::<Vec<f32>>()
        });
        let torn = exact.iter().zip(&swept).filter(|(exact, swept)| exact.is_nan() != swept.is_nan()).count();
        let far = exact.iter().zip(&swept).filter(|(exact, swept)| (*exact - *swept).abs() > 0.2 * **exact).count();
        assert!(torn * 50 < exact.len() && far * 20 < exact.len(), "{eye:?}: {torn} torn, {far} far");
    }
}

#[test]
fn colors_are_mixed_at_edges_of_ground_alone_and_as_rays_beside_each_other_would() {
    let field = Field::hills(100, 250.0, 7);
    let ground = field.ground(16, None);
    let colors = field.colors();
    let mut caster = Caster::new(1).unwrap();
    let mut draw = |camera: &Camera, has_soft_edges: bool| -> Vec<([f64; 3], f32)> {
        let picture = Picture::new([camera.width(), camera.height()]);
        let sweep = SweepDetail { has_soft_edges, ..SweepDetail::BEST };
        caster.draw(&CastTask {
            ground: &ground,
            colors: &[&colors[..]],
            heights: &[],
            camera,
            options: &CastOptions { sweep, ..options() },
            picture: &picture,
        });
        let channels = |rgba: u32| [0, 8, 16].map(|shift| f64::from(rgba >> shift & 0xff));
        picture.rgba().map(channels).zip(picture.depth()).collect()
    };
    let [width, height] = SIZE.map(|side| side as usize);
    let off = |a: [f64; 3], b: [f64; 3]| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f64>();
    let (mut mixed, mut before, mut after) = (0, 0.0, 0.0);
    for angles in [[30.0, -8.0, 0.0], [140.0, -15.0, 35.0], [250.0, 0.0, -80.0], [300.0, -40.0, 180.0]] {
        let eye = [500.0, 450.0, field.at(500.0, 450.0).unwrap() + 60.0];
        let [hard, soft] = [false, true].map(|is_soft| draw(&camera(eye, angles, 60.0, SIZE), is_soft));
        let fine = draw(&camera(eye, angles, 60.0, SIZE.map(|side| 6 * side)), false);
        for (k, ((hard_color, depth), (soft_color, soft_depth))) in hard.iter().zip(&soft).enumerate() {
            assert_eq!(depth.to_bits(), soft_depth.to_bits(), "depth is that of the pixel's middle");
            if hard_color == soft_color {
                continue;
            }
            let (x, y) = (k % width, k / width);
            let around = (y.saturating_sub(1)..height.min(y + 2))
                .flat_map(|y| (x.saturating_sub(1)..width.min(x + 2)).map(move |x| y * width + x));
            let is_even = around.map(|n| hard[n].1).all(|other| (other - depth).abs() < 0.01 * depth);
            assert!(!is_even, "{angles:?}: pixel {x}, {y} is on no edge");
            let mut mean = [0.0; 3];
            for n in 0..36 {
                let (color, _) = fine[(6 * y + n / 6) * 6 * width + 6 * x + n % 6];
                (0..3).for_each(|c| mean[c] += color[c] / 36.0);
            }
            mixed += 1;
            before += off(*hard_color, mean);
            after += off(*soft_color, mean);
        }
    }
    assert!(mixed > 100 && after < 0.6 * before, "{mixed} pixels, off by {before}, then by {after}");
}
