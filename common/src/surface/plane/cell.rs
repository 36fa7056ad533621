//! The lattice relative to an eye, where numbers have to be small.

use super::Plane;
use glam::DVec3;

/// The lattice cell that an eye is over: lattice points are counted from it where integers are
/// small, as on a graphics device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EyeCell {
    /// Its south west corner.
    pub corner: [i64; 2],
    /// The eye's position in it, metres east and north of the corner.
    pub eye_m: [f32; 2],
}

impl EyeCell {
    /// A lattice coordinate along an axis (0 east, 1 north) from the cell; it saturates.
    #[inline]
    #[must_use]
    pub fn count(&self, axis: usize, lattice: u32) -> i32 {
        (i64::from(lattice) - self.corner[axis]).clamp(i32::MIN.into(), i32::MAX.into()) as i32
    }
}

impl Plane {
    /// The lattice cell that an eye is over.
    #[must_use]
    pub fn eye_cell(&self, eye: DVec3) -> EyeCell {
        let cell = [eye.x, eye.y].map(|v| (v / self.unit_m).floor());
        let eye_m = [(eye.x - cell[0] * self.unit_m) as f32, (eye.y - cell[1] * self.unit_m) as f32];
        EyeCell { corner: cell.map(|v| v as i64), eye_m }
    }
}
