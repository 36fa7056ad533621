//! Pictures that stay on the device: for a sink that shows them there, without read-back.
//!
//! Like a read-back buffer, a picture is filled by one frame, then owned by the sink that shows it,
//! then goes back to be filled again. A sink that shows it copies it, by a submit of its own, to
//! whatever is shown.

use super::barrier::{self, Access, layout_of};
use super::buffer::{Buffer, BufferUse};
use super::commands::Commands;
use super::device::Device;
use super::error::GpuError;
use super::image::{Image, ImageShape, whole};
use super::readback::Readback;
use super::target::COLOR_FORMAT;
use ash::vk;
use std::sync::Arc;
use terravision_common::rig::PictureLayout;

/// A picture on the device, with all views of a frame.
#[derive(Debug)]
pub struct DevicePicture {
    image: Image,
    layout: PictureLayout,
    device: Arc<Device>,
}

impl DevicePicture {
    /// A picture of this layout.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(device: &Arc<Device>, layout: PictureLayout) -> Result<Self, GpuError> {
        use vk::ImageUsageFlags as U;
        let shape = ImageShape {
            format: COLOR_FORMAT,
            size: layout.size,
            layers: 1,
            mips: 1,
            samples: 1,
            usage: U::TRANSFER_DST | U::TRANSFER_SRC,
            aspect: vk::ImageAspectFlags::COLOR,
            is_array: false,
        };
        let image = Image::without_view(device, shape, "picture on the device")?;
        Ok(Self { image, layout, device: Arc::clone(device) })
    }

    /// Another one like it.
    ///
    /// # Errors
    /// Out of memory.
    pub fn like(&self) -> Result<Self, GpuError> {
        Self::new(&self.device, self.layout)
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.layout.size
    }

    /// Makes room for a frame's picture, and what no view covers black; `commands` fill it next.
    ///
    /// # Safety
    /// * `commands` is being recorded, outside of rendering.
    pub(super) unsafe fn begin(&self, commands: vk::CommandBuffer) {
        let next = if self.layout.is_single() { Access::CopyTarget } else { Access::Cleared };
        // SAFETY: the caller's promise; the image waits for the submit before it goes (`Owned`).
        unsafe { barrier::image(&self.device, commands, &self.image, Access::Discarded, next) };
        if next == Access::CopyTarget {
            return;
        }
        let black = vk::ClearColorValue { float32: [0.0, 0.0, 0.0, 1.0] };
        let (layout, ranges) = (layout_of(next), [whole(vk::ImageAspectFlags::COLOR)]);
        // SAFETY: as above; the image is in this layout.
        unsafe {
            self.device.raw().cmd_clear_color_image(commands, self.image.raw(), layout, &black, &ranges);
            barrier::memory(&self.device, commands, Access::Cleared, Access::CopyTarget);
        }
    }

    /// The frame has filled it: what comes next copies it.
    ///
    /// # Safety
    /// * `commands` is being recorded, outside of rendering, and [`DevicePicture::begin`] was
    ///   recorded before.
    pub(super) unsafe fn end(&self, commands: vk::CommandBuffer) {
        // SAFETY: the caller's promise.
        unsafe { barrier::image(&self.device, commands, &self.image, Access::CopyTarget, Access::CopySource) };
    }

    /// The device that it is on.
    #[must_use]
    pub fn device(&self) -> &Arc<Device> {
        &self.device
    }

    pub(super) fn image(&self) -> &Image {
        &self.image
    }

    /// Copies `from`, which a finished frame has filled, on the device; waits for it.
    ///
    /// # Errors
    /// The sizes differ, or the device failed.
    pub fn copy_from(&mut self, from: &Self) -> Result<(), GpuError> {
        if self.size() != from.size() {
            let pixels = |size: [u32; 2]| u64::from(size[0]) * u64::from(size[1]);
            let (found, limit) = (pixels(from.size()), pixels(self.size()));
            return Err(GpuError::TooMany { what: "pixels of a picture on the device", found, limit });
        }
        let layers = color_layers();
        let [width, height] = self.size();
        let regions = [vk::ImageCopy2::default()
            .src_subresource(layers)
            .dst_subresource(layers)
            .extent(vk::Extent3D { width, height, depth: 1 })];
        let info = vk::CopyImageInfo2::default()
            .src_image(from.image.raw())
            .src_image_layout(layout_of(Access::CopySource))
            .dst_image(self.image.raw())
            .dst_image_layout(layout_of(Access::CopyTarget))
            .regions(&regions);
        // SAFETY: outside of rendering; both images have this size, and live until the submit has
        // been waited for.
        self.at_once(|device, commands| unsafe {
            barrier::image(device, commands, &self.image, Access::Discarded, Access::CopyTarget);
            device.raw().cmd_copy_image2(commands, &info);
            barrier::image(device, commands, &self.image, Access::CopyTarget, Access::CopySource);
        })
    }

    /// Its pixels, `[height, width, 4]` bytes RGBA, row 0 at the top; waits for the device. For
    /// tests and screenshots: a sink of all frames has them read back.
    ///
    /// # Errors
    /// Out of memory, or the device failed.
    pub fn read(&self) -> Result<Vec<u8>, GpuError> {
        let [width, height] = self.size();
        let bytes = u64::from(width) * u64::from(height) * 4;
        let buffer = Buffer::new(&self.device, bytes, BufferUse::Readback, "pixels of a picture on the device")?;
        let regions = [vk::BufferImageCopy2::default().image_subresource(color_layers()).image_extent(vk::Extent3D {
            width,
            height,
            depth: 1,
        })];
        let info = vk::CopyImageToBufferInfo2::default()
            .src_image(self.image.raw())
            .src_image_layout(layout_of(Access::CopySource))
            .dst_buffer(buffer.raw())
            .regions(&regions);
        // SAFETY: outside of rendering; the buffer has room, and lives until the submit has been
        // waited for.
        self.at_once(|device, commands| unsafe {
            device.raw().cmd_copy_image_to_buffer2(commands, &info);
            barrier::memory(device, commands, Access::CopyTarget, Access::HostRead);
        })?;
        Ok(buffer.bytes()[..bytes as usize].to_vec())
    }

    /// Records commands, submits them, and waits for them.
    fn at_once(&self, record: impl FnOnce(&Device, vk::CommandBuffer)) -> Result<(), GpuError> {
        let device = &self.device;
        let mut copy = Commands::new(device, "copy of a picture")?;
        let commands = copy.begin()?;
        // What frames did before is in the same queue.
        // SAFETY: recording, outside of rendering.
        unsafe { barrier::memory(device, commands, Access::CopyTarget, Access::CopySource) };
        record(device, commands);
        // SAFETY: recording; all that it names is alive until it has been waited for below, or, where
        // that fails, waits itself before it goes (`Owned`).
        unsafe { copy.submit() }?;
        copy.finish().map(drop)
    }
}

