//! Rays to pixels.

use super::cast::cast;
use super::{Colors, Heights, Hit};
use glam::DVec2;
use terravision_common::camera::Camera;

/// What is looked at.
#[derive(Debug, Clone, Copy)]
pub struct Scene<'a> {
    /// The ground.
    pub heights: &'a Heights,
    /// Its colour.
    pub colors: &'a Colors,
}

/// How it is drawn.
#[derive(Debug, Clone, Copy)]
pub struct RenderOptions {
    /// Colour rays per pixel, along each side of the pixel.
    pub rays_per_side: u32,
    /// Colour where a ray meets no ground.
    pub sky_rgb: [u8; 3],
    /// Factor on heights.
    pub exaggeration: f64,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { rays_per_side: 3, sky_rgb: [150, 190, 235], exaggeration: 1.0 }
    }
}

/// A picture; all arrays in rows from the top.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Colour.
    pub rgb: Vec<[u8; 3]>,
    /// Whether every ray of the pixel met the ground.
    pub is_land: Vec<bool>,
    /// Whether no ray of the pixel met the ground.
    pub is_sky: Vec<bool>,
    /// Metres along the view axis of what the pixel's centre sees, NaN for sky.
    pub depth: Vec<f32>,
    /// Easting, northing, height of what the pixel's centre sees, NaN for sky.
    pub ground: Vec<[f64; 3]>,
}

#[derive(Debug, Clone, Copy)]
struct Pixel {
    rgb: [u8; 3],
    hits: u32,
    centre: Option<Hit>,
}

/// Draws the scene as `camera` sees it, its eye in the rasters' CRS. Uses all cores.
#[must_use]
pub fn render(scene: Scene<'_>, camera: &Camera, options: &RenderOptions) -> Picture {
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let blank = Pixel { rgb: options.sky_rgb, hits: 0, centre: None };
    let mut pixels = vec![blank; width * height];
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    // Rows are dealt out one by one: the cost of a row varies from sky to foreground.
    let mut hands: Vec<Vec<(usize, &mut [Pixel])>> = (0..threads).map(|_| Vec::new()).collect();
    for (y, row) in pixels.chunks_mut(width).enumerate() {
        hands[y % threads].push((y, row));
    }
    std::thread::scope(|scope| {
        for hand in hands {
            scope.spawn(move || {
                for (y, row) in hand {
                    for (x, pixel) in row.iter_mut().enumerate() {
                        *pixel = trace(scene, camera, options, x, y);
                    }
                }
            });
        }
    });
    let rays = options.rays_per_side * options.rays_per_side;
    Picture {
        width,
        height,
        rgb: pixels.iter().map(|p| p.rgb).collect(),
        is_land: pixels.iter().map(|p| p.hits == rays).collect(),
        is_sky: pixels.iter().map(|p| p.hits == 0 && p.centre.is_none()).collect(),
        depth: pixels.iter().map(|p| p.centre.map_or(f32::NAN, |hit| hit.t as f32)).collect(),
        ground: pixels.iter().map(|p| p.centre.map_or([f64::NAN; 3], |hit| hit.point.to_array())).collect(),
    }
}

fn trace(scene: Scene<'_>, camera: &Camera, options: &RenderOptions, x: usize, y: usize) -> Pixel {
    let eye = camera.eye();
    let shoot = |px, py| cast(scene.heights, options.exaggeration, eye, camera.ray_in_world(px, py));
    let (x, y) = (x as f64, y as f64);
    let side = options.rays_per_side;
    let step = 1.0 / f64::from(side);
    let mut sum = [0.0; 3];
    let mut hits = 0;
    for j in 0..side {
        for i in 0..side {
            let (px, py) = (x + (f64::from(i) + 0.5) * step, y + (f64::from(j) + 0.5) * step);
            let color = match shoot(px, py) {
                Some(hit) => {
                    hits += 1;
                    let on_plane = |px, py| footprint(&hit, camera, px, py);
                    let (across, along) = (on_plane(px + step, py), on_plane(px, py + step));
                    scene.colors.average(hit.point.truncate(), across, along)
                }
                None => options.sky_rgb.map(f64::from),
            };
            for (sum, value) in sum.iter_mut().zip(color) {
                *sum += value;
            }
        }
    }
    let rays = f64::from(side * side);
    Pixel { rgb: sum.map(|v| (v / rays).round() as u8), hits, centre: shoot(x + 0.5, y + 0.5) }
}

/// From the hit to where the ray through `(px, py)` meets the hit's tangent plane, on the ground;
/// no longer than a hundredth of the distance, for planes seen edge on.
fn footprint(hit: &Hit, camera: &Camera, px: f64, py: f64) -> DVec2 {
    let direction = camera.ray_in_world(px, py);
    let eye = camera.eye();
    let slope = hit.normal.dot(direction);
    let t = hit.normal.dot(hit.point - eye) / slope;
    let limit = 0.01 * hit.t * direction.length();
    let offset = (eye + direction * t - hit.point).truncate();
    if slope >= 0.0 || !offset.is_finite() || offset.length() > limit {
        let flat = direction.truncate().normalize_or_zero();
        return flat * limit;
    }
    offset
}

#[cfg(test)]
mod tests {
    use super::*;
    use terravision_common::camera::CameraFields;

    #[test]
    fn a_plane_from_above_shows_its_map_north_up_with_depth_and_ground() {
        let heights = Heights::new(101, 101, [0.0, 0.0], 10.0, vec![100.0; 101 * 101]);
        // West half red, east half green; the north quarter blue.
        let rgb = (0..100 * 100)
            .map(|k| match (k % 100, k / 100) {
                (_, y) if y >= 75 => [0, 0, 255],
                (x, _) if x < 50 => [255, 0, 0],
                _ => [0, 255, 0],
            })
            .collect();
        let colors = Colors::new(100, 100, [0.0, 0.0], 10.0, rgb);
        let camera = Camera::new(CameraFields {
            eye_in_world: [500.0, 500.0, 500.0],
            heading_rad: 0.0,
            pitch_rad: -std::f64::consts::FRAC_PI_2,
            roll_rad: 0.0,
            vfov_rad: 2.0 * (1.25f64).atan(),
            width: 40,
            height: 40,
            timestamp_nanos: 0,
        })
        .expect("valid");
        let picture = render(Scene { heights: &heights, colors: &colors }, &camera, &RenderOptions::default());
        // The view is exactly 1000 m wide.
        let at = |x: usize, y: usize| picture.rgb[y * 40 + x];
        assert_eq!((at(5, 30), at(34, 30), at(5, 4)), ([255, 0, 0], [0, 255, 0], [0, 0, 255]));
        assert!(picture.depth.iter().all(|d| (d - 400.0).abs() < 1e-3));
        let [e, n, h] = picture.ground[10 * 40 + 5];
        assert!((e - 137.5).abs() < 1e-6 && (n - 737.5).abs() < 1e-6 && (h - 100.0).abs() < 1e-6);
        assert!(picture.is_land.iter().all(|land| *land));
    }
}
