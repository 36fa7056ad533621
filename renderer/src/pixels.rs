//! Where a frame's pixels are until they have left the sink. A buffer is filled by one frame, then
//! owned by the sink that encodes it, then goes back to be filled again: pixels are never copied on
//! their way to a sink. What no sink needs is not made ([`PixelPlaces`]).

use crate::gpu::{DevicePicture, Outputs, Place, Readback};
use terravision_common::rig::PictureLayout;

/// Where the pixels of finished pictures are needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelPlaces {
    /// In memory of the processor, with depth where frames have it.
    pub host: bool,
    /// In a picture on the device, without depth.
    pub device: bool,
    /// In either: on the device, unless something is drawn over them by the processor.
    pub either: bool,
}

impl PixelPlaces {
    /// Nowhere: frames are drawn for their own sake.
    pub const NOWHERE: Self = Self { host: false, device: false, either: false };
    /// In memory of the processor.
    pub const HOST: Self = Self { host: true, ..Self::NOWHERE };
    /// On the device.
    pub const DEVICE: Self = Self { device: true, ..Self::NOWHERE };
    /// In either of the two.
    pub const EITHER: Self = Self { either: true, ..Self::NOWHERE };

    /// Wherever either needs them.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self { host: self.host || other.host, device: self.device || other.device, either: self.either || other.either }
    }

    /// Whether each frame may be put where it costs least.
    #[must_use]
    pub fn has_choice(self) -> bool {
        self.either && !self.host && !self.device
    }

    /// Whether frames may be needed in memory of the processor.
    #[must_use]
    pub fn may_be_host(self) -> bool {
        self.host || self.either
    }
}

/// Picture, and depth when it was asked for, of all views of one frame.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a run makes a few and moves them; nothing has many of them")]
pub enum Pixels {
    /// Where a Vulkan device has put them.
    Device(Outputs),
    /// In memory of the processor's own.
    Memory(Raster),
}

/// Pixels in plain memory.
#[derive(Debug)]
pub struct Raster {
    layout: PictureLayout,
    pub(crate) rgba: Vec<u32>,
    pub(crate) reversed_depth: Option<Vec<f32>>,
}

impl Raster {
    /// A raster without pixels.
    #[must_use]
    pub fn new(has_depth: bool) -> Self {
        Self { layout: PictureLayout::default(), rgba: Vec::new(), reversed_depth: has_depth.then(Vec::new) }
    }

    /// Makes room for a frame's picture. Where views lay elsewhere before, all of it is black.
    pub fn lay_out(&mut self, layout: PictureLayout) {
        if layout == self.layout {
            return;
        }
        self.layout = layout;
        let pixels = layout.size[0] as usize * layout.size[1] as usize;
        self.rgba.clear();
        self.rgba.resize(pixels, u32::from_le_bytes([0, 0, 0, 255]));
        if let Some(depths) = &mut self.reversed_depth {
            depths.clear();
            depths.resize(pixels, 0.0);
        }
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.layout.size
    }
}

impl Pixels {
    /// Width and height of what is in memory of the processor, pixels; zeros where nothing is.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        match self {
            Self::Device(outputs) => outputs.readback().map_or([0; 2], Readback::size),
            Self::Memory(raster) => raster.size(),
        }
    }

    /// The picture: `[height, width, 4]` bytes RGBA, row 0 at the top; empty where it was not
    /// needed in memory of the processor.
    #[must_use]
    pub fn rgba(&self) -> &[u8] {
        match self {
            Self::Device(outputs) => outputs.readback().map_or(&[], Readback::rgba),
            Self::Memory(raster) => bytemuck::cast_slice(&raster.rgba),
        }
    }

    /// The next frame is needed here only, where there is a choice.
    pub(crate) fn choose(&mut self, place: Place) {
        if let Self::Device(outputs) = self {
            outputs.choose(place);
        }
    }

    /// The picture and the depth, as [`Pixels::rgba`] and [`Pixels::reversed_depth`] give them, to
    /// be drawn over.
    pub(crate) fn planes_mut(&mut self) -> (&mut [u8], Option<&mut [f32]>) {
        match self {
            Self::Device(outputs) => outputs.readback_mut().map_or((&mut [], None), Readback::planes_mut),
            Self::Memory(Raster { rgba, reversed_depth, .. }) => {
                (bytemuck::cast_slice_mut(rgba), reversed_depth.as_deref_mut())
            }
        }
    }

    /// The depth, when the frame has it: `[height, width]`, row 0 at the top; near plane over
    /// metres along the view axis, 0 for sky.
    #[must_use]
    pub fn reversed_depth(&self) -> Option<&[f32]> {
        match self {
            Self::Device(outputs) => outputs.readback().and_then(Readback::reversed_depth),
            Self::Memory(raster) => raster.reversed_depth.as_deref(),
        }
    }

    /// The picture on the device, where it was needed there.
    #[must_use]
    pub fn on_device(&self) -> Option<&DevicePicture> {
        match self {
            Self::Device(outputs) => outputs.picture(),
            Self::Memory(_) => None,
        }
    }
}
