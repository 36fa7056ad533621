//! The floor pass: what the device can do at best. One full-screen grid, textured and depth-tested.

use super::pipeline::{self, PipelineShape, Words, grid_indices};
use crate::gpu::buffer::Buffer;
use crate::gpu::color_pool::ColorPool;
use crate::gpu::error::GpuError;
use crate::gpu::frame::FrameRecording;
use crate::gpu::owned::Owned;
use crate::gpu::target::Target;
use ash::vk;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

static SPIRV: &Words<[u8]> = &Words(*include_bytes!(concat!(env!("OUT_DIR"), "/floor.spv")));

#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Grid {
    columns: u32,
    rows: u32,
    column_reciprocal: f32,
    layer: u32,
}

/// A grid of `columns` by `rows` cells over the whole picture.
#[derive(Debug)]
pub struct FloorPass {
    pipeline: Owned<vk::Pipeline>,
    layout: Owned<vk::PipelineLayout>,
    indices: Buffer,
    grid: Grid,
}

impl FloorPass {
    /// For pictures like those of `target`; textured with layer 0 of `colors`.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(colors: &ColorPool, target: &Target, columns: u32, rows: u32) -> Result<Self, GpuError> {
        let device = colors.device();
        let layout =
            pipeline::layout(device, &[colors.set_layout(), colors.set_layout()], vk::ShaderStageFlags::VERTEX)?;
        let module = pipeline::module(device, &SPIRV.0, "floor")?;
        let shape = PipelineShape {
            vertex: c"vertex",
            fragment: Some(c"fragment"),
            has_color: true,
            samples: target.samples(),
            name: "floor",
        };
        let pipeline = pipeline::pipeline(device, &module, &layout, &shape)?;
        let indices: Vec<u32> = grid_indices(columns, rows, [1, columns + 1]).collect();
        let indices = Buffer::with_indices(device, &indices, "floor indices")?;
        let grid = Grid { columns, rows, column_reciprocal: 1.0 / (columns + 1) as f32, layer: 0 };
        Ok(Self { pipeline, layout, indices, grid })
    }

    /// Triangles of the grid.
    #[must_use]
    pub fn triangles(&self) -> u64 {
        2 * u64::from(self.grid.columns) * u64::from(self.grid.rows)
    }

    /// Draws the grid; within rendering.
    pub fn draw(&self, recording: &mut FrameRecording<'_>, colors: &ColorPool) {
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let graphics = vk::PipelineBindPoint::GRAPHICS;
        // SAFETY: recording, within rendering of the pipeline's formats; the indices name vertices
        // of the grid; every object waits for the submit before it goes.
        unsafe {
            device.raw().cmd_bind_pipeline(commands, graphics, self.pipeline.get());
            device.raw().cmd_bind_descriptor_sets(commands, graphics, self.layout.get(), 1, &[colors.set()], &[]);
            device.raw().cmd_bind_index_buffer(commands, self.indices.raw(), 0, vk::IndexType::UINT32);
            device.raw().cmd_push_constants(
                commands,
                self.layout.get(),
                vk::ShaderStageFlags::VERTEX,
                0,
                bytemuck::bytes_of(&self.grid),
            );
            device.raw().cmd_set_cull_mode(commands, vk::CullModeFlags::NONE);
            device.raw().cmd_draw_indexed(commands, (self.indices.len() / 4) as u32, 1, 0, 0, 0);
        }
    }
}
