//! Buffers that finished pictures come back in, with all views of a frame. A read-back buffer is
//! filled by one frame, then owned by the sink that encodes it, then goes back to be filled again:
//! pixels are never copied on their way to a sink.

use super::buffer::{Buffer, BufferUse};
use super::device::Device;
use super::error::GpuError;
use std::sync::Arc;
use terravision_common::rig::PictureLayout;

/// Bytes of a pixel, of its colour and of its depth.
const BYTES_PER_PIXEL: u64 = 4;

/// Picture (and depth) of one frame in memory of the processor.
#[derive(Debug)]
pub struct Readback {
    color: Buffer,
    depth: Option<Buffer>,
    /// Of the frame that it is filled by.
    layout: PictureLayout,
}

impl Readback {
    /// A buffer for pictures of this many pixels at most, with depth when `has_depth`.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(device: &Arc<Device>, size: [u32; 2], has_depth: bool) -> Result<Self, GpuError> {
        let len = u64::from(size[0]) * u64::from(size[1]) * BYTES_PER_PIXEL;
        let color = Buffer::new(device, len, BufferUse::Readback, "colour read-back")?;
        let depth = || Buffer::new(device, len, BufferUse::Readback, "depth read-back");
        let depth = if has_depth { Some(depth()?) } else { None };
        Ok(Self { color, depth, layout: PictureLayout::default() })
    }

    /// Makes room for a frame's picture; no submit uses the buffer. Pictures of one size may lie in
    /// it after pictures of another.
    ///
    /// # Errors
    /// The picture is larger than the buffer.
    pub fn lay_out(&mut self, layout: PictureLayout) -> Result<(), GpuError> {
        let limit = self.color.len() / BYTES_PER_PIXEL;
        let found = u64::from(layout.size[0]) * u64::from(layout.size[1]);
        if found > limit {
            return Err(GpuError::TooMany { what: "pixels of a picture", found, limit });
        }
        if layout != self.layout {
            self.layout = layout;
            // What no view covers is black, and as far away as the sky.
            let (rgba, depth) = self.planes_mut();
            rgba.chunks_exact_mut(4).for_each(|texel| texel.copy_from_slice(&[0, 0, 0, 255]));
            if let Some(depth) = depth {
                depth.fill(0.0);
            }
        }
        Ok(())
    }

    /// Bytes of the picture, and of its depth.
    fn bytes(&self) -> usize {
        self.layout.size.map(|side| side as usize).iter().product::<usize>() * BYTES_PER_PIXEL as usize
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.layout.size
    }

    /// The picture: `[height, width, 4]` bytes RGBA, row 0 at the top.
    #[must_use]
    pub fn rgba(&self) -> &[u8] {
        &self.color.bytes()[..self.bytes()]
    }

    /// The depth buffer, when the frame has one: `[height, width]`, row 0 at the top; near plane
    /// over metres along the view axis, 0 for sky.
    #[must_use]
    pub fn reversed_depth(&self) -> Option<&[f32]> {
        self.depth.as_ref().map(|buffer| bytemuck::cast_slice(&buffer.bytes()[..self.bytes()]))
    }

    /// Both, to be drawn over by the processor.
    pub(crate) fn planes_mut(&mut self) -> (&mut [u8], Option<&mut [f32]>) {
        let bytes = self.bytes();
        let depth = self.depth.as_mut().map(|buffer| bytemuck::cast_slice_mut(&mut buffer.bytes_mut()[..bytes]));
        (&mut self.color.bytes_mut()[..bytes], depth)
    }

    pub(super) fn color_buffer(&self) -> &Buffer {
        &self.color
    }

    pub(super) fn depth_buffer(&self) -> Option<&Buffer> {
        self.depth.as_ref()
    }
}
