//! Pipelines without vertex attributes and their inputs: what all passes have in common.

use crate::gpu::device::Device;
use crate::gpu::error::{During, GpuError};
use crate::gpu::owned::{Owned, destroyer};
use crate::gpu::requirements::PUSH_CONSTANT_BYTES;
use crate::gpu::target::{COLOR_FORMAT, DEPTH_FORMAT};
use ash::vk;
use std::ffi::CStr;
use std::sync::Arc;

/// SPIR-V that `build.rs` made, aligned as words.
#[repr(C, align(4))]
pub(super) struct Words<Bytes: ?Sized>(pub(super) Bytes);

/// A shader module.
pub(super) fn module(device: &Arc<Device>, spirv: &[u8], name: &str) -> Result<Owned<vk::ShaderModule>, GpuError> {
    let words: &[u32] = bytemuck::cast_slice(spirv);
    let info = vk::ShaderModuleCreateInfo::default().code(words);
    // SAFETY: the code was made and validated by naga at build time.
    let raw = unsafe { device.raw().create_shader_module(&info, None) }.during("creating a shader module")?;
    device.name(raw, name);
    Ok(Owned::new(device, raw, destroyer!(destroy_shader_module)))
}

/// A pipeline layout of these sets, and our push constants for these stages.
pub(super) fn layout(
    device: &Arc<Device>,
    sets: &[vk::DescriptorSetLayout],
    stages: vk::ShaderStageFlags,
) -> Result<Owned<vk::PipelineLayout>, GpuError> {
    let constants = [vk::PushConstantRange::default().stage_flags(stages).size(PUSH_CONSTANT_BYTES)];
    let info = vk::PipelineLayoutCreateInfo::default().set_layouts(sets).push_constant_ranges(&constants);
    // SAFETY: the set layouts are alive.
    let raw = unsafe { device.raw().create_pipeline_layout(&info, None) }.during("creating a pipeline layout")?;
    Ok(Owned::new(device, raw, destroyer!(destroy_pipeline_layout)))
}

/// The layout of a set of storage buffers, bound from 0 on, that these stages use.
pub(super) fn storage_layout(
    device: &Arc<Device>,
    buffers: usize,
    stages: vk::ShaderStageFlags,
) -> Result<Owned<vk::DescriptorSetLayout>, GpuError> {
    let binding = |binding: usize| {
        vk::DescriptorSetLayoutBinding::default()
            .binding(binding as u32)
            .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
            .descriptor_count(1)
            .stage_flags(stages)
    };
    let bindings: Vec<_> = (0..buffers).map(binding).collect();
    let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: the structure is complete.
    let raw = unsafe { device.raw().create_descriptor_set_layout(&info, None) }.during("creating a set layout")?;
    Ok(Owned::new(device, raw, destroyer!(destroy_descriptor_set_layout)))
}

/// A set of storage buffers for each frame slot, and the pool that they are of.
pub(super) fn storage_sets(
    device: &Arc<Device>,
    layout: &Owned<vk::DescriptorSetLayout>,
    buffers: usize,
    slots: usize,
) -> Result<(Owned<vk::DescriptorPool>, Vec<vk::DescriptorSet>), GpuError> {
    let descriptor_count = (buffers * slots) as u32;
    let sizes = [vk::DescriptorPoolSize { ty: vk::DescriptorType::STORAGE_BUFFER, descriptor_count }];
    let info = vk::DescriptorPoolCreateInfo::default().max_sets(slots as u32).pool_sizes(&sizes);
    // SAFETY: the structure is complete.
    let pool = unsafe { device.raw().create_descriptor_pool(&info, None) }.during("creating a descriptor pool")?;
    let pool = Owned::new(device, pool, destroyer!(destroy_descriptor_pool));
    let layouts = vec![layout.get(); slots];
    let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool.get()).set_layouts(&layouts);
    // SAFETY: the pool has room for these sets, which go with it.
    let sets = unsafe { device.raw().allocate_descriptor_sets(&info) }.during("allocating descriptor sets")?;
    Ok((pool, sets))
}

/// A compute pipeline.
pub(super) fn compute(
    device: &Arc<Device>,
    module: &Owned<vk::ShaderModule>,
    layout: &Owned<vk::PipelineLayout>,
    entry: &'static CStr,
    name: &str,
) -> Result<Owned<vk::Pipeline>, GpuError> {
    let stage = vk::PipelineShaderStageCreateInfo::default()
        .stage(vk::ShaderStageFlags::COMPUTE)
        .module(module.get())
        .name(entry);
    let info = vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout.get());
    // SAFETY: module and layout are alive, and the entry exists (the shader names it).
    let made = unsafe { device.raw().create_compute_pipelines(vk::PipelineCache::null(), &[info], None) };
    let raw = made.map_err(|(_, result)| result).during("creating a compute pipeline")?[0];
    device.name(raw, name);
    Ok(Owned::new(device, raw, destroyer!(destroy_pipeline)))
}

