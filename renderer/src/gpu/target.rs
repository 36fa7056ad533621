//! What views are drawn to: a picture and its depth, with 1 or 4 samples per pixel. Every view is
//! drawn from the upper left corner on, whatever its place in the frame's picture: rasterizers work
//! in coordinates of the target, and its bytes must not depend on where it is shown.

use super::barrier::{self, Access, layout_of};
use super::buffer::Buffer;
use super::device::Device;
use super::error::GpuError;
use super::frame::FrameRecording;
use super::image::{Image, ImageShape};
use super::picture::{DevicePicture, Outputs};
use super::readback::Readback;
use ash::vk;
use std::sync::Arc;

/// Format of pictures and colour tiles.
pub(super) const COLOR_FORMAT: vk::Format = vk::Format::R8G8B8A8_UNORM;
/// Format of depth buffers.
pub(super) const DEPTH_FORMAT: vk::Format = vk::Format::D32_SFLOAT;

/// Bytes of a pixel, in pictures and in depth buffers.
const BYTES_PER_PIXEL: u64 = 4;

/// The images that views are drawn to. One set serves all of them, and all frames in flight: the
/// device draws one after another.
#[derive(Debug)]
pub struct Target {
    color: Image,
    depth: Image,
    /// Colour of all samples; `color` then holds their mean.
    color_samples: Option<Image>,
    /// Depth at pixel centres, drawn by a pass of its own when the picture has several samples.
    depth_of_centres: Option<Image>,
    size: [u32; 2],
    samples: u32,
}

