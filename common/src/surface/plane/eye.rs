//! A plane as seen from an eye: distances and depths of points, and relative positions of vertices.

use super::{Column, Row};
use crate::surface::{Sight, WorldBox};
use glam::{DVec3, Vec3};

/// Distances and depths of points of the surface from an eye. The same inputs give the same bits in
/// every process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaneFrame {
    eye: DVec3,
    forward: DVec3,
}

/// Terms that are common to all points of a row.
#[derive(Debug, Clone, Copy)]
pub struct PlaneRow {
    north2: f64,
    depth: f64,
}

impl PlaneFrame {
    pub(super) fn new(eye: DVec3, forward: DVec3) -> Self {
        Self { eye, forward }
    }

    /// The eye, world coordinates.
    #[inline]
    #[must_use]
    pub fn eye(&self) -> DVec3 {
        self.eye
    }

    /// Terms that are common to the points of a row: the part of [`PlaneFrame::sight`] that is
    /// computed once.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, row: Row) -> PlaneRow {
        let north = row - self.eye.y;
        PlaneRow { north2: north * north, depth: north * self.forward.y }
    }

    /// Depth and distances of the point at a row, a column and a height (exaggerated).
    #[inline(always)]
    #[must_use]
    pub fn sight(&self, row: PlaneRow, column: Column, height_m: f64) -> Sight {
        let east = column - self.eye.x;
        let up = height_m - self.eye.z;
        let horizontal2 = east * east + row.north2;
        let vertical2 = up * up;
        let depth = east * self.forward.x + row.depth + up * self.forward.z;
        Sight { depth, horizontal2, vertical2, distance2: horizontal2 + vertical2 }
    }

    /// Bounds over the points of a box: the smallest depth and distances, and the largest
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

    /// The term of a column in the position of its vertices relative to the eye: metres east.
    #[inline(always)]
    #[must_use]
    pub fn column_from_eye(&self, column: Column) -> f32 {
        (column - self.eye.x) as f32
    }

    /// The term of a row in the position of its vertices relative to the eye: metres north.
    #[inline(always)]
    #[must_use]
    pub fn row_from_eye(&self, row: Row) -> f32 {
        (row - self.eye.y) as f32
    }

    /// A height (exaggerated) as stored in elevation arrays: metres above the eye.
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
