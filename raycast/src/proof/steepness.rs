//! Where the ground around the eye is steep: this decides how much of a ray another ray proves.
//!
//! ```text
//!        ring 2 ┌──┬──┬──┐     a sector is an interval of directions, a ring one of horizontal distances;
//!        ring 1 ├──┼──┼──┤     each field has a slope that no ground in it exceeds. Ground that is not in
//!        ring 0 └──┴──┴──┘     a steep block keeps below one bound, so that only steep blocks have to be
//!                 sectors      entered.
//! ```
//!
//! A field also has the highest elevation angle under which its steep ground is seen: rays above
//! that angle pass over it.
//!
//! At the same parameter, two neighbouring rays of a line, and the segment between them, lie in the
//! same sector or in two adjacent ones. Only where a field is steeper than the rays allow, the ray
//! has to be sampled.

use super::unproven::{RING_ENDS, RINGS};
use crate::model::{Ground, SLOPE_BOUND};
use glam::Vec2;

/// Intervals of directions of the full circle. (Measured, as are the rings per octave; see
/// `docs/techniques.md`, *Thresholds*.)
pub(crate) const SECTORS: usize = 512;
/// Slopes are compared with a margin of a hundredth, for the rounding of directions.
const MARGIN: f32 = 1.01;
/// Ring 0 ends at this many lattice units from the eye: nearer ground is below the eye.
const NEAREST_UNITS: f32 = 4.0;
/// Margins for rounding, here and in the rays: steep blocks are widened by this on each side,
/// lattice units, and their angles by a share and a tangent.
const WIDER_UNITS: f64 = 0.25;
const STEEPER: f32 = 1e-3;
const STEEPER_TANGENT: f32 = 1e-4;
/// Margins for rounding: sectors by which a block is widened on each side, and a share of its
/// distance.
const WIDER_SECTORS: f32 = 0.01;
const WIDER_RINGS: f32 = 1e-3;

/// Data about the ground of a sector in a ring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Field {
    /// Upper bound of the slope of the ground.
    pub(super) slope: f32,
    /// Upper bound of the tangent of elevation under which the eye sees the ground that is steeper
    /// than the slope bound.
    pub(super) tangent: f32,
}

/// Slopes by direction and distance.
#[derive(Debug, Default)]
pub struct Steepness {
    /// By sector, then by ring.
    fields: Vec<Field>,
    /// The slope bound: all ground outside of steep blocks is less steep.
    pub(super) bound: f32,
    /// The steepest slope of each sector.
    pub(super) steepest_of: Vec<f32>,
    pub(super) steepest: f32,
    /// Where ring 0 ends.
    pub(super) nearest_m: f32,
}

/// A direction in the plane as a number from 0 to [`SECTORS`], monotonic in its angle.
#[inline(always)]
fn turn(direction: Vec2) -> f32 {
    let sum = direction.x.abs() + direction.y.abs();
    let share = direction.y / sum.max(f32::MIN_POSITIVE);
    // From 0 to 4: one for each quarter turn.
    let turn = match (direction.x >= 0.0, direction.y >= 0.0) {
        (true, true) => share,
        (false, _) => 2.0 - share,
        (true, false) => 4.0 + share,
    };
    turn * (SECTORS as f32 / 4.0)
}

#[inline(always)]
pub(super) fn sector(direction: Vec2) -> usize {
    (turn(direction) as usize) % SECTORS
}

/// Which of the two surfaces slopes belong to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Plane {
    /// The surface of voxels.
    Voxels,
    /// The facets between heights.
    Facets,
}

impl Steepness {
    /// Sets the slopes for a ground seen from an eye, in lattice units and metres above the datum.
    pub(crate) fn set(&mut self, ground: &Ground, eye: [f64; 2], eye_m: f32, surface: Plane) {
        self.clear(SLOPE_BOUND);
        let unit = ground.shape().surface.unit_m() as f32;
        self.nearest_m = NEAREST_UNITS * unit;
        for block in ground.steep_blocks() {
            let slope = MARGIN
                * match surface {
                    Plane::Voxels => block.slopes.voxels,
                    Plane::Facets => block.slopes.heights,
                };
            if slope <= self.bound {
                continue;
            }
            let low = [0, 1].map(|axis| (f64::from(block.low[axis]) - WIDER_UNITS - eye[axis]) as f32 * unit);
            let high = [0, 1].map(|axis| (f64::from(block.high[axis]) + WIDER_UNITS - eye[axis]) as f32 * unit);
            self.enter(Vec2::from_array(low), Vec2::from_array(high), slope, block.top_m - eye_m);
        }
    }

    /// Removes all steep ground.
    fn clear(&mut self, bound: f32) {
        self.bound = bound;
        self.fields.clear();
        self.fields.resize(SECTORS * RINGS, Field { slope: bound, tangent: f32::NEG_INFINITY });
        self.steepest_of.clear();
        self.steepest_of.resize(SECTORS, bound);
        self.steepest = bound;
    }

    /// The fields of a sector.
    #[inline(always)]
    pub(super) fn rings(&self, sector: usize) -> &[Field] {
        &self.fields[sector * RINGS..][..RINGS]
    }

    #[inline(always)]
    pub(super) fn ring(&self, distance_m: f32) -> usize {
        let distance = distance_m / self.nearest_m;
        RING_ENDS.partition_point(|end| *end < distance).min(RINGS - 1)
    }

