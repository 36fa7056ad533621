//! Pixels of a line whose rays lie in one plane, and how far the ground below them may be followed.

use super::highest::HighestSeen;
use crate::proof::Steepness;
use crate::scene::Scene;
use crate::shade::strip::Strip;
use glam::Vec2;

/// Pixels for which the steepness of the ground is looked up together: the pixels of a run
/// ([`Strip`]), half of those that the painter takes together. (Measured; see `docs/techniques.md`,
/// *Thresholds*.)
pub(crate) const CHUNK: usize = 16;
/// The ground is followed for at least this many pixels above each other. For fewer, casting their
/// rays costs less than looking up how steep the ground is. (Measured; see `docs/techniques.md`,
/// *Thresholds*.)
const FEWEST: usize = 3;
/// The distance up to which the ground is followed is reduced by a thousandth, for rounding.
const SHORTER: f32 = 0.999;

/// A line whose pixels are being found.
#[derive(Debug)]
pub(crate) struct Target<'a> {
    /// Its pixels.
    pub(crate) strip: Strip<'a>,
    /// For each chunk of pixels two rectangles of ground that earlier lines have looked up.
    pub(crate) seen: &'a mut [HighestSeen],
}

/// Pixels of a strip whose rays lie in one plane, and the projection of posts into that plane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Column<'a> {
    slopes: &'a Steepness,
    /// The pixels.
    begin: usize,
    pub(super) last: usize,
    /// Whether they are in one row, instead of one column.
    pub(super) is_row: bool,
    /// Column (or row) of all of them; row (or column) of pixel number 0, and its change from
    /// number to number: 1 or -1.
    pub(super) fixed: f32,
    pub(super) first: f32,
    pub(super) sign: f32,
    /// Position of pixel number 0 in the picture, and its change from number to number.
    origin: Vec2,
    step: Vec2,
    /// s per depth at pixel number 0, and its change from number to number.
    guide: [f32; 2],
    pub(super) chunk: Chunk,
}

/// Pixels for which the ground is known to keep below the slope that they allow, up to some
/// distance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chunk {
    /// Index of the chunk; `None` at first.
    index: Option<usize>,
    /// The lowest pixel to which the cut may fall.
    pub(super) lowest: f32,
    /// Distance, metres, divided by the largest number of metres per s of a ray.
    pub(super) followed_until_s: f32,
}

impl<'a> Column<'a> {
    /// The pixels from `k` on that are in one column or row; `None` when there are too few.
    pub(crate) fn new(scene: &Scene<'_>, slopes: &'a Steepness, strip: &Strip<'_>, k: usize) -> Option<Self> {
        let pixels = strip.pixels;
        let ([x, y], [next_x, next_y]) = (*pixels.get(k)?, *pixels.get(k + FEWEST - 1)?);
        let minor = match (x == next_x, y == next_y) {
            (true, false) => 0,
            (false, true) => 1,
            _ => return None,
        };
        let fixed = pixels[k][minor];
        let last = if pixels[pixels.len() - 1][minor] == fixed {
            pixels.len() - 1
        } else {
            k + pixels[k..].iter().take_while(|pixel| pixel[minor] == fixed).count() - 1
        };
        let major = 1 - minor;
        let sign = if pixels[k + 1][major] > pixels[k][major] { 1.0f32 } else { -1.0 };
        let first = f32::from(pixels[k][major]) - sign * k as f32;
        let (mut origin, mut step) = (Vec2::ZERO, Vec2::ZERO);
        (origin[major], origin[minor], step[major]) = (first, f32::from(fixed), sign);
        let guide = scene.view.guide();
        let at_0 = scene.view.direction_at(origin.x, origin.y).dot(guide);
        let [per_column, per_row] = scene.view.steps();
        let per_pixel = (per_column * step.x + per_row * step.y).dot(guide);
        Some(Self {
            slopes,
            begin: k,
            last,
            is_row: minor == 1,
            fixed: f32::from(fixed),
            first,
            sign,
            origin,
            step,
            guide: [at_0, per_pixel],
            chunk: Chunk { index: None, lowest: 0.0, followed_until_s: 0.0 },
        })
    }

    /// Whether it contains pixel `k`.
    #[inline(always)]
    pub(crate) fn holds(&self, k: usize) -> bool {
        (self.begin..=self.last).contains(&k)
    }

    /// s per depth of a pixel.
    #[inline(always)]
    pub(super) fn s_per_depth(&self, k: f32) -> f32 {
        self.guide[0] + self.guide[1] * k
    }

    /// Computes the chunk of pixel `k`, unless it is the current one.
    #[inline(always)]
    pub(super) fn enter_chunk(&mut self, scene: &Scene<'_>, k: usize, seen: &mut [HighestSeen]) {
        if self.chunk.index != Some(k / CHUNK) {
            self.chunk = self.chunk_of(scene, k / CHUNK, seen);
        }
    }

    #[inline(never)]
    fn chunk_of(&self, scene: &Scene<'_>, index: usize, seen: &mut [HighestSeen]) -> Chunk {
        let lowest = (index * CHUNK).saturating_sub(CHUNK) as f32;
        let highest = ((index + 1) * CHUNK).min(self.last + 1) as f32;
        let unknown = Chunk { index: Some(index), lowest, followed_until_s: 0.0 };
        let ray = |k: f32| {
            let at = self.origin + self.step * k;
            scene.view.ray_along(at.x, at.y)
        };
        let (Some(low), Some(high)) = (ray(lowest), ray(highest)) else { return unknown };
        let by = high.direction - low.direction;
        if by.z <= 0.0 {
            return unknown;
        }
        let (a, b) = (low.direction.truncate(), high.direction.truncate());
        let limit = by.z * by.z / by.truncate().length_squared();
        if !scene.is_entered_above([&low, &high], &mut seen[2 * index]) {
            return unknown;
        }
        let until_m = self.slopes.below_slope_until(low.direction, high.direction, limit);
        Chunk { followed_until_s: SHORTER * until_m / a.length().max(b.length()), ..unknown }
    }
}
