//! The rays pass: exact rays through blocks of elevation arrays, by compute shaders, then colour
//! and depth of what they meet.

use super::pipeline::{self, PipelineShape, Words};
use crate::gpu::barrier::{self, Access};
use crate::gpu::buffer::{Buffer, BufferUse};
use crate::gpu::color_pool::ColorPool;
use crate::gpu::device::Device;
use crate::gpu::elevation::Elevation;
use crate::gpu::error::GpuError;
use crate::gpu::frame::FrameRecording;
use crate::gpu::owned::Owned;
use crate::gpu::target::Target;
use ash::vk;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

static CAST: &Words<[u8]> = &Words(*include_bytes!(concat!(env!("OUT_DIR"), "/rays-cast.spv")));
static COLOR: &Words<[u8]> = &Words(*include_bytes!(concat!(env!("OUT_DIR"), "/rays-color.spv")));

/// `Frame` of `rays/shared.wgsl`: the view, as push constants.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayView {
    /// Direction of depth 1 through the centre of the upper left pixel.
    pub first: [f32; 3],
    /// Near plane, metres.
    pub near_m: f32,
    /// Its change per column.
    pub per_column: [f32; 3],
    /// The tree's root, as the children of nodes.
    pub root: u32,
    /// Its change per row.
    pub per_row: [f32; 3],
    /// Columns (low half) and rows of the picture.
    pub size: u32,
    /// South west corner of all ground, metres from the eye.
    pub bounds_low: [f32; 2],
    /// North east corner.
    pub bounds_high: [f32; 2],
    /// South west corner of the tree's root, metres from the eye.
    pub root_low: [f32; 2],
    /// Its side, metres.
    pub root_side: f32,
    /// Which maxima are made; set by [`RaysPass::prepare`].
    pub turn: u32,
    /// Whether facets are seen from below, 0 or 1.
    pub has_undersides: u32,
    /// Values of an elevation array's plane; 0 in a world without validity.
    pub plane: u32,
    /// What elevations are above, metres above the eye.
    pub datum_m: f32,
    /// Zero.
    pub reserved: u32,
}

/// `Tile` of `rays/shared.wgsl`: one block.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayTile {
    /// South west corner, metres from the eye.
    pub corner: [f32; 2],
    /// Cells per metre.
    pub cells_per_m: f32,
    /// Index of the block's first post among the elevations.
    pub array_start: u32,
    /// Cells east and north, at least 1.
    pub cells: [u32; 2],
    /// Values from post to post east, and north.
    pub strides: [u32; 2],
    /// By how much the last cells east and north reach over the world's border; 1 for not at all.
    pub stretch: [f32; 2],
    /// Index of its first maximum; set by [`RaysPass::prepare`].
    pub maxima_start: u32,
    /// Layer of the colour pool.
    pub color_layer: u32,
    /// Where the texture begins in the south west, metres from the eye.
    pub color_corner: [f32; 2],
    /// Texture coordinates per metre.
    pub color_per_m: f32,
    /// Colour of the outline, RGBA8.
    pub outline: u32,
}

/// `Node` of `rays/cast.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct RayNode {
    /// South west, south east, north west, north east: [`RayNode::EMPTY`], a tile's index with
    /// [`RayNode::IS_TILE`], or a node's.
    pub children: [u32; 4],
    /// Where the children meet, metres from the eye.
    pub middle: [f32; 2],
    /// Zero.
    pub reserved: [u32; 2],
}

impl RayNode {
    /// No child.
    pub const EMPTY: u32 = u32::MAX;
    /// A child is a tile.
    pub const IS_TILE: u32 = 1 << 31;
}

const _: () = assert!(size_of::<RayView>() == 96 && size_of::<RayTile>() == 64 && size_of::<RayNode>() == 32);
const _: () = assert!(size_of::<RayView>() <= crate::gpu::requirements::PUSH_CONSTANT_BYTES as usize);

