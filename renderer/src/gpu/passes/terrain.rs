//! The terrain pass: blocks of elevation arrays, textured from the colour pool.

use super::pipeline::{self, PipelineShape, Words, grid_indices};
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
use std::ffi::CStr;
use std::sync::Arc;
use terravision_common::world::World;

static SPIRV: &Words<[u8]> = &Words(*include_bytes!(concat!(env!("OUT_DIR"), "/mesh.spv")));
/// The same for bodies.
static GLOBE_SPIRV: &Words<[u8]> = &Words(*include_bytes!(concat!(env!("OUT_DIR"), "/mesh-globe.spv")));

/// `Frame` of `mesh.wgsl`: the view, as push constants.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ViewParameters {
    /// First row of the matrix from positions relative to the eye to clip coordinates.
    pub clip_x: [f32; 3],
    /// Lattice unit, metres; of a body, the eye's height above the ellipsoid.
    pub unit_m: f32,
    /// Second row.
    pub clip_y: [f32; 3],
    /// Near plane, metres.
    pub near_m: f32,
    /// Fourth row (the third is `near_m` alone: reversed depth without far plane).
    pub clip_w: [f32; 3],
    /// 1 / posts of an elevation array's side.
    pub posts_reciprocal: f32,
    /// The eye within its lattice cell, metres; of a body, sine and cosine of its latitude.
    pub eye_in_cell_m: [f32; 2],
    /// Last lattice point of the world, from the eye's cell.
    pub extent_from_cell: [i32; 2],
    /// Posts of an elevation array's side.
    pub posts: u32,
    /// Border of a colour tile over its stored side.
    pub color_border: f32,
    /// Steps of the rasterizer's grid of vertices from the picture's centre to its edges.
    pub grid: [f32; 2],
    /// What elevations are above, metres above the eye.
    pub datum_m: f32,
    /// Zero.
    pub reserved: [u32; 3],
}

/// `Tile` of `mesh.wgsl`: one block.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TileParameters {
    /// Lower left corner of the elevation leaf, lattice units from the eye's cell; of a body, where the
    /// terms of its columns and of its rows begin.
    pub origin_from_cell: [i32; 2],
    /// Lower left corner of the colour tile's node, likewise; of a body, in posts from the leaf's corner.
    pub color_origin_from_cell: [i32; 2],
    /// Index of the elevation array's first value.
    pub array_start: u32,
    /// Bits 0-7: level; then four bits each: snap of the west, east, south, north edge.
    pub level_and_snap: u32,
    /// Texture coordinates per lattice unit; of a body, per post, east.
    pub color_scale: f32,
    /// Layer of the colour pool.
    pub color_layer: u32,
    /// First column (low half) and row (high half).
    pub block_start: u32,
    /// Last column and row.
    pub block_end: u32,
    /// Colour of the outline, RGBA8.
    pub outline: u32,
    /// Of a body: texture coordinates per post, north.
    pub color_scale_north: f32,
}

const _: () = assert!(size_of::<ViewParameters>() == 96 && size_of::<TileParameters>() == 48);

/// Columns and rows of a block, in posts: `start` within the array, `size` at least 1, both
/// multiples of `1 << snap`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block {
    /// First column and row.
    pub start: [u32; 2],
    /// Columns and rows.
    pub size: [u32; 2],
    /// log2 of the posts from vertex to vertex.
    pub snap: u32,
}

/// Which sides of the ground are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sides {
    /// The upper side alone.
    Upper,
    /// Both.
    Both,
}

/// What is drawn by one call of [`TerrainPass::draw`].
#[derive(Debug, Clone, Copy)]
pub struct TerrainView<'a> {
    /// The view.
    pub parameters: &'a ViewParameters,
    /// Blocks, each with the number of its tile among those of [`TerrainPass::prepare`].
    pub blocks: &'a [(u32, Block)],
    /// Which sides.
    pub sides: Sides,
    /// The pass of [`Target::begin_depth`].
    pub is_depth_only: bool,
}

/// Tiles that a slot has room for at first; it grows.
const FIRST_TILES: usize = 1024;
/// Terms of columns and rows, likewise.
const FIRST_TERMS: usize = 1 << 16;

#[derive(Debug)]
struct SlotInputs {
    tiles: Buffer,
    /// Terms of columns and rows, of a body.
    terms: Option<Buffer>,
    set: vk::DescriptorSet,
}

/// Pipelines and inputs of the terrain pass.
#[derive(Debug)]
pub struct TerrainPass {
    picture: Owned<vk::Pipeline>,
    depth_only: Option<Owned<vk::Pipeline>>,
    layout: Owned<vk::PipelineLayout>,
    _set_layout: Owned<vk::DescriptorSetLayout>,
    _descriptors: Owned<vk::DescriptorPool>,
    slots: Vec<SlotInputs>,
    indices: Buffer,
    /// By snap: first index of the section whose rows have `1 << k` facets' sides.
    sections: Vec<Vec<u32>>,
    posts: u32,
}