impl Target {
    /// Images of this size. `has_depth`: the depth at pixel centres is to be read back.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(device: &Arc<Device>, size: [u32; 2], samples: u32, has_depth: bool) -> Result<Self, GpuError> {
        use vk::ImageUsageFlags as U;
        let color_shape = |samples, usage| ImageShape {
            format: COLOR_FORMAT,
            size,
            layers: 1,
            mips: 1,
            samples,
            usage,
            aspect: vk::ImageAspectFlags::COLOR,
            is_array: false,
        };
        let depth_shape = |samples, usage| ImageShape {
            format: DEPTH_FORMAT,
            aspect: vk::ImageAspectFlags::DEPTH,
            ..color_shape(samples, usage)
        };
        let depth_use =
            |is_copied: bool| U::DEPTH_STENCIL_ATTACHMENT | if is_copied { U::TRANSFER_SRC } else { U::empty() };
        let is_multisampled = samples > 1;
        let color = Image::new(device, color_shape(1, U::COLOR_ATTACHMENT | U::TRANSFER_SRC), "picture")?;
        let depth = depth_shape(samples, depth_use(has_depth && !is_multisampled));
        let depth = Image::new(device, depth, "depth")?;
        let (mut color_samples, mut depth_of_centres) = (None, None);
        if is_multisampled {
            let shape = color_shape(samples, U::COLOR_ATTACHMENT | U::TRANSIENT_ATTACHMENT);
            color_samples = Some(Image::new(device, shape, "picture samples")?);
            if has_depth {
                depth_of_centres = Some(Image::new(device, depth_shape(1, depth_use(true)), "depth of pixel centres")?);
            }
        }
        Ok(Self { color, depth, color_samples, depth_of_centres, size, samples })
    }

    /// Size of the largest view that fits, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Samples per pixel of the picture.
    #[must_use]
    pub fn samples(&self) -> u32 {
        self.samples
    }

    /// Whether depth needs a pass of its own ([`Target::begin_depth`]).
    #[must_use]
    pub fn has_depth_pass(&self) -> bool {
        self.depth_of_centres.is_some()
    }

    /// Begins the picture of a view of this size: all sky.
    pub fn begin_picture(&self, recording: &mut FrameRecording<'_>, size: [u32; 2], sky_rgba: [u8; 4]) {
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let images = [Some(&self.color), self.color_samples.as_ref()];
        for image in images.into_iter().flatten() {
            // SAFETY: recording, outside of rendering; the image waits for the submit before it
            // goes (`Owned`).
            unsafe { barrier::image(&device, commands, image, Access::Discarded, Access::ColorTarget) };
        }
        // SAFETY: as above.
        unsafe { barrier::image(&device, commands, &self.depth, Access::Discarded, Access::DepthTarget) };
        let float32 = sky_rgba.map(|v| f32::from(v) / 255.0);
        let clear = vk::ClearValue { color: vk::ClearColorValue { float32 } };
        let mut color = vk::RenderingAttachmentInfo::default()
            .image_layout(layout_of(Access::ColorTarget))
            .load_op(vk::AttachmentLoadOp::CLEAR)
            .clear_value(clear);
        color = match &self.color_samples {
            Some(samples) => color
                .image_view(samples.view())
                .store_op(vk::AttachmentStoreOp::DONT_CARE)
                .resolve_mode(vk::ResolveModeFlags::AVERAGE)
                .resolve_image_view(self.color.view())
                .resolve_image_layout(layout_of(Access::ColorTarget)),
            None => color.image_view(self.color.view()).store_op(vk::AttachmentStoreOp::STORE),
        };
        self.begin(&device, commands, size, &[color], &self.depth);
    }

    /// Begins the depth of pixel centres. Nothing happens when the picture's own depth serves.
    pub fn begin_depth(&self, recording: &mut FrameRecording<'_>, size: [u32; 2]) {
        let Some(depth) = &self.depth_of_centres else { return };
        let device = Arc::clone(recording.device());
        // SAFETY: recording, outside of rendering; the image waits for the submit before it goes
        // (`Owned`).
        unsafe { barrier::image(&device, recording.commands(), depth, Access::Discarded, Access::DepthTarget) };
        self.begin(&device, recording.commands(), size, &[], depth);
    }

    fn begin(
        &self,
        device: &Device,
        commands: vk::CommandBuffer,
        [width, height]: [u32; 2],
        colors: &[vk::RenderingAttachmentInfo<'_>],
        depth: &Image,
    ) {
        // Reversed: 0 is infinitely far.
        let clear = vk::ClearValue { depth_stencil: vk::ClearDepthStencilValue { depth: 0.0, stencil: 0 } };
        let depth = vk::RenderingAttachmentInfo::default()
            .image_view(depth.view())
            .image_layout(layout_of(Access::DepthTarget))
            .load_op(vk::AttachmentLoadOp::CLEAR)
            .store_op(vk::AttachmentStoreOp::STORE)
            .clear_value(clear);
        let area = vk::Rect2D {
            offset: vk::Offset2D::default(),
            extent: vk::Extent2D { width: width.min(self.size[0]), height: height.min(self.size[1]) },
        };
        let info = vk::RenderingInfo::default()
            .render_area(area)
            .layer_count(1)
            .color_attachments(colors)
            .depth_attachment(&depth);
        let viewport =
            vk::Viewport { x: 0.0, y: 0.0, width: width as f32, height: height as f32, min_depth: 0.0, max_depth: 1.0 };
        // SAFETY: recording, outside of rendering; the attachments are in the layouts named and
        // have one size.
        unsafe {
            device.raw().cmd_begin_rendering(commands, &info);
            device.raw().cmd_set_viewport(commands, 0, &[viewport]);
            device.raw().cmd_set_scissor(commands, 0, &[area]);
        }
    }

    /// Ends the picture or the depth pass.
    pub fn end(&self, recording: &mut FrameRecording<'_>) {
        // SAFETY: one of the `begin` functions was called before (the frame function's steps).
        unsafe { recording.device().raw().cmd_end_rendering(recording.commands()) };
    }

    /// Copies picture and depth of a view of this size to its place in the outputs; what does not
    /// fit there is left out.
    pub(super) fn copy_to_outputs(
        &mut self,
        recording: &mut FrameRecording<'_>,
        outputs: &Outputs,
        size: [u32; 2],
        at: [u32; 2],
    ) {
        let (readback, picture) = (outputs.readback(), outputs.picture());
        let device = Arc::clone(recording.device());
        let commands = recording.commands();
        let size = [0, 1].map(|axis| size[axis].min(self.size[axis]));
        if readback.is_some() || picture.is_some() {
            // SAFETY: recording, outside of rendering.
            unsafe { barrier::image(&device, commands, &self.color, Access::ColorTarget, Access::CopySource) };
        }
        if let Some(readback) = readback {
            copy_to_buffer(&device, commands, &self.color, (readback, readback.color_buffer()), size, at);
            if let Some(buffer) = readback.depth_buffer() {
                let depth = self.depth_of_centres.as_ref().unwrap_or(&self.depth);
                // SAFETY: recording, outside of rendering.
                unsafe { barrier::image(&device, commands, depth, Access::DepthTarget, Access::CopySource) };
                copy_to_buffer(&device, commands, depth, (readback, buffer), size, at);
            }
        }
        if let Some(picture) = picture {
            copy_to_picture(&device, commands, &self.color, picture, size, at);
        }
    }
}