/// Bytes of what a pixel sees (`Hit` of `rays/shared.wgsl`).
const HIT_BYTES: u64 = 16;
/// Blocks and nodes that a slot has room for at first; it grows.
const FIRST_TILES: usize = 1024;
/// Maxima that a slot has room for at first; it grows.
const FIRST_MAXIMA: usize = 1 << 16;
/// Pixels of a work group, a side: as in `rays/cast.wgsl`.
const GROUP_SIDE: u32 = 8;
/// Maxima of a work group: as in `rays/cast.wgsl`.
const GROUP_MAXIMA: u32 = 64;
/// Bindings: elevations, tiles, nodes, maxima, hits.
const BINDINGS: usize = 5;
const STAGES: vk::ShaderStageFlags = vk::ShaderStageFlags::from_raw(
    vk::ShaderStageFlags::COMPUTE.as_raw()
        | vk::ShaderStageFlags::FRAGMENT.as_raw()
        | vk::ShaderStageFlags::VERTEX.as_raw(),
);

/// What one draw of one frame in flight has of its own.
#[derive(Debug)]
struct DrawInputs {
    buffers: Option<InputBuffers>,
    set: vk::DescriptorSet,
}

#[derive(Debug)]
struct InputBuffers {
    tiles: Buffer,
    nodes: Buffer,
    maxima: Buffer,
    hits: Buffer,
}

/// Pipelines and inputs of the rays pass.
#[derive(Debug)]
pub struct RaysPass {
    model: Owned<vk::Pipeline>,
    cast: Owned<vk::Pipeline>,
    color: Owned<vk::Pipeline>,
    layout: Owned<vk::PipelineLayout>,
    _set_layout: Owned<vk::DescriptorSetLayout>,
    _descriptors: Owned<vk::DescriptorPool>,
    /// Of each frame slot its draws.
    slots: Vec<Vec<DrawInputs>>,
}

impl RaysPass {
    /// For views no larger than `target` at first, and this many frame slots, each with this many
    /// draws. `has_overlay`: outlines of the blocks.
    ///
    /// # Errors
    /// Out of memory, or the picture is too large for the device's buffers.
    pub fn new(
        colors: &ColorPool,
        target: &Target,
        has_overlay: bool,
        [slots, draws]: [usize; 2],
    ) -> Result<Self, GpuError> {
        let device = colors.device();
        checked(device, "bytes of what pixels see", hit_bytes(target.size()))?;
        let set_layout = pipeline::storage_layout(device, BINDINGS, STAGES)?;
        let (descriptors, sets) = pipeline::storage_sets(device, &set_layout, BINDINGS, slots * draws)?;
        let layout = pipeline::layout(device, &[set_layout.get(), colors.set_layout()], STAGES)?;
        let module = pipeline::module(device, &CAST.0, "rays")?;
        let model = pipeline::compute(device, &module, &layout, c"model", "models of rays")?;
        let cast = pipeline::compute(device, &module, &layout, c"cast_ray", "rays")?;
        let module = pipeline::module(device, &COLOR.0, "colours of rays")?;
        let fragment = if has_overlay { c"fragment_overlay" } else { c"fragment" };
        let shape = PipelineShape {
            vertex: c"vertex",
            fragment: Some(fragment),
            has_color: true,
            samples: 1,
            name: "colours of rays",
        };
        let color = pipeline::pipeline(device, &module, &layout, &shape)?;
        let inputs = |set: &vk::DescriptorSet| DrawInputs { buffers: None, set: *set };
        let slots = sets.chunks(draws.max(1)).map(|sets| sets.iter().map(inputs).collect()).collect();
        Ok(Self { model, cast, color, layout, _set_layout: set_layout, _descriptors: descriptors, slots })
    }

