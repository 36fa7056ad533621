//! The coarse-to-fine search of the quad tree for what the views of a frame see. Its result is the
//! truncated quad tree.
//!
//! 1. **Elevation.** From the root down, breadth first: a node whose box may be in the frustum of a
//!    view is split while its level is above the elevation level's lower bound over its box.
//! 2. **Restriction.** Elevation leaves that are coarser than an edge neighbour by more than one
//!    level are split until there are no more of them.
//! 3. **Colour.** Below each elevation leaf, nodes are split while their level is above the colour
//!    level's bound.
//! 4. **Output.** Nodes without any visible part are left out; the rest is written depth first, the
//!    children of a node nearest to the eye first, which for a grid is exact front-to-back order.
//!
//! Where levels are sparse, a node is split only when its children have tiles of the layer for
//! which it is split. Sparse elevation is built so that the tree can be restricted: a node that has
//! children is surrounded by nodes of its level.
//!
//! If a tree does not fit, the search is repeated with both wanted levels one level coarser, until
//! it fits: the tree stays restricted and complete, but is coarser. All memory is allocated in
//! [`Traversal::new`].

mod emit;
mod view;

pub use view::{Frustum, HeightRanges, node_box};

use crate::database::Layer;
use crate::level::{LevelFunction, deepest_color_below};
use crate::node::{MAX_LEVEL, NodeId};
use crate::node_table::NodeTable;
use crate::rig::{MAX_VIEWS, Views};
use crate::surface::{EyeFrame, MOST_CHILDREN, NodeBounds, SIDES};
use crate::tree::TreeNode;
use crate::world::World;
use std::num::NonZeroU32;

/// The size limits of a tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TreeLimits {
    /// Nodes: the capacity of one half of the ping-pong buffer.
    pub nodes: u32,
    /// Elevation leaves: the capacity of the elevation ring, without which the preparer could never
    /// hand the frame over.
    pub elevation_leaves: u32,
}

/// The result of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TreeStats {
    /// Nodes written.
    pub node_count: u32,
    /// Elevation leaves among them.
    pub elevation_leaf_count: u32,
    /// Colour leaves among them.
    pub color_leaf_count: u32,
    /// Whether the limits made the tree coarser than wanted.
    pub is_cut_short: bool,
}

/// One node while it is searched. Children come after their parent.
#[derive(Debug, Clone, Copy)]
struct Found {
    id: NodeId,
    /// Lower bound of the elevation level over the node's box.
    bound: f64,
    children: [Option<NonZeroU32>; MOST_CHILDREN],
    is_split: bool,
    is_elevation_leaf: bool,
    /// Whether it or anything below it is drawn.
    is_drawn: bool,
}

/// The search; keeps its buffers from frame to frame.
#[derive(Debug)]
pub struct Traversal {
    world: World,
    limits: TreeLimits,
    found: Vec<Found>,
    table: NodeTable,
    stack: Vec<emit::Pending>,
}

/// The limits are reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Full;

/// The visible region of a view.
#[derive(Clone, Copy)]
struct ViewSight {
    frustum: Frustum,
    frame: EyeFrame,
    /// For an eye beside the world, which sees the skirts at the world's border: the lowest ground,
    /// metres.
    skirt_low_m: Option<f64>,
}

/// Inputs of the search of a frame.
struct Search<'a, R> {
    world: World,
    sights: [Option<ViewSight>; MAX_VIEWS],
    level: &'a LevelFunction,
    ranges: &'a R,
    /// The lowest ground of all, metres, exaggerated.
    lowest_m: f64,
    /// Added to both wanted levels.
    coarser: f64,
}

