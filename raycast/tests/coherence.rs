//! Coherent rays find what plain rays find: on ground and in poses where forward-only rays do not,
//! too.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail by panicking")]

use proptest::prelude::*;
use terravision_common::camera::Camera;
use terravision_raycast::model::{Filter, Ground};
use terravision_raycast::{CastOptions, CastTask, Caster, Counts, Picture};
use terravision_testkit::rays::{AnyMethod, Field, UNIT_M, camera};

const SIZE: [u32; 2] = [96, 72];
const CELLS: usize = 120;

fn depths(
    field: &Field,
    side: usize,
    filter: impl Into<Option<Filter>>,
    camera: &Camera,
    method: AnyMethod,
) -> (Vec<f32>, Counts) {
    let mut caster = Caster::new(1).unwrap();
    let picture = Picture::new(SIZE);
    let options = CastOptions::default();
    let counts = method.draw(
        &mut caster,
        &CastTask {
            ground: &field.ground(side, filter),
            colors: &[&field.colors()[..]],
            heights: &[],
            camera,
            options: &options,
            picture: &picture,
        },
    );
    (picture.depth().collect(), counts)
}

fn depths_of(ground: &Ground, field: &Field, camera: &Camera, method: AnyMethod, options: &CastOptions) -> Vec<f32> {
    let picture = Picture::new(SIZE);
    method.draw(
        &mut Caster::new(1).unwrap(),
        &CastTask { ground, colors: &[&field.colors()[..]], heights: &[], camera, options, picture: &picture },
    );
    picture.depth().collect()
}

/// Which tiles have voxels.
#[derive(Debug, Clone, Copy)]
enum Modes {
    Accurate,
    Approximate,
    SideBySide,
}

impl Modes {
    fn is_accurate(self, [x, y]: [u32; 2]) -> bool {
        match self {
            Self::Accurate => true,
            Self::Approximate => false,
            Self::SideBySide => (x / 16 + y / 16).is_multiple_of(2),
        }
    }
}

fn modes() -> impl Strategy<Value = Modes> {
    prop_oneof![Just(Modes::Accurate), Just(Modes::Approximate), Just(Modes::SideBySide)]
}

/// The longest sampling interval of a picture along the view axis: rays are sampled on common
/// planes.
fn interval_m(camera: &Camera) -> f32 {
    let [tx, ty] = camera.picture_plane().half();
    // The guide is at most 60 degrees from a ray and the view axis at most that far from the guide.
    (0.6 * UNIT_M * 2.0 * (1.0 + tx * tx + ty * ty).sqrt()) as f32
}

/// Pixels at which two pictures of depth differ by more than a limit.
fn count_different(a: &[f32], b: &[f32], limit: f32) -> usize {
    let is_other = |a: f32, b: f32| a.is_nan() != b.is_nan() || (a - b).abs() > limit;
    a.iter().zip(b).filter(|(a, b)| is_other(**a, **b)).count()
}

/// The same, but for a ray that grazes a silhouette within rounding: it may hit or miss, so at one
/// pixel, or two, of a picture one of the pictures has sky and the other ground, beside which both
/// have sky and ground.
fn count_beyond_silhouettes(a: &[f32], b: &[f32], limit: f32) -> usize {
    let width = SIZE[0] as usize;
    let around = |picture: &[f32], k: usize| -> [bool; 2] {
        let (x, y) = (k % width, k / width);
        let rows = y.saturating_sub(1)..(y + 2).min(SIZE[1] as usize);
        let near = rows.flat_map(|v| (x.saturating_sub(1)..(x + 2).min(width)).map(move |u| v * width + u));
        let sky: Vec<bool> = near.map(|at| picture[at].is_nan()).collect();
        [sky.contains(&true), sky.contains(&false)]
    };
    let grazes =
        |k: usize| a[k].is_nan() != b[k].is_nan() && [a, b].iter().all(|picture| around(picture, k) == [true; 2]);
    let grazing = (0..a.len()).filter(|k| grazes(*k)).count();
    count_different(a, b, limit) - grazing.min(2)
}

fn eye_over(field: &Field, x: f64, y: f64, height_m: f64) -> [f64; 3] {
    let [x, y] = [x, y].map(|share| share * CELLS as f64 * UNIT_M);
    [x, y, field.at(x, y).unwrap() + height_m]
}

