//! Depth against rays marched by small steps, on the heights themselves.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use glam::DVec3;
use terravision_common::camera::Camera;
use terravision_raycast::model::Filter;
use terravision_raycast::{CastOptions, CastTask, Caster, Picture};
use terravision_testkit::rays::{AnyMethod, Field, UNIT_M, camera};

const SIZE: [u32; 2] = [80, 60];

/// Depth at which the ray through a pixel's centre first lies on or below the ground, to a
/// thousandth of a cell.
fn marched(field: &Field, camera: &Camera, x: u32, y: u32) -> Option<f64> {
    let direction = camera.ray_in_world(f64::from(x) + 0.5, f64::from(y) + 0.5);
    let eye = DVec3::from_array(camera.fields().eye_in_world);
    let above = |t: f64| {
        let p = eye + direction * t;
        field.at(p.x, p.y).map(|ground| p.z - ground)
    };
    let step = 0.05 * UNIT_M / direction.length();
    let mut t = 0.0;
    while t < field.cells as f64 * UNIT_M * 1.5 {
        if above(t).is_some_and(|above| above <= 0.0) {
            let (mut low, mut high) = (t - step, t);
            for _ in 0..8 {
                let middle = 0.5 * (low + high);
                if above(middle).is_some_and(|above| above <= 0.0) { high = middle } else { low = middle }
            }
            return Some(high);
        }
        t += step;
    }
    None
}

/// Median and greatest error of depth, metres, and pixels that are ground in one picture only.
fn errors(field: &Field, side: usize, camera: &Camera, method: AnyMethod) -> (f64, f64, usize) {
    let picture = Picture::new(SIZE);
    let options = CastOptions::default();
    let ground = field.ground(side, Filter::OrientedBox);
    method.draw(
        &mut Caster::new(1).unwrap(),
        &CastTask {
            ground: &ground,
            colors: &[&field.colors()[..]],
            heights: &[],
            camera,
            options: &options,
            picture: &picture,
        },
    );
    let (mut errors, mut torn) = (Vec::new(), 0);
    for (k, depth) in picture.depth().enumerate() {
        match marched(field, camera, k as u32 % SIZE[0], k as u32 / SIZE[0]) {
            Some(exact) if !depth.is_nan() => errors.push((f64::from(depth) - exact).abs()),
            exact => torn += usize::from(exact.is_some() || !depth.is_nan()),
        }
    }
    errors.sort_by(f64::total_cmp);
    (errors[errors.len() / 2], errors[errors.len() - 1], torn)
}

#[test]
fn depth_is_that_of_the_surface() {
    let field = Field::hills(100, 250.0, 11);
    let eye = [300.0, 200.0, field.at(300.0, 200.0).unwrap() + 150.0];
    for (side, angles) in [(128, [30.0, -25.0, 0.0]), (16, [30.0, -25.0, 0.0]), (32, [60.0, -50.0, 100.0])] {
        let camera = camera(eye, angles, 60.0, SIZE);
        let (median, _, torn) = errors(&field, side, &camera, AnyMethod::Coherent);
        assert!(median < 0.1 * UNIT_M && torn < 25, "coherent, {angles:?}: {median} m, {torn} pixels");
        let (median, greatest, torn) = errors(&field, side, &camera, AnyMethod::Mipmap);
        // Small steps pass over ridges that are grazed.
        assert!(median < 1e-3 * UNIT_M && torn < 4, "mipmap, {angles:?}: {median} m, {greatest} m, {torn} pixels");
    }
}
