//! Poses and camera paths, and the pictures that come of them.

use glam::DVec3;
use serde_json::json;
use std::path::Path;
use terravision_common::camera::{Camera, CameraFields};

/// A pose in the world's CRS; degrees as on the command line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Easting, northing, height.
    pub eye: [f64; 3],
    /// Degrees clockwise from grid north.
    pub heading: f64,
    /// Degrees up from the horizontal.
    pub pitch: f64,
    /// Degrees clockwise.
    pub roll: f64,
}

impl Pose {
    /// A pose without roll.
    #[must_use]
    pub fn new(eye: [f64; 3], heading: f64, pitch: f64) -> Self {
        Self { eye, heading, pitch, roll: 0.0 }
    }

    /// The camera, for pictures of this size and vertical field of view.
    #[must_use]
    pub fn camera(&self, [width, height]: [u32; 2], vfov_deg: f64) -> Camera {
        Camera::new(CameraFields {
            eye_in_world: self.eye,
            heading_rad: self.heading.to_radians(),
            pitch_rad: self.pitch.to_radians(),
            roll_rad: self.roll.to_radians(),
            vfov_rad: vfov_deg.to_radians(),
            width,
            height,
            timestamp_nanos: 0,
        })
        .expect("valid")
    }

    /// The pose, moved by a vector.
    #[must_use]
    pub fn moved(&self, by: DVec3) -> Self {
        Self { eye: (DVec3::from_array(self.eye) + by).to_array(), ..*self }
    }

    /// The arguments of `terravision still` that give this pose.
    #[must_use]
    pub fn arguments(&self) -> [String; 4] {
        let [x, y, z] = self.eye;
        [
            format!("--eye={x},{y},{z}"),
            format!("--heading={}", self.heading),
            format!("--pitch={}", self.pitch),
            format!("--roll={}", self.roll),
        ]
    }
}

/// Writes a camera path of one pose per frame.
///
/// # Panics
/// When it cannot be written.
pub fn write_path(path: &Path, poses: &[Pose], [width, height]: [u32; 2], vfov_deg: f64) {
    let frames: Vec<_> = poses
        .iter()
        .map(|pose| {
            let [x, y, z] = pose.eye;
            json!({"x": x, "y": y, "z": z, "heading": pose.heading, "pitch": pose.pitch, "roll": pose.roll})
        })
        .collect();
    let text = json!({"width": width, "height": height, "vfov_deg": vfov_deg, "fps": 30, "frames": frames});
    std::fs::write(path, text.to_string()).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

/// Reads a PNG: width, height, RGB rows from the top.
///
/// # Panics
/// When it cannot be read.
#[must_use]
pub fn read_png(path: &Path) -> (usize, usize, Vec<[u8; 3]>) {
    let image = image::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).into_rgb8();
    (image.width() as usize, image.height() as usize, image.pixels().map(|p| p.0).collect())
}

/// Writes a PNG, to look at.
///
/// # Panics
/// When it cannot be written.
pub fn write_png(path: &Path, width: usize, rgb: &[[u8; 3]]) {
    let bytes: Vec<u8> = rgb.iter().flatten().copied().collect();
    let size = (width as u32, (rgb.len() / width) as u32);
    image::save_buffer(path, &bytes, size.0, size.1, image::ExtendedColorType::Rgb8)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}
