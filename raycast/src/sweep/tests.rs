use super::sector::{Row, Sector};
use super::strip::LINES;
use proptest::prelude::*;
use terravision_common::camera::{Camera, CameraFields};

fn camera([heading, pitch, roll]: [f64; 3], vfov_deg: f64, [width, height]: [u32; 2]) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [0.0; 3],
        heading_rad: heading.to_radians(),
        pitch_rad: pitch.to_radians(),
        roll_rad: roll.to_radians(),
        vfov_rad: vfov_deg.to_radians(),
        width,
        height,
        timestamp_nanos: 0,
    })
    .unwrap()
}

/// How often the strips of all sectors put each pixel.
fn times(camera: &Camera, lines_per_px: f64) -> Vec<u32> {
    let [width, height] = [camera.width() as i32, camera.height() as i32];
    let mut times = vec![0; (width * height) as usize];
    let mut put = |sector: Sector, rows: &[Row]| {
        let [corner, along, up] = sector.pixel_steps();
        for first in (0..sector.lines).step_by(LINES) {
            for number in sector.rows[0]..sector.rows[1] {
                let row = rows[number as usize];
                for x in row.start(first, sector.lines)..row.start(first + LINES, sector.lines) {
                    let place = [0, 1].map(|axis| corner[axis] + along[axis] * x as i32 + up[axis] * number as i32);
                    assert!(place[0] >= 0 && place[0] < width && place[1] >= 0 && place[1] < height, "{place:?}");
                    times[(place[1] * width + place[0]) as usize] += 1;
                    let line = row.line_at(x);
                    assert!(line > -1.0 && line < sector.lines as f64, "line {line} of {}", sector.lines);
                }
            }
        }
    };
    Sector::all(camera, lines_per_px, &mut put, &mut Vec::new());
    times
}

#[test]
fn a_level_picture_is_one_sector_and_one_that_looks_down_is_four() {
    let sectors = |angles: [f64; 3]| {
        let mut count = 0;
        Sector::all(&camera(angles, 60.0, [64, 48]), 1.0, &mut |_, _| count += 1, &mut Vec::new());
        count
    };
    assert_eq!([[10.0, 0.0, 0.0], [0.0, 0.0, 90.0], [30.0, -90.0, 12.0], [0.0, 90.0, 0.0]].map(sectors), [1, 1, 4, 4]);
}

/// Heading, pitch and roll of an eye that flies a loop, and one that rolls as it flies.
fn aerobatics() -> impl Iterator<Item = [f64; 3]> {
    (0..360).step_by(5).flat_map(|degrees| {
        let angle = f64::from(degrees);
        let looping = match angle {
            0.0..=90.0 => [30.0, angle, 0.0],
            90.0..=270.0 => [210.0, 180.0 - angle, 180.0],
            _ => [30.0, angle - 360.0, 0.0],
        };
        [looping, [30.0, -16.0, angle]]
    })
}

#[test]
fn every_pixel_is_put_once_in_a_loop_and_in_a_barrel_roll() {
    for angles in aerobatics() {
        let times = times(&camera(angles, 60.0, [128, 72]), 0.4);
        assert!(times.iter().all(|n| *n == 1), "{angles:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn every_pixel_is_put_once_in_any_attitude(
        heading in -180.0f64..180.0, pitch in -100.0f64..100.0, roll in -180.0f64..180.0,
        quarters in prop::option::of((-4i32..=4, -4i32..=4)), vfov in 1.0f64..150.0,
        width in 1u32..90, height in 1u32..90, lines_per_px in 0.2f64..2.0, shift in prop::option::of(-99.0f64..99.0),
    ) {
        let [pitch, roll] = quarters.map_or([pitch, roll], |(a, b)| [f64::from(a * 45) / 2.0, f64::from(b * 45)]);
        let camera = camera([heading, pitch, roll], vfov, [width, height]);
        let camera = camera.with_lens_shift(shift.unwrap_or(0.0)).expect("valid");
        let times = times(&camera, lines_per_px);
        prop_assert!(times.iter().all(|n| *n == 1), "{camera:?}: {times:?}");
    }
}
