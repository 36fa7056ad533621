//! Air over pictures that are known.

use super::Air;
use crate::pixels::{Pixels, Raster};
use crate::technique::NEAR_M;
use terravision_common::camera::{Camera, CameraFields};
use terravision_common::light::{AirConfig, Sun};
use terravision_common::rig::{PictureLayout, Views};
use terravision_common::simd::Instructions;

const SIZE: [u32; 2] = [83, 40];
const SKY: [u8; 3] = [150, 190, 235];

fn camera(pitch_deg: f64) -> Camera {
    Camera::new(CameraFields {
        eye_in_world: [0.0, 0.0, 500.0],
        heading_rad: 1.0,
        pitch_rad: pitch_deg.to_radians(),
        roll_rad: 0.2,
        vfov_rad: 1.0,
        width: SIZE[0],
        height: SIZE[1],
        timestamp_nanos: 0,
    })
    .expect("valid")
}

/// What a pixel is before: its share of ground, 255ths, the ground's colour and its distance along
/// the view axis.
fn before(k: usize) -> (u8, [u8; 3], f64) {
    let share = [255, 0, 255, 128, 254, 7][k % 6];
    (share, [(k * 7 % 256) as u8, (k * 31 % 256) as u8, (k * 5 % 256) as u8], 200.0 + 37.0 * (k % 911) as f64)
}

fn drawn(air: &Air, pitch_deg: f64) -> Vec<u8> {
    let views = Views::single(&camera(pitch_deg));
    let mut raster = Raster::new(true);
    raster.lay_out(PictureLayout::new(SIZE, &views));
    let mut pixels = Pixels::Memory(raster);
    let (rgba, depth) = pixels.planes_mut();
    for (k, (texel, depth)) in rgba.chunks_exact_mut(4).zip(depth.expect("it has one")).enumerate() {
        let (share, rgb, metres) = before(k);
        let part = |value: u8| (u32::from(value) * u32::from(share) / if share == 254 { 254 } else { 255 }) as u8;
        texel.copy_from_slice(&[part(rgb[0]), part(rgb[1]), part(rgb[2]), share]);
        *depth = if share > 127 { (NEAR_M / metres) as f32 } else { 0.0 };
    }
    air.draw(&mut pixels, &views);
    pixels.rgba().to_vec()
}

#[test]
fn all_instructions_give_the_same_bytes() {
    let sun = Sun { azimuth_deg: 60.0, altitude_deg: 5.0 };
    for config in [
        AirConfig { sun: Some(sun), visibility_m: Some(9000.0) },
        AirConfig { sun: None, visibility_m: Some(50.0) },
        AirConfig { sun: Some(sun), visibility_m: None },
    ] {
        let air = Air::new(&config, SKY);
        let first = drawn(&air.clone().by(Instructions::PORTABLE), 3.0);
        for instructions in Instructions::all() {
            assert!(drawn(&air.clone().by(instructions), 3.0) == first, "{instructions:?}");
        }
    }
}

#[test]
fn ground_fades_by_its_distance_into_the_horizon() {
    let visibility_m = 9000.0;
    let air = Air::new(&AirConfig { sun: None, visibility_m: Some(visibility_m) }, SKY);
    let camera = camera(-10.0);
    let horizon = air.medium.sky.horizon.map(f64::from);
    let after = drawn(&air, -10.0);
    let mut checked = 0;
    for (k, texel) in after.chunks_exact(4).enumerate() {
        let (share, rgb, metres) = before(k);
        let [x, y] = [k % SIZE[0] as usize, k / SIZE[0] as usize].map(|at| at as f64 + 0.5);
        let distance = metres * camera.ray_in_world(x, y).length();
        // Koschmieder: 2 % is left at the distance of visibility.
        let left = 0.02f64.powf(distance / visibility_m);
        if share >= 254 {
            assert_eq!(texel[3], share, "what was made up stays marked");
            for channel in 0..3 {
                let expected = horizon[channel] + left * (f64::from(rgb[channel]) - horizon[channel]);
                let found = f64::from(texel[channel]);
                assert!((found - expected).abs() < 0.6, "pixel {k}, {distance} m: {found}, expected {expected}");
            }
            checked += 1;
        } else {
            assert_eq!(texel[3], 255);
        }
    }
    assert!(checked > 1000);
}

#[test]
fn the_sky_is_pale_below_and_the_sun_is_where_it_stands() {
    let sun = Sun { azimuth_deg: 1.0f64.to_degrees(), altitude_deg: 20.0 };
    let air = Air::new(&AirConfig { sun: Some(sun), visibility_m: None }, SKY);
    let camera = camera(20.0);
    let views = Views::single(&camera);
    let mut raster = Raster::new(false);
    raster.lay_out(PictureLayout::new(SIZE, &views));
    let mut pixels = Pixels::Memory(raster);
    pixels.planes_mut().0.fill(0);
    air.draw(&mut pixels, &views);
    let of = |x: u32, y: u32| &pixels.rgba()[4 * (y * SIZE[0] + x) as usize..][..4];
    // In the middle of the picture.
    let (sun, corner) = (of(41, 20), of(2, 2));
    assert!(sun[0] >= 250 && sun[2] >= 235 && corner[0] < 140 && corner[2] > corner[0] + 40, "{sun:?} {corner:?}");
    let without = Air::new(&AirConfig { sun: None, visibility_m: None }, SKY);
    let mut plain = Raster::new(false);
    plain.lay_out(PictureLayout::new(SIZE, &views));
    let mut plain = Pixels::Memory(plain);
    plain.planes_mut().0.fill(0);
    without.draw(&mut plain, &views);
    let red = |y: u32| plain.rgba()[4 * (y * SIZE[0] + 40) as usize];
    assert!((1..SIZE[1]).all(|y| red(y) >= red(y - 1)) && red(SIZE[1] - 1) > red(0) + 60, "{} {}", red(0), red(39));
    assert!(plain.rgba().chunks_exact(4).all(|texel| texel[3] == 255));
}
