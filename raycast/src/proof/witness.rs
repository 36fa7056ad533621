//! How much of a ray another ray proves, by the slopes of the ground between the two.

use super::steepness::{Field, SECTORS, Steepness, sector};
use super::unproven::{RING_ENDS, RINGS};
use super::{StartRule, Unproven};
use crate::view::Ray;
use glam::Vec3;

/// Rings that are tested together, as a vector of fields without a branch for each.
const GROUP: usize = 8;
/// Two rays whose directions are more sectors apart prove nothing about each other, unless all
/// ground is below the slope bound. Neighbouring pixels of a line are less than a sector apart,
/// except where rays are nearly vertical.
const MOST_APART: usize = 2;
/// The segment between two points in sectors that close is nowhere nearer to the eye than this
/// share of the nearer point's distance: the cosine of half of three sectors is 0.9997.
const SAGITTA: f32 = 0.999;
/// Distances are widened by a thousandth on both sides, for the rounding of lengths.
const WIDER: f32 = 1e-3;

/// What matters of two rays for the steep ground between them.
#[derive(Debug, Clone, Copy)]
struct Between {
    /// Slopes up to its square root are proven.
    limit: f32,
    /// Tangent of elevation of the lower ray.
    tangent: f32,
    /// Whether ground below the slope bound is proven to be below the ray.
    is_bound_proven: bool,
}

impl Between {
    #[inline(always)]
    fn leaves_unproven(&self, field: &Field) -> bool {
        (field.slope * field.slope > self.limit) & ((field.tangent >= self.tangent) | !self.is_bound_proven)
    }
}

impl StartRule for Steepness {
    const RELIES: bool = true;
    const STARTS_BELOW_TOP: bool = true;

    /// The candidate that leaves the fewest rings unproven; the first that leaves none, if there is
    /// one.
    #[inline(always)]
    fn find_witness<K>(
        &self,
        ray: &Ray,
        below: impl Iterator<Item = K>,
        of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Unproven)> {
        let mut best: Option<(K, Unproven)> = None;
        for known in below {
            let (other, reach) = of(&known);
            let Some(unproven) = self.unproven(ray, other, reach) else { continue };
            if unproven.ring_count() == 0 {
                return Some((known, unproven));
            }
            if best.as_ref().is_none_or(|(_, best)| unproven.ring_count() < best.ring_count()) {
                best = Some((known, unproven));
            }
        }
        best
    }

    fn slopes(&self) -> Option<&Steepness> {
        Some(self)
    }
}

impl Steepness {
    #[inline(always)]
    fn between(&self, a: Vec3, b: Vec3, limit: f32) -> Between {
        let tangent = |direction: Vec3| direction.z / direction.truncate().length();
        Between { limit, tangent: tangent(a).min(tangent(b)), is_bound_proven: self.bound * self.bound <= limit }
    }

    /// The distance, metres, up to which no ground between the directions `a` and `b` (within the
    /// smaller angle) that is not below all rays between them is steeper than the square root of
    /// `limit`.
    pub(crate) fn below_slope_until(&self, a: Vec3, b: Vec3, limit: f32) -> f32 {
        if self.steepest * self.steepest <= limit {
            return f32::INFINITY;
        }
        let (from, to) = (sector(a.truncate()), sector(b.truncate()));
        let apart = (to + SECTORS - from) % SECTORS;
        let (first, count) = if apart <= SECTORS / 2 { (from, apart + 1) } else { (to, SECTORS - apart + 1) };
        if count > SECTORS / 4 {
            return 0.0;
        }
        let between = self.between(a, b, limit);
        let mut end = RINGS;
        for sector in (first..first + count).map(|sector| sector % SECTORS) {
            if self.steepest_of[sector] * self.steepest_of[sector] > limit {
                let rings = self.rings(sector);
                let groups = rings.chunks_exact(GROUP).take(end.div_ceil(GROUP));
                let is_any =
                    |group: &[Field]| group.iter().fold(false, |any, field| any | between.leaves_unproven(field));
                let group = groups.into_iter().position(is_any).unwrap_or(RINGS / GROUP);
                let from = GROUP * group;
                let within = rings[from..end.max(from)].iter().position(|field| between.leaves_unproven(field));
                end = within.map_or(end, |ring| from + ring);
            }
        }
        match end {
            0 => 0.0,
            RINGS => f32::INFINITY,
            end => self.nearest_m * RING_ENDS[end - 1],
        }
    }

    /// The intervals, up to parameter `reach` of both, in which ray `other`, which is in the air,
    /// does not prove that `ray` is in the air too. `None`: it proves nothing.
    #[inline(always)]
    pub(crate) fn unproven(&self, ray: &Ray, other: &Ray, reach: f32) -> Option<Unproven> {
        let by = ray.direction - other.direction;
        let squared = by.x * by.x + by.y * by.y;
        if by.z <= 0.0 {
            return None;
        }
        // Slopes up to `by.z / √squared` are proven.
        let is_proven = |slope: f32| by.z * by.z >= slope * slope * squared;
        if is_proven(self.steepest) {
            return Some(Unproven::NONE);
        }
        let (a, b) = (ray.direction.truncate(), other.direction.truncate());
        let (from, to) = (sector(a), sector(b));
        let apart = (to + SECTORS - from) % SECTORS;
        let (first, count) = if apart <= MOST_APART {
            (from, apart + 1)
        } else if SECTORS - apart <= MOST_APART {
            (to, SECTORS - apart + 1)
        } else {
            return None;
        };
        let sectors = || (first..first + count).map(|sector| sector % SECTORS);
        if sectors().all(|sector| is_proven(self.steepest_of[sector])) {
            return Some(Unproven::NONE);
        }
        let (near, far) = {
            let (a, b) = (a.length(), b.length());
            (SAGITTA * a.min(b), a.max(b))
        };
        let last = self.ring(reach * far);
        let between = self.between(ray.direction, other.direction, by.z * by.z / squared);
        let mut rings = 0u64;
        for sector in sectors() {
            for (ring, field) in self.rings(sector)[..=last].iter().enumerate() {
                rings |= u64::from(between.leaves_unproven(field)) << ring;
            }
        }
        Some(Unproven::new(rings, self.nearest_m / far * (1.0 - WIDER), self.nearest_m / near * (1.0 + WIDER)))
    }
}
