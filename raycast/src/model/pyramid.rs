//! The elevation pyramid of a frame, in place: the tiles of its elevation leaves and of all nodes
//! above them, where they lie in their pool.
//!
//! ```text
//! away from the eye, metres²        levels of the surface there
//!   below d²(q + 0.6)               q
//!   from there to d²(q + 1)         q, blended into q + 1
//!   from d²(q + 1)                  q + 1, and so on;  d(q): where posts of level q are a given number of pixels apart
//! ```
//!
//! The ground of a point is a function of the point and of its distance from the eye alone, so that
//! nothing pops and leaves of different levels meet, as long as leaves are as fine as distances
//! want them. Where tiles are missing a leaf is drawn by its own level: it meets finer neighbors
//! with a step.

mod sample;

use super::spec::GroundError;
use terravision_common::surface::Plane;
use terravision_common::validity::{HALF, PLANES};

/// From this share of a level on it is blended into the next one.
const BLEND_FROM: f32 = 0.6;
/// No node.
const NONE: u32 = u32::MAX;
/// Cells along a side of the smallest blocks whose highest posts are kept.
const LEAST_BLOCK: u32 = 4;
/// A rectangle is covered by at most this many blocks a side, and one.
const BLOCKS_A_SIDE: u32 = 4;

/// An elevation tile of a frame, in a slot of the elevation pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PoolTile {
    /// Lower left corner of its node, lattice units.
    pub origin: [u32; 2],
    /// Level of its node.
    pub level: u8,
    /// Its slot.
    pub slot: u32,
    /// How often that slot was filled: another number is another tile.
    pub generation: u32,
}

/// How the elevation pool holds its tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoolShape {
    /// Slots.
    pub slots: u32,
    /// Numbers from the beginning of a slot to that of the next.
    pub stride: u32,
    /// Factor on all heights, positive.
    pub exaggeration: f32,
    /// Whether tiles have planes of validity behind their heights.
    pub has_validity: bool,
}

/// Squares of the distances from the eye from which on each level is fine enough, metres².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LevelDistances([f32; Self::MOST]);

impl LevelDistances {
    const MOST: usize = 32;

    /// For posts at most `post_px` pixels apart, on a picture plane `focal_px` pixels from the eye.
    pub(crate) fn new(surface: &Plane, focal_px: f32, post_px: f32) -> Self {
        let finest = surface.unit_m() as f32 * focal_px / post_px;
        let mut squares = [f32::INFINITY; Self::MOST];
        for (square, level) in squares.iter_mut().zip(0i32..) {
            let distance = finest * (level as f32).exp2();
            *square = distance * distance;
        }
        Self(squares)
    }

    /// From where on a level is fine enough.
    fn of(&self, level: u8) -> f32 {
        self.0.get(usize::from(level)).copied().unwrap_or(f32::INFINITY)
    }

    /// The coarsest level that is fine enough, and the one that it may be blended into.
    pub(crate) fn coarsest(&self, away2: f32) -> u8 {
        self.0.iter().skip(1).filter(|from| **from <= away2).count() as u8 + 1
    }
}

/// A node with a tile.
#[derive(Debug, Clone, Copy)]
struct Node {
    origin: [u32; 2],
    level: u8,
    slot: u32,
    parent: u32,
    children: [u32; 4],
    /// Its highest post, and the highest of it and of all nodes below it, metres, not exaggerated.
    top_m: f32,
    below_m: f32,
}

/// What is known of a pool slot's tile.
#[derive(Debug, Clone, Copy)]
struct Kept {
    generation: u32,
    range_m: [f32; 2],
    /// Whether it has posts that are not ground, or were not measured.
    is_partly_unmeasured: bool,
}

/// Where the ground of a point is taken from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Source {
    /// A tile.
    Tile(TileSource),
    /// Nothing, in a square of `1 << log` lattice units, for points nearer than `until2`, metres².
    Hole { corner: [u32; 2], log: u32, until2: f32 },
}

