//! Where the ground is steep, around the eye: what decides how far a ray below proves the way of another one.
//!
//! ```text
//!        ring 2 ┌──┬──┬──┐     a sector is an interval of directions, a ring one of horizontal distances; each field has
//!        ring 1 ├──┼──┼──┤     a slope that no ground in it exceeds. Blocks of ground that are not steep share one bound,
//!        ring 0 └──┴──┴──┘     so that only the steep ones have to be entered.
//!                 sectors
//! ```
//!
//! A field also has the highest elevation angle under which its steep ground is seen: rays above that pass over it.
//!
//! Two neighbouring rays of a line lie, at the same parameter, in the same sector or in two beside each other, and so does the
//! straight way between them. Where a field is steeper than the rays allow, and there alone, the way has to be looked at.

use crate::model::Ground;
use crate::view::Ray;
use glam::{Vec2, Vec3};

/// Intervals of directions, all around.
const SECTORS: usize = 512;
/// Intervals of distances.
const RINGS: usize = 64;
/// Rings that are looked at at once.
const GROUP: usize = 8;
/// Rings within which distances double.
const RINGS_PER_OCTAVE: usize = 4;
/// Two rays whose directions are more sectors apart say nothing of each other, unless all ground is gentle enough.
const MOST_APART: usize = 2;
/// The way between two points in sectors that near is nowhere nearer to the eye than this share of the nearer one's
/// distance: the cosine of half of three sectors is 0.9997.
const SAGITTA: f32 = 0.999;
/// Slopes are compared with a hundredth more, for the rounding of directions.
const MARGIN: f32 = 1.01;

/// What is known of the ground of a sector in a ring.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Field {
    /// No ground is steeper.
    slope: f32,
    /// All ground that is not gentle is seen from the eye under this tangent of elevation or a lower one.
    tangent: f32,
}

/// Two rays, as far as it matters to what steep ground is between them.
#[derive(Debug, Clone, Copy)]
struct Between {
    /// Slopes up to its square root are proven.
    limit: f32,
    /// The lower one's tangent of elevation.
    tangent: f32,
    is_gentle_proven: bool,
}

impl Between {
    #[inline(always)]
    fn is_doubtful(&self, field: &Field) -> bool {
        (field.slope * field.slope > self.limit) & ((field.tangent >= self.tangent) | !self.is_gentle_proven)
    }
}

/// The table.
#[derive(Debug, Default)]
pub(crate) struct Steepness {
    /// By sector, then by ring.
    fields: Vec<Field>,
    gentle: f32,
    /// Of each sector.
    steepest_of: Vec<f32>,
    steepest: f32,
    nearest_m: f32,
}

/// Parts of a ray's way that nothing proves to be in the air, as far as another ray was: from where and up to where, in order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Doubts {
    rings: u64,
    /// Parameter of the end of ring 0, for its beginning as seen by the ray that gets there first, and for its end by the last.
    first: f32,
    last: f32,
}

impl Doubts {
    /// Nowhere.
    pub(crate) const NONE: Self = Self { rings: 0, first: 0.0, last: 0.0 };
}

impl Iterator for Doubts {
    type Item = [f32; 2];

    #[inline(always)]
    fn next(&mut self) -> Option<[f32; 2]> {
        if self.rings == 0 {
            return None;
        }
        let from = self.rings.trailing_zeros();
        let count = (self.rings >> from).trailing_ones();
        let to = from + count;
        self.rings = if to >= 64 { 0 } else { self.rings >> to << to };
        let begin = if from == 0 { 0.0 } else { self.first * RING_ENDS[from as usize - 1] };
        // The last ring has no end.
        let end = if to as usize >= RINGS { f32::INFINITY } else { self.last * RING_ENDS[to as usize - 1] };
        Some([begin, end])
    }
}

/// Distance at which each ring ends, that of ring 0 being 1.
const RING_ENDS: [f32; RINGS] = ring_ends();

const fn ring_ends() -> [f32; RINGS] {
    // Powers of the fourth root of 2.
    let within_octave = [1.0, 1.189_207_1, std::f32::consts::SQRT_2, 1.681_792_9];
    let mut ends = [1.0; RINGS];
    let (mut ring, mut octave) = (0, 1.0);
    while ring < RINGS {
        ends[ring] = octave * within_octave[ring % RINGS_PER_OCTAVE];
        ring += 1;
        if ring % RINGS_PER_OCTAVE == 0 {
            octave *= 2.0;
        }
    }
    ends
}

/// A direction in the plane as a number from 0 to [`SECTORS`] that grows all around with its angle.
#[inline(always)]
fn turn(direction: Vec2) -> f32 {
    let sum = direction.x.abs() + direction.y.abs();
    let share = direction.y / sum.max(f32::MIN_POSITIVE);
    // From 0 to 4, a quarter turn each.
    let turn = match (direction.x >= 0.0, direction.y >= 0.0) {
        (true, true) => share,
        (false, _) => 2.0 - share,
        (true, false) => 4.0 + share,
    };
    turn * (SECTORS as f32 / 4.0)
}

