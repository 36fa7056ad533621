//! Heights of the posts of one level in a rectangle, whatever tiles they are in.
//!
//! A height depends on its post alone, not on the tile that is lit: tiles beside each other see
//! the same ground on both sides of their border.

use super::elevations::Elevations;
use std::sync::Arc;
use terravision_common::node::NodeId;
use terravision_common::world::World;

/// A rectangle of posts of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rect {
    /// Column and row of the first post, from the world's south west corner; may be negative.
    pub first: [i64; 2],
    /// Columns and rows.
    pub size: [usize; 2],
}

impl Rect {
    /// All posts from `first` to `last`, both included.
    #[must_use]
    pub fn between(first: [i64; 2], last: [i64; 2]) -> Self {
        Self { first, size: [0, 1].map(|axis| (last[axis] - first[axis] + 1).max(0) as usize) }
    }

    /// The last column and row.
    #[must_use]
    pub fn last(&self) -> [i64; 2] {
        [0, 1].map(|axis| self.first[axis] + self.size[axis] as i64 - 1)
    }

    /// The posts of the next coarser level around all of these.
    #[must_use]
    pub fn coarser(&self) -> Self {
        let last = self.last();
        Self::between(self.first.map(|at| at.div_euclid(2)), last.map(|at| (at + 1).div_euclid(2)))
    }
}

/// Numbers of the posts of a rectangle.
#[derive(Debug, Clone, Default)]
pub struct Window {
    first: [i64; 2],
    size: [usize; 2],
    /// Rows from the south.
    values: Vec<f32>,
}

impl Window {
    /// A window of a rectangle, all `value`; keeps the memory of this one.
    pub fn reset(&mut self, rect: Rect, value: f32) {
        (self.first, self.size) = (rect.first, rect.size);
        self.values.clear();
        self.values.resize(rect.size[0] * rect.size[1], value);
    }

    /// Its posts.
    #[must_use]
    pub fn rect(&self) -> Rect {
        Rect { first: self.first, size: self.size }
    }

    /// Columns from `column` on of a row, both counted from the world's corner. They must lie
    /// inside.
    #[must_use]
    pub fn row(&self, column: i64, row: i64) -> &[f32] {
        let [x, y] = self.place([column, row]);
        &self.values[y * self.size[0] + x..(y + 1) * self.size[0]]
    }

    /// Likewise.
    pub fn row_mut(&mut self, column: i64, row: i64) -> &mut [f32] {
        let [x, y] = self.place([column, row]);
        &mut self.values[y * self.size[0] + x..(y + 1) * self.size[0]]
    }

    fn place(&self, at: [i64; 2]) -> [usize; 2] {
        [0, 1].map(|axis| (at[axis] - self.first[axis]) as usize)
    }

    /// The number of a post inside.
    #[must_use]
    pub fn at(&self, [column, row]: [i64; 2]) -> f32 {
        self.row(column, row)[0]
    }

    /// Fills it with heights of a level, times `factor`, of `rect` at least. Beyond the world the height is that of its
    /// border; where a tile is missing, that of the coarser ground that is drawn there.
    pub fn read(&mut self, world: &World, tiles: &dyn Elevations, level: u8, rect: Rect, factor: f32) {
        let intervals = i64::from(world.elevation_tile());
        let end = world.extent().map(|side| u64::from(side).div_ceil(1 << level) as i64);
        // With some of the world in it: what is beyond repeats its border.
        let [first, last] = [rect.first, rect.last()];
        let rect = Rect::between([0, 1].map(|axis| first[axis].min(end[axis])), last.map(|at| at.max(0)));
        self.reset(rect, f32::NAN);
        let inside = [rect.first, rect.last()].map(|at| [0, 1].map(|axis| at[axis].clamp(0, end[axis])));
        let [first, last] = inside;
        let nodes = world.nodes_at(level).map(i64::from);
        let node_of = |at: i64, axis: usize| (at / intervals).min(nodes[axis] - 1);
        let mut is_whole = true;
        for n in node_of(first[1], 1)..=node_of(last[1], 1) {
            for m in node_of(first[0], 0)..=node_of(last[0], 0) {
                let tile = NodeId::new(m as u32, n as u32, level).and_then(|node| tiles.posts(node));
                match tile {
                    Some(tile) => self.copy(&tile, [m, n].map(|k| k * intervals), intervals, [first, last], factor),
                    None => is_whole = false,
                }
            }
        }
        if !is_whole {
            self.interpolate(world, tiles, level, Rect::between(first, last), factor);
        }
        self.extend(first, last);
    }

    /// Copies what lies between two posts out of a tile with its first post at `origin`.
    fn copy(&mut self, tile: &Arc<[f32]>, origin: [i64; 2], intervals: i64, [first, last]: [[i64; 2]; 2], factor: f32) {
        let from = [0, 1].map(|axis| first[axis].max(origin[axis]));
        let to = [0, 1].map(|axis| last[axis].min(origin[axis] + intervals));
        if from[0] > to[0] {
            return;
        }
        let count = (to[0] - from[0] + 1) as usize;
        for row in from[1]..=to[1] {
            let start = ((row - origin[1]) * (intervals + 1) + from[0] - origin[0]) as usize;
            let Some(heights) = tile.get(start..start + count) else { return };
            for (out, height) in self.row_mut(from[0], row).iter_mut().zip(heights) {
                *out = height * factor;
            }
        }
    }

    /// Fills posts of `rect` that no tile had: on the facets of the next coarser level.
    fn interpolate(&mut self, world: &World, tiles: &dyn Elevations, level: u8, rect: Rect, factor: f32) {
        let mut coarse = Self::default();
        if level < world.root().q() {
            coarse.read(world, tiles, level + 1, rect.coarser(), factor);
        } else {
            coarse.reset(rect.coarser(), 0.0);
        }
        let (first, last) = (rect.first, rect.last());
        for row in first[1]..=last[1] {
            for column in first[0]..=last[0] {
                let Some(out) = self.row_mut(column, row).first_mut().filter(|out| out.is_nan()) else { continue };
                *out = halfway(&coarse, [column, row]);
            }
        }
    }

    /// Repeats the posts between `first` and `last` beyond them.
    fn extend(&mut self, first: [i64; 2], last: [i64; 2]) {
        let Rect { first: start, size } = self.rect();
        if start == first && self.rect().last() == last {
            return;
        }
        for y in 0..size[1] as i64 {
            let row = (start[1] + y).clamp(first[1], last[1]);
            for x in 0..size[0] as i64 {
                let column = (start[0] + x).clamp(first[0], last[0]);
                if [start[0] + x, start[1] + y] != [column, row] {
                    let value = self.at([column, row]);
                    self.row_mut(start[0] + x, start[1] + y)[0] = value;
                }
            }
        }
    }
}

/// The number at a post of the next finer level than a window's, on facets that are cut from south
/// west to north east.
#[must_use]
pub fn halfway(coarse: &Window, at: [i64; 2]) -> f32 {
    let [x, y] = at.map(|at| at.div_euclid(2));
    let [dx, dy] = at.map(|at| at.rem_euclid(2));
    let a = coarse.at([x, y]);
    if dx == 0 && dy == 0 { a } else { 0.5 * (a + coarse.at([x + dx, y + dy])) }
}