/// A tile, and the one above it, into which it is blended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TileSource {
    /// Lower left corner, lattice units, and level.
    pub(crate) origin: [u32; 2],
    pub(crate) level: u8,
    /// Where its posts begin in the pool.
    pub(crate) first: u32,
    /// For which distances, metres².
    pub(crate) from2: f32,
    pub(crate) until2: f32,
    /// From where on it is blended into the next level.
    pub(crate) blend_from2: f32,
    /// Where the next level's posts begin, and the tile's corner in it, cells. Without a next level
    /// the tile itself.
    pub(crate) next_first: u32,
    pub(crate) next_corner: [f32; 2],
}

/// The tiles of a frame. Memory is used again; what was found out about a tile is kept while it
/// stays in its slot.
#[derive(Debug)]
pub(crate) struct Pyramid {
    shape: PoolShape,
    surface: Plane,
    levels: u8,
    nodes: Vec<Node>,
    /// Of each slot.
    kept: Vec<Kept>,
    /// Of each slot the highest posts of blocks, the smallest first.
    maxima: Vec<f32>,
    /// Cells along a side of the smallest blocks, and maxima of a tile.
    least_block: u32,
    blocks: usize,
}

impl Pyramid {
    pub(super) fn new(shape: PoolShape, surface: Plane, levels: u8) -> Self {
        let cells = surface.cells();
        let least_block = LEAST_BLOCK.min(cells);
        let sides = std::iter::successors(Some(cells / least_block), |side| Some(side / 2).filter(|side| *side > 0));
        let blocks = sides.map(|side| side as usize * side as usize).sum();
        Self {
            shape,
            surface,
            levels,
            nodes: Vec::with_capacity(4096),
            kept: vec![Kept { generation: 0, range_m: [0.0; 2], is_partly_unmeasured: false }; shape.slots as usize],
            // Zeros are memory that the system has not given yet: only slots that are used take any.
            maxima: vec![0.0; shape.slots as usize * blocks],
            least_block,
            blocks,
        }
    }

    pub(super) fn clear(&mut self) {
        self.nodes.clear();
    }

    /// Adds a tile, whose parent has been added before; the first one is the root's. `heights`: the
    /// whole pool.
    pub(super) fn add(&mut self, tile: &PoolTile, heights: &[f32]) -> Result<(), GroundError> {
        let PoolTile { origin, level, slot, generation } = *tile;
        let posts = (self.surface.cells() as usize + 1).pow(2);
        let first = slot as usize * self.shape.stride as usize;
        let planes = if self.shape.has_validity { PLANES } else { 1 };
        let numbers = heights.get(first..).and_then(|rest| rest.get(..planes * posts));
        let (Some(numbers), true) = (numbers, slot < self.shape.slots) else {
            return Err(GroundError::Cells { cells: [self.surface.cells(); 2], heights: heights.len() });
        };
        let (posts, shares) = numbers.split_at(posts);
        let parent = self.parent_of(origin, level)?;
        if self.kept[slot as usize].generation != generation || generation == 0 {
            let range_m = self.keep(slot as usize, posts);
            let range_m = range_m.ok_or_else(|| {
                let index = posts.iter().position(|height| !height.is_finite()).unwrap_or_default();
                GroundError::Height { origin, index }
            })?;
            let is_partly_unmeasured = shares.iter().any(|share| *share < HALF);
            self.kept[slot as usize] = Kept { generation, range_m, is_partly_unmeasured };
        }
        let index = self.nodes.len() as u32;
        if let Some((parent, child)) = parent {
            self.nodes[parent as usize].children[child] = index;
        }
        let top_m = self.kept[slot as usize].range_m[1];
        let parent = parent.map_or(NONE, |(parent, _)| parent);
        self.nodes.push(Node { origin, level, slot, parent, children: [NONE; 4], top_m, below_m: top_m });
        Ok(())
    }