#[test]
fn beside_towers_forward_only_rays_miss_what_coherent_rays_find() {
    let field = Field::towers(CELLS, 150.0, 5);
    let mut missed = 0;
    for (angles, vfov) in [
        ([20.0, -35.0, 0.0], 70.0),
        ([200.0, -50.0, 0.0], 80.0),
        ([75.0, -30.0, 33.0], 60.0),
        ([300.0, -20.0, 130.0], 60.0),
        ([10.0, -85.0, -70.0], 60.0),
    ] {
        let camera = camera(eye_over(&field, 0.5, 0.45, 320.0), angles, vfov, SIZE);
        let of = |method| depths(&field, 128, Filter::OrientedBox, &camera, method).0;
        let plain = of(AnyMethod::Plain);
        let limit = interval_m(&camera);
        assert_eq!(count_different(&of(AnyMethod::Coherent), &plain, limit), 0, "{angles:?}");
        missed += count_different(&of(AnyMethod::ForwardOnly), &plain, limit);
    }
    assert!(missed > 100, "the poses are such that it matters: {missed}");
}

#[test]
fn on_natural_ground_nearly_every_ray_starts_where_another_one_hit() {
    let field = Field::hills(CELLS, 300.0, 3);
    let camera = camera(eye_over(&field, 0.5, 0.1, 400.0), [0.0, -30.0, 0.0], 45.0, SIZE);
    let (_, counts) = depths(&field, 128, Filter::OrientedBox, &camera, AnyMethod::Coherent);
    let (_, plain) = depths(&field, 128, Filter::OrientedBox, &camera, AnyMethod::Plain);
    assert!(counts.without_witness * 20 < counts.rays, "{counts:?}");
    assert!(counts.samples * 4 < plain.samples, "{counts:?} {plain:?}");
    assert_eq!(counts.rays, u64::from(SIZE[0] * SIZE[1]));
}

#[test]
fn a_cliff_costs_the_rays_over_it_alone() {
    let mut field = Field::hills(CELLS, 120.0, 3);
    let camera = camera(eye_over(&field, 0.5, 0.1, 400.0), [0.0, -30.0, 0.0], 45.0, SIZE);
    let looks_back = |field: &Field| {
        [(Filter::OrientedBox.into(), AnyMethod::Coherent), (None, AnyMethod::Mipmap)].map(|(filter, method)| {
            let (_, counts) = depths(field, 128, filter, &camera, method);
            assert!(counts.without_witness * 20 < counts.rays, "{counts:?}");
            counts.partly_proven
        })
    };
    let before = looks_back(&field);
    field.heights[70 * (CELLS + 1) + 66] += 100.0;
    let after = looks_back(&field);
    for (before, after) in before.into_iter().zip(after) {
        let more = after - before;
        assert!(more > 0 && more * 20 < u64::from(SIZE[0] * SIZE[1]), "{before} {after}");
    }
}

