//! Vertex decimation: at which resolution each elevation leaf is drawn.
//!
//! The search splits a node for the part of it that needs the finest level, and the restriction of
//! the tree splits some nodes for a neighbour. So there are many leaves of which every vertex needs
//! a coarser level than the leaf's own. Heights there are taken from coarser levels
//! ([`crate::heights`]), whose facets are larger: the vertices in between lie on those facets, and
//! are omitted. A leaf of level q that is drawn at level e has every `2^(e - q)`-th vertex, and on
//! an edge as few as the neighbour.
//!
//! Two leaves agree on an edge because each has one drawn level, and the coarser of the two applies
//! on the edge. This needs two rules:
//! * a leaf is drawn no coarser than its neighbours' edges, and the blocks of their colour leaves,
//!   can follow;
//! * a leaf beside a coarser one is drawn no coarser than that one: along an edge there is one
//!   step.
//!
//! On bodies leaves of one level may have different steps along an edge that they share: what counts
//! there are the steps.

use crate::heights::{Heights, TileVanished};
use crate::truncation::{ElevationLeaf, Tiles, Truncation, along};
use std::cmp::Reverse;
use terravision_common::level::LevelFunction;
use terravision_common::surface::Surface;
use terravision_common::world::World;

/// The drawn levels of one frame's elevation leaves; keeps its buffers.
#[derive(Debug)]
pub struct Decimation {
    most: u8,
    /// The drawn level of each elevation leaf, in their order.
    drawn: Vec<u8>,
    /// Leaves, coarse to fine.
    order: Vec<u32>,
    neighbors: Vec<[Option<u32>; 4]>,
    /// log2 of the steps of each leaf's posts, along each axis.
    steps: Vec<[u8; 2]>,
    surface: Surface,
}

impl Decimation {
    /// Buffers for trees of up to `nodes` nodes.
    #[must_use]
    pub fn new(world: &World, nodes: u32) -> Self {
        let nodes = nodes as usize;
        Self {
            most: world.elevation_tile().ilog2() as u8,
            drawn: Vec::with_capacity(nodes),
            order: Vec::with_capacity(nodes),
            neighbors: Vec::with_capacity(nodes),
            steps: Vec::with_capacity(nodes),
            surface: *world.surface(),
        }
    }

    /// Finds the drawn level of each leaf of a truncated tree.
    ///
    /// # Errors
    /// [`TileVanished`] when a tile of the smooth elevation is missing.
    pub fn choose(
        &mut self,
        truncation: &Truncation,
        level: &LevelFunction,
        tiles: &impl Tiles,
        heights: &mut Heights,
    ) -> Result<(), TileVanished> {
        let leaves = truncation.elevation_leaves();
        self.drawn.clear();
        self.neighbors.clear();
        self.steps.clear();
        for leaf in leaves {
            let wanted = heights.lowest_level(level, tiles, leaf.node)?;
            // Below the level at which rows are cut, rows are as far apart as in the leaves beside that
            // are coarser: all of them are drawn.
            let wanted = if leaf.node.q() < self.surface.rows_level() { leaf.node.q() } else { wanted };
            self.drawn.push(wanted.min(leaf.node.q() + self.room(truncation, leaf)));
            self.neighbors.push(truncation.neighbors(leaf.node));
            self.steps.push(self.surface.log_steps(leaf.node));
        }
        self.limit_halves(truncation);
        for (at, leaf) in leaves.iter().enumerate() {
            let room = self.room(truncation, leaf);
            for (side, neighbor) in (0..4).filter_map(|side| Some((side, self.neighbors[at][side]? as usize))) {
                let further = self.steps[neighbor][along(side)].saturating_sub(self.steps[at][along(side)]);
                let limit = leaves[neighbor].node.q() + room.saturating_sub(further);
                self.drawn[neighbor] = self.drawn[neighbor].min(limit);
            }
        }
        self.order.clear();
        self.order.extend(0..leaves.len() as u32);
        self.order.sort_unstable_by_key(|at| Reverse(leaves[*at as usize].node.q()));
        for at in self.order.iter().map(|at| *at as usize) {
            let q = leaves[at].node.q();
            for (side, neighbor) in (0..4).filter_map(|side| Some((side, self.neighbors[at][side]? as usize))) {
                let theirs = leaves[neighbor].node.q();
                if theirs > q {
                    let step = self.steps[neighbor][along(side)] + self.drawn[neighbor] - theirs;
                    self.drawn[at] = self.drawn[at].min(q + step.saturating_sub(self.steps[at][along(side)]));
                }
            }
        }
        Ok(())
    }

    /// log2 of the steps between the drawn vertices of a leaf, in its interior and on its west,
    /// east, south and north edge.
    #[must_use]
    pub fn snaps(&self, truncation: &Truncation, at: usize, leaf: &ElevationLeaf) -> (u8, [u8; 4]) {
        let own = self.drawn[at] - leaf.node.q();
        let edges = [0, 1, 2, 3].map(|side| {
            let Some(neighbor) = self.neighbors[at][side].map(|n| n as usize) else { return own };
            let (axis, theirs) = (along(side), truncation.elevation_leaves()[neighbor].node.q());
            let step = self.steps[neighbor][axis] + (self.drawn[neighbor] - theirs);
            own.max(step.saturating_sub(self.steps[at][axis]))
        });
        (own, edges)
    }

    /// Draws two leaves that share the edge of one beside them no coarser than that one's posts are.
    fn limit_halves(&mut self, truncation: &Truncation) {
        if self.surface.lag() == 0 {
            return;
        }
        let leaves = truncation.elevation_leaves();
        for leaf in leaves {
            for side in 0..4 {
                let (2, halves) = truncation.leaves_across(leaf.node, side) else { continue };
                if halves[0].is_some() && halves[0] == halves[1] {
                    continue;
                }
                for half in halves.into_iter().flatten().map(|n| n as usize) {
                    self.drawn[half] = self.drawn[half].min(leaves[half].node.q() + self.surface.lag());
                }
            }
        }
    }

    /// log2 of the longest step between vertices on a leaf's edges: no block of its colour leaves may
    /// be narrower.
    fn room(&self, truncation: &Truncation, leaf: &ElevationLeaf) -> u8 {
        let finest = truncation.colors_of(leaf).iter().map(|color| color.node.q()).min().unwrap_or(leaf.node.q());
        self.most - (leaf.node.q() - finest)
    }
}