    /// The node above a new one, and which of its children that is; `None` for the root.
    fn parent_of(&self, origin: [u32; 2], level: u8) -> Result<Option<(u32, usize)>, GroundError> {
        let levels = self.levels;
        let log = |level: u8| self.surface.cells().ilog2() + u32::from(level);
        let is_place = level < levels
            && log(levels - 1) < 32
            && origin.iter().all(|v| v % (1 << log(level)) == 0 && u64::from(*v) < 1 << log(levels - 1));
        if !is_place {
            return Err(GroundError::Place { origin, level, levels });
        }
        if level + 1 == levels {
            return if self.nodes.is_empty() { Ok(None) } else { Err(GroundError::Occupied { origin }) };
        }
        let unattached = GroundError::Unattached { origin, level };
        let mut at = 0u32;
        loop {
            let node = self.nodes.get(at as usize).ok_or(unattached)?;
            let child = child_at(origin, log(node.level) - 1);
            if node.level == level + 1 {
                let is_free = node.children[child] == NONE;
                return if is_free { Ok(Some((at, child))) } else { Err(GroundError::Occupied { origin }) };
            }
            at = node.children[child];
        }
    }

    /// Makes the maxima of a slot's tile; its lowest and highest post, unless one is NaN or
    /// infinite.
    fn keep(&mut self, slot: usize, posts: &[f32]) -> Option<[f32; 2]> {
        let (cells, block) = (self.surface.cells() as usize, self.least_block as usize);
        let stride = cells + 1;
        let maxima = &mut self.maxima[slot * self.blocks..][..self.blocks];
        let mut side = cells / block;
        let (mut low, mut is_finite) = (f32::INFINITY, true);
        for row in 0..side {
            for column in 0..side {
                let mut highest = f32::NEG_INFINITY;
                for posts in posts[row * block * stride..].chunks(stride).take(block + 1) {
                    for post in &posts[column * block..=(column + 1) * block] {
                        highest = highest.max(*post);
                        low = low.min(*post);
                        is_finite &= post.is_finite();
                    }
                }
                maxima[row * side + column] = highest;
            }
        }
        let mut finer = 0;
        while side > 1 {
            let coarser = finer + side * side;
            for row in 0..side / 2 {
                for column in 0..side / 2 {
                    let at = |by: usize| maxima[finer + (2 * row + by / 2) * side + 2 * column + by % 2];
                    maxima[coarser + row * (side / 2) + column] = at(0).max(at(1)).max(at(2)).max(at(3));
                }
            }
            finer = coarser;
            side /= 2;
        }
        is_finite.then_some([low, maxima[finer]])
    }

    /// To be called when all tiles have been added; their lowest and highest post, metres,
    /// exaggerated.
    pub(super) fn finish(&mut self) -> [f32; 2] {
        let mut range = [f32::INFINITY, f32::NEG_INFINITY];
        for index in (0..self.nodes.len()).rev() {
            let Node { parent, slot, below_m, .. } = self.nodes[index];
            if let Some(parent) = self.nodes.get_mut(parent as usize) {
                parent.below_m = parent.below_m.max(below_m);
            }
            let [low, high] = self.kept[slot as usize].range_m;
            range = [range[0].min(low), range[1].max(high)];
        }
        range.map(|height| height * self.shape.exaggeration)
    }

    /// Whether some of its tiles' ground may be a hole, or may have been filled.
    pub(super) fn has_unmeasured(&self) -> bool {
        self.nodes.iter().any(|node| self.kept[node.slot as usize].is_partly_unmeasured)
    }

    /// What is known of a source's tile, and of the one that it is blended into.
    fn kept_of(&self, source: &TileSource) -> [Kept; 2] {
        [source.first, source.next_first].map(|first| {
            let slot = (first / self.shape.stride.max(1)) as usize;
            self.kept.get(slot).copied().unwrap_or(Kept {
                generation: 0,
                range_m: [f32::NEG_INFINITY, f32::INFINITY],
                is_partly_unmeasured: true,
            })
        })
    }

