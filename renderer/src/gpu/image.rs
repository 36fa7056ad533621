//! Images with their memory and one view of all of them.

use super::device::Device;
use super::error::{During, GpuError};
use super::owned::{Owned, destroyer};
use ash::vk;
use std::sync::Arc;

/// What an image is to be.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImageShape {
    pub(super) format: vk::Format,
    pub(super) size: [u32; 2],
    pub(super) layers: u32,
    pub(super) mips: u32,
    pub(super) samples: u32,
    pub(super) usage: vk::ImageUsageFlags,
    pub(super) aspect: vk::ImageAspectFlags,
    pub(super) is_array: bool,
}

/// An image in the device's memory.
#[derive(Debug)]
pub(super) struct Image {
    view: Option<Owned<vk::ImageView>>,
    handle: Owned<vk::Image>,
    _memory: Owned<vk::DeviceMemory>,
    shape: ImageShape,
}

impl Image {
    /// An image that is only copied from and to.
    pub(super) fn without_view(device: &Arc<Device>, shape: ImageShape, name: &str) -> Result<Self, GpuError> {
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(shape.format)
            .extent(vk::Extent3D { width: shape.size[0], height: shape.size[1], depth: 1 })
            .mip_levels(shape.mips)
            .array_layers(shape.layers)
            .samples(vk::SampleCountFlags::from_raw(shape.samples))
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(shape.usage);
        // SAFETY: size, layers, samples and format are within what `requirements` checked.
        let raw = unsafe { device.raw().create_image(&info, None) }.during("creating an image")?;
        let handle = Owned::new(device, raw, destroyer!(destroy_image));
        device.name(raw, name);
        // SAFETY: the image is of this device.
        let needs = unsafe { device.raw().get_image_memory_requirements(raw) };
        let wishes = [vk::MemoryPropertyFlags::DEVICE_LOCAL, vk::MemoryPropertyFlags::empty()];
        let kind = device.memory_type(needs.memory_type_bits, &wishes, "an image")?;
        let allocate = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
        // SAFETY: the type index comes from this device.
        let memory = unsafe { device.raw().allocate_memory(&allocate, None) }.during("allocating an image's memory")?;
        let memory = Owned::new(device, memory, destroyer!(free_memory));
        // SAFETY: fresh image, fresh memory of the size and type that it needs.
        unsafe { device.raw().bind_image_memory(raw, memory.get(), 0) }.during("binding an image's memory")?;
        Ok(Self { view: None, handle, _memory: memory, shape })
    }

    pub(super) fn new(device: &Arc<Device>, shape: ImageShape, name: &str) -> Result<Self, GpuError> {
        let image = Self::without_view(device, shape, name)?;
        let kind = if shape.is_array { vk::ImageViewType::TYPE_2D_ARRAY } else { vk::ImageViewType::TYPE_2D };
        let view_info = vk::ImageViewCreateInfo::default()
            .image(image.raw())
            .view_type(kind)
            .format(shape.format)
            .subresource_range(whole(shape.aspect));
        // SAFETY: the image is complete.
        let view = unsafe { device.raw().create_image_view(&view_info, None) }.during("creating an image's view")?;
        let view = Owned::new(device, view, destroyer!(destroy_image_view));
        Ok(Self { view: Some(view), ..image })
    }

    pub(super) fn raw(&self) -> vk::Image {
        self.handle.get()
    }

    pub(super) fn view(&self) -> vk::ImageView {
        self.view.as_ref().map_or(vk::ImageView::null(), Owned::get)
    }

    pub(super) fn shape(&self) -> &ImageShape {
        &self.shape
    }
}

/// All mips and layers.
pub(super) fn whole(aspect: vk::ImageAspectFlags) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange {
        aspect_mask: aspect,
        base_mip_level: 0,
        level_count: vk::REMAINING_MIP_LEVELS,
        base_array_layer: 0,
        layer_count: vk::REMAINING_ARRAY_LAYERS,
    }
}
