//! One frame from tree to ring: marker, views, a slot per colour leaf near to far, end.

mod buffer;

pub use buffer::FrameBuffer;

use crate::block_culling::{BlockCulling, Sight};
use crate::decimation::Decimation;
use crate::frame_tree::{FrameTree, TreeError};
use crate::heights::{Heights, TileVanished};
use crate::truncation::{ColorLeaf, ElevationLeaf, RootMissing, Tiles, Truncation};
use bytemuck::Zeroable;
use terravision_common::camera::Camera;
use terravision_common::level::LevelFunction;
use terravision_common::rig::Views;
use terravision_common::shm::WaitError;
use terravision_common::slot::{ElevationSlot, ElevationTile, FrameEnd, FrameMarker, SlotContent, TileSlot, ViewSlot};
use terravision_common::surface::tile::node_elevation;
use terravision_common::tree::TreeHeader;
use terravision_common::world::World;

/// Why a frame could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The tree is not valid.
    #[error("the generator's tree cannot be used: {source}")]
    Tree {
        /// What is wrong.
        #[from]
        source: TreeError,
    },
    /// The root's tiles are missing.
    #[error(transparent)]
    RootMissing {
        /// Which tile.
        #[from]
        source: RootMissing,
    },
    /// A tile was evicted.
    #[error(transparent)]
    TileVanished {
        /// Which.
        #[from]
        source: TileVanished,
    },
    /// The run ended while a ring was full.
    #[error(transparent)]
    Wait {
        /// How.
        #[from]
        source: WaitError,
    },
}

/// Where a frame goes: the elevation ring and the ring of slots.
pub trait FrameOutput {
    /// Waits for a free elevation array, lets `fill` fill it, publishes it, and returns its
    /// position.
    ///
    /// # Errors
    /// The error of `fill`, or the run ended.
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError>;

    /// Writes a slot to the ring, or keeps it until [`FrameOutput::finish`].
    ///
    /// # Errors
    /// The run ended.
    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError>;

    /// The position that the next array will have.
    fn next_position(&self) -> u64;

    /// The frame is complete: writes the slots that were kept to the ring.
    ///
    /// # Errors
    /// The run ended.
    fn finish(&mut self) -> Result<(), FrameError>;
}

/// Inputs of a frame.
#[derive(Debug, Clone, Copy)]
pub struct FrameRequest<'a> {
    /// The header of its tree.
    pub header: &'a TreeHeader,
    /// The header's camera.
    pub pose: &'a Camera,
    /// The views that are drawn of it, carried by that camera.
    pub views: &'a Views,
    /// The level functions of these views.
    pub level: &'a LevelFunction,
}

/// Counts of the parts of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FrameCounts {
    /// Tiles that the frame wanted.
    pub wanted: u32,
    /// Those of them that could not be read.
    pub unavailable: u32,
    /// Nodes of its truncated tree.
    pub nodes: u32,
    /// Elevation arrays.
    pub arrays: u32,
    /// Tiles of the elevation pool that it names.
    pub elevations: u32,
    /// Tile slots.
    pub tiles: u32,
}

/// Makes frames; keeps all buffers, so that a frame allocates nothing.
#[derive(Debug)]
pub struct FrameMaker {
    world: World,
    truncation: Truncation,
    heights: Heights,
    decimation: Decimation,
    culling: BlockCulling,
    is_culled: bool,
}

impl FrameMaker {
    /// Buffers for trees of up to `nodes` nodes.
    #[must_use]
    pub fn new(world: &World, nodes: u32) -> Self {
        Self {
            world: *world,
            truncation: Truncation::new(world, nodes),
            heights: Heights::new(world),
            decimation: Decimation::new(world, nodes),
            culling: BlockCulling::new(world),
            is_culled: true,
        }
    }

    /// Keeps what the walls go down from that a world has at its border, down to this height.
    #[must_use]
    pub fn with_skirts(self, skirt_low_m: Option<f64>) -> Self {
        Self { culling: self.culling.with_skirts(skirt_low_m), ..self }
    }

    /// Does not cull blocks: for callers that draw the frame from another eye.
    #[must_use]
    pub fn with_whole_blocks(self) -> Self {
        Self { is_culled: false, ..self }
    }

    /// What the last frame draws.
    #[must_use]
    pub fn truncation(&self) -> &Truncation {
        &self.truncation
    }

    /// Makes one frame from a tree that has been read and from the resident tiles.
    ///
    /// # Errors
    /// [`FrameError`]; part of the frame may be in the ring then, without its end.
    pub fn make(
        &mut self,
        request: &FrameRequest<'_>,
        tree: &FrameTree,
        tiles: &impl Tiles,
        unavailable: u32,
        out: &mut impl FrameOutput,
    ) -> Result<FrameCounts, FrameError> {
        self.begin(request, tree, tiles, out)?;
        let tile_count = self.put_blocks(request, tree, tiles, out)?;
        let arrays = self.truncation.elevation_leaves().len() as u32;
        self.end(FrameCounts { unavailable, arrays, tiles: tile_count, ..FrameCounts::default() }, request, tree, out)
    }