fn sector(direction: Vec2) -> usize {
    (turn(direction) as usize) % SECTORS
}

impl Steepness {
    /// Sets it for a ground seen from an eye; `is_voxels`: of the surface of voxels, else of the heights themselves. `eye`: in
    /// lattice units; `eye_m`: metres above the datum.
    pub(crate) fn set(&mut self, ground: &Ground, eye: [f64; 2], eye_m: f32, is_voxels: bool) {
        let gentle = ground.gentle();
        self.gentle = gentle;
        self.fields.clear();
        self.fields.resize(SECTORS * RINGS, Field { slope: gentle, tangent: f32::NEG_INFINITY });
        self.steepest_of.clear();
        self.steepest_of.resize(SECTORS, gentle);
        self.steepest = gentle;
        let unit = ground.shape().lattice_unit_m as f32;
        self.nearest_m = 4.0 * unit;
        for block in ground.steep_blocks() {
            let slope = MARGIN * if is_voxels { block.voxel_slope } else { block.slope };
            if slope <= gentle {
                continue;
            }
            // A little more on all sides: rounding, here and in the rays.
            let low = [0, 1].map(|axis| (f64::from(block.low[axis]) - 0.25 - eye[axis]) as f32 * unit);
            let high = [0, 1].map(|axis| (f64::from(block.high[axis]) + 0.25 - eye[axis]) as f32 * unit);
            self.enter(Vec2::from_array(low), Vec2::from_array(high), slope, block.top_m - eye_m);
        }
    }

    #[inline(always)]
    fn ring(&self, distance_m: f32) -> usize {
        let distance = distance_m / self.nearest_m;
        RING_ENDS.partition_point(|end| *end < distance).min(RINGS - 1)
    }

    /// Enters a rectangle of ground, metres from the eye, no steep part of which is higher than `top` above the eye.
    fn enter(&mut self, low: Vec2, high: Vec2, slope: f32, top: f32) {
        self.steepest = self.steepest.max(slope);
        let inside = Vec2::ZERO.clamp(low, high);
        let nearest = inside.length();
        let furthest = low.abs().max(high.abs()).length();
        let tangent = top / if top > 0.0 { nearest } else { furthest };
        // Rounding, here and below.
        let tangent = if tangent.is_nan() { f32::INFINITY } else { tangent + 1e-3 * tangent.abs() + 1e-4 };
        let rings = self.ring(0.999 * nearest)..=self.ring(1.001 * furthest);
        let (first, count) = if nearest == 0.0 {
            (0, SECTORS)
        } else {
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
            let first = (middle + least - 0.01).floor();
            let count = ((middle + most + 0.01).floor() - first) as usize + 1;
            (first.rem_euclid(all) as usize, count.min(SECTORS))
        };
        for sector in (first..first + count).map(|sector| sector % SECTORS) {
            self.steepest_of[sector] = self.steepest_of[sector].max(slope);
            for field in &mut self.fields[sector * RINGS..][rings.clone()] {
                *field = Field { slope: field.slope.max(slope), tangent: field.tangent.max(tangent) };
            }
        }
    }

    /// The square of a slope that no ground exceeds.
    #[inline(always)]
    pub(crate) fn steepest_squared(&self) -> f32 {
        self.steepest * self.steepest
    }

    #[inline(always)]
    fn between(&self, a: Vec3, b: Vec3, limit: f32) -> Between {
        let tangent = |direction: Vec3| direction.z / direction.truncate().length();
        Between { limit, tangent: tangent(a).min(tangent(b)), is_gentle_proven: self.gentle * self.gentle <= limit }
    }