    /// Where the root's posts begin in the pool; 0 without a root.
    pub(crate) fn first_of_root(&self) -> u32 {
        self.nodes.first().map_or(0, |root| root.slot.wrapping_mul(self.shape.stride))
    }

    /// Whether its tiles have planes of validity.
    pub(crate) fn has_validity(&self) -> bool {
        self.shape.has_validity
    }

    /// Factor on all heights.
    pub(crate) fn exaggeration(&self) -> f32 {
        self.shape.exaggeration
    }

    /// Where the ground of a point, lattice units, is taken from, whose distance from the eye has
    /// this square. A point outside of the root is taken to its border.
    pub(crate) fn find(&self, point: [f64; 2], away2: f32, distances: &LevelDistances) -> Source {
        let point = point.map(|v| v as u32);
        let log_cells = self.surface.cells().ilog2();
        let Some(mut node) = self.nodes.first() else {
            return Source::Hole { corner: [0; 2], log: 31, until2: f32::INFINITY };
        };
        loop {
            let is_fine = away2 >= distances.of(node.level);
            if is_fine || node.children == [NONE; 4] {
                return Source::Tile(self.source(node, distances));
            }
            let log = log_cells + u32::from(node.level) - 1;
            match self.nodes.get(node.children[child_at(point, log)] as usize) {
                Some(child) => node = child,
                None => {
                    let corner = point.map(|v| (v >> log) << log);
                    return Source::Hole { corner, log, until2: distances.of(node.level) };
                }
            }
        }
    }

    fn source(&self, node: &Node, distances: &LevelDistances) -> TileSource {
        let stride = self.shape.stride;
        let first = node.slot.wrapping_mul(stride);
        let own = distances.of(node.level);
        let mut source = TileSource {
            origin: node.origin,
            level: node.level,
            first,
            from2: if node.children == [NONE; 4] { f32::NEG_INFINITY } else { own },
            until2: f32::INFINITY,
            blend_from2: f32::MAX,
            next_first: first,
            next_corner: [0.0; 2],
        };
        if let Some(next) = self.nodes.get(node.parent as usize) {
            source.until2 = distances.of(next.level);
            source.blend_from2 = own * (2.0 * BLEND_FROM).exp2();
            source.next_first = next.slot.wrapping_mul(stride);
            source.next_corner = [0, 1].map(|axis| ((node.origin[axis] - next.origin[axis]) >> next.level) as f32);
        }
        source
    }

    /// The facet of the finest tile at a point, lattice units: rise per cell east and north, and
    /// the level whose cell it is. `heights`: the whole pool.
    pub(crate) fn corners_at(&self, point: [f64; 2], heights: &[f32]) -> Option<([f32; 4], [f32; 2], u8)> {
        let Source::Tile(TileSource { origin, level, first, .. }) =
            self.find(point, f32::NEG_INFINITY, &LevelDistances([f32::INFINITY; LevelDistances::MOST]))
        else {
            return None;
        };
        let cells = self.surface.cells();
        let at = [0, 1].map(|axis| {
            let cell = (point[axis] - f64::from(origin[axis])) / f64::from(1u32 << level);
            cell.clamp(0.0, f64::from(cells)) as f32
        });
        let [i, j] = at.map(|at| (at as u32).min(cells - 1));
        let south = first as usize + (j * (cells + 1) + i) as usize;
        let pair = |at: usize| heights.get(at..at + 2).map(|pair| [pair[0], pair[1]]);
        let ([sw, se], [nw, ne]) = (pair(south)?, pair(south + cells as usize + 1)?);
        let corners = [sw, se, nw, ne].map(|height| height * self.shape.exaggeration);
        Some((corners, [at[0] - i as f32, at[1] - j as f32], level))
    }