/// How much of a view of this size fits into a picture at its place.
fn room(picture: [u32; 2], size: [u32; 2], at: [u32; 2]) -> Option<vk::Extent3D> {
    let [width, height] = [0, 1].map(|axis| size[axis].min(picture[axis].saturating_sub(at[axis])));
    (width > 0 && height > 0).then_some(vk::Extent3D { width, height, depth: 1 })
}

fn layers(image: &Image) -> vk::ImageSubresourceLayers {
    vk::ImageSubresourceLayers { aspect_mask: image.shape().aspect, mip_level: 0, base_array_layer: 0, layer_count: 1 }
}

/// Copies a view, whose image is a source of copies, to its place in a read-back buffer.
fn copy_to_buffer(
    device: &Device,
    commands: vk::CommandBuffer,
    image: &Image,
    (readback, buffer): (&Readback, &Buffer),
    size: [u32; 2],
    at: [u32; 2],
) {
    let Some(extent) = room(readback.size(), size, at) else { return };
    let row = readback.size()[0];
    let regions = [vk::BufferImageCopy2::default()
        .image_subresource(layers(image))
        .buffer_offset((u64::from(at[1]) * u64::from(row) + u64::from(at[0])) * BYTES_PER_PIXEL)
        .buffer_row_length(row)
        .image_extent(extent)];
    let info = vk::CopyImageToBufferInfo2::default()
        .src_image(image.raw())
        .src_image_layout(layout_of(Access::CopySource))
        .dst_buffer(buffer.raw())
        .regions(&regions);
    // SAFETY: recording, outside of rendering; the region lies inside image and buffer.
    unsafe { device.raw().cmd_copy_image_to_buffer2(commands, &info) };
}

/// Likewise to its place in a picture on the device.
fn copy_to_picture(
    device: &Device,
    commands: vk::CommandBuffer,
    image: &Image,
    picture: &DevicePicture,
    size: [u32; 2],
    at: [u32; 2],
) {
    let Some(extent) = room(picture.size(), size, at) else { return };
    let [x, y] = at.map(u32::cast_signed);
    let regions = [vk::ImageCopy2::default()
        .src_subresource(layers(image))
        .dst_subresource(layers(picture.image()))
        .dst_offset(vk::Offset3D { x, y, z: 0 })
        .extent(extent)];
    let info = vk::CopyImageInfo2::default()
        .src_image(image.raw())
        .src_image_layout(layout_of(Access::CopySource))
        .dst_image(picture.image().raw())
        .dst_image_layout(layout_of(Access::CopyTarget))
        .regions(&regions);
    // SAFETY: recording, outside of rendering; the region lies inside both images, and the picture
    // was begun.
    unsafe { device.raw().cmd_copy_image2(commands, &info) };
}