    /// Casts the rays of a view in the `index`-th draw of the frame being recorded; before
    /// rendering begins. Blocks lie within the elevations, and the tree of nodes is one.
    ///
    /// # Errors
    /// Out of memory, or no elevations were staged.
    pub fn prepare(
        &mut self,
        recording: &mut FrameRecording<'_>,
        elevation: &Elevation,
        (index, view): (usize, &RayView),
        tiles: &mut [RayTile],
        nodes: &[RayNode],
    ) -> Result<(), GpuError> {
        let slot = recording.slot_index();
        let device = Arc::clone(recording.device());
        let limit = self.slots.first().map_or(0, Vec::len) as u64;
        let (Some(slot), Some(elevations)) =
            (self.slots.get_mut(slot).and_then(|draws| draws.get_mut(index)), elevation.buffer(slot))
        else {
            return Err(GpuError::TooMany { what: "draws of a frame by rays", found: index as u64 + 1, limit });
        };
        let size = [view.size & 0xffff, view.size >> 16];
        checked(&device, "bytes of what pixels see", hit_bytes(size))?;
        let (mut maxima, mut most) = (0u64, 0u32);
        for tile in tiles.iter_mut() {
            let count = maxima_of(tile.cells);
            tile.maxima_start = u32::try_from(maxima).unwrap_or(u32::MAX);
            maxima += u64::from(count);
            most = most.max(count);
        }
        checked(&device, "bytes of maxima", maxima * 4)?;
        slot.fill(&device, tiles, nodes, maxima as usize, hit_bytes(size))?;
        slot.bind(&device, elevations);
        let commands = recording.commands();
        let compute = vk::PipelineBindPoint::COMPUTE;
        let groups = size.map(|side| side.div_ceil(GROUP_SIDE));
        let constants = |turn: u32| RayView { turn, ..*view };
        // SAFETY: recording, outside of rendering; the set's buffers have room for all that the
        // shaders index; every object waits for the submit before it goes.
        unsafe {
            device.raw().cmd_bind_descriptor_sets(commands, compute, self.layout.get(), 0, &[slot.set], &[]);
            device.raw().cmd_bind_pipeline(commands, compute, self.model.get());
            for turn in 0..2 {
                let constants = constants(turn);
                let bytes = bytemuck::bytes_of(&constants);
                device.raw().cmd_push_constants(commands, self.layout.get(), STAGES, 0, bytes);
                if most > 0 {
                    device.raw().cmd_dispatch(commands, most.div_ceil(GROUP_MAXIMA), tiles.len() as u32, 1);
                }
                barrier::memory(&device, commands, Access::Computed, Access::Computed);
            }
            device.raw().cmd_bind_pipeline(commands, compute, self.cast.get());
            device.raw().cmd_dispatch(commands, groups[0], groups[1], 1);
            barrier::memory(&device, commands, Access::Computed, Access::ReadByFragments);
        }
        Ok(())
    }

    /// Draws what the rays of the `index`-th draw of the frame being recorded have met; within
    /// rendering.
    pub fn draw(&self, recording: &mut FrameRecording<'_>, colors: &ColorPool, (index, view): (usize, &RayView)) {
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let Some(slot) = self.slots.get(recording.slot_index()).and_then(|draws| draws.get(index)) else { return };
        let sets = [slot.set, colors.set()];
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: recording, within rendering of the pipeline's formats; every object waits for the
        // submit before it goes.
        unsafe {
            device.raw().cmd_set_cull_mode(commands, vk::CullModeFlags::NONE);
            device.raw().cmd_bind_pipeline(commands, graphics, self.color.get());
            device.raw().cmd_bind_descriptor_sets(commands, graphics, self.layout.get(), 0, &sets, &[]);
            device.raw().cmd_push_constants(commands, self.layout.get(), STAGES, 0, bytemuck::bytes_of(view));
            device.raw().cmd_draw(commands, 3, 1, 0, 0);
        }
    }
}