impl TerrainPass {
    /// For pictures like those of `target`, elevation arrays of a world, and this many frame slots.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(
        colors: &ColorPool,
        target: &Target,
        world: &World,
        has_overlay: bool,
        slots: usize,
    ) -> Result<Self, GpuError> {
        let device = colors.device();
        let (posts, has_validity) = (world.elevation_posts(), world.has_validity());
        let stages = vk::ShaderStageFlags::VERTEX;
        let is_body = world.globe().is_some();
        let buffers = if is_body { 3 } else { 2 };
        let set_layout = pipeline::storage_layout(device, buffers, stages)?;
        let (descriptors, sets) = pipeline::storage_sets(device, &set_layout, buffers, slots)?;
        let layout = pipeline::layout(device, &[set_layout.get(), colors.set_layout()], stages)?;
        let module = pipeline::module(device, if is_body { &GLOBE_SPIRV.0 } else { &SPIRV.0 }, "mesh")?;
        let (vertex, fragment) = entries(has_overlay, has_validity);
        let shape = PipelineShape {
            vertex,
            fragment: Some(fragment),
            has_color: true,
            samples: target.samples(),
            name: "terrain picture",
        };
        let picture = pipeline::pipeline(device, &module, &layout, &shape)?;
        let depth_only = if target.has_depth_pass() {
            let (vertex, fragment) = match has_validity {
                true => (c"vertex_valid", Some(c"fragment_depth_valid")),
                false => (c"vertex", None),
            };
            let shape = PipelineShape { vertex, fragment, has_color: false, samples: 1, name: "terrain depth" };
            Some(pipeline::pipeline(device, &module, &layout, &shape)?)
        } else {
            None
        };
        let (indices, sections) = index_sections(posts);
        let indices = Buffer::with_indices(device, &indices, "terrain indices")?;
        let slots = sets
            .into_iter()
            .map(|set| {
                let terms = is_body.then(|| term_buffer(device, FIRST_TERMS)).transpose()?;
                Ok(SlotInputs { tiles: tile_buffer(device, FIRST_TILES)?, terms, set })
            })
            .collect::<Result<Vec<_>, GpuError>>()?;
        Ok(Self {
            picture,
            depth_only,
            layout,
            _set_layout: set_layout,
            _descriptors: descriptors,
            slots,
            indices,
            sections,
            posts,
        })
    }

    /// Gives the frame being recorded its tiles and elevations; before rendering begins.
    ///
    /// # Errors
    /// Out of memory, or no elevations were staged.
    pub fn prepare(
        &mut self,
        recording: &FrameRecording<'_>,
        elevation: &Elevation,
        tiles: &[TileParameters],
        terms: &[f32],
    ) -> Result<(), GpuError> {
        let index = recording.slot_index();
        let (device, limit) = (recording.device(), self.slots.len() as u64);
        let (Some(slot), Some(elevations)) = (self.slots.get_mut(index), elevation.buffer(index)) else {
            return Err(GpuError::TooMany { what: "frame slots", found: index as u64 + 1, limit });
        };
        let bytes: &[u8] = bytemuck::cast_slice(tiles);
        if slot.tiles.len() < bytes.len() as u64 {
            slot.tiles = tile_buffer(device, tiles.len().next_power_of_two())?;
        }
        slot.tiles.bytes_mut()[..bytes.len()].copy_from_slice(bytes);
        if let Some(buffer) = &mut slot.terms {
            let bytes: &[u8] = bytemuck::cast_slice(terms);
            if buffer.len() < bytes.len() as u64 {
                *buffer = term_buffer(device, terms.len().next_power_of_two())?;
            }
            buffer.bytes_mut()[..bytes.len()].copy_from_slice(bytes);
        }
        let buffers = [Some(elevations), Some(&slot.tiles), slot.terms.as_ref()].map(|buffer| {
            buffer.map(|buffer| [vk::DescriptorBufferInfo::default().buffer(buffer.raw()).range(vk::WHOLE_SIZE)])
        });
        // A frame allocates nothing.
        let mut writes = [vk::WriteDescriptorSet::default(); 3];
        let mut count = 0;
        for ((binding, buffer), write) in (0u32..).zip(&buffers).zip(&mut writes) {
            let Some(buffer) = buffer else { break };
            *write = vk::WriteDescriptorSet::default()
                .dst_set(slot.set)
                .dst_binding(binding)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .buffer_info(buffer);
            count += 1;
        }
        // SAFETY: buffers and set are alive, and the set is in no pending submit: `recording` is of
        // its slot.
        unsafe { device.raw().update_descriptor_sets(&writes[..count], &[]) };
        Ok(())
    }

    /// Draws blocks in this order; within rendering.
    pub fn draw(&self, recording: &mut FrameRecording<'_>, colors: &ColorPool, view: &TerrainView<'_>) {
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let pipeline =
            if view.is_depth_only { self.depth_only.as_ref().unwrap_or(&self.picture) } else { &self.picture };
        let Some(slot) = self.slots.get(recording.slot_index()) else { return };
        let sets = [slot.set, colors.set()];
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        let culled = match view.sides {
            Sides::Upper => vk::CullModeFlags::BACK,
            Sides::Both => vk::CullModeFlags::NONE,
        };
        // SAFETY: recording, within rendering of the pipeline's formats; every object waits for the
        // submit before it goes.
        unsafe {
            device.raw().cmd_set_cull_mode(commands, culled);
            device.raw().cmd_bind_pipeline(commands, graphics, pipeline.get());
            device.raw().cmd_bind_descriptor_sets(commands, graphics, self.layout.get(), 0, &sets, &[]);
            device.raw().cmd_bind_index_buffer(commands, self.indices.raw(), 0, vk::IndexType::UINT32);
            device.raw().cmd_push_constants(
                commands,
                self.layout.get(),
                vk::ShaderStageFlags::VERTEX,
                0,
                bytemuck::bytes_of(view.parameters),
            );
        }
        for &(instance, block) in view.blocks {
            let draw = |indices: u32, first: u32, row: u32| {
                let vertex = (block.start[1] + (row << block.snap)) * self.posts + block.start[0];
                // SAFETY: as above; indices and first lie inside the index buffer (`sections`),
                // vertices inside the array: `Block`s were checked against its size, and
                // `robustBufferAccess` is on.
                unsafe {
                    device.raw().cmd_draw_indexed(commands, indices, 1, first, vertex.cast_signed(), instance);
                }
            };
            let Some(sections) = self.sections.get(block.snap as usize) else { continue };
            let [columns, rows] = block.size.map(|n| n.min(self.posts - 1) >> block.snap);
            if columns.is_power_of_two() {
                draw(columns * rows * 6, sections[columns.ilog2() as usize], 0);
            } else if let Some(&widest) = sections.last() {
                // No section has rows of this width: the beginnings of wider rows, one by one.
                (0..rows).for_each(|row| draw(columns * 6, widest, row));
            }
        }
    }
}

