//! How far ground is drawn from where it should be.

use super::still::Taken;
use super::truth::Truth;
use glam::DVec3;
use terravision_common::camera::Camera;
use terravision_common::surface::facet::facet_linear;
use terravision_common::surface::tile::CellPosition;

/// How far the ground that a pixel sees is from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Displacement {
    /// Metres up or down.
    pub m: f64,
    /// What that is on screen at most: as if the eye looked along level ground.
    pub px: f64,
}

impl Truth {
    /// Of every pixel that shows ground, measured and not made up, where the truth has land.
    pub(super) fn displacements(&self, camera: &Camera, taken: &Taken, is_land: &[bool]) -> Vec<Option<Displacement>> {
        let focal_px = camera.focal_px();
        let of_pixel = |((ground, depth), is_land): ((&DVec3, &f64), &bool)| {
            let shows = *is_land && depth.is_finite() && ground.is_finite();
            let m = shows.then(|| (ground.z - self.height_at(*ground)).abs())?;
            Some(Displacement { m, px: m * focal_px / depth })
        };
        taken.ground.iter().zip(&taken.depth).zip(is_land).map(of_pixel).collect()
    }

    /// Linear on the facets of the finest level: the surface that the pipeline comes down to.
    fn height_at(&self, ground: DVec3) -> f64 {
        let [columns, rows] = self.heights.cells();
        let step = self.heights.spacing_m();
        let x = CellPosition::within(ground.x / step, columns as u32);
        let y = CellPosition::within(ground.y / step, rows as u32);
        let south = y.cell as usize * (columns + 1) + x.cell as usize;
        let z = |at: usize| f64::from(self.heights.values()[at]);
        let north = south + columns + 1;
        facet_linear(z(south), z(south + 1), z(north), z(north + 1), x.offset, y.offset)
    }
}
