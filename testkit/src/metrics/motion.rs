//! What changes from one frame of a flight to the next, apart from the motion itself.

use glam::DVec3;
use terravision_common::camera::{Camera, PicturePlane};

/// Change of a picture after its motion was taken out.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionChange {
    /// Mean absolute difference of colour, 0 to 255, over the pixels that both frames see.
    pub mean: f64,
    /// The difference that one pixel in a hundred exceeds.
    pub p99: f64,
    /// Mean of each block of 16 x 16 pixels, in rows from the top: a node that pops is a few blocks
    /// of the picture. `None` where less than half of the block is seen by both.
    pub blocks: Vec<Option<f64>>,
    /// Pixels that both see.
    pub pixels: usize,
}

/// One frame: the camera, the picture, and what each pixel sees (metres along the view axis, NaN
/// for sky).
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The pose.
    pub camera: &'a Camera,
    /// Colours, rows from the top.
    pub rgb: &'a [[u8; 3]],
    /// Depths, rows from the top.
    pub depth: &'a [f32],
}

/// Fetches, for each pixel of `after`, the colour that the same ground had in `before`, and
/// compares. Ground that one of the two does not see (depths differ by more than 1 %) is left out.
/// The fetch is bilinear, so a little change remains on sharp detail; it is the same from frame to
/// frame, where a pop is not.
#[must_use]
pub fn motion_compensated_change(before: Frame<'_>, after: Frame<'_>) -> MotionChange {
    let (width, height) = (after.camera.width() as usize, after.camera.height() as usize);
    let blocks_wide = width.div_ceil(BLOCK);
    let mut blocks = vec![(0.0, 0usize); blocks_wide * height.div_ceil(BLOCK)];
    let mut differences = Vec::with_capacity(width * height);
    let view = Projection::new(before.camera);
    for y in 0..height {
        for x in 0..width {
            let i = y * width + x;
            let depth = f64::from(after.depth[i]);
            if depth.is_nan() {
                continue;
            }
            let point = after.camera.eye() + after.camera.ray_in_world(x as f64 + 0.5, y as f64 + 0.5) * depth;
            let Some((px, py, then)) = view.pixel(point) else { continue };
            let Some(sample) = fetch(&before, px, py, then) else { continue };
            let difference = sample.iter().zip(after.rgb[i]).map(|(a, b)| (a - f64::from(b)).abs()).sum::<f64>() / 3.0;
            differences.push(difference);
            let block = &mut blocks[(y / BLOCK) * blocks_wide + x / BLOCK];
            block.0 += difference;
            block.1 += 1;
        }
    }
    let pixels = differences.len();
    let mean = differences.iter().sum::<f64>() / pixels.max(1) as f64;
    let p99 = match pixels {
        0 => 0.0,
        n => *differences.select_nth_unstable_by((n * 99 / 100).min(n - 1), f64::total_cmp).1,
    };
    let blocks = blocks.iter().map(|(sum, n)| (*n > BLOCK * BLOCK / 2).then(|| sum / *n as f64)).collect();
    MotionChange { mean, p99, blocks, pixels }
}

/// The largest pop in a series of changes: how much more a block changes in one frame than in any
/// of the two frames before and after. Returns the frame (index into `changes`), the block, and the
/// excess.
///
/// Motion over sharp detail leaves a change too, but a similar one in every frame.
#[must_use]
pub fn largest_pop(changes: &[MotionChange]) -> Option<(usize, usize, f64)> {
    let mut largest: Option<(usize, usize, f64)> = None;
    for at in 0..changes.len() {
        for (block, change) in changes[at].blocks.iter().enumerate() {
            let around = (at.saturating_sub(2)..(at + 3).min(changes.len())).filter(|k| *k != at);
            let others: Option<Vec<f64>> = around.map(|k| changes[k].blocks[block]).collect();
            let (Some(change), Some(others)) = (change, others) else { continue };
            let excess = change - others.into_iter().fold(0.0, f64::max);
            if largest.is_none_or(|(_, _, most)| excess > most) {
                largest = Some((at, block, excess));
            }
        }
    }
    largest
}

const BLOCK: usize = 16;

struct Projection {
    eye: DVec3,
    axes: [DVec3; 3],
    plane: PicturePlane,
}

