//! Which posts the sun shines on.
//!
//! A post lies in the shadow where a ray from it to the sun meets the ground. All rays are
//! parallel, so that the ray of every post of a rectangle is sampled at once: step by step along
//! the axis that is nearer to the sun's direction, between two posts across it.
//!
//! ```text
//!   level       ├──────────┤               steps 2 to 32, one post of the level each
//!   level + 1              ├──────────┤    steps 17 to 32, one post of level + 1 each
//!   level + 2                         ├───────── … up to the root's
//! ```
//!
//! What a ray meets depends on its post and its level, not on the rectangle: shadows go on across
//! the borders of tiles.

use super::elevations::Elevations;
use super::window::{Rect, Window, halfway};
use terravision_common::world::World;

/// Steps along a ray on each level.
const STEPS: i64 = 32;
/// The first one on the level that is lit. What is nearer is the ground's own slope, which its
/// normal tells.
const FIRST_STEP: i64 = 2;

/// The sun as rays are followed to it.
#[derive(Debug, Clone, Copy)]
pub struct Rays {
    /// East or north (0 or 1): the axis along which they step.
    along: usize,
    /// Towards the sun along it, -1 or 1.
    forward: i64,
    /// Posts across it a step.
    across: f64,
    /// Metres that a ray covers a step, for a spacing of one metre.
    reach: f64,
    /// Metres that a ray rises per metre.
    rise: f64,
}

impl Rays {
    /// To a sun in this direction: east, north, up. `None` when it is not above the horizon, or so
    /// high that nothing throws a shadow.
    #[must_use]
    pub fn towards([east, north, up]: [f64; 3]) -> Option<Self> {
        let level = east.hypot(north);
        if up <= 0.0 || level < 1e-6 {
            return None;
        }
        let along = usize::from(north.abs() > east.abs());
        let (main, other) = if along == 0 { (east, north) } else { (north, east) };
        Some(Self {
            along,
            forward: if main > 0.0 { 1 } else { -1 },
            across: other / main.abs(),
            reach: level / main.abs(),
            rise: up / level,
        })
    }

    /// Columns and rows of the post before the place of a step, from where a ray began, and how far
    /// behind that post it is, across.
    fn step(&self, number: i64) -> ([i64; 2], f32) {
        let across = number as f64 * self.across;
        let whole = across.floor();
        let mut offset = [self.forward * number; 2];
        offset[1 - self.along] = whole as i64;
        (offset, (across - whole) as f32)
    }
}

/// Buffers.
#[derive(Debug, Default)]
pub struct ShadowScratch {
    heights: Window,
    /// Of each level: the height up to which the ground further away throws its shadow.
    tops: Vec<Window>,
}

/// How much of the sun each post of `lit` sees, 0 to 1, into `out`; those posts have the heights
/// `heights`.
pub fn find_shadows(
    rays: &Rays,
    (world, tiles): (&World, &dyn Elevations),
    level: u8,
    (heights, factor): (&Window, f32),
    lit: Rect,
    scratch: &mut ShadowScratch,
    out: &mut Window,
) {
    let root = world.root().q();
    let levels = usize::from(root.saturating_sub(level)) + 1;
    let ShadowScratch { heights: around, tops } = scratch;
    if tops.len() < levels {
        tops.resize_with(levels, Window::default);
    }
    let mut rect = lit;
    for top in &mut tops[..levels] {
        top.reset(rect, f32::NEG_INFINITY);
        rect = rect.coarser();
    }
    for number in (0..levels).rev() {
        let (finer, coarser) = tops.split_at_mut(number + 1);
        let top = &mut finer[number];
        let at = level + number as u8;
        let first = if number == 0 { FIRST_STEP } else { STEPS / 2 + 1 };
        raise(rays, (world, tiles), at, first, factor, around, top);
        if let Some(coarser) = coarser.first().filter(|_| number + 1 < levels) {
            raise_to(top, coarser);
        }
    }
    // From full light to full shadow it is a post.
    let soft = (world.elevation_spacing_m(level) * rays.rise) as f32;
    out.reset(lit, 1.0);
    let (first, last) = (lit.first, lit.last());
    for row in first[1]..=last[1] {
        let posts = out.row_mut(first[0], row).iter_mut().zip(tops[0].row(first[0], row));
        for ((seen, top), height) in posts.zip(heights.row(first[0], row)) {
            *seen = (0.5 - (top - height) / soft).clamp(0.0, 1.0);
        }
    }
}

/// Raises tops to where the ground of a level throws its shadow, from the step `first` on.
fn raise(
    rays: &Rays,
    (world, tiles): (&World, &dyn Elevations),
    level: u8,
    first: i64,
    factor: f32,
    around: &mut Window,
    top: &mut Window,
) {
    let posts = top.rect();
    let (low, high) = (posts.first, posts.last());
    let (nearest, furthest) = (rays.step(first).0, rays.step(STEPS).0);
    let needed = Rect::between(
        [0, 1].map(|axis| low[axis] + nearest[axis].min(furthest[axis])),
        [0, 1].map(|axis| high[axis] + nearest[axis].max(furthest[axis]) + 1),
    );
    around.read(world, tiles, level, needed, factor);
    let drop = (world.elevation_spacing_m(level) * rays.reach * rays.rise) as f32;
    for row in low[1]..=high[1] {
        let tops = top.row_mut(low[0], row);
        for number in first..=STEPS {
            let ([x, y], share) = rays.step(number);
            let here = around.row(low[0] + x, row + y);
            let beside = if rays.along == 0 { around.row(low[0] + x, row + y + 1) } else { &here[1..] };
            let lower = number as f32 * drop;
            for ((top, a), b) in tops.iter_mut().zip(here).zip(beside) {
                let height = a + share * (b - a) - lower;
                *top = if height > *top { height } else { *top };
            }
        }
    }
}

/// Raises tops to those of the next coarser level.
fn raise_to(top: &mut Window, coarser: &Window) {
    let (low, high) = (top.rect().first, top.rect().last());
    for row in low[1]..=high[1] {
        for (top, column) in top.row_mut(low[0], row).iter_mut().zip(low[0]..=high[0]) {
            *top = top.max(halfway(coarser, [column, row]));
        }
    }
}