impl<'a, R: HeightRanges> Search<'a, R> {
    fn new(views: &Views, level: &'a LevelFunction, ranges: &'a R, world: &World) -> Self {
        let surface = world.surface();
        let lows = world.roots().filter_map(|root| ranges.range(root)).map(|[low, high]| {
            let [low, high] = [low, high].map(|z| level.exaggeration() * f64::from(z));
            low.min(high)
        });
        let lowest_m = lows.reduce(f64::min);
        let mut sights = [None; MAX_VIEWS];
        for (sight, camera) in sights.iter_mut().zip(views.cameras()) {
            let skirt_low_m = lowest_m.filter(|_| !surface.is_over(camera.eye()));
            let frame = surface.seen_by(camera.eye(), camera.axes_in_world()[2]);
            *sight = Some(ViewSight { frustum: Frustum::new(camera), frame, skirt_low_m });
        }
        Self { world: *world, sights, level, ranges, lowest_m: lowest_m.unwrap_or_default(), coarser: 0.0 }
    }

    /// Whether a node may be seen in any of the views, or its skirt if it lies on the world's
    /// border. (Its level depends only on its ground.)
    fn may_see(&self, bounds: &NodeBounds) -> bool {
        self.sights.iter().flatten().any(|sight| {
            let bounds = sight.skirt_low_m.map_or(*bounds, |low| bounds.with_skirt(low));
            !sight.frame.is_behind_limb(&bounds, self.lowest_m)
                && sight.frustum.may_see(&sight.frame.box_from_eye(&bounds))
        })
    }

    /// Whether a node can be split.
    fn has_children(&self, layer: Layer, node: NodeId) -> bool {
        self.world.is_crown(node)
            || self.ranges.has_children(layer, node) && self.world.surface().children(node).iter().next().is_some()
    }
}

impl Traversal {
    /// Buffers for trees of a world.
    #[must_use]
    pub fn new(world: &World, limits: TreeLimits) -> Self {
        let capacity = limits.nodes as usize;
        Self {
            world: *world,
            limits,
            found: Vec::with_capacity(capacity),
            table: NodeTable::new(capacity),
            stack: Vec::with_capacity(4 * (usize::from(MAX_LEVEL) + 1)),
        }
    }

    /// Searches the tree for views with valid cameras and writes it to the front of `out`:
    /// everything that any view may see, at the finest level that any of them wants. The level
    /// functions must be those of the same views. Neither blocks nor allocates.
    pub fn build(
        &mut self,
        views: &Views,
        level: &LevelFunction,
        ranges: &impl HeightRanges,
        out: &mut [TreeNode],
    ) -> TreeStats {
        let mut search = Search::new(views, level, ranges, &self.world);
        let mut is_cut_short = false;
        // Wanted levels span at most some 80 powers of two; then the tree is only its root.
        while search.coarser < 128.0 {
            if self.search(&search, out.len()).is_ok() {
                break;
            }
            search.coarser += 1.0;
            is_cut_short = true;
        }
        TreeStats { is_cut_short, ..self.emit(&search, out) }
    }

    fn search<R: HeightRanges>(&mut self, search: &Search<'_, R>, out_len: usize) -> Result<(), Full> {
        self.found.clear();
        self.table.clear();
        let capacity = out_len.min(self.limits.nodes as usize);
        if self.add(search, self.world.root(), capacity)?.is_none() {
            return Ok(());
        }
        let mut at = 0;
        while at < self.found.len() {
            let Found { id, bound, .. } = self.found[at];
            let is_too_coarse = f64::from(id.q()) > bound + search.coarser || self.world.is_crown(id);
            if is_too_coarse
                && id.q() > self.world.finest_elevation_level()
                && search.has_children(Layer::Elevation, id)
            {
                self.split(search, at, capacity)?;
            }
            at += 1;
        }
        self.restrict(search, capacity)?;
        self.split_for_color(search, capacity)?;
        self.mark_drawn();
        let leaves = self.found.iter().filter(|f| f.is_elevation_leaf && f.is_drawn).count();
        if leaves > self.limits.elevation_leaves as usize { Err(Full) } else { Ok(()) }
    }

    /// Adds the node if it may be visible, and returns its index.
    fn add<R: HeightRanges>(
        &mut self,
        search: &Search<'_, R>,
        id: NodeId,
        capacity: usize,
    ) -> Result<Option<usize>, Full> {
        let Some(bounds) = node_box(&self.world, search.ranges, search.level.exaggeration(), id) else {
            return Ok(None);
        };
        if !search.may_see(&bounds) {
            return Ok(None);
        }
        let at = self.found.len();
        if at >= capacity {
            return Err(Full);
        }
        let bound = search.level.elevation_bound(&bounds);
        let node = Found {
            id,
            bound,
            children: [None; MOST_CHILDREN],
            is_split: false,
            is_elevation_leaf: false,
            is_drawn: false,
        };
        self.found.push(node);
        self.table.insert(id, at as u32).map_err(|_value| Full)?;
        Ok(Some(at))
    }

