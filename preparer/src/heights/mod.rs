//! Elevation arrays: the height of every vertex of an elevation leaf.
//!
//! The height at a lattice point is `z_t(x, y, l)`: facet-linear elevation of pyramid levels
//! `floor(l)` and `floor(l) + 1`, weighted by `frac(l)`, at `l = max(L_z(x, y), floor)`. The floor
//! of a vertex is the level of the coarsest leaf that touches it, so every leaf that has this
//! vertex computes the same: all of it is a function of the lattice point and the floor, evaluated
//! with the same operations in the same order.
//!
//! `L_z` is evaluated on the smooth elevation: that of level [`SMOOTH_LEVEL`], or of the floor if
//! that is coarser.
//!
//! In a world with validity, the heights in an array are followed by the shares of its vertices
//! ([`terravision_common::validity`]). They are computed from the tiles' planes in the same way as
//! heights. So leaves agree on them along their edges, and holes grow and shrink as smoothly as
//! heights.

mod ancestors;

pub use ancestors::{SMOOTH_LEVEL, vertex_height};

use crate::truncation::{ElevationLeaf, Tiles};
use ancestors::{Ancestors, smooth_level, stored, weight};
use std::ops::RangeInclusive;
use terravision_common::level::LevelFunction;
use terravision_common::node::NodeId;
use terravision_common::surface::tile::TileSampler;
use terravision_common::surface::{Columns, LatticePoint, PostLine, Row};
use terravision_common::world::World;

/// An elevation tile that the frame needs was evicted while the frame was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the elevation tile of node {node} left the pool while a frame needed it")]
pub struct TileVanished {
    /// The node.
    pub node: NodeId,
}

/// Makes elevation arrays; keeps its buffers.
#[derive(Debug)]
pub struct Heights {
    world: World,
    /// Lattice coordinates of columns and rows, and the parts of positions that depend only on
    /// them.
    columns: Vec<u64>,
    rows: Vec<u64>,
    column_terms: Columns,
    row_terms: Vec<Row>,
    tile: TileSampler,
    /// Where the posts of the tile lie that was entered, and on which rows every second counts.
    lines: [PostLine; 2],
    joined_rows: [Option<u64>; 2],
    /// One row of one level.
    row: Vec<f64>,
    /// Levels, then heights, of the whole array.
    levels: Vec<f64>,
    sums: Vec<f64>,
    /// For each row, the pyramid levels from which its heights are taken.
    spans: Vec<RangeInclusive<u8>>,
}

