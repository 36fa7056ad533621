//! Buffers that finished pictures come back in, with all views of a frame. A read-back buffer is filled by one frame, then owned by whoever encodes
//! it, then goes back to be filled again: pixels are never copied on their way to a sink.

use super::buffer::{Buffer, BufferUse};
use super::device::Device;
use super::error::GpuError;
use std::sync::Arc;

/// Picture (and depth) of one frame in memory of the processor.
#[derive(Debug)]
pub struct Readback {
    color: Buffer,
    depth: Option<Buffer>,
    size: [u32; 2],
}

impl Readback {
    /// A buffer for frames' pictures of this size, with depth when `has_depth`.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(device: &Arc<Device>, size: [u32; 2], has_depth: bool) -> Result<Self, GpuError> {
        let len = u64::from(size[0]) * u64::from(size[1]) * 4;
        let (mut color, mut depth) = (Buffer::new(device, len, BufferUse::Readback, "colour read-back")?, None);
        // What no view covers is black, and as far away as the sky.
        color.bytes_mut().chunks_exact_mut(4).for_each(|texel| texel.copy_from_slice(&[0, 0, 0, 255]));
        if has_depth {
            let mut made = Buffer::new(device, len, BufferUse::Readback, "depth read-back")?;
            made.bytes_mut().fill(0);
            depth = Some(made);
        }
        Ok(Self { color, depth, size })
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The picture: `[height, width, 4]` bytes RGBA, row 0 at the top.
    #[must_use]
    pub fn rgba(&self) -> &[u8] {
        self.color.bytes()
    }

    /// The depth buffer, when the frame has one: `[height, width]`, row 0 at the top; near plane over metres along the
    /// view axis, 0 for sky.
    #[must_use]
    pub fn reversed_depth(&self) -> Option<&[f32]> {
        self.depth.as_ref().map(|buffer| bytemuck::cast_slice(buffer.bytes()))
    }

    /// Both, to be drawn over by the processor.
    pub(crate) fn planes_mut(&mut self) -> (&mut [u8], Option<&mut [f32]>) {
        let depth = self.depth.as_mut().map(|buffer| bytemuck::cast_slice_mut(buffer.bytes_mut()));
        (self.color.bytes_mut(), depth)
    }

    pub(super) fn color_buffer(&self) -> &Buffer {
        &self.color
    }

    pub(super) fn depth_buffer(&self) -> Option<&Buffer> {
        self.depth.as_ref()
    }
}
