//! Whether rays pass above all ground of an interval, by the highest ground there.

use crate::scene::Scene;
use crate::view::Ray;
use glam::Vec3;

/// The highest ground is looked up for a larger rectangle, by this share of the distance on each
/// side, because neighbouring lines are likely to need it. The 32 lines that a worker takes at a
/// time span a twentieth of the distance, at 60 degrees and 1280 columns.
const SEEN_AROUND: f32 = 1.0 / 16.0;
/// An interval is widened by this share of its distance and this many metres on all sides: a
/// hundred times the largest rounding error of metres from the eye.
const WIDER: f32 = 1e-5;
const WIDER_M: f32 = 0.01;

/// A rectangle of ground, lattice units, and its highest point, metres above the datum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HighestSeen {
    low: [f64; 2],
    high: [f64; 2],
    highest: f32,
}

impl HighestSeen {
    /// The value for no ground.
    pub(crate) const NOTHING: Self =
        Self { low: [f64::INFINITY; 2], high: [f64::NEG_INFINITY; 2], highest: f32::NEG_INFINITY };

    /// Whether it contains another rectangle.
    #[inline(always)]
    fn holds(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        (0..2).all(|axis| self.low[axis] <= low[axis] && high[axis] <= self.high[axis])
    }
}

impl Scene<'_> {
    /// Whether the rays between two, in one plane, are above the ground where only some of them
    /// have entered its bounds: there the other ones prove nothing.
    pub(super) fn is_entered_above(&self, rays: [&Ray; 2], seen: &mut HighestSeen) -> bool {
        if !self.is_eye_beside_tiles() {
            return true;
        }
        let (mut first, mut last) = (0.0f32, 0.0f32);
        for axis in 0..2 {
            let (min, max) = (self.bounds.min[axis], self.bounds.max[axis]);
            let border = if min > 0.0 {
                min
            } else if max < 0.0 {
                max
            } else {
                continue;
            };
            let entries = rays.map(|ray| border / ray.direction[axis]);
            // Some never enter its bounds.
            if !entries.iter().all(|entry| *entry > 0.0 && entry.is_finite()) {
                return false;
            }
            first = first.max(entries[0].min(entries[1]));
            last = last.max(entries[0].max(entries[1]));
        }
        self.is_above(rays, [first, last], seen)
    }

    /// Whether the rays between two, in one plane, are above the ground from one parameter to
    /// another.
    pub(super) fn is_above(&self, rays: [&Ray; 2], [first, last]: [f32; 2], seen: &mut HighestSeen) -> bool {
        let corners = rays.map(|ray| [ray.direction * first, ray.direction * last]);
        let corners = [corners[0][0], corners[0][1], corners[1][0], corners[1][1]];
        let low = corners.into_iter().fold(Vec3::INFINITY, Vec3::min);
        let high = corners.into_iter().fold(Vec3::NEG_INFINITY, Vec3::max);
        let furthest = high.abs().max(low.abs()).max_element();
        let margin = WIDER * furthest + WIDER_M;
        if low.z - margin > self.highest {
            return true;
        }
        let (eye, surface) = (self.view.eye_in_world(), &self.ground.shape().surface);
        let lattice = |at: Vec3, by: f32| surface.lattice_of_way((at.truncate() + by).as_dvec2(), eye).to_array();
        let top = |tile: u32| self.ground.tiles()[tile as usize].top_m;
        let highest_in = |by: f32| {
            let (low, high) = (lattice(low, -by), lattice(high, by));
            HighestSeen { low, high, highest: self.ground.tree().highest_in(low, high, &top) }
        };
        let lowest = f64::from(low.z - margin) + surface.height_m(eye) - self.ground.datum_m();
        let is_below = |highest: f32| lowest > f64::from(highest);
        if !seen.holds(lattice(low, -margin), lattice(high, margin)) {
            *seen = highest_in(margin + furthest * SEEN_AROUND);
        }
        is_below(seen.highest) || is_below(highest_in(margin).highest)
    }
}