impl DrawInputs {
    /// Takes a draw's blocks and nodes in, and makes room for their maxima and for what pixels see.
    fn fill(
        &mut self,
        device: &Arc<Device>,
        tiles: &[RayTile],
        nodes: &[RayNode],
        maxima: usize,
        hit_bytes: u64,
    ) -> Result<(), GpuError> {
        let buffers = match &mut self.buffers {
            Some(buffers) => buffers,
            None => self.buffers.insert(InputBuffers {
                tiles: tile_buffer(device, FIRST_TILES)?,
                nodes: node_buffer(device, FIRST_TILES)?,
                maxima: maxima_buffer(device, FIRST_MAXIMA)?,
                hits: hit_buffer(device, hit_bytes)?,
            }),
        };
        let (tile_bytes, node_bytes): (&[u8], &[u8]) = (bytemuck::cast_slice(tiles), bytemuck::cast_slice(nodes));
        if buffers.tiles.len() < tile_bytes.len() as u64 {
            buffers.tiles = tile_buffer(device, tiles.len().next_power_of_two())?;
        }
        if buffers.nodes.len() < node_bytes.len() as u64 {
            buffers.nodes = node_buffer(device, nodes.len().next_power_of_two())?;
        }
        if buffers.maxima.len() < maxima as u64 * 4 {
            buffers.maxima = maxima_buffer(device, maxima.next_power_of_two())?;
        }
        if buffers.hits.len() < hit_bytes {
            buffers.hits = hit_buffer(device, hit_bytes)?;
        }
        buffers.tiles.bytes_mut()[..tile_bytes.len()].copy_from_slice(tile_bytes);
        buffers.nodes.bytes_mut()[..node_bytes.len()].copy_from_slice(node_bytes);
        Ok(())
    }

    fn bind(&self, device: &Device, elevations: &Buffer) {
        let Some(InputBuffers { tiles, nodes, maxima, hits }) = &self.buffers else { return };
        let buffers = [elevations, tiles, nodes, maxima, hits]
            .map(|buffer| [vk::DescriptorBufferInfo::default().buffer(buffer.raw()).range(vk::WHOLE_SIZE)]);
        let writes: [_; BINDINGS] = std::array::from_fn(|binding| {
            vk::WriteDescriptorSet::default()
                .dst_set(self.set)
                .dst_binding(binding as u32)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .buffer_info(&buffers[binding])
        });
        // SAFETY: buffers and set are alive, and the set is in no pending submit: a frame of its
        // slot is being recorded.
        unsafe { device.raw().update_descriptor_sets(&writes, &[]) };
    }
}

/// Maxima of a block: those of a square of a power of two, of which it may fill a part
/// (`level_start` of `rays/cast.wgsl`).
fn maxima_of(cells: [u32; 2]) -> u32 {
    let side = cells[0].max(cells[1]).next_power_of_two();
    (side * side - 1) / 3
}

/// A number of bytes that the device can bind.
fn checked(device: &Device, what: &'static str, bytes: u64) -> Result<(), GpuError> {
    let limit = device.capabilities().max_storage_range;
    if bytes > limit { Err(GpuError::TooMany { what, found: bytes, limit }) } else { Ok(()) }
}

fn hit_bytes([width, height]: [u32; 2]) -> u64 {
    u64::from(width) * u64::from(height) * HIT_BYTES
}

fn hit_buffer(device: &Arc<Device>, bytes: u64) -> Result<Buffer, GpuError> {
    Buffer::new(device, bytes, BufferUse::Scratch, "what pixels see")
}

fn tile_buffer(device: &Arc<Device>, tiles: usize) -> Result<Buffer, GpuError> {
    Buffer::new(device, (tiles * size_of::<RayTile>()) as u64, BufferUse::Storage, "tiles of rays")
}

fn node_buffer(device: &Arc<Device>, nodes: usize) -> Result<Buffer, GpuError> {
    Buffer::new(device, (nodes * size_of::<RayNode>()) as u64, BufferUse::Storage, "nodes of rays")
}

fn maxima_buffer(device: &Arc<Device>, maxima: usize) -> Result<Buffer, GpuError> {
    Buffer::new(device, maxima as u64 * 4, BufferUse::Scratch, "maxima")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_has_the_maxima_of_its_square() {
        let found = [[1, 1], [2, 1], [2, 2], [3, 4], [5, 2], [128, 128]].map(maxima_of);
        assert_eq!(found, [0, 1, 1, 5, 21, (128 * 128 - 1) / 3]);
    }
}