    /// Up to which distance no ground between the directions `a` and `b` (the smaller angle of the two), and not below all
    /// rays between them, is steeper than the square root of `limit`, metres.
    pub(crate) fn gentle_until(&self, a: Vec3, b: Vec3, limit: f32) -> f32 {
        if self.steepest_squared() <= limit {
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
                let rings = &self.fields[sector * RINGS..][..RINGS];
                // Several at a time, without a branch for each.
                let groups = rings.chunks_exact(GROUP).take(end.div_ceil(GROUP));
                let is_any = |group: &[Field]| group.iter().fold(false, |any, field| any | between.is_doubtful(field));
                let group = groups.into_iter().position(is_any).unwrap_or(RINGS / GROUP);
                let from = GROUP * group;
                let within = rings[from..end.max(from)].iter().position(|field| between.is_doubtful(field));
                end = within.map_or(end, |ring| from + ring);
            }
        }
        match end {
            0 => 0.0,
            RINGS => f32::INFINITY,
            end => self.nearest_m * RING_ENDS[end - 1],
        }
    }

    /// Of rays below, nearest first, the one that leaves the fewest doubts: the first that leaves
    /// none, if there is one. `of`: a candidate's ray, and the parameter up to which it is known.
    #[inline(always)]
    pub(crate) fn nearest_proof<K>(
        &self,
        ray: &Ray,
        below: impl Iterator<Item = K>,
        of: impl Fn(&K) -> (&Ray, f32),
    ) -> Option<(K, Doubts)> {
        let mut best: Option<(K, Doubts)> = None;
        for known in below {
            let (other, reach) = of(&known);
            let Some(doubts) = self.doubts(ray, other, reach) else { continue };
            if doubts.rings == 0 {
                return Some((known, doubts));
            }
            if best.as_ref().is_none_or(|(_, best)| doubts.rings.count_ones() < best.rings.count_ones()) {
                best = Some((known, doubts));
            }
        }
        best
    }

    /// Where, up to parameter `reach` of both, ray `other` in the air does not prove that `ray` is in the air as well. `None`:
    /// anywhere.
    #[inline(always)]
    pub(crate) fn doubts(&self, ray: &Ray, other: &Ray, reach: f32) -> Option<Doubts> {
        let by = ray.direction - other.direction;
        let squared = by.x * by.x + by.y * by.y;
        if by.z <= 0.0 {
            return None;
        }
        // Slopes up to `by.z / √squared` are proven.
        let is_proven = |slope: f32| by.z * by.z >= slope * slope * squared;
        if is_proven(self.steepest) {
            return Some(Doubts::NONE);
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
            return Some(Doubts::NONE);
        }
        let (near, far) = {
            let (a, b) = (a.length(), b.length());
            (SAGITTA * a.min(b), a.max(b))
        };
        let last = self.ring(reach * far);
        let between = self.between(ray.direction, other.direction, by.z * by.z / squared);
        let mut rings = 0u64;
        for sector in sectors() {
            for (ring, field) in self.fields[sector * RINGS..][..=last].iter().enumerate() {
                rings |= u64::from(between.is_doubtful(field)) << ring;
            }
        }
        Some(Doubts { rings, first: self.nearest_m / far * 0.999, last: self.nearest_m / near * 1.001 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn turns_grow_with_the_angle() {
        let turns: Vec<f32> =
            (0..720).map(|n| turn(Vec2::from_angle((0.5 * n as f32 + 0.1).to_radians()) * 7.0)).collect();
        assert!(turns.is_sorted() && turns[0] >= 0.0 && turns[719] <= SECTORS as f32, "{turns:?}");
    }

    fn table(low: Vec2, high: Vec2, slope: f32) -> Steepness {
        let mut table = Steepness {
            fields: vec![Field { slope: 0.5, tangent: f32::NEG_INFINITY }; SECTORS * RINGS],
            gentle: 0.5,
            steepest_of: vec![0.5; SECTORS],
            steepest: 0.5,
            nearest_m: 4.0,
        };
        table.enter(low, high, slope, f32::INFINITY);
        table
    }

    proptest! {
        #[test]
        fn a_steep_rectangle_is_in_doubt_wherever_a_way_between_rays_crosses_it(
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
            let Some(doubts) = table.doubts(&rays[0], &rays[1], reach) else { return Ok(()) };
            let doubts: Vec<_> = doubts.collect();
            for k in 0..2000 {
                let s = k as f32;
                let crosses = (0..=8).any(|n| {
                    let p = at.lerp(other, n as f32 / 8.0) * s;
                    p.cmpge(low).all() && p.cmple(high).all()
                });
                let is_doubted = doubts.iter().any(|[from, to]| (*from..=*to).contains(&s));
                prop_assert!(!crosses || is_doubted, "{s} {doubts:?}");
            }
        }
    }

    #[test]
    fn without_steep_ground_in_the_way_there_is_no_doubt() {
        let table = table(Vec2::new(100.0, -5.0), Vec2::new(110.0, 5.0), 9.0);
        let rays = |angle: f32| {
            let at = Vec2::from_angle(angle);
            [at.extend(-0.49), (at * 1.01).extend(-0.5)].map(|direction: Vec3| Ray { direction, depth: 1.0 })
        };
        let [ray, below] = rays(1.0);
        assert_eq!(table.doubts(&ray, &below, 500.0).unwrap().count(), 0);
        let [ray, below] = rays(0.0);
        let doubts: Vec<_> = table.doubts(&ray, &below, 500.0).unwrap().collect();
        assert!(
            doubts.len() == 1 && doubts[0][0] < 100.0 && doubts[0][1] > 110.0 && doubts[0][1] < 160.0,
            "{doubts:?}"
        );
        assert_eq!(table.doubts(&ray, &below, 40.0).unwrap().count(), 0, "it is not reached");
        assert!(table.doubts(&below, &ray, 40.0).is_none(), "not above");
    }
}