pub(super) fn color_layers() -> vk::ImageSubresourceLayers {
    vk::ImageSubresourceLayers {
        aspect_mask: vk::ImageAspectFlags::COLOR,
        mip_level: 0,
        base_array_layer: 0,
        layer_count: 1,
    }
}

/// Where the views of a frame are copied to: what its sinks asked for, which may be nothing.
#[derive(Debug, Default)]
pub struct Outputs {
    readback: Option<Readback>,
    picture: Option<DevicePicture>,
    /// Which of the two this frame leaves out.
    left_out: Option<Place>,
}

/// Where pixels are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// In memory of the processor.
    Memory,
    /// On the device.
    Device,
}

impl Outputs {
    /// Memory of the processor, a picture on the device, or both.
    #[must_use]
    pub fn new(readback: Option<Readback>, picture: Option<DevicePicture>) -> Self {
        Self { readback, picture, left_out: None }
    }

    /// The next frame is needed in one of the two only, where there is a choice.
    pub fn choose(&mut self, place: Place) {
        let has_choice = self.readback.is_some() && self.picture.is_some();
        let other = if place == Place::Memory { Place::Device } else { Place::Memory };
        self.left_out = has_choice.then_some(other);
    }

    /// Memory of the processor, where the frame is put there.
    #[must_use]
    pub fn readback(&self) -> Option<&Readback> {
        self.readback.as_ref().filter(|_| self.left_out != Some(Place::Memory))
    }

    /// The same, to be drawn over.
    pub(crate) fn readback_mut(&mut self) -> Option<&mut Readback> {
        self.readback.as_mut().filter(|_| self.left_out != Some(Place::Memory))
    }

    /// The picture on the device, where the frame is put there.
    #[must_use]
    pub fn picture(&self) -> Option<&DevicePicture> {
        self.picture.as_ref().filter(|_| self.left_out != Some(Place::Device))
    }

    /// Makes room for a frame's picture; no submit uses the outputs.
    ///
    /// # Errors
    /// Out of memory, or the picture is larger than what there is room for.
    pub fn lay_out(&mut self, device: &Arc<Device>, layout: PictureLayout) -> Result<(), GpuError> {
        if let Some(readback) = self.readback_mut() {
            readback.lay_out(layout)?;
        }
        if let Some(picture) = self.picture.as_mut().filter(|_| self.left_out != Some(Place::Device)) {
            if picture.size() != layout.size {
                *picture = DevicePicture::new(device, layout)?;
            }
            picture.layout = layout;
        }
        Ok(())
    }
}
