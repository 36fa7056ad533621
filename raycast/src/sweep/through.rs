//! Pixels whose ground is a hole, or was filled, sixteen at a time.
//!
//! Whether ground is a hole goes by the pixel's own place, so that the borders of holes are as sharp
//! as those of the mesh. What is seen through it is taken from the lines beside the pixel
//! ([`super::beyond`]) where both see the same; other pixels, mostly along the borders of holes, are
//! looked at one by one ([`super::holes`]).

use super::heights::{Heights, Place};
use super::shade::{Between, LEAST_NEARNESS, NUMBERS, ONE_SURFACE, RowPlace, Seen, Shader};
use super::surface::Plane;
use crate::scene::Scene;
use terravision_common::simd::Simd;
use terravision_common::validity::HALF;

/// What is needed to look at ground that may be a hole, or may have been filled.
pub(super) struct Holes<'a> {
    heights: Heights<'a>,
    pub(super) surface: Plane<'a>,
}

impl<'a> Holes<'a> {
    pub(super) fn new(scene: &'a Scene<'a>) -> Option<Self> {
        Some(Self { heights: Heights::new(scene), surface: Plane::new(scene)? })
    }
}

/// Pixels beside each other, a bit of each.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Through {
    /// Their ground was filled.
    pub(super) filled: u32,
    /// They are still to be looked at one by one.
    pub(super) left: u32,
}

impl<S: Simd> Shader<'_, S> {
    /// Has pixels on holes see what lies beyond. `land`: a bit of each that sees ground.
    #[inline(always)]
    pub(super) fn look_through(
        &mut self,
        seen: &mut Seen<S>,
        place: &RowPlace<'_>,
        at: [u32; 2],
        land: u32,
    ) -> Through {
        let simd = self.simd;
        let mut through = Through::default();
        let Some([ground, measured]) = self.shares(seen.nearness, at, land) else { return through };
        let half = simd.floats(HALF);
        let holes = simd.bits(simd.less(ground, half)) & land;
        through.filled = simd.bits(simd.less(measured, half)) & land & !holes;
        if holes != 0 {
            let known = self.see_beyond(seen, place, holes);
            through.left = holes & !known;
            let land = simd.bits(simd.less(simd.floats(0.0), seen.nearness)) & known;
            if land != 0
                && let Some([_, measured]) = self.shares(seen.nearness, at, land)
            {
                through.filled |= simd.bits(simd.less(measured, half)) & land;
            }
        }
        through
    }

    /// Has pixels see what the lines beside them see through holes; those for which both lines see the
    /// same.
    #[inline(always)]
    fn see_beyond(&self, seen: &mut Seen<S>, place: &RowPlace<'_>, holes: u32) -> u32 {
        let simd = self.simd;
        let Some(beyond) = place.beyond else { return 0 };
        let Between { at, share, is_here } = self.between(place);
        let [here, next] = self.lines(place, &beyond.nearness, at);
        let [per_row_here, per_row_next] = self.lines(place, &beyond.per_row, at);
        let (zero, by) = (simd.floats(0.0), next - here);
        let nearest = simd.select(is_here, here, next);
        // A line that met no hole has no number there.
        let is_known = simd.at_most(here, here) & simd.at_most(next, next);
        let is_sky = simd.at_most(simd.larger(here, next), zero);
        let is_one = simd.less(simd.magnitude(by), nearest * simd.floats(ONE_SURFACE));
        let known = is_known & (is_sky | is_one) & simd.mask(holes);
        let nearness = simd.select(is_sky, zero, here + share * by);
        let per_row = simd.select(is_here, per_row_here, per_row_next);
        seen.nearness = simd.select(known, nearness, seen.nearness);
        seen.per_row = simd.select(known, per_row, seen.per_row);
        simd.bits(known)
    }

    /// Shares of ground and of measured ground of pixels that see ground; `None` where all of it was
    /// measured.
    #[inline(always)]
    fn shares(&mut self, nearness: S::Floats, [x, number]: [u32; 2], land: u32) -> Option<[S::Floats; 2]> {
        let simd = self.simd;
        let holes = self.holes.as_mut()?;
        let [corner, along, up] = self.directions;
        // Pixels that see none are as far away as others, so that they lie over the same tiles.
        let mask = simd.mask(land);
        let other = simd.floats(simd.largest(simd.select(mask, nearness, simd.floats(LEAST_NEARNESS))));
        let depth = simd.floats(1.0) / simd.select(mask, nearness, other);
        let first = corner + along * x as f32 + up * number as f32;
        let number = simd.load(&NUMBERS);
        let east = (simd.floats(first.x) + simd.floats(along.x) * number) * depth;
        let north = (simd.floats(first.y) + simd.floats(along.y) * number) * depth;
        let rise = (simd.floats(first.z) + simd.floats(along.z) * number) * depth;
        holes.heights.shares(simd, &Place { east, north, away2: east * east + north * north + rise * rise })
    }

    /// Looks at pixels of sixteen one by one. `left`: a bit of each.
    #[inline(never)]
    pub(super) fn look_at_each(&self, [x, number]: [u32; 2], mut left: u32) {
        let Some(holes) = &self.holes else { return };
        while left != 0 {
            holes.surface.look_at(self.canvas, self.pixel([x + left.trailing_zeros(), number]));
            left &= left - 1;
        }
    }

    /// Whether what a pixel sees at this nearness is a hole.
    #[inline(never)]
    pub(super) fn is_hole(&self, pixel: [u32; 2], nearness: f32) -> bool {
        self.holes.as_ref().is_some_and(|holes| nearness > 0.0 && holes.surface.is_hole(pixel, 1.0 / nearness))
    }
}
