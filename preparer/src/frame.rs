//! One frame from tree to ring: marker, views, a slot per colour leaf near to far, end.

use crate::frame_tree::{FrameTree, TreeError};
use crate::heights::{Heights, TileVanished};
use crate::thinning::Thinning;
use crate::trim::{Sight, Trim};
use crate::truncation::{ColorLeaf, ElevationLeaf, RootMissing, Tiles, Truncation};
use bytemuck::Zeroable;
use terravision_common::camera::Camera;
use terravision_common::facet::node_elevation;
use terravision_common::level::LevelFunction;
use terravision_common::rig::Views;
use terravision_common::shm::WaitError;
use terravision_common::slot::{FrameEnd, FrameMarker, Slot, SlotContent, TileSlot, ViewSlot};
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;

/// Why a frame could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The tree is not one that the generator writes.
    #[error("the generator's tree cannot be used: {source}")]
    Tree {
        /// What is wrong.
        #[from]
        source: TreeError,
    },
    /// The root is not there.
    #[error(transparent)]
    RootMissing(#[from] RootMissing),
    /// A tile went away.
    #[error(transparent)]
    TileVanished(#[from] TileVanished),
    /// The run ended while a ring was full.
    #[error(transparent)]
    Wait(#[from] WaitError),
}

/// Where a frame goes: the elevation ring and the ring of slots.
pub trait FrameOutput {
    /// Waits for a free elevation array, has it filled, publishes it, and returns its position.
    ///
    /// # Errors
    /// What `fill` gives, or that the run ended.
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError>;

    /// Puts a slot into the ring, or keeps it until [`FrameOutput::finish`].
    ///
    /// # Errors
    /// The run ended.
    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError>;

    /// The position that the next array will have.
    fn next_position(&self) -> u64;

    /// The frame is complete: what was kept goes into the ring.
    ///
    /// # Errors
    /// The run ended.
    fn finish(&mut self) -> Result<(), FrameError>;
}

/// What a frame is made for.
#[derive(Debug, Clone, Copy)]
pub struct FrameRequest<'a> {
    /// The header of its tree.
    pub header: &'a TreeHeader,
    /// The views that are drawn of it, which the header's camera carries.
    pub views: &'a Views,
    /// The level functions of these views.
    pub level: &'a LevelFunction,
}

/// What a frame was made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Tiles that it wanted.
    pub wanted: u32,
    /// Those of them that could not be had.
    pub unavailable: u32,
    /// Nodes of its truncated tree.
    pub nodes: u32,
    /// Elevation arrays.
    pub arrays: u32,
    /// Tile slots.
    pub tiles: u32,
}

/// Makes frames; keeps all buffers, so that a frame allocates nothing.
#[derive(Debug)]
pub struct FrameMaker {
    world: World,
    truncation: Truncation,
    heights: Heights,
    thinning: Thinning,
    trim: Trim,
    is_trimmed: bool,
}

impl FrameMaker {
    /// Buffers for trees of up to `nodes` nodes.
    #[must_use]
    pub fn new(world: &World, nodes: u32) -> Self {
        Self {
            world: *world,
            truncation: Truncation::new(world, nodes),
            heights: Heights::new(world),
            thinning: Thinning::new(world, nodes),
            trim: Trim::new(world),
            is_trimmed: true,
        }
    }

    /// Blocks are not trimmed to what is seen: for whoever draws the frame from another eye.
    #[must_use]
    pub fn with_whole_blocks(self) -> Self {
        Self { is_trimmed: false, ..self }
    }

    /// What the last frame draws.
    #[must_use]
    pub fn truncation(&self) -> &Truncation {
        &self.truncation
    }

    /// Makes one frame from a tree that was read and from the tiles that are there.
    ///
    /// # Errors
    /// [`FrameError`]; part of the frame may be in the ring then, without its end.
    pub fn make(
        &mut self,
        &FrameRequest { header, views, level }: &FrameRequest<'_>,
        tree: &FrameTree,
        tiles: &impl Tiles,
        unavailable: u32,
        out: &mut impl FrameOutput,
    ) -> Result<FrameCounts, FrameError> {
        self.truncation.truncate(tree, tiles)?;
        out.slot(&SlotContent::Marker(FrameMarker {
            frame: header.frame,
            camera: header.camera,
            r_z_px: header.r_z_px,
            r_c_px: header.r_c_px,
            picture: views.picture(),
            ..FrameMarker::zeroed()
        }))?;
        for (index, view) in (0u32..).zip(views.iter()) {
            let count = views.len() as u32;
            out.slot(&SlotContent::View(ViewSlot { camera: view.camera, at: view.at, index, count }))?;
        }
        self.thinning.thin(&self.truncation, level, tiles, &mut self.heights)?;
        let world = self.world;
        self.trim.look(
            header.camera.eye_in_world[2],
            views.cameras().map(|camera| {
                let is_in_order = tree.is_near_to_far(header.camera.eye(), camera.eye());
                let ground_m = ground_under_eye(&world, camera, level.exaggeration(), tiles);
                Sight { camera, ground_m: is_in_order.then_some(ground_m) }
            }),
        );
        let mut tile_count = 0;
        for (at, leaf) in self.truncation.elevation_leaves().iter().enumerate() {
            let snaps = self.thinning.snaps(at, leaf);
            let (heights, trim, origin) = (&mut self.heights, &mut self.trim, self.world.node_origin(leaf.node));
            let position = out.array(&mut |values| {
                heights.make(level, tiles, leaf, snaps.0, values)?;
                trim.enter(origin, leaf.node.q(), values, snaps);
                Ok(())
            })?;
            let range = leaf.first_color_leaf as usize..leaf.end_color_leaf as usize;
            for color in &self.truncation.color_leaves()[range] {
                let mut slot = tile_slot(&self.world, leaf, color, position, snaps);
                if !self.is_trimmed || self.trim.trim(&mut slot) {
                    out.slot(&SlotContent::Tile(slot))?;
                    tile_count += 1;
                }
            }
            self.trim.leave();
        }
        let counts = FrameCounts {
            wanted: tree.wanted().len() as u32,
            unavailable,
            nodes: self.truncation.node_count(),
            arrays: self.truncation.elevation_leaves().len() as u32,
            tiles: tile_count,
        };
        out.slot(&SlotContent::End(FrameEnd {
            frame: header.frame,
            tile_count: counts.tiles,
            unavailable_count: unavailable,
            elevation_end: out.next_position(),
            wanted_count: counts.wanted,
            node_count: counts.nodes,
        }))?;
        out.finish()?;
        Ok(counts)
    }
}

