//! Where a frame's pixels are until they have left the sink. A buffer is filled by one frame, then owned by whoever encodes it,
//! then goes back to be filled again: pixels are never copied on their way to a sink.

use crate::gpu::Readback;

/// Picture, and depth when it was asked for, of all views of one frame.
#[derive(Debug)]
pub enum Pixels {
    /// Where a Vulkan device has put them.
    Device(Readback),
    /// In memory of the processor's own.
    Memory(Raster),
}

/// Pixels in plain memory.
#[derive(Debug)]
pub struct Raster {
    pub(crate) size: [u32; 2],
    pub(crate) rgba: Vec<u32>,
    pub(crate) reversed_depth: Option<Vec<f32>>,
}

impl Raster {
    /// A black raster of this size.
    #[must_use]
    pub fn new(size: [u32; 2], has_depth: bool) -> Self {
        let pixels = size[0] as usize * size[1] as usize;
        let black = u32::from_le_bytes([0, 0, 0, 255]);
        Self { size, rgba: vec![black; pixels], reversed_depth: has_depth.then(|| vec![0.0; pixels]) }
    }
}

impl Pixels {
    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        match self {
            Self::Device(readback) => readback.size(),
            Self::Memory(raster) => raster.size,
        }
    }

    /// The picture: `[height, width, 4]` bytes RGBA, row 0 at the top.
    #[must_use]
    pub fn rgba(&self) -> &[u8] {
        match self {
            Self::Device(readback) => readback.rgba(),
            Self::Memory(raster) => bytemuck::cast_slice(&raster.rgba),
        }
    }

    /// The picture and the depth, as [`Pixels::rgba`] and [`Pixels::reversed_depth`] give them, to be drawn over.
    pub(crate) fn planes_mut(&mut self) -> (&mut [u8], Option<&mut [f32]>) {
        match self {
            Self::Device(readback) => readback.planes_mut(),
            Self::Memory(Raster { rgba, reversed_depth, .. }) => {
                (bytemuck::cast_slice_mut(rgba), reversed_depth.as_deref_mut())
            }
        }
    }

    /// The depth, when the frame has it: `[height, width]`, row 0 at the top; near plane over metres along the view axis, 0
    /// for sky.
    #[must_use]
    pub fn reversed_depth(&self) -> Option<&[f32]> {
        match self {
            Self::Device(readback) => readback.reversed_depth(),
            Self::Memory(raster) => raster.reversed_depth.as_deref(),
        }
    }
}
