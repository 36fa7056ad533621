//! Holes, and ground that was filled (`terravision_common::validity`): a pass over the pixels once
//! all rays have been cast.
//!
//! All methods cast their rays at the whole surface, as if it had no holes. So what they prove
//! about the air above it stays true, and worlds without holes need no extra work. Then each ray
//! that hit a hole goes on from facet to facet: below the surface until it comes out again, or
//! above it. A point is in a hole where the share of ground, linear over its facet, is less than a
//! half, as in the mesh.

use super::entered::{LEAST_BELOW, LEAST_BELOW_M};
use super::walk::{Side, past};
use crate::counts::Counts;
use crate::scene::Place;
use crate::shade::Canvas;
use crate::view::Ray;
use crate::workers::Workers;
use glam::Vec2;
use std::sync::atomic::{AtomicUsize, Ordering};
use terravision_common::surface::facet::{facet_slope, is_south_east};
use terravision_common::validity::HALF;

/// A ray passes through no more holes. A bound on the loop that holds whatever rounding does.
pub(crate) const MOST_HOLES: u32 = 1 << 10;
/// Factor on the way to the border, so that the point is still over ground.
pub(crate) const WITHIN: f32 = 1.0 - 8.0 * f32::EPSILON;
/// The bit of a colour's alpha that is cleared where the ground was filled.
pub(crate) const MARK: u32 = 1 << 24;

/// The surface at the point that a ray hit.
#[derive(Debug, Clone, Copy)]
struct Met {
    tile: u32,
    /// Share of ground.
    ground: f32,
    /// Share of measured ground.
    measured: f32,
    /// On which side of the facet the ray goes on.
    beyond: Side,
}

impl Canvas<'_> {
    /// Continues the rays that hit a hole, and marks pixels whose ground was filled.
    pub(crate) fn look_at_shares(&self, workers: &Workers) {
        let rows = self.picture.size()[1] as usize;
        let next = AtomicUsize::new(0);
        workers.run(|_| {
            let mut counts = Counts::default();
            // Relaxed: the result does not depend on which worker takes a row.
            while let Some(row) = Some(next.fetch_add(1, Ordering::Relaxed)).filter(|row| *row < rows) {
                self.look_at_row(row, &mut counts);
            }
            counts
        });
    }

    fn look_at_row(&self, row: usize, counts: &mut Counts) {
        for ((color, depth), x) in self.picture.row(row).zip(0u32..) {
            if !depth.is_finite() {
                continue;
            }
            let pixel = [x, row as u32];
            let ray = self.scene.view.ray(pixel);
            // Between two planes of a sweep a point may lie a little beyond the border: what is there
            // is what is at the border.
            let s = (depth / ray.depth).min(self.scene.departure(&ray) * WITHIN);
            let Some(met) = self.met(&ray, s) else { continue };
            let mark = |met: &Met| if met.measured < HALF { MARK } else { 0 };
            if met.ground >= HALF {
                if mark(&met) != 0 {
                    self.picture.put(pixel, color & !MARK, depth);
                }
                continue;
            }
            match self.beyond_hole(&ray, s, met, counts) {
                Some((s, met)) => {
                    let color = self.shade(met.tile, &ray, s) & !mark(&met);
                    self.picture.put(pixel, color, s * ray.depth);
                }
                None => self.put_sky(pixel),
            }
        }
    }

    /// Where a ray that passes through a hole hits ground, if it does.
    fn beyond_hole(&self, ray: &Ray, mut s: f32, mut met: Met, counts: &mut Counts) -> Option<(f32, Met)> {
        let border = self.scene.departure(ray);
        for _ in 0..MOST_HOLES {
            let mut current = self.scene.enter(met.tile)?;
            s = self.scene.next_hit(ray, met.beyond, [past(s), border], &mut current, counts)?.s;
            met = self.met_in(current.index, ray, s)?;
            if met.ground >= HALF {
                return Some((s, met));
            }
        }
        None
    }

    fn met(&self, ray: &Ray, s: f32) -> Option<Met> {
        match self.scene.find(ray, s) {
            Place::Tile(tile) => self.met_in(tile, ray, s),
            Place::HoleUntil(_) | Place::Left => None,
        }
    }

    /// The surface of this tile where a ray crosses it at `s`.
    fn met_in(&self, tile: u32, ray: &Ray, s: f32) -> Option<Met> {
        let current = self.scene.enter(tile)?;
        let along = current.along(ray);
        let [columns, rows] = current.tile.cells;
        let at = current.at(&along, s).clamp(Vec2::ZERO, Vec2::new(columns as f32, rows as f32));
        let cell = [(at.x as u32).min(columns - 1), (at.y as u32).min(rows - 1)];
        let by = at - Vec2::new(cell[0] as f32, cell[1] as f32);
        // Rise per cell of the facet that the point is on.
        let slope = |corners: [f32; 4]| Vec2::from_array(facet_slope(corners, is_south_east(by.x, by.y)));
        let shares = self.scene.ground.shares_of_cell(current.tile, cell);
        let share = |plane: usize| {
            let corners = shares.map(|share| share[plane]);
            corners[0] + slope(corners).dot(by)
        };
        let corners = current.corners(cell);
        let rise = slope(corners);
        let above = along.rise * s + current.eye_height - corners[0] - rise.dot(by);
        // A ray that hit voxels may still be in front of the facet, or behind it.
        let beyond = match above {
            above if above.abs() > LEAST_BELOW * s + LEAST_BELOW_M => {
                if above > 0.0 {
                    Side::Above
                } else {
                    Side::Below
                }
            }
            _ if along.rise <= rise.dot(along.per_s) => Side::Below,
            _ => Side::Above,
        };
        Some(Met { tile, ground: share(0), measured: share(1), beyond })
    }
}