/// Height of the root's ground under the eye, metres, exaggerated; above every eye when nothing is drawn.
fn ground_under_eye(world: &World, camera: &Camera, exaggeration: f64, tiles: &impl Tiles) -> f64 {
    let root = world.root();
    // Casts of negative numbers give 0.
    let [x, y] = [0, 1].map(|axis| (camera.eye_in_world[axis] / world.lattice_unit_m()) as u64);
    let height = |posts| exaggeration * node_elevation(world, root, posts, x, y);
    tiles.elevation(root).map_or(f64::INFINITY, height)
}

/// The slot of one colour leaf.
fn tile_slot(
    world: &World,
    leaf: &ElevationLeaf,
    color: &ColorLeaf,
    elevation_position: u64,
    (grid_snap, edge_snap): (u8, [u8; 4]),
) -> TileSlot {
    let q = leaf.node.q();
    let below = q - color.node.q();
    let side = world.elevation_tile() >> below;
    let inside = |at: u32, leaf_at: u32| (at - (leaf_at << below)) * side;
    let start = [inside(color.node.m(), leaf.node.m()), inside(color.node.n(), leaf.node.n())];
    let origin = world.node_origin(leaf.node);
    // Vertices beyond the extent collapse onto it: facets past the first of them are nothing, unless an edge snaps, which
    // needs the vertices that it snaps to. An edge's step is never finer than that of the leaf.
    let step = 1u64 << edge_snap.into_iter().max().unwrap_or(0);
    let end = [0, 1].map(|axis| {
        let cells = (u64::from(world.extent()[axis]) - origin[axis]).div_ceil(1 << q);
        u64::from(start[axis] + side).min(cells.next_multiple_of(step)) as u16
    });
    let lattice = |[x, y]: [u64; 2]| [x as u32, y as u32];
    TileSlot {
        node: color.node.pack(),
        elevation_position,
        elevation_origin: lattice(origin),
        color_origin: lattice(world.node_origin(color.color.node)),
        start: start.map(|v| v as u16),
        end,
        color_slot: color.color.slot,
        color_generation: color.color.generation,
        elevation_level: q,
        color_level: color.color.node.q(),
        edge_snap,
        grid_snap,
        is_hidden: 0,
    }
}

/// The slots of the last frame, for tests and benches that need no shared memory.
#[derive(Debug, Default)]
pub struct FrameBuffer {
    arrays: Vec<f32>,
    array_f32: usize,
    array_count: usize,
    slots: Vec<Slot>,
}

impl FrameBuffer {
    /// Room for `arrays` arrays of `array_f32` numbers.
    #[must_use]
    pub fn new(arrays: usize, array_f32: usize) -> Self {
        Self { arrays: vec![0.0; arrays * array_f32], array_f32, array_count: 0, slots: Vec::with_capacity(4 * arrays) }
    }

    /// Forgets the frame.
    pub fn clear(&mut self) {
        self.array_count = 0;
        self.slots.clear();
    }

    /// The slots.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// An elevation array; `None` past the last.
    #[must_use]
    pub fn array(&self, position: u64) -> Option<&[f32]> {
        let position = usize::try_from(position).ok().filter(|p| *p < self.array_count)?;
        self.arrays.get(position * self.array_f32..(position + 1) * self.array_f32)
    }
}

impl FrameOutput for FrameBuffer {
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError> {
        let begin = self.array_count * self.array_f32;
        if self.arrays.len() < begin + self.array_f32 {
            self.arrays.resize(begin + self.array_f32, 0.0);
        }
        fill(&mut self.arrays[begin..begin + self.array_f32])?;
        self.array_count += 1;
        Ok(self.array_count as u64 - 1)
    }

    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError> {
        self.slots.push(Slot::new(slot));
        Ok(())
    }

    fn next_position(&self) -> u64 {
        self.array_count as u64
    }

    fn finish(&mut self) -> Result<(), FrameError> {
        Ok(())
    }
}
