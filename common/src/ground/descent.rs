//! From the root of the tree down to the facets that a straight way may meet, nearest first.

use super::NoGround;
use super::tiles::{GroundScratch, GroundTiles, TileAt};
use crate::database::Layer;
use crate::node::NodeId;
use crate::surface::facet::FACET_CORNERS;
use crate::surface::{LatticePoint, NodeBounds};
use crate::validity::{GROUND_PLANE, HALF, PLANES};
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// A straight way through the world, of a point or a sphere.
#[derive(Debug, Clone, Copy)]
pub(super) struct Way {
    /// Where it begins, in the space in which it is straight.
    pub(super) start: DVec3,
    /// To its end.
    pub(super) way: DVec3,
    /// How far around it ground matters, metres.
    pub(super) margin: f64,
}

/// A facet that the way may meet.
#[derive(Debug)]
pub(super) struct Facet {
    /// Its corners, relative to the way's start, counter-clockwise seen from above.
    pub(super) corners: [DVec3; 3],
    /// Whether any of its corners is ground, and not all of it a hole.
    pub(super) has_ground: bool,
}

/// What a descent came to.
#[derive(Debug)]
pub(super) struct Descent<T> {
    /// What was met first.
    pub(super) first: Option<(f64, T)>,
    /// Whether all tiles were the finest that exist.
    pub(super) is_finest: bool,
}

/// A part of the world that the way meets at a share.
struct Step {
    share: f64,
    part: Part,
}

enum Part {
    Node(NodeId),
    /// A square of cells of a tile: which tile, its first column and row, and its side.
    Cells {
        tile: usize,
        corner: [u32; 2],
        side: u32,
    },
}

impl PartialEq for Step {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Step {}

impl PartialOrd for Step {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Step {
    /// The nearest is the greatest. Of equals, cells come before nodes, so that what is met at once
    /// is found without a look at the rest.
    fn cmp(&self, other: &Self) -> Ordering {
        let size = |step: &Self| match step.part {
            Part::Node(_) => u32::MAX,
            Part::Cells { side, .. } => side,
        };
        other.share.total_cmp(&self.share).then_with(|| size(other).cmp(&size(self)))
    }
}

impl GroundTiles<'_> {
    /// The straight way from one position to another.
    pub(super) fn way(&self, from: DVec3, to: DVec3, margin: f64) -> Way {
        let [start, end] = [from, to].map(|position| self.world.surface().straight(position));
        Way { start, way: end - start, margin }
    }

    /// Goes through the facets that a way may meet, until no other can be met earlier. `meet` says
    /// where the way meets one, as a share of the way, and what is to be known of it.
    ///
    /// # Errors
    /// [`NoGround::Unreadable`].
    pub(super) fn first_met<T>(
        &self,
        way: &Way,
        scratch: &mut GroundScratch,
        mut meet: impl FnMut(&Facet) -> Option<(f64, T)>,
    ) -> Result<Descent<T>, NoGround> {
        let mut descent = Descent { first: None, is_finest: true };
        let (mut steps, mut tiles) = (BinaryHeap::new(), Vec::new());
        self.world.roots().for_each(|root| self.push_node(root, way, &mut steps));
        while let Some(Step { share, part }) = steps.pop() {
            if descent.first.as_ref().is_some_and(|(first, _)| share >= *first) {
                break;
            }
            match part {
                Part::Node(node) if self.is_leaf(node) => {
                    let tile = self.tile_of(node, scratch).ok_or(NoGround::Unreadable)?;
                    descent.is_finest &= tile.is_finest;
                    let (corner, side) = cells_of(node, tile.node, self.world.surface().cells());
                    tiles.push(tile);
                    self.push_cells(&tiles, Part::Cells { tile: tiles.len() - 1, corner, side }, way, &mut steps);
                }
                Part::Node(node) => {
                    let children = self.world.surface().children(node);
                    children.iter().for_each(|child| self.push_node(child, way, &mut steps));
                }
                Part::Cells { tile, corner, side: 1 } => {
                    for facet in self.facets(&tiles[tile], corner, way) {
                        let Some((share, found)) = meet(&facet) else { continue };
                        if descent.first.as_ref().is_none_or(|(first, _)| share < *first) {
                            descent.first = Some((share, found));
                        }
                    }
                }
                Part::Cells { tile, corner: [x, y], side } => {
                    let half = side / 2;
                    for corner in [[x, y], [x + half, y], [x, y + half], [x + half, y + half]] {
                        self.push_cells(&tiles, Part::Cells { tile, corner, side: half }, way, &mut steps);
                    }
                }
            }
        }
        Ok(descent)
    }

