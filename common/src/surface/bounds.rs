//! Bounding boxes of ground.

use glam::DVec3;

/// An axis-aligned box in world space, metres; heights are exaggerated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorldBox {
    /// Lower corner.
    pub min: DVec3,
    /// Upper corner.
    pub max: DVec3,
}

impl WorldBox {
    /// The box relative to an eye.
    #[inline]
    #[must_use]
    pub fn seen_from(&self, eye: DVec3) -> Self {
        Self { min: self.min - eye, max: self.max - eye }
    }

    /// The vector from the origin to the nearest point of the box; 0 along axes where the origin is
    /// inside.
    #[inline]
    #[must_use]
    pub fn nearest(&self) -> DVec3 {
        self.min.max(-self.max).max(DVec3::ZERO)
    }

    /// The largest coordinate of its corners along a direction.
    #[inline]
    #[must_use]
    pub fn most_along(&self, direction: DVec3) -> f64 {
        (direction * self.min).max(direction * self.max).element_sum()
    }

    /// The smallest coordinate of its corners along a direction.
    #[inline]
    #[must_use]
    pub fn least_along(&self, direction: DVec3) -> f64 {
        (direction * self.min).min(direction * self.max).element_sum()
    }

    /// The box, extended down to this height.
    #[must_use]
    pub fn down_to(mut self, height_m: f64) -> Self {
        self.min.z = self.min.z.min(height_m);
        self
    }
}
