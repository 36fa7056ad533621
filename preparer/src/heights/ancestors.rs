//! Elevation tiles of a leaf and of its ancestors: heights of single vertices, and functions that
//! these share with heights of whole rows.

use super::TileVanished;
use crate::truncation::Tiles;
use terravision_common::level::LevelFunction;
use terravision_common::node::{MAX_LEVEL, NodeId};
use terravision_common::surface::LatticePoint;
use terravision_common::surface::tile::node_elevation;
use terravision_common::world::World;

/// The level whose elevation is smooth enough to compute levels from. With tiles of 32 intervals it
/// has one post per side of a node of level 0.
pub const SMOOTH_LEVEL: u8 = 5;

/// Elevation tiles of a node and of its ancestors, each looked up once.
pub(super) struct Ancestors<'t, T> {
    world: &'t World,
    tiles: &'t T,
    pub(super) node: NodeId,
    found: [Option<&'t [f32]>; MAX_LEVEL as usize + 1],
}

impl<'t, T: Tiles> Ancestors<'t, T> {
    pub(super) fn new(world: &'t World, tiles: &'t T, node: NodeId) -> Self {
        Self { world, tiles, node, found: [None; MAX_LEVEL as usize + 1] }
    }

    /// The ancestor at level `q` and a plane of its posts.
    pub(super) fn tile(&mut self, q: u8, plane: usize) -> Result<(NodeId, &'t [f32]), TileVanished> {
        let ancestor = self.world.surface().ancestor(self.node, q);
        let found = &mut self.found[usize::from(q)];
        if found.is_none() {
            *found = self.tiles.elevation(ancestor).and_then(|tile| tile.get(..self.world.elevation_values()));
        }
        let posts = (self.world.elevation_posts() as usize).pow(2);
        let plane = found.and_then(|tile| tile.get(plane * posts..(plane + 1) * posts));
        plane.map(|plane| (ancestor, plane)).ok_or(TileVanished { node: ancestor })
    }

    fn elevation(&mut self, plane: usize, point: LatticePoint, q: u8) -> Result<f64, TileVanished> {
        let (tile, posts) = self.tile(q, plane)?;
        Ok(node_elevation(self.world.surface(), tile, posts, point))
    }

    /// Height, or a share, of a vertex before it is stored.
    pub(super) fn vertex_sum(
        &mut self,
        level: &LevelFunction,
        plane: usize,
        point: LatticePoint,
        floor: u8,
    ) -> Result<f64, TileVanished> {
        let (root, surface) = (self.world.coarsest_level(), self.world.surface());
        let smooth = self.elevation(0, point, smooth_level(self.world, floor))? * level.exaggeration();
        let l = level.elevation_level_at(surface.column(point.x), surface.row(point.y), smooth);
        let l = l.max(f64::from(floor)).min(f64::from(root));
        let lower = l as u8;
        let mut sum = 0.0;
        for q in lower..=(lower + 1).min(root) {
            sum += weight(l, q) * self.elevation(plane, point, q)?;
        }
        Ok(sum)
    }
}

/// Height of one vertex relative to the eye, equal to that of [`super::Heights::make`]. `node`: its
/// leaf; `floor`: the level of the coarsest leaf that touches it.
///
/// # Errors
/// [`TileVanished`] when the tile of an ancestor is missing.
pub fn vertex_height(
    world: &World,
    level: &LevelFunction,
    tiles: &impl Tiles,
    node: NodeId,
    point: LatticePoint,
    floor: u8,
) -> Result<f32, TileVanished> {
    Ok(stored(level, 0, Ancestors::new(world, tiles, node).vertex_sum(level, 0, point, floor)?))
}

/// Weight of level `q` in the elevation at level `l`: 1 there, falling to 0 at the next level on
/// both sides. A level that does not take part adds an exact zero, so a sum over more levels has
/// the same bits.
#[inline(always)]
pub(super) fn weight(l: f64, q: u8) -> f64 {
    (1.0 - (l - f64::from(q)).abs()).max(0.0)
}

/// A number of a plane as stored in arrays: heights relative to the eye, shares unchanged.
#[inline(always)]
pub(super) fn stored(level: &LevelFunction, plane: usize, sum: f64) -> f32 {
    if plane == 0 { level.frame().height_from_eye(level.exaggeration() * sum) } else { sum as f32 }
}

/// The level of the smooth elevation for a vertex with this floor.
pub(super) fn smooth_level(world: &World, floor: u8) -> u8 {
    (SMOOTH_LEVEL + world.surface().rows_level()).min(world.coarsest_level()).max(floor)
}