    /// Whether nothing finer exists below a node.
    fn is_leaf(&self, node: NodeId) -> bool {
        node.q() <= self.world.finest_elevation_level()
            || self.world.surface().children(node).iter().next().is_none()
            || self.ranges.is_some_and(|ranges| !ranges.has_children(Layer::Elevation, node))
    }

    fn push_node(&self, node: NodeId, way: &Way, steps: &mut BinaryHeap<Step>) {
        let range = match self.ranges {
            Some(ranges) => ranges.range(node),
            None => self.world.contains(node).then_some([f32::MIN, f32::MAX]),
        };
        let Some(range) = range else { return };
        let bounds = self.world.surface().node_bounds(node, range.map(f64::from));
        push(&bounds, way, Part::Node(node), steps);
    }

    fn push_cells(&self, tiles: &[TileAt], part: Part, way: &Way, steps: &mut BinaryHeap<Step>) {
        let Part::Cells { tile, corner: [x, y], side } = part else { return };
        let TileAt { node, values, .. } = &tiles[tile];
        let surface = self.world.surface();
        let stride = surface.cells() as usize + 1;
        let posts = (y..=y + side).flat_map(|row| {
            let first = row as usize * stride + x as usize;
            &values[first..=first + side as usize]
        });
        let [lowest, highest] =
            posts.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], z| [low.min(*z), high.max(*z)]);
        // Posts of a tile that reaches beyond the world are no ground there.
        let heights = [lowest.into(), highest.into()];
        if let Some(bounds) = surface.cells_bounds(*node, [x, y], side, heights) {
            push(&bounds, way, part, steps);
        }
    }

    /// The two facets of a cell.
    fn facets(&self, tile: &TileAt, [x, y]: [u32; 2], way: &Way) -> [Facet; 2] {
        let surface = self.world.surface();
        let stride = surface.cells() as usize + 1;
        let [columns, rows] = surface.post_lines(tile.node);
        let south_west = y as usize * stride + x as usize;
        let posts = [south_west, south_west + 1, south_west + stride, south_west + stride + 1];
        let corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[east, north]| LatticePoint {
            x: columns.post(x + east).cast_unsigned(),
            y: rows.post(y + north).cast_unsigned(),
        });
        let plane = stride * stride;
        let has_shares = tile.values.len() >= PLANES * plane;
        let is_ground = |post: usize| !has_shares || tile.values[GROUND_PLANE * plane + post] >= HALF;
        FACET_CORNERS.map(|of| Facet {
            corners: of.map(|k| surface.vertex(corners[k], tile.values[posts[k]].into()) - way.start),
            has_ground: of.iter().any(|k| is_ground(posts[*k])),
        })
    }
}

fn push(bounds: &NodeBounds, way: &Way, part: Part, steps: &mut BinaryHeap<Step>) {
    if let Some(share) = bounds.met_by(way.start, way.way, way.margin) {
        steps.push(Step { share, part });
    }
}

/// The cells of a tile that are in a node below it: their corner, and how many they are along a
/// side.
fn cells_of(node: NodeId, of_tile: NodeId, cells: u32) -> ([u32; 2], u32) {
    let up = of_tile.q() - node.q();
    let within = [node.m() - (of_tile.m() << up), node.n() - (of_tile.n() << up)];
    let corner = within.map(|at| ((u64::from(at) * u64::from(cells)) >> up) as u32);
    (corner, (cells >> up).max(1))
}