#[test]
fn following_the_ground_gives_the_picture_of_rays_that_each_begin_at_the_eye() {
    let field = Field::hills(CELLS, 60.0, 3);
    for roll in [0.0, 4.0, 90.0] {
        let camera = camera(eye_over(&field, 0.5, 0.1, 60.0), [0.0, -25.0, roll], 45.0, SIZE);
        let ground = field.ground(16, None);
        let draw = |method: AnyMethod| {
            let picture = Picture::new(SIZE);
            let options = CastOptions::default();
            let counts = method.draw(
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
            (picture.rgba().map(u32::to_le_bytes).collect::<Vec<_>>(), counts)
        };
        let (plain, many) = draw(AnyMethod::PlainMipmap);
        let (followed, few) = draw(AnyMethod::Mipmap);
        assert_eq!(few.hits, many.hits, "roll {roll}");
        let other = plain.iter().zip(&followed).filter(|(a, b)| (0..4).any(|c| a[c].abs_diff(b[c]) > 6)).count();
        assert!(other * 200 < plain.len(), "roll {roll}: {other} pixels have another colour");
        assert!(few.samples * 2 < many.samples, "roll {roll}: {few:?} {many:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn coherent_and_plain_rays_agree_within_a_sampling_interval(
        seed in 0u64..1000, is_towers: bool, is_gaussian: bool, is_tiled: bool,
        x in 0.05..0.95f64, y in 0.05..0.95f64, height in 20.0..500.0f64,
        heading in 0.0..360.0f64, pitch in -90.0..30.0f64, roll in -180.0..180.0f64, vfov in 20.0..90.0f64,
    ) {
        let field = if is_towers { Field::towers(CELLS, 120.0, seed) } else { Field::hills(CELLS, 400.0, seed) };
        let filter = if is_gaussian { Filter::Gaussian } else { Filter::OrientedBox };
        let side = if is_tiled { 16 } else { 128 };
        let camera = camera(eye_over(&field, x, y, height), [heading, pitch, roll], vfov, SIZE);
        let (plain, counts) = depths(&field, side, filter, &camera, AnyMethod::Plain);
        let (coherent, _) = depths(&field, side, filter, &camera, AnyMethod::Coherent);
        let different = count_different(&coherent, &plain, interval_m(&camera));
        prop_assert_eq!(different, 0, "of {:?}", counts);
    }

    #[test]
    fn they_agree_across_levels_and_modes(
        seed in 0u64..1000, is_towers: bool, modes in modes(), is_approximate: bool, looks_between: bool,
        x in 0.05..0.95f64, y in 0.05..0.95f64, height in 20.0..500.0f64,
        heading in 0.0..360.0f64, pitch in -90.0..30.0f64, roll in -180.0..180.0f64, vfov in 20.0..90.0f64,
    ) {
        let field = if is_towers { Field::towers(CELLS, 120.0, seed) } else { Field::hills(CELLS, 400.0, seed) };
        let camera = camera(eye_over(&field, x, y, height), [heading, pitch, roll], vfov, SIZE);
        let ground = field.mixed(seed, Filter::OrientedBox, |origin| modes.is_accurate(origin));
        let options = CastOptions { is_approximate, looks_between, ..CastOptions::default() };
        let [plain, coherent] = [AnyMethod::Plain, AnyMethod::Coherent]
            .map(|method| depths_of(&ground, &field, &camera, method, &options));
        // An interval of the coarsest voxels.
        prop_assert_eq!(count_different(&coherent, &plain, 4.0 * interval_m(&camera)), 0);
    }

    #[test]
    fn from_beside_the_ground_they_agree_as_well(
        seed in 0u64..1000, distance in 0.0..500.0f64, height in -300.0..400.0f64, turn in -40.0..40.0f64,
        pitch in -60.0..30.0f64, roll in -180.0..180.0f64,
    ) {
        let field = Field::hills(CELLS, 400.0, seed);
        let eye = [-distance, 0.5 * CELLS as f64 * UNIT_M, height];
        let camera = camera(eye, [90.0 + turn, pitch, roll], 60.0, SIZE);
        let (plain, _) = depths(&field, 128, Filter::OrientedBox, &camera, AnyMethod::Plain);
        let (coherent, _) = depths(&field, 128, Filter::OrientedBox, &camera, AnyMethod::Coherent);
        prop_assert_eq!(count_different(&coherent, &plain, interval_m(&camera)), 0);
        let [plain, exact] =
            [AnyMethod::PlainMipmap, AnyMethod::Mipmap].map(|method| depths(&field, 128, None, &camera, method).0);
        prop_assert_eq!(count_beyond_silhouettes(&exact, &plain, 0.1 * interval_m(&camera)), 0, "exact rays");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn exact_rays_agree_with_those_that_each_begin_at_the_eye(
        seed in 0u64..1000, is_towers: bool, is_tiled: bool, x in 0.05..0.95f64, y in 0.05..0.95f64, height in 20.0..500.0f64,
        heading in 0.0..360.0f64, pitch in -90.0..30.0f64, roll in -180.0..180.0f64, vfov in 20.0..90.0f64,
    ) {
        let field = if is_towers { Field::towers(CELLS, 120.0, seed) } else { Field::hills(CELLS, 400.0, seed) };
        let side = if is_tiled { 16 } else { 128 };
        let camera = camera(eye_over(&field, x, y, height), [heading, pitch, roll], vfov, SIZE);
        let [plain, exact] =
            [AnyMethod::PlainMipmap, AnyMethod::Mipmap].map(|method| depths(&field, side, None, &camera, method).0);
        prop_assert_eq!(count_beyond_silhouettes(&exact, &plain, 0.1 * interval_m(&camera)), 0);
    }
}
