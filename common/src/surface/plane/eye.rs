//! A plane from an eye: distances and depths of points, and vertices relative to it.

use super::{Column, Row};
use crate::surface::{Sight, WorldBox};
use glam::{DVec3, Vec3};

/// What an eye sees of points of the surface. The same inputs give the same bits in every process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EyeFrame {
    eye: DVec3,
    forward: DVec3,
}

/// What all points of a row have in common.
#[derive(Debug, Clone, Copy)]
pub struct EyeRow {
    north2: f64,
    depth: f64,
}

impl EyeFrame {
    pub(super) fn new(eye: DVec3, forward: DVec3) -> Self {
        Self { eye, forward }
    }

    /// The eye, world coordinates.
    #[inline]
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// What the points of a row share: the part of [`EyeFrame::sight`] that is done once.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, row: Row) -> EyeRow {
        let north = row - self.eye.y;
        EyeRow { north2: north * north, depth: north * self.forward.y }
    }

    /// How the point of a row, a column and a height (exaggerated) lies.
    #[inline(always)]
    #[must_use]
    pub fn sight(&self, row: EyeRow, column: Column, height_m: f64) -> Sight {
        let east = column - self.eye.x;
        let up = height_m - self.eye.z;
        let horizontal2 = east * east + row.north2;
        let vertical2 = up * up;
        let depth = east * self.forward.x + row.depth + up * self.forward.z;
        Sight { depth, horizontal2, vertical2, distance2: horizontal2 + vertical2 }
    }

    /// Bounds of how the points of a box lie: the least depth and distances, the greatest
    /// difference in height.
    #[must_use]
    pub fn bound(&self, bounds: &WorldBox) -> Sight {
        let bounds = bounds.seen_from(self.eye);
        let nearest = bounds.nearest();
        let horizontal2 = nearest.x * nearest.x + nearest.y * nearest.y;
        let distance2 = horizontal2 + nearest.z * nearest.z;
        let highest = bounds.min.z.abs().max(bounds.max.z.abs());
        let depth = bounds.least_along(self.forward);
        Sight { depth, horizontal2, vertical2: highest * highest, distance2 }
    }

    /// Of a column's vertices, what their position relative to the eye takes from it: metres east.
    #[inline(always)]
    #[must_use]
    pub fn column_from_eye(&self, column: Column) -> f32 {
        (column - self.eye.x) as f32
    }

    /// Of a row's vertices, what their position relative to the eye takes from it: metres north.
    #[inline(always)]
    #[must_use]
    pub fn row_from_eye(&self, row: Row) -> f32 {
        (row - self.eye.y) as f32
    }

    /// A height, exaggerated, as elevation arrays hold it: metres above the eye.
    #[inline(always)]
    #[must_use]
    pub fn height_from_eye(&self, height_m: f64) -> f32 {
        (height_m - self.eye.z) as f32
    }

    /// A position in single precision, metres from the eye.
    #[inline(always)]
    #[must_use]
    pub fn from_eye(&self, position: DVec3) -> Vec3 {
        (position - self.eye).as_vec3()
    }
}
