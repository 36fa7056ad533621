//! How an exact ray crosses a tile: from above through the pyramid of maxima, from below cell by
//! cell.

use super::entered::{Along, Entered, Hit};
use crate::model::Ground;
use crate::scene::exit;
use glam::Vec2;

/// How a ray crossed a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Crossing {
    /// It hit the ground, or left it from below.
    Hit(Hit),
    /// It left, or reached its limit, at this parameter.
    Left(f32),
}

/// The cell, or block of `2^level` cells a side, that a ray is in.
#[derive(Debug, Clone, Copy)]
struct Block {
    level: u32,
    at: [u32; 2],
}

impl Block {
    /// Descends into the quarter that contains a point. `cells`: those of the tile.
    #[inline(always)]
    fn descend(&mut self, point: Vec2, cells: [u32; 2], low: Vec2, side: f32) {
        self.level -= 1;
        let half = 0.5 * side;
        for axis in 0..2 {
            let last = (cells[axis] - 1) >> self.level;
            self.at[axis] = (2 * self.at[axis] + u32::from(point[axis] >= low[axis] + half)).min(last);
        }
    }

    /// Moves to the next block along an axis, and up a level (at most to `most`) when it enters
    /// another block of the coarser level. Returns whether there is a next block.
    #[inline(always)]
    fn advance(&mut self, axis: usize, is_up: bool, cells: [u32; 2], most: u32) -> bool {
        let before = self.at[axis] >> 1;
        if is_up {
            self.at[axis] += 1;
            if self.at[axis] > (cells[axis] - 1) >> self.level {
                return false;
            }
        } else if self.at[axis] == 0 {
            return false;
        } else {
            self.at[axis] -= 1;
        }
        if self.at[axis] >> 1 != before && self.level < most {
            self.level += 1;
            self.at = [self.at[0] >> 1, self.at[1] >> 1];
        }
        true
    }
}

impl Entered<'_> {
    /// Follows the ray from `from` until it hits, leaves, or is past `until`.
    pub(crate) fn cross(&self, along: &Along, from: f32, until: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(along.per_s, -self.at_0, size - self.at_0).min(until).max(from);
        let most = cells[0].max(cells[1]).next_power_of_two().ilog2();
        let start = self.at(along, from).clamp(Vec2::ZERO, size);
        let per_s_reciprocal = along.per_s.recip();
        let is_east = along.per_s.x > 0.0;
        let is_north = along.per_s.y > 0.0;
        let height = |s: f32| along.rise * s + self.eye_height;
        let mut block =
            Block { level: 0, at: [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)] };
        let mut s = from;
        loop {
            *samples += 1;
            let side = (1u32 << block.level) as f32;
            let low = Vec2::new(block.at[0] as f32, block.at[1] as f32) * side;
            let leave = |axis: usize, is_up: bool| {
                let border = if is_up { low[axis] + side } else { low[axis] };
                if along.per_s[axis] == 0.0 {
                    f32::INFINITY
                } else {
                    (border - self.at_0[axis]) * per_s_reciprocal[axis]
                }
            };
            let leaves = [leave(0, is_east), leave(1, is_north)];
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let lowest = height(s).min(height(out));
            if block.level == 0 {
                let corners = self.corners(block.at);
                let highest = corners[0].max(corners[1]).max(corners[2].max(corners[3]));
                if lowest <= highest
                    && let Some(hit) = self.root::<false>(along, corners, low, [s, out])
                {
                    return Crossing::Hit(hit);
                }
            } else if lowest <= Ground::block_maximum(self.tile, self.maxima, block.level, block.at) {
                block.descend(self.at(along, s), cells, low, side);
                continue;
            }
            s = out;
            let axis = usize::from(leaves[1] < leaves[0]);
            if s >= end || !block.advance(axis, along.per_s[axis] > 0.0, cells, most) {
                return Crossing::Left(end);
            }
        }
    }

    /// Follows a ray that is below the ground from `from` until it leaves the ground or the tile,
    /// or is past `until`.
    pub(crate) fn emerge(&self, along: &Along, from: f32, until: f32, samples: &mut u64) -> Crossing {
        let cells = self.tile.cells;
        let size = Vec2::new(cells[0] as f32, cells[1] as f32);
        let end = exit(along.per_s, -self.at_0, size - self.at_0).min(until).max(from);
        let highest = |from: f32, to: f32| (along.rise * from).max(along.rise * to) + self.eye_height;
        if highest(from, end) < self.tile.lowest_m {
            return Crossing::Left(end);
        }
        let start = self.at(along, from).clamp(Vec2::ZERO, size);
        let mut at = [(start.x as u32).min(cells[0] - 1), (start.y as u32).min(cells[1] - 1)];
        let mut s = from;
        loop {
            *samples += 1;
            let low = Vec2::new(at[0] as f32, at[1] as f32);
            let leaves = [0, 1].map(|axis| match along.per_s[axis] {
                d if d > 0.0 => (low[axis] + 1.0 - self.at_0[axis]) / d,
                d if d < 0.0 => (low[axis] - self.at_0[axis]) / d,
                _ => f32::INFINITY,
            });
            let out = leaves[0].min(leaves[1]).min(end).max(s);
            let corners = self.corners(at);
            if highest(s, out) >= corners.into_iter().fold(f32::INFINITY, f32::min)
                && let Some(hit) = self.root::<true>(along, corners, low, [s, out])
            {
                return Crossing::Hit(hit);
            }
            s = out;
            let axis = usize::from(leaves[1] < leaves[0]);
            let next = if along.per_s[axis] > 0.0 { at[axis].checked_add(1) } else { at[axis].checked_sub(1) };
            match next.filter(|next| s < end && *next < cells[axis]) {
                Some(next) => at[axis] = next,
                None => return Crossing::Left(end),
            }
        }
    }
}
