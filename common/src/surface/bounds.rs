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

    /// Where a straight way from `start` meets the box, widened by a margin on all sides: the share
    /// of the way, 0 to 1; `None` where it passes by.
    #[must_use]
    pub fn met_by(&self, start: DVec3, way: DVec3, margin: f64) -> Option<f64> {
        let (mut enter, mut leave) = (0.0f64, 1.0f64);
        for axis in 0..3 {
            let [low, high] = [self.min[axis] - margin - start[axis], self.max[axis] + margin - start[axis]];
            if way[axis] == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return None;
                }
                continue;
            }
            let [a, b] = [low / way[axis], high / way[axis]];
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        (enter <= leave).then_some(enter)
    }

    /// The box, extended down to this height.
    #[must_use]
    pub fn down_to(mut self, height_m: f64) -> Self {
        self.min.z = self.min.z.min(height_m);
        self
    }
}