    /// Whether ground of a rectangle, lattice units, may rise above a height, metres, whose points
    /// have such distances from the eye, squared.
    pub(crate) fn rises_above(
        &self,
        height: f32,
        [low, high]: [[f64; 2]; 2],
        away2: [f32; 2],
        distances: &LevelDistances,
    ) -> bool {
        let search = Search {
            pyramid: self,
            height: height / self.shape.exaggeration,
            low,
            high,
            // The finest level that distances want, and the coarsest that is blended into.
            finest: (0..self.levels).take_while(|level| distances.of(*level) <= away2[0]).last().unwrap_or(0),
            coarsest: distances.coarsest(away2[1]),
        };
        search.rises(0)
    }

    /// A height that no ground exceeds, where `farthest2` gives an upper bound of the square of the
    /// distance from the eye of a square, whose corner and side are lattice units.
    pub(crate) fn highest(&self, distances: &LevelDistances, farthest2: impl Fn([u32; 2], u64) -> f32) -> f32 {
        let mut highest = f32::NEG_INFINITY;
        for node in &self.nodes {
            let side = u64::from(self.surface.cells()) << node.level;
            if node.top_m > highest
                && (node.children == [NONE; 4] || node.level <= distances.coarsest(farthest2(node.origin, side)))
            {
                highest = node.top_m;
            }
        }
        highest * self.shape.exaggeration
    }
}

/// A search for ground above a height, not exaggerated, in a rectangle.
struct Search<'a> {
    pyramid: &'a Pyramid,
    height: f32,
    low: [f64; 2],
    high: [f64; 2],
    finest: u8,
    coarsest: u8,
}

impl Search<'_> {
    /// Whether there may be some in a node or below it.
    fn rises(&self, at: u32) -> bool {
        let Some(node) = self.pyramid.nodes.get(at as usize) else { return false };
        if node.below_m <= self.height {
            return false;
        }
        let side = f64::from(self.pyramid.surface.cells()) * f64::from(1u32 << node.level);
        let is_beside = (0..2).any(|axis| {
            let corner = f64::from(node.origin[axis]);
            self.high[axis] < corner || self.low[axis] > corner + side
        });
        if is_beside {
            return false;
        }
        let is_drawn = node.children == [NONE; 4] || node.level <= self.coarsest;
        (node.top_m > self.height && is_drawn && self.rises_in(node))
            || (node.level > self.finest && node.children.into_iter().any(|child| self.rises(child)))
    }

    /// Whether a post of a node's cells over the rectangle does.
    fn rises_in(&self, node: &Node) -> bool {
        let Pyramid { surface, maxima, blocks, least_block, .. } = self.pyramid;
        let (cells, scale) = (surface.cells(), 1.0 / f64::from(1u32 << node.level));
        let within = |axis: usize| {
            let cell = |at: f64| ((at - f64::from(node.origin[axis])) * scale).max(0.0) as u32;
            [self.low, self.high].map(|corner| cell(corner[axis]).min(cells - 1))
        };
        let [columns, rows] = [within(0), within(1)];
        let widest = (columns[1] - columns[0]).max(rows[1] - rows[0]);
        let (mut block, mut first, mut side) = (*least_block, 0, cells / least_block);
        while widest > BLOCKS_A_SIDE * block && side > 1 {
            first += (side * side) as usize;
            block *= 2;
            side /= 2;
        }
        let maxima = &maxima[node.slot as usize * blocks + first..][..(side * side) as usize];
        (rows[0] / block..=rows[1] / block).any(|row| {
            let row = &maxima[(row * side) as usize..];
            row[(columns[0] / block) as usize..=(columns[1] / block) as usize].iter().any(|top| *top > self.height)
        })
    }
}

/// Which child of a node, whose children have sides of `2^log`, holds a point.
fn child_at(point: [u32; 2], log: u32) -> usize {
    ((point[0] >> log) & 1 | ((point[1] >> log) & 1) << 1) as usize
}

#[cfg(test)]
mod tests;
