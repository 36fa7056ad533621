//! Air: haze before the ground, and a sky with a gradient and a sun, laid over finished pictures,
//! whatever drew them. All techniques have the same air, the skirt has it too, and drawing itself
//! costs nothing more.
//!
//! What draws leaves the sky black with an alpha of 0, and a pixel that is partly ground with that
//! share of the ground's colour and of alpha ([`crate::engine::EngineOptions::has_air`]): edges
//! against the sky stay smooth. Sinks' threads do it, beside the drawing of the next frame.

mod row;
mod sky;
#[cfg(test)]
mod tests;

use crate::pixels::Pixels;
use row::{Medium, Row};
use sky::Sky;
use terravision_common::light::AirConfig;
use terravision_common::rig::View;
use terravision_common::simd::Instructions;

/// Contrast that is left at the distance of visibility (H. Koschmieder, 1924).
const LEAST_CONTRAST: f64 = 0.02;

/// The air of a run.
#[derive(Debug, Clone)]
pub struct Air {
    medium: Medium,
    instructions: Instructions,
}

impl Air {
    /// Air under a sky of this colour.
    #[must_use]
    pub fn new(config: &AirConfig, sky_rgb: [u8; 3]) -> Self {
        let per_m = config.visibility_m.map_or(0.0, |metres| -LEAST_CONTRAST.ln() / metres);
        let medium = Medium { sky: Sky::new(sky_rgb, config.sun), per_m: per_m as f32 };
        Self { medium, instructions: Instructions::widest() }
    }

    /// With other instructions, to compare with.
    #[must_use]
    pub fn by(self, instructions: Instructions) -> Self {
        Self { instructions, ..self }
    }

    /// Whether it needs to know how far pixels are.
    #[must_use]
    pub fn needs_depth(config: &AirConfig) -> bool {
        config.visibility_m.is_some()
    }

    /// Lays it over all views of a picture.
    pub fn draw(&self, pixels: &mut Pixels, views: &[View]) {
        if pixels.rgba().is_empty() {
            return;
        }
        let stride = pixels.size()[0] as usize;
        let (rgba, depth) = pixels.planes_mut();
        let depth = depth.map_or(&[][..], |depth| &*depth);
        for view in views {
            self.draw_view(view, stride, rgba, depth);
        }
    }

    fn draw_view(&self, view: &View, stride: usize, rgba: &mut [u8], depth: &[f32]) {
        let [left, top] = view.at.map(|at| at as usize);
        let [width, height] = view.size().map(|side| side as usize);
        let has_haze = self.medium.per_m > 0.0;
        let mut nearness = Vec::with_capacity(width);
        for y in 0..height {
            let start = (top + y) * stride + left;
            let Some(texels) = rgba.get_mut(4 * start..4 * (start + width)) else { return };
            let across = f64::from(y as u32) + 0.5;
            let [first, second] = [0.5, 1.5].map(|x| view.camera.ray_in_world(x, across));
            nearness.clear();
            if has_haze {
                let Some(row) = depth.get(start..start + width) else { return };
                nearness.extend_from_slice(row);
                let rows =
                    [y.checked_sub(1).map(|_first| start - stride), Some(start + stride).filter(|_| y + 1 < height)];
                fill_edges(texels, &mut nearness, rows.map(|row| row.and_then(|row| depth.get(row..row + width))));
            }
            self.instructions.run(Row {
                medium: &self.medium,
                direction: first.as_vec3().to_array(),
                step: (second - first).as_vec3().to_array(),
                texels,
                depth: &nearness,
            });
        }
    }
}

/// Pixels of sky that show some ground at an edge have the depth of the nearest ground beside.
fn fill_edges(texels: &[u8], nearness: &mut [f32], rows: [Option<&[f32]>; 2]) {
    let mut before = 0.0;
    for x in 0..nearness.len() {
        let own = nearness[x];
        if own == 0.0 && texels[4 * x + 3] != 0 {
            let after = nearness.get(x + 1).copied().unwrap_or(0.0);
            let beside = rows.iter().flatten().map(|row| row[x]);
            nearness[x] = beside.chain([before, after]).fold(0.0, f32::max);
        }
        before = own;
    }
}