/// What one pipeline differs in.
#[derive(Debug, Clone, Copy)]
pub(super) struct PipelineShape {
    pub(super) vertex: &'static CStr,
    /// `None`: every fragment counts.
    pub(super) fragment: Option<&'static CStr>,
    /// Without: depth only, no colour attachment.
    pub(super) has_color: bool,
    pub(super) samples: u32,
    pub(super) name: &'static str,
}

/// A pipeline: lists of triangles (strips with restart measured no faster on lavapipe),
/// counter-clockwise ones in front, culling set while recording, reversed depth.
pub(super) fn pipeline(
    device: &Arc<Device>,
    module: &Owned<vk::ShaderModule>,
    layout: &Owned<vk::PipelineLayout>,
    shape: &PipelineShape,
) -> Result<Owned<vk::Pipeline>, GpuError> {
    let stage = |kind, entry| vk::PipelineShaderStageCreateInfo::default().stage(kind).module(module.get()).name(entry);
    let mut stages = [stage(vk::ShaderStageFlags::VERTEX, shape.vertex); 2];
    let mut stage_count = 1;
    let mut color_formats: &[vk::Format] = &[];
    if let Some(entry) = shape.fragment {
        stages[1] = stage(vk::ShaderStageFlags::FRAGMENT, entry);
        stage_count = 2;
    }
    if shape.has_color {
        color_formats = &[COLOR_FORMAT];
    }
    let vertex_input = vk::PipelineVertexInputStateCreateInfo::default();
    let assembly = vk::PipelineInputAssemblyStateCreateInfo::default().topology(vk::PrimitiveTopology::TRIANGLE_LIST);
    let viewport = vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
    let raster = vk::PipelineRasterizationStateCreateInfo::default()
        .polygon_mode(vk::PolygonMode::FILL)
        .front_face(vk::FrontFace::COUNTER_CLOCKWISE)
        .line_width(1.0);
    let samples = vk::PipelineMultisampleStateCreateInfo::default()
        .rasterization_samples(vk::SampleCountFlags::from_raw(shape.samples));
    let depth = vk::PipelineDepthStencilStateCreateInfo::default()
        .depth_test_enable(true)
        .depth_write_enable(true)
        .depth_compare_op(vk::CompareOp::GREATER);
    let attachments =
        [vk::PipelineColorBlendAttachmentState::default().color_write_mask(vk::ColorComponentFlags::RGBA)];
    let blend = vk::PipelineColorBlendStateCreateInfo::default().attachments(&attachments[..color_formats.len()]);
    let states = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR, vk::DynamicState::CULL_MODE];
    let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&states);
    let mut rendering = vk::PipelineRenderingCreateInfo::default()
        .color_attachment_formats(color_formats)
        .depth_attachment_format(DEPTH_FORMAT);
    let info = vk::GraphicsPipelineCreateInfo::default()
        .stages(&stages[..stage_count])
        .vertex_input_state(&vertex_input)
        .input_assembly_state(&assembly)
        .viewport_state(&viewport)
        .rasterization_state(&raster)
        .multisample_state(&samples)
        .depth_stencil_state(&depth)
        .color_blend_state(&blend)
        .dynamic_state(&dynamic)
        .layout(layout.get())
        .push_next(&mut rendering);
    // SAFETY: module and layout are alive, the entries exist (the shader names them), states are
    // complete.
    let made = unsafe { device.raw().create_graphics_pipelines(vk::PipelineCache::null(), &[info], None) };
    let raw = made.map_err(|(_, result)| result).during("creating a pipeline")?[0];
    device.name(raw, shape.name);
    Ok(Owned::new(device, raw, destroyer!(destroy_pipeline)))
}

/// Indices of a grid's triangles, two a cell, split from south west to north east, row by row from
/// row 0. `steps`: from a vertex to the next one east, and north.
pub(super) fn grid_indices(columns: u32, rows: u32, steps: [u32; 2]) -> impl Iterator<Item = u32> {
    let [east, north] = steps;
    (0..rows).flat_map(move |row| {
        (0..columns).flat_map(move |column| {
            let sw = row * north + column * east;
            let (se, nw, ne) = (sw + east, sw + north, sw + north + east);
            [sw, se, ne, sw, ne, nw]
        })
    })
}
