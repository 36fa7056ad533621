//! The walk of one exact ray: skips nodes that lie wholly below it, and goes from tile to tile,
//! above the ground and below it.

use super::cross::Crossing;
use super::entered::{Entered, Hit};
use crate::counts::Counts;
use crate::model::Link;
use crate::scene::{Place, Scene, exit};
use crate::view::Ray;
use glam::{DVec2, Vec2};

/// Where a ray is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Side {
    /// Over no tile, so that neither is known.
    Outside,
    Above,
    Below,
}

/// A ray crosses fewer tiles than this. A bound on the loop that holds whatever rounding does.
const MOST_TILES: u32 = 1 << 16;

impl Scene<'_> {
    /// Where a ray hits the ground, from `from` on and before `until`. From its `entry` into the
    /// ground's bounds up to `from` it is known to be in the air. `current` is the tile in which it
    /// is likely to be, and afterwards the tile that it hit.
    pub(crate) fn first_hit<'f>(
        &'f self,
        ray: &Ray,
        entry: f32,
        [from, until]: [f32; 2],
        current: &mut Entered<'f>,
        counts: &mut Counts,
    ) -> Option<Hit> {
        let side = if from <= entry { Side::Outside } else { Side::Above };
        self.next_hit(ray, side, [from, until], current, counts)
    }

    /// The same, when it is known on which side of the ground the ray is.
    pub(crate) fn next_hit<'f>(
        &'f self,
        ray: &Ray,
        mut side: Side,
        [from, until]: [f32; 2],
        current: &mut Entered<'f>,
        counts: &mut Counts,
    ) -> Option<Hit> {
        let mut s = from;
        let mut is_here = current.is_under(&current.along(ray), s);
        for _ in 0..MOST_TILES {
            if !s.is_finite() || s >= until || ray.direction.z >= 0.0 && ray.direction.z * s > self.highest {
                return None;
            }
            if !is_here {
                match self.find(ray, s) {
                    Place::Tile(tile) if tile == current.index => {}
                    Place::Tile(tile) => *current = self.enter(tile)?,
                    Place::HoleUntil(until) => {
                        s = past(until.max(s));
                        side = Side::Outside;
                        continue;
                    }
                    Place::Left => return None,
                }
                if let Some(skip) = self.skip_nodes(ray, s) {
                    side = Side::Above;
                    s = past(skip);
                    continue;
                }
            }
            is_here = false;
            let along = current.along(ray);
            if side == Side::Outside {
                side = if current.is_below(&along, s) { Side::Below } else { Side::Above };
                counts.under += u64::from(side == Side::Below);
            }
            let crossing = match side {
                Side::Below => current.emerge(&along, s, until, &mut counts.samples),
                Side::Above | Side::Outside => current.cross(&along, s, until, &mut counts.samples),
            };
            s = match crossing {
                Crossing::Hit(hit) if side == Side::Above || self.has_undersides => return Some(hit),
                // It leaves the ground from below, and undersides are not drawn.
                Crossing::Hit(hit) => {
                    side = Side::Above;
                    past(hit.s)
                }
                Crossing::Left(out) => past(out.max(s)),
            };
        }
        None
    }

    /// What a ray sees that enters the ground's bounds lower than its edge: a tile and a parameter,
    /// or sky. The outer `None`: it does not enter so.
    pub(crate) fn seen_from_below(&self, ray: &Ray, counts: &mut Counts) -> Option<Option<(u32, f32)>> {
        let (entry, border) = (self.entry(ray), self.departure(ray));
        let mut s = entry;
        for _ in 0..MOST_TILES {
            match self.find(ray, s) {
                Place::Tile(tile) => {
                    let mut current = self.enter(tile)?;
                    if !current.is_below(&current.along(ray), s) {
                        return None;
                    }
                    let hit = self.first_hit(ray, s, [s, border], &mut current, counts);
                    return Some(hit.map(|hit| (current.index, hit.s)));
                }
                Place::HoleUntil(until) if until < border => s = past(until.max(s)),
                Place::HoleUntil(_) | Place::Left => return None,
            }
        }
        None
    }

    /// Descends the tree at a point of a ray. Returns where the ray leaves the largest node that it
    /// passes above, if there is one.
    #[inline]
    pub(crate) fn skip_nodes(&self, ray: &Ray, s: f32) -> Option<f32> {
        let tree = self.ground.tree();
        let (surface, eye) = (&self.ground.shape().surface, self.view.eye_in_world());
        let at = surface.lattice_of_way((ray.direction * s).truncate().as_dvec2(), eye);
        let size = (1u64 << (tree.log_side() + tree.root_level())) as f64;
        let point = [at.x, at.y].map(|v| v.clamp(0.0, size - 1.0) as u32);
        let direction = ray.direction.truncate();
        let mut log = tree.log_side() + tree.root_level();
        let mut link = tree.root();
        loop {
            let highest = match link {
                Link::Empty => return None,
                Link::Tile(tile) => self.ground.tiles()[tile as usize].top_m,
                Link::Node(node) => tree.node(node).highest_m,
            };
            let low = DVec2::from_array(point.map(|at| f64::from((at >> log) << log)));
            let low = surface.lattice_from_eye(low, eye).as_vec2();
            let side = ((1u64 << log) as f64 * surface.unit_m()) as f32;
            let out = exit(direction, low, low + Vec2::splat(side)).max(s);
            let lowest = self.eye_height + (ray.direction.z * s).min(ray.direction.z * out);
            if lowest > highest {
                return Some(out);
            }
            let Link::Node(node) = link else { return None };
            log -= 1;
            link = tree.child(node, point, log);
        }
    }

    /// A tile, ready for exact rays.
    #[inline]
    pub(crate) fn enter(&self, index: u32) -> Option<Entered<'_>> {
        let tile = self.ground.tiles().get(index as usize)?;
        let placed = self.placed.get(index as usize)?;
        Some(Entered {
            index,
            tile,
            heights: self.ground.heights(tile),
            maxima: self.ground.maxima(tile),
            per_m: placed.per_m,
            at_0: -placed.corner.truncate() * placed.per_m,
            eye_height: self.eye_height,
        })
    }
}

/// A parameter a few units in the last place further: a point on a border belongs to the cell
/// behind it.
#[inline(always)]
pub(crate) fn past(s: f32) -> f32 {
    s + s.abs() * 2e-6 + 1e-6
}
