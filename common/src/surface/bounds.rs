//! The space that ground may fill.

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
    /// Seen from an eye: its corners relative to it.
    #[inline]
    #[must_use]
    pub fn seen_from(&self, eye: DVec3) -> Self {
        Self { min: self.min - eye, max: self.max - eye }
    }

    /// The way from the origin to the nearest point, along each axis; 0 where it is inside.
    #[inline]
    #[must_use]
    pub fn nearest(&self) -> DVec3 {
        self.min.max(-self.max).max(DVec3::ZERO)
    }

    /// How far its farthest corner lies along a direction.
    #[inline]
    #[must_use]
    pub fn most_along(&self, direction: DVec3) -> f64 {
        (direction * self.min).max(direction * self.max).element_sum()
    }

    /// How far its nearest corner lies along a direction.
    #[inline]
    #[must_use]
    pub fn least_along(&self, direction: DVec3) -> f64 {
        (direction * self.min).min(direction * self.max).element_sum()
    }

    /// The same, and what is under it down to this height.
    #[must_use]
    pub fn down_to(mut self, height_m: f64) -> Self {
        self.min.z = self.min.z.min(height_m);
        self
    }
}