    /// Adds a rectangle of ground, metres from the eye, whose steep parts are at most `top` above
    /// the eye.
    fn enter(&mut self, low: Vec2, high: Vec2, slope: f32, top: f32) {
        self.steepest = self.steepest.max(slope);
        let inside = Vec2::ZERO.clamp(low, high);
        let nearest = inside.length();
        let furthest = low.abs().max(high.abs()).length();
        let tangent = top / if top > 0.0 { nearest } else { furthest };
        let tangent =
            if tangent.is_nan() { f32::INFINITY } else { tangent + STEEPER * tangent.abs() + STEEPER_TANGENT };
        let rings = self.ring((1.0 - WIDER_RINGS) * nearest)..=self.ring((1.0 + WIDER_RINGS) * furthest);
        let (first, count) = if nearest == 0.0 { (0, SECTORS) } else { sectors_of(low, high) };
        for sector in (first..first + count).map(|sector| sector % SECTORS) {
            self.steepest_of[sector] = self.steepest_of[sector].max(slope);
            for field in &mut self.fields[sector * RINGS..][rings.clone()] {
                *field = Field { slope: field.slope.max(slope), tangent: field.tangent.max(tangent) };
            }
        }
    }
}

/// The first sector in which a rectangle is seen, and the number of sectors. The eye must not be
/// over the rectangle.
fn sectors_of(low: Vec2, high: Vec2) -> (usize, usize) {
    let middle = turn(0.5 * (low + high));
    let all = SECTORS as f32;
    let (mut least, mut most) = (0.0f32, 0.0f32);
    for corner in [low, high, Vec2::new(low.x, high.y), Vec2::new(high.x, low.y)] {
        let by = turn(corner) - middle;
        let by = if by > 0.5 * all {
            by - all
        } else if by < -0.5 * all {
            by + all
        } else {
            by
        };
        (least, most) = (least.min(by), most.max(by));
    }
    let first = (middle + least - WIDER_SECTORS).floor();
    let count = ((middle + most + WIDER_SECTORS).floor() - first) as usize + 1;
    (first.rem_euclid(all) as usize, count.min(SECTORS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::Ray;
    use glam::Vec3;
    use proptest::prelude::*;

    #[test]
    fn turns_grow_with_the_angle() {
        let turns: Vec<f32> =
            (0..720).map(|n| turn(Vec2::from_angle((0.5 * n as f32 + 0.1).to_radians()) * 7.0)).collect();
        assert!(turns.is_sorted() && turns[0] >= 0.0 && turns[719] <= SECTORS as f32, "{turns:?}");
    }

    fn table(low: Vec2, high: Vec2, slope: f32) -> Steepness {
        let mut table = Steepness { nearest_m: 4.0, ..Steepness::default() };
        table.clear(0.5);
        table.enter(low, high, slope, f32::INFINITY);
        table
    }

    proptest! {
        #[test]
        fn a_steep_rectangle_is_unproven_wherever_a_way_between_rays_crosses_it(
            x in -900.0f32..900.0, y in -900.0f32..900.0, side in 1.0f32..90.0,
            angle in 0.0f32..7.0, by in -0.004f32..0.004, length in 0.3f32..3.0, longer in 0.99f32..1.01,
        ) {
            let (low, high) = (Vec2::new(x, y), Vec2::new(x + side, y + side));
            let table = table(low, high, 9.0);
            let at = Vec2::from_angle(angle) * length;
            let other = Vec2::from_angle(angle + by) * (length * longer);
            let gap = (at - other).length();
            // Slopes of 1 are proven, of 9 not.
            let rays = [at.extend(gap - 1.0), other.extend(-1.0)].map(|direction| Ray { direction, depth: 1.0 });
            prop_assume!(gap > 1e-4);
            let reach = 2000.0;
            let Some(unproven) = table.unproven(&rays[0], &rays[1], reach) else { return Ok(()) };
            let unproven: Vec<_> = unproven.collect();
            for k in 0..2000 {
                let s = k as f32;
                let crosses = (0..=8).any(|n| {
                    let p = at.lerp(other, n as f32 / 8.0) * s;
                    p.cmpge(low).all() && p.cmple(high).all()
                });
                let is_unproven = unproven.iter().any(|[from, to]| (*from..=*to).contains(&s));
                prop_assert!(!crosses || is_unproven, "{s} {unproven:?}");
            }
        }
    }

    #[test]
    fn without_steep_ground_in_the_way_everything_is_proven() {
        let table = table(Vec2::new(100.0, -5.0), Vec2::new(110.0, 5.0), 9.0);
        let rays = |angle: f32| {
            let at = Vec2::from_angle(angle);
            [at.extend(-0.49), (at * 1.01).extend(-0.5)].map(|direction: Vec3| Ray { direction, depth: 1.0 })
        };
        let [ray, below] = rays(1.0);
        assert_eq!(table.unproven(&ray, &below, 500.0).unwrap().count(), 0);
        let [ray, below] = rays(0.0);
        let unproven: Vec<_> = table.unproven(&ray, &below, 500.0).unwrap().collect();
        assert!(
            unproven.len() == 1 && unproven[0][0] < 100.0 && unproven[0][1] > 110.0 && unproven[0][1] < 160.0,
            "{unproven:?}"
        );
        assert_eq!(table.unproven(&ray, &below, 40.0).unwrap().count(), 0, "it is not reached");
        assert!(table.unproven(&below, &ray, 40.0).is_none(), "not above");
    }
}