    fn split<R: HeightRanges>(&mut self, search: &Search<'_, R>, at: usize, capacity: usize) -> Result<(), Full> {
        self.found[at].is_split = true;
        let children = self.world.surface().children(self.found[at].id);
        for (index, child) in children.iter().enumerate() {
            let child = self.add(search, child, capacity)?;
            self.found[at].children[index] = child.and_then(|c| NonZeroU32::new(c as u32));
        }
        Ok(())
    }

    /// Splits leaves until edge neighbours differ by at most one level. Each leaf of level q
    /// requires the four nodes of level q + 1 across its edges; leaves that a split creates come
    /// later in the list, and are handled in turn.
    fn restrict<R: HeightRanges>(&mut self, search: &Search<'_, R>, capacity: usize) -> Result<(), Full> {
        let mut at = 0;
        while at < self.found.len() {
            if !self.found[at].is_split {
                let (world, id) = (self.world, self.found[at].id);
                for neighbor in (0..SIDES.len()).flat_map(|side| world.across(id, side)) {
                    // Where a level is not there across the edge, the next coarser one is enough.
                    let is_level = neighbor.q() == id.q();
                    self.reach(search, if is_level { world.surface().parent(neighbor) } else { neighbor }, capacity)?;
                }
            }
            at += 1;
        }
        Ok(())
    }

    /// Splits the leaf that covers `target` until `target` is in the tree, or is found to be
    /// invisible.
    fn reach<R: HeightRanges>(&mut self, search: &Search<'_, R>, target: NodeId, capacity: usize) -> Result<(), Full> {
        let root = self.world.root();
        while self.table.get(target).is_none() {
            let mut above = target;
            let covering = loop {
                if above.q() >= root.q() {
                    return Ok(());
                }
                above = self.world.surface().parent(above);
                if let Some(found) = self.table.get(above) {
                    break found as usize;
                }
            };
            // Sparse levels are built so that a neighbour is never missing; but the index may be
            // damaged.
            if self.found[covering].is_split || !search.has_children(Layer::Elevation, self.found[covering].id) {
                return Ok(());
            }
            self.split(search, covering, capacity)?;
        }
        Ok(())
    }

    fn split_for_color<R: HeightRanges>(&mut self, search: &Search<'_, R>, capacity: usize) -> Result<(), Full> {
        let elevation_nodes = self.found.len();
        for found in &mut self.found {
            found.is_elevation_leaf = !found.is_split;
        }
        let deepest = deepest_color_below(&self.world);
        let color_minus_elevation = search.level.color_minus_elevation();
        for leaf in 0..elevation_nodes {
            if self.found[leaf].is_split {
                continue;
            }
            let finest = self.found[leaf].id.q().saturating_sub(deepest).max(self.world.finest_color_level());
            let mut next = self.found.len();
            let mut at = leaf;
            loop {
                let Found { id, bound, .. } = self.found[at];
                let is_too_coarse = f64::from(id.q()) > bound + color_minus_elevation + search.coarser;
                if id.q() > finest && is_too_coarse && search.has_children(Layer::Color, id) {
                    self.split(search, at, capacity)?;
                }
                if next >= self.found.len() {
                    break;
                }
                at = next;
                next += 1;
            }
        }
        Ok(())
    }

    /// A node that was split and has no visible child is not visible itself.
    fn mark_drawn(&mut self) {
        for at in (0..self.found.len()).rev() {
            let Found { children, is_split, .. } = self.found[at];
            let is_drawn = !is_split || children.iter().flatten().any(|c| self.found[c.get() as usize].is_drawn);
            self.found[at].is_drawn = is_drawn;
        }
    }
}

#[cfg(test)]
mod tests;
