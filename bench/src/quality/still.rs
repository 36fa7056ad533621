//! A picture of the pipeline, with depth and ground of every pixel.

use super::setting::Setting;
use crate::session::sibling;
use anyhow::{Context, bail, ensure};
use glam::DVec3;
use std::path::Path;
use std::process::{Command, Stdio};
use terravision_common::camera::Camera;
use terravision_common::surface::CrsFrame;
use terravision_testkit::floats::read_floats;

/// A picture to be taken.
pub(super) struct Still<'a> {
    pub world: &'a Path,
    /// Where the world lies in its CRS.
    pub frame: CrsFrame,
    /// In world coordinates.
    pub camera: &'a Camera,
    pub setting: &'a Setting,
    /// More arguments.
    pub more: &'a [String],
}

/// A picture that was taken; rows from the top.
pub(super) struct Taken {
    pub rgb: Vec<[u8; 3]>,
    /// Metres along the view axis, NaN for sky.
    pub depth: Vec<f64>,
    /// What each pixel sees, in world coordinates, NaN for sky.
    pub ground: Vec<DVec3>,
}

impl Still<'_> {
    /// Takes it, its files in `folder`.
    ///
    /// # Errors
    /// When `terravision still` fails, with what it says, or its files are not as they should be.
    pub(super) fn take(&self, [r, g, b]: [u8; 3], folder: &Path) -> anyhow::Result<Taken> {
        let files = ["still.png", "depth.tif", "ground.tif"].map(|name| folder.join(name));
        let (width, height) = (self.camera.width(), self.camera.height());
        let place = self.frame.place(self.camera.eye());
        let mut command = Command::new(sibling("terravision")?);
        command.arg("still").arg(self.world).args(["--quiet", "--quality", self.setting.quality]);
        command.args(self.setting.arguments);
        command.arg(format!("--eye={},{},{}", place.x, place.y, place.z));
        for (name, radians) in [
            ("heading", self.camera.heading_rad()),
            ("pitch", self.camera.pitch_rad()),
            ("roll", self.camera.roll_rad()),
            ("vfov", self.camera.vfov_rad()),
        ] {
            command.arg(format!("--{name}={}", radians.to_degrees()));
        }
        command.arg(format!("--size={width}x{height}")).arg(format!("--sky={r},{g},{b}"));
        command.arg("-o").arg(&files[0]).arg("--depth").arg(&files[1]).arg("--ground").arg(&files[2]);
        let output = command.args(self.more).stdin(Stdio::null()).output().context("cannot start terravision still")?;
        if !output.status.success() {
            bail!("terravision still: {}", String::from_utf8_lossy(&output.stderr).trim());
        }
        self.read(files.each_ref().map(|file| file.as_path()))
    }

    fn read(&self, [picture, depth, ground]: [&Path; 3]) -> anyhow::Result<Taken> {
        let unreadable = |path: &Path| format!("cannot read {}", path.display());
        let rgb = image::open(picture).with_context(|| unreadable(picture))?.into_rgb8();
        let (.., depth) = read_floats(depth).with_context(|| unreadable(depth))?;
        let (.., places) = read_floats(ground).with_context(|| unreadable(ground))?;
        let pixels = (self.camera.width() * self.camera.height()) as usize;
        ensure!(
            rgb.pixels().len() == pixels && depth.len() == pixels && places.len() == 3 * pixels,
            "the picture, its depth and its ground have {}, {} and {} values, expected {pixels} pixels of {}x{}: \
             leave out arguments that change the picture's size",
            rgb.pixels().len(),
            depth.len(),
            places.len(),
            self.camera.width(),
            self.camera.height(),
        );
        let ground = places.chunks_exact(3).map(|place| self.frame.position(DVec3::from_slice(place))).collect();
        Ok(Taken { rgb: rgb.pixels().map(|p| p.0).collect(), depth, ground })
    }
}