impl Projection {
    fn new(camera: &Camera) -> Self {
        Self { eye: camera.eye(), axes: camera.axes_in_world(), plane: camera.picture_plane() }
    }

    /// Column and row (a pixel's centre is at + 0.5) and depth of a point, if it is before the
    /// camera.
    fn pixel(&self, point: DVec3) -> Option<(f64, f64, f64)> {
        let p = point - self.eye;
        let [x, y, depth] = self.axes.map(|axis| axis.dot(p));
        (depth > 0.0).then(|| {
            let [px, py] = self.plane.pixel([x / depth, y / depth]);
            (px, py, depth)
        })
    }
}

/// Bilinear fetch, if the pixels around see what lies at `depth`.
fn fetch(frame: &Frame<'_>, px: f64, py: f64, depth: f64) -> Option<[f64; 3]> {
    let (width, height) = (frame.camera.width() as usize, frame.camera.height() as usize);
    let (x, y) = (px - 0.5, py - 0.5);
    if !(0.0..(width - 1) as f64).contains(&x) || !(0.0..(height - 1) as f64).contains(&y) {
        return None;
    }
    let (i, j) = (x as usize, y as usize);
    let (u, v) = (x - i as f64, y - j as f64);
    let at = [j * width + i, j * width + i + 1, (j + 1) * width + i, (j + 1) * width + i + 1];
    let mix = |[a, b, d, e]: [f64; 4]| (a + (b - a) * u) * (1.0 - v) + (d + (e - d) * u) * v;
    let seen = mix(at.map(|k| f64::from(frame.depth[k])));
    // False for NaN, too: one of the four is sky.
    ((seen / depth - 1.0).abs() < 0.01).then(|| std::array::from_fn(|c| mix(at.map(|k| f64::from(frame.rgb[k][c])))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{Colors, Heights, RenderOptions, Scene, render};
    use terravision_common::camera::CameraFields;

    fn camera(x: f64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: [x, 200.0, 300.0],
            heading_rad: 0.3,
            pitch_rad: -0.6,
            roll_rad: 0.0,
            vfov_rad: 1.0,
            width: 160,
            height: 96,
            timestamp_nanos: 0,
        })
        .expect("valid")
    }

    #[test]
    fn a_move_is_taken_out_and_a_patch_that_changes_stays() {
        let heights = Heights::new(201, 201, [0.0, 0.0], 10.0, vec![0.0; 201 * 201]);
        let rgb = (0..100 * 100)
            .map(|k| {
                let (x, y) = ((k % 100) as f64, (k / 100) as f64);
                [(128.0 + 100.0 * (x * 0.3).sin() * (y * 0.3).sin()) as u8; 3]
            })
            .collect();
        let colors = Colors::new(100, 100, [0.0, 0.0], 20.0, rgb);
        let scene = Scene { heights: &heights, colors: &colors };
        let cameras: Vec<Camera> = (0..6).map(|k| camera(1000.0 + 4.0 * f64::from(k))).collect();
        let mut pictures: Vec<_> =
            cameras.iter().map(|camera| render(scene, camera, &RenderOptions::default())).collect();
        let changes = |pictures: &[crate::reference::Picture]| -> Vec<MotionChange> {
            let frame = |k: usize| Frame { camera: &cameras[k], rgb: &pictures[k].rgb, depth: &pictures[k].depth };
            (1..6).map(|k| motion_compensated_change(frame(k - 1), frame(k))).collect()
        };
        let smooth = changes(&pictures);
        assert!(smooth.iter().all(|change| change.mean < 1.5 && change.pixels > 8_000), "{smooth:?}");
        let (_, _, excess) = largest_pop(&smooth).unwrap();
        assert!(excess < 1.0, "{excess}");
        // From frame 3 on a patch is a little brighter: change 2 (of frame 2 to 3) has a pop.
        for picture in &mut pictures[3..] {
            for y in 48..64 {
                for x in 64..80 {
                    picture.rgb[y * 160 + x] = picture.rgb[y * 160 + x].map(|v| v.saturating_add(6));
                }
            }
        }
        let (at, block, excess) = largest_pop(&changes(&pictures)).unwrap();
        assert_eq!((at, block), (2, 3 * 10 + 4));
        assert!(excess > 3.0, "{excess}");
    }
}