/// The shader's entries for pictures: with outlines or not, of a world with validity or not. Pixels
/// of several samples are in a hole or not as a whole, by their centre, as their depth is: naga
/// writes no sample mask that Vulkan takes.
fn entries(has_overlay: bool, has_validity: bool) -> (&'static CStr, &'static CStr) {
    match (has_overlay, has_validity) {
        (false, false) => (c"vertex", c"fragment"),
        (true, false) => (c"vertex_overlay", c"fragment_overlay"),
        (false, true) => (c"vertex_valid", c"fragment_valid"),
        (true, true) => (c"vertex_overlay_valid", c"fragment_overlay_valid"),
    }
}

/// Index sections by snap, for rows of 1, 2, 4, … facets' sides; a block of fewer rows uses the
/// first part of a section.
fn index_sections(posts: u32) -> (Vec<u32>, Vec<Vec<u32>>) {
    let intervals = posts - 1;
    let mut indices = Vec::new();
    let sections = (0..=intervals.ilog2()).map(|snap| {
        let rows = intervals >> snap;
        let sections = (0..=rows.ilog2()).map(|log_columns| {
            let first = indices.len() as u32;
            indices.extend(grid_indices(1 << log_columns, rows, [1 << snap, posts << snap]));
            first
        });
        sections.collect()
    });
    let sections = sections.collect();
    (indices, sections)
}

fn tile_buffer(device: &Arc<Device>, tiles: usize) -> Result<Buffer, GpuError> {
    Buffer::new(device, (tiles * size_of::<TileParameters>()) as u64, BufferUse::Storage, "terrain tiles")
}

fn term_buffer(device: &Arc<Device>, terms: usize) -> Result<Buffer, GpuError> {
    Buffer::new(device, (terms * size_of::<f32>()) as u64, BufferUse::Storage, "terms of columns and rows")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_cover_their_blocks_with_facets_split_from_south_west_to_north_east() {
        let (indices, sections) = index_sections(5);
        assert_eq!(sections.iter().map(Vec::len).collect::<Vec<_>>(), [3, 2, 1]);
        let full = &indices[sections[0][2] as usize..sections[1][0] as usize];
        assert_eq!(full.len(), 4 * 4 * 6);
        assert_eq!(&full[..6], [0, 1, 6, 0, 6, 5]);
        let narrow = &indices[sections[0][1] as usize..sections[0][2] as usize];
        assert_eq!(narrow.len(), 2 * 4 * 6);
        assert!(narrow.iter().all(|index| index % 5 <= 2 && *index < 25));
        let thin = &indices[sections[1][1] as usize..sections[2][0] as usize];
        assert_eq!(thin.len(), 2 * 2 * 6);
        assert_eq!(&thin[..6], [0, 2, 12, 0, 12, 10]);
        assert_eq!(&indices[sections[2][0] as usize..], [0, 4, 24, 0, 24, 20]);
    }
}