impl Heights {
    /// Buffers for leaves of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let posts = world.elevation_posts() as usize;
        Self {
            world: *world,
            columns: vec![0; posts],
            rows: vec![0; posts],
            column_terms: Columns::new(posts),
            row_terms: vec![Row::default(); posts],
            tile: TileSampler::new(posts),
            lines: [PostLine::even(0, 0, 1); 2],
            joined_rows: [None; 2],
            row: vec![0.0; posts],
            levels: vec![0.0; posts * posts],
            sums: vec![0.0; posts * posts],
            spans: vec![0..=0; posts],
        }
    }

    /// Fills `out`, [`World::elevation_values`] numbers (the rest is left alone), row 0 in the
    /// south, with heights of a leaf's vertices relative to the eye, metres, exaggerated, and the
    /// planes of validity of a world that has them. The leaf is drawn with every `1 <<
    /// grid_snap`-th row and column; rows in between are set to zero. Tiles of the leaf and of all
    /// its ancestors must be resident.
    ///
    /// # Errors
    /// [`TileVanished`] when one of them is missing.
    pub fn make(
        &mut self,
        level: &LevelFunction,
        tiles: &impl Tiles,
        leaf: &ElevationLeaf,
        grid_snap: u8,
        out: &mut [f32],
    ) -> Result<(), TileVanished> {
        let grid = 1 << grid_snap;
        let world = self.world;
        let mut ancestors = Ancestors::new(&world, tiles, leaf.node);
        self.place(leaf.node);
        self.make_levels(level, &mut ancestors, grid)?;
        let posts = self.columns.len();
        for (plane, out) in out.chunks_exact_mut(posts * posts).take(world.elevation_planes()).enumerate() {
            self.make_plane(&mut ancestors, plane, grid)?;
            let rows = out.chunks_exact_mut(posts).zip(self.sums.chunks_exact(posts));
            for (row, (out, sums)) in rows.enumerate() {
                if row % grid > 0 {
                    out.fill(0.0);
                    continue;
                }
                for (out, sum) in out.iter_mut().zip(sums) {
                    *out = stored(level, plane, *sum);
                }
            }
            self.make_seams(level, &mut ancestors, plane, leaf, grid, out)?;
        }
        Ok(())
    }

    /// Computes the columns and rows of the vertices, clamped to the extent.
    fn place(&mut self, node: NodeId) {
        let surface = self.world.surface();
        for (index, (lattice, x)) in self.columns.iter_mut().zip(surface.posts(node, 0)).enumerate() {
            *lattice = x;
            self.column_terms.set(index, surface.column(x));
        }
        for ((lattice, row), y) in self.rows.iter_mut().zip(&mut self.row_terms).zip(surface.posts(node, 1)) {
            (*lattice, *row) = (y, surface.row(y));
        }
    }

    /// Computes the level that each vertex needs, and from these the levels from which the heights
    /// of each row are taken.
    fn make_levels<T: Tiles>(
        &mut self,
        level: &LevelFunction,
        ancestors: &mut Ancestors<'_, T>,
        grid: usize,
    ) -> Result<(), TileVanished> {
        let (posts, node) = (self.columns.len(), ancestors.node);
        let (root, floor) = (f64::from(self.world.coarsest_level()), f64::from(node.q()));
        let smooth = ancestors.tile(smooth_level(&self.world, node.q()), 0)?;
        self.enter(smooth.0);
        for j in (0..posts).step_by(grid) {
            self.interpolate_row(&smooth, j);
            for z in &mut self.row {
                *z *= level.exaggeration();
            }
            let levels = &mut self.levels[j * posts..][..posts];
            level.elevation_levels(&self.column_terms, self.row_terms[j], &self.row, levels);
            for l in &mut *levels {
                *l = l.max(floor).min(root);
            }
            let [lowest, highest] = range_of(levels);
            self.spans[j] = lowest as u8..=(highest as u8 + 1).min(self.world.coarsest_level());
        }
        Ok(())
    }

    /// The coarsest level that is fine enough for every vertex of a leaf, at least the leaf's own.
    /// Tests every fourth row: levels change by far less than one from row to row.
    ///
    /// # Errors
    /// [`TileVanished`] when the tile with the smooth elevation is missing.
    pub fn lowest_level(
        &mut self,
        level: &LevelFunction,
        tiles: &impl Tiles,
        node: NodeId,
    ) -> Result<u8, TileVanished> {
        self.place(node);
        let world = self.world;
        let smooth = Ancestors::new(&world, tiles, node).tile(smooth_level(&world, node.q()), 0)?;
        self.enter(smooth.0);
        let posts = self.columns.len();
        let mut lowest = f64::from(self.world.coarsest_level());
        for j in (0..posts).step_by(4) {
            self.interpolate_row(&smooth, j);
            for z in &mut self.row {
                *z *= level.exaggeration();
            }
            let levels = &mut self.levels[..posts];
            level.elevation_levels(&self.column_terms, self.row_terms[j], &self.row, levels);
            lowest = levels.iter().copied().fold(lowest, f64::min);
        }
        Ok((lowest.max(0.0) as u8).max(node.q()))
    }

    /// Heights, or shares, before they are stored.
    fn make_plane<T: Tiles>(
        &mut self,
        ancestors: &mut Ancestors<'_, T>,
        plane: usize,
        grid: usize,
    ) -> Result<(), TileVanished> {
        let posts = self.columns.len();
        self.sums.fill(0.0);
        let drawn = self.spans.iter().step_by(grid);
        let [lowest, highest] = drawn.fold([u8::MAX, 0], |[low, high], s| [low.min(*s.start()), high.max(*s.end())]);
        for q in lowest..=highest {
            let tile = ancestors.tile(q, plane)?;
            self.enter(tile.0);
            for j in (0..posts).step_by(grid) {
                // Any other level would add an exact zero.
                if !self.spans[j].contains(&q) {
                    continue;
                }
                self.interpolate_row(&tile, j);
                let range = j * posts..(j + 1) * posts;
                for ((sum, l), z) in self.sums[range.clone()].iter_mut().zip(&self.levels[range]).zip(&self.row) {
                    *sum += weight(*l, q) * z;
                }
            }
        }
        Ok(())
    }

    /// Computes the vertices that coarser leaves touch too.
    fn make_seams<T: Tiles>(
        &self,
        level: &LevelFunction,
        ancestors: &mut Ancestors<'_, T>,
        plane: usize,
        leaf: &ElevationLeaf,
        grid: usize,
        out: &mut [f32],
    ) -> Result<(), TileVanished> {
        let last = self.columns.len() - 1;
        let mut make = |floor: u8, i: usize, j: usize| {
            if floor > leaf.node.q() {
                let point = LatticePoint { x: self.columns[i], y: self.rows[j] };
                out[j * (last + 1) + i] = stored(level, plane, ancestors.vertex_sum(level, plane, point, floor)?);
            }
            Ok(())
        };
        let [west, east, south, north] = leaf.seams.floors();
        for k in (grid..last).step_by(grid) {
            make(west, 0, k)?;
            make(east, last, k)?;
            make(south, k, 0)?;
            make(north, k, last)?;
        }
        let [south_west, south_east, north_west, north_east] = leaf.seams.corner_floors();
        make(south_west, 0, 0)?;
        make(south_east, last, 0)?;
        make(north_west, 0, last)?;
        make(north_east, last, last)?;
        self.repeat_edges(leaf.node, out);
        Ok(())
    }

    /// Posts that lie on an edge of the ground although others lie beyond them are as high as those.
    fn repeat_edges(&self, node: NodeId, out: &mut [f32]) {
        let posts = self.columns.len();
        let [west, east, south, north] = self.world.surface().edge_posts(node).map(|at| at as usize);
        for row in 1..=south {
            out.copy_within(..posts, row * posts);
        }
        for row in north..posts - 1 {
            out.copy_within((posts - 1) * posts..posts * posts, row * posts);
        }
        for row in out.chunks_exact_mut(posts).take(posts) {
            let (first, last) = (row[0], row[posts - 1]);
            row[..=west].fill(first);
            row[east..].fill(last);
        }
    }

    fn enter(&mut self, tile: NodeId) {
        let surface = self.world.surface();
        self.lines = surface.post_lines(tile);
        self.joined_rows = surface.joined_rows(tile);
        self.tile.enter(&self.columns, &self.lines[0], self.columns.len());
    }

    /// Elevation of the entered tile along row `j` of the array.
    fn interpolate_row(&mut self, (_, posts): &(NodeId, &[f32]), j: usize) {
        let [columns, rows] = &self.lines;
        let y = rows.position(self.rows[j]);
        if self.joined_rows.contains(&Some(self.rows[j])) {
            TileSampler::interpolate_joined(&self.columns, columns, posts, y, &mut self.row);
        } else {
            self.tile.interpolate(posts, y, &mut self.row);
        }
    }
}

/// Minimum and maximum of numbers, in four lanes: a plain fold waits for each comparison.
fn range_of(numbers: &[f64]) -> [f64; 2] {
    let (mut low, mut high) = ([f64::INFINITY; 4], [f64::NEG_INFINITY; 4]);
    let fours = numbers.chunks_exact(4);
    let rest = fours.remainder();
    for four in fours {
        for ((low, high), x) in low.iter_mut().zip(&mut high).zip(four) {
            *low = if *x < *low { *x } else { *low };
            *high = if *x > *high { *x } else { *high };
        }
    }
    let low = low.iter().chain(rest).copied().fold(f64::INFINITY, f64::min);
    let high = high.iter().chain(rest).copied().fold(f64::NEG_INFINITY, f64::max);
    [low, high]
}
