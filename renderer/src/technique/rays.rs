//! From a slot of the ring to a tile of ground for rays: the same block of the same elevation array
//! that the mesh draws, at the step that it is drawn with.

use crate::frame::TileFault;
use crate::source::{Pools, SourceError};
use terravision_common::node::NodeId;
use terravision_common::slot::TileSlot;
use terravision_common::validity::PLANES;
use terravision_common::world::World;
use terravision_raycast::model::color::ColorPlace;
use terravision_raycast::model::{PatchSpec, TileSpec};

/// Reads blocks; keeps its buffers.
#[derive(Debug)]
pub struct BlockReader {
    world: World,
    /// The elevation array that was read last, and its position.
    array: Vec<f32>,
    position: Option<u64>,
    /// Planes of the block: heights, shares of ground, shares that were measured.
    planes: [Vec<f32>; PLANES],
}

impl BlockReader {
    /// Buffers for slots of a world.
    #[must_use]
    pub fn new(world: &World) -> Self {
        let posts = (world.elevation_posts() as usize).pow(2);
        let planes =
            std::array::from_fn(|plane| Vec::with_capacity(if plane < world.elevation_planes() { posts } else { 0 }));
        Self { world: *world, array: vec![0.0; world.elevation_values()], position: None, planes }
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> World {
        self.world
    }

    /// The tile of a checked slot: all of its colour leaf, also what was culled, with the colours
    /// of this layer. Heights are above `eye_z_m`.
    ///
    /// # Errors
    /// The source is damaged; within, what is wrong with the slot.
    pub fn read(
        &mut self,
        tile: &TileSlot,
        pools: &mut dyn Pools,
        eye_z_m: f64,
        layer: u32,
    ) -> Result<Result<TileSpec<'_>, TileFault>, SourceError> {
        let Some(SlotBlock { node, start, cells, stretch }) = block_of(&self.world, tile) else {
            return Ok(Err(TileFault::Block));
        };
        if self.position != Some(tile.elevation_position) {
            self.position = None;
            if !pools.read_elevation(tile.elevation_position, &mut self.array)? {
                return Ok(Err(TileFault::Elevation));
            }
            self.position = Some(tile.elevation_position);
        }
        let (posts, step) = (self.world.elevation_posts() as usize, 1usize << tile.grid_snap);
        let [columns, rows] = cells.map(|n| n as usize + 1);
        let origin = self.world.node_origin(node);
        let first = start[1] as usize * posts + start[0] as usize;
        let is_as_it_is = step == 1 && stretch == [1.0; 2];
        let stored = self.array.chunks_exact(posts * posts).map(|plane| &plane[first..]);
        if !is_as_it_is {
            for (plane, out) in stored.clone().zip(&mut self.planes) {
                out.clear();
                for row in plane.chunks(posts * step).take(rows) {
                    out.extend(row.iter().step_by(step).take(columns));
                }
                for (axis, factor) in stretch.into_iter().enumerate() {
                    reach_over_border(out, axis, [columns, rows], factor);
                }
            }
        }
        let stride = if is_as_it_is { posts } else { columns };
        let mut planes = [&[][..]; PLANES];
        for ((out, stored), made) in planes.iter_mut().zip(stored).zip(&self.planes) {
            *out = if is_as_it_is { stored } else { made };
        }
        let [heights, ground, measured] = planes;
        Ok(Ok(TileSpec {
            origin: origin.map(|v| v as u32),
            level: node.q(),
            log_spacing: tile.elevation_level + tile.grid_snap,
            cells,
            heights,
            shares: self.world.has_validity().then_some([ground, measured]),
            stride,
            datum_m: eye_z_m,
            color: ColorPlace::of_tile(&self.world, layer, tile.color_origin, tile.color_level),
            is_accurate: true,
        }))
    }

    /// The part of a ground in place that a checked slot is: all of its colour leaf, with the colours
    /// of this layer.
    ///
    /// # Errors
    /// What is wrong with the slot.
    pub fn patch(&self, tile: &TileSlot, layer: u32) -> Result<PatchSpec, TileFault> {
        let SlotBlock { node, cells, .. } = block_of(&self.world, tile).ok_or(TileFault::Block)?;
        Ok(PatchSpec {
            origin: self.world.node_origin(node).map(|v| v as u32),
            level: node.q(),
            log_spacing: tile.elevation_level + tile.grid_snap,
            cells,
            color: ColorPlace::of_tile(&self.world, layer, tile.color_origin, tile.color_level),
        })
    }

    /// A frame begins: no array has been read.
    pub fn forget(&mut self) {
        self.position = None;
    }
}

/// What rays see of a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SlotBlock {
    /// The colour leaf.
    pub(super) node: NodeId,
    /// Its first post in the elevation array.
    pub(super) start: [u32; 2],
    /// Its cells inside of the world, at the step that it is drawn with.
    pub(super) cells: [u32; 2],
    /// By how much the last cells east and north reach over the world's border, where vertices past
    /// it lie; 1 for not at all.
    pub(super) stretch: [f32; 2],
}

/// The block of a slot: all of its colour leaf, also what was culled.
pub(super) fn block_of(world: &World, tile: &TileSlot) -> Option<SlotBlock> {
    let node = tile.node().filter(|node| node.q() <= tile.elevation_level)?;
    let posts = world.elevation_tile() >> (tile.elevation_level - node.q());
    let step = 1u32 << tile.grid_snap;
    if posts < step {
        return None;
    }
    let origin = world.node_origin(node);
    let inside = world.plane().cells_inside(origin, tile.elevation_level + tile.grid_snap);
    let (mut start, mut cells) = ([0; 2], [0; 2]);
    for axis in 0..2 {
        let from_array = origin[axis].checked_sub(u64::from(tile.elevation_origin[axis]))?;
        start[axis] = u32::try_from(from_array >> tile.elevation_level).ok()?;
        cells[axis] = inside[axis].filter(|cells| *cells > 0)?.min(u64::from(posts / step)) as u32;
        let is_in_array = start[axis].is_multiple_of(step) && start[axis] + posts <= world.elevation_tile();
        // The block that is to be drawn is part of it.
        let [first, last] = [tile.start[axis], tile.end[axis]].map(u32::from);
        if !is_in_array || first < start[axis] || last > start[axis] + posts {
            return None;
        }
    }
    let log_spacing = tile.elevation_level + tile.grid_snap;
    let stretch = [0, 1].map(|axis| {
        let before = origin[axis] + (u64::from(cells[axis] - 1) << log_spacing);
        let inside = u64::from(world.extent()[axis]).saturating_sub(before);
        let is_cut = inside > 0 && inside < 1 << log_spacing;
        if is_cut { (1u64 << log_spacing) as f32 / inside as f32 } else { 1.0 }
    });
    Some(SlotBlock { node, start, cells, stretch })
}

/// Vertices past the world's border lie on it. Here every cell has its full width, and the ground
/// ends within the last one: its far posts continue the slope that leads to the border.
fn reach_over_border(heights: &mut [f32], axis: usize, [columns, rows]: [usize; 2], factor: f32) {
    if factor == 1.0 {
        return;
    }
    let [along, across, others, count] =
        if axis == 0 { [1, columns, rows, columns] } else { [columns, 1, columns, rows] };
    for other in 0..others {
        let last = other * across + (count - 1) * along;
        let before = heights[last - along];
        heights[last] = before + (heights[last] - before) * factor;
    }
}
