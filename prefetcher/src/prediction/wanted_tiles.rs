//! The tiles that a view wants: the same search as the generator's, then a breadth-first walk.

use bytemuck::Zeroable;
use std::collections::VecDeque;
use terravision_common::camera::Camera;
use terravision_common::database::{Layer, Tile};
use terravision_common::level::{LevelFunction, Measure};
use terravision_common::rig::Views;
use terravision_common::traversal::{HeightRanges, Traversal, TreeLimits};
use terravision_common::tree::{COLOR_FROM_ANCESTOR, ELEVATION_LEAF, TreeNode};
use terravision_common::world::World;

/// The resolution of a search.
#[derive(Debug, Clone, Copy)]
pub struct Resolution {
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// Factor on all heights.
    pub exaggeration: f64,
    /// How screen resolution is measured.
    pub measure: Measure,
}

/// Searches views; keeps its buffers.
#[derive(Debug)]
pub struct WantedTiles<R> {
    world: World,
    ranges: R,
    traversal: Traversal,
    nodes: Vec<TreeNode>,
    queue: VecDeque<(u32, bool)>,
    tiles: Vec<Tile>,
}

impl<R: HeightRanges> WantedTiles<R> {
    /// A search for views of a world whose nodes have these ranges of height.
    #[must_use]
    pub fn new(world: &World, ranges: R, limits: TreeLimits) -> Self {
        Self {
            world: *world,
            ranges,
            traversal: Traversal::new(world, limits),
            nodes: vec![TreeNode::zeroed(); limits.nodes as usize],
            queue: VecDeque::new(),
            tiles: Vec::new(),
        }
    }

    /// Every tile that the views carried by `pose` want, coarse to fine, and within a level near to
    /// far. Cameras must be valid.
    pub fn tiles(&mut self, pose: &Camera, views: &Views, resolution: &Resolution) -> &[Tile] {
        let Resolution { r_z_px, r_c_px, exaggeration, measure } = *resolution;
        let level = LevelFunction::for_views(pose, views, &self.world, exaggeration, measure, r_z_px, r_c_px);
        let stats = self.traversal.build(views, &level, &self.ranges, &mut self.nodes);
        self.tiles.clear();
        self.queue.clear();
        if stats.node_count > 0 {
            self.queue.push_back((0, false));
        }
        while let Some((index, is_below_elevation)) = self.queue.pop_front() {
            let node = self.nodes[index as usize];
            let Some(id) = node.id() else { continue };
            if !is_below_elevation && self.world.has_elevation(id) {
                self.tiles.push(Tile { layer: Layer::Elevation, node: id });
            }
            if node.flags & COLOR_FROM_ANCESTOR == 0 && self.world.has_color(id) {
                self.tiles.push(Tile { layer: Layer::Color, node: id });
            }
            let is_below = is_below_elevation || node.flags & ELEVATION_LEAF != 0;
            let children = node.children(index, stats.node_count).unwrap_or(0..0);
            self.queue.extend(children.map(|child| (child, is_below)));
        }
        &self.tiles
    }
}