    /// The same for who reads heights out of the elevation pool, in place: no array is made, and
    /// nothing is culled.
    ///
    /// # Errors
    /// As [`FrameMaker::make`].
    pub fn make_in_place(
        &mut self,
        request: &FrameRequest<'_>,
        tree: &FrameTree,
        tiles: &impl Tiles,
        unavailable: u32,
        out: &mut impl FrameOutput,
    ) -> Result<FrameCounts, FrameError> {
        self.begin(request, tree, tiles, out)?;
        for nodes in self.truncation.elevation_nodes().chunks(ElevationSlot::MOST) {
            let mut elevations = [ElevationTile::zeroed(); ElevationSlot::MOST];
            for (elevation, node) in elevations.iter_mut().zip(nodes) {
                let key = tiles.elevation_key(*node).ok_or(TileVanished { node: *node })?;
                *elevation = ElevationTile::new(*node, key);
            }
            out.slot(&SlotContent::Elevation(ElevationSlot::of(&elevations)))?;
        }
        for leaf in self.truncation.elevation_leaves() {
            for color in self.truncation.colors_of(leaf) {
                let slot = tile_slot(&self.world, leaf, color, leaf.tile.into(), (0, [0; 4]));
                out.slot(&SlotContent::Tile(slot))?;
            }
        }
        let tiles = self.truncation.color_leaves().len() as u32;
        let elevations = self.truncation.elevation_nodes().len() as u32;
        self.end(FrameCounts { unavailable, elevations, tiles, ..FrameCounts::default() }, request, tree, out)
    }

    /// Truncates the tree, and opens the frame.
    fn begin(
        &mut self,
        &FrameRequest { header, views, .. }: &FrameRequest<'_>,
        tree: &FrameTree,
        tiles: &impl Tiles,
        out: &mut impl FrameOutput,
    ) -> Result<(), FrameError> {
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
            out.slot(&SlotContent::View(ViewSlot::new(view, index, count)))?;
        }
        Ok(())
    }

    /// Makes the elevation arrays, and the slots of what is seen; how many.
    fn put_blocks(
        &mut self,
        &FrameRequest { pose, views, level, .. }: &FrameRequest<'_>,
        tree: &FrameTree,
        tiles: &impl Tiles,
        out: &mut impl FrameOutput,
    ) -> Result<u32, FrameError> {
        self.decimation.choose(&self.truncation, level, tiles, &mut self.heights)?;
        let world = self.world;
        self.culling.look(
            pose,
            views.cameras().map(|camera| {
                let is_in_order = tree.is_near_to_far(pose.eye(), camera.eye());
                let ground_m = ground_under_eye(&world, camera, level.exaggeration(), tiles);
                Sight { camera, ground_m: is_in_order.then_some(ground_m) }
            }),
        );
        let mut tile_count = 0;
        for (at, leaf) in self.truncation.elevation_leaves().iter().enumerate() {
            let snaps = self.decimation.snaps(&self.truncation, at, leaf);
            let (heights, culling) = (&mut self.heights, &mut self.culling);
            let position = out.array(&mut |values| {
                heights.make(level, tiles, leaf, snaps.0, values)?;
                culling.enter(leaf.node, values, snaps);
                Ok(())
            })?;
            for color in self.truncation.colors_of(leaf) {
                let mut slot = tile_slot(&self.world, leaf, color, position, snaps);
                if !self.is_culled || self.culling.cull(&mut slot) {
                    out.slot(&SlotContent::Tile(slot))?;
                    tile_count += 1;
                }
            }
            self.culling.leave();
        }
        Ok(tile_count)
    }

    /// Closes the frame.
    fn end(
        &self,
        counts: FrameCounts,
        request: &FrameRequest<'_>,
        tree: &FrameTree,
        out: &mut impl FrameOutput,
    ) -> Result<FrameCounts, FrameError> {
        let (wanted, nodes) = (tree.wanted().len() as u32, self.truncation.node_count());
        let counts = FrameCounts { wanted, nodes, ..counts };
        out.slot(&SlotContent::End(FrameEnd {
            frame: request.header.frame,
            tile_count: counts.tiles,
            unavailable_count: counts.unavailable,
            elevation_end: out.next_position(),
            wanted_count: counts.wanted,
            node_count: counts.nodes,
            elevation_tile_count: counts.elevations,
            reserved: 0,
        }))?;
        out.finish()?;
        Ok(counts)
    }
}

/// Height of the root's ground under the eye, metres, exaggerated; above every eye when nothing is
/// drawn.
fn ground_under_eye(world: &World, camera: &Camera, exaggeration: f64, tiles: &impl Tiles) -> f64 {
    let root = world.root();
    let under = world.plane().lattice_under(camera.eye());
    let height = |posts| exaggeration * node_elevation(world.surface(), root, posts, under);
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
    let [start, sides] = world.surface().block_of(leaf.node, color.node);
    let origin = world.node_origin(leaf.node);
    // Vertices beyond the extent collapse onto it: facets past the first of them are degenerate,
    // unless an edge snaps, which needs the vertices that it snaps to. The step of an edge is never
    // finer than that of the leaf.
    let step = 1u64 << edge_snap.into_iter().max().unwrap_or(0);
    let inside = world.surface().cells_inside(leaf.node);
    let end = [0, 1].map(|axis| u64::from(start[axis] + sides[axis]).min(inside[axis].next_multiple_of(step)) as u16);
    let lattice = |[x, y]: [u64; 2]| [x as u32, y as u32];
    TileSlot {
        node: color.node.pack(),
        elevation_position,
        elevation_origin: lattice(origin),
        color_origin: lattice(world.node_origin(color.color.node)),
        start: start.map(|v| v as u16),
        end,
        color_slot: color.color.key.slot.get(),
        color_generation: color.color.key.generation.get(),
        elevation_level: q,
        color_level: color.color.node.q(),
        edge_snap,
        grid_snap,
        unseen_by: 0,
    }
}
