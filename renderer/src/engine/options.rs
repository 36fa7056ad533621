//! How frames are drawn, in numbers and choices.

use crate::gpu::{AdapterDescription, DeviceChoice, DeviceKind, ElevationPath, Needs, describe_adapters};
use crate::pixels::PixelPlaces;
use terravision_common::run::{RaysChoice, TechniqueChoice};

/// How frames are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct EngineOptions {
    /// How the ground is drawn.
    pub technique: TechniqueChoice,
    /// Why that technique draws, a clause for people.
    pub reason: String,
    /// How rays are cast, when they are.
    pub rays: RaysChoice,
    /// Threads that cast rays.
    pub workers: usize,
    /// Which device.
    pub device: DeviceChoice,
    /// Size of a frame's picture at most, pixels. It holds all of the frame's views; each frame
    /// says itself how large it is.
    pub size: [u32; 2],
    /// Where finished pictures are needed.
    pub pixels: PixelPlaces,
    /// How large and how many the views of a frame are; `None` for one that is the whole picture.
    pub views: Option<ViewBounds>,
    /// Samples per pixel, 1 or 4.
    pub samples: u32,
    /// Factor on all heights that are read out of the elevation pool; those of arrays have it.
    pub exaggeration: f64,
    /// Colour of the sky.
    pub sky_rgb: [u8; 3],
    /// Air is laid over pictures ([`mod@crate::air`]): the sky is left black, with an alpha of 0.
    pub has_air: bool,
    /// Height of the world's lowest ground as it is drawn, where it has a skirt down to it; `None`
    /// for no skirt.
    pub skirt_low_m: Option<f64>,
    /// Outlines of the colour leaves.
    pub has_tree_overlay: bool,
    /// The validation layer is asked for; its messages are errors.
    pub has_validation: bool,
    /// Depth comes back with the picture.
    pub has_depth: bool,
    /// Frames recorded or drawn at a time; 0 leaves it to the device (`device.rs`).
    pub frames_in_flight: usize,
    /// How elevations reach the device.
    pub elevation_path: ElevationPath,
    /// Whether colour tiles may be copied from shared memory by the device itself.
    pub can_import_colors: bool,
    /// For tests: the device is lost when it is handed the frame of this number, counted from 1,
    /// and so is every device after it.
    pub lose_device_at: Option<u64>,
}

/// How large and how many the views of a frame are at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ViewBounds {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Views of a frame.
    pub count: usize,
}

impl EngineOptions {
    /// How large and how many views are at most.
    pub(super) fn view_bounds(&self) -> ViewBounds {
        self.views.unwrap_or(ViewBounds { size: self.size, count: 1 })
    }

    /// What pixels are where no ground is, RGBA.
    pub(crate) fn sky_rgba(&self) -> [u8; 4] {
        let [r, g, b] = self.sky_rgb;
        if self.has_air { [0; 4] } else { [r, g, b, 255] }
    }

    /// Whether a device casts rays.
    pub(super) fn is_compute(&self) -> bool {
        self.technique == TechniqueChoice::Rays && self.rays == RaysChoice::Compute
    }

    /// Rays of which it is left open what casts them are a GPU's, if there is one.
    pub(super) fn with_gpu_rays(self) -> Self {
        if self.technique != TechniqueChoice::Rays || self.rays != RaysChoice::Auto {
            return self;
        }
        // Without Vulkan the list is empty.
        let devices = describe_adapters(&self.device, &Needs { size: self.view_bounds().size, ..Needs::LEAST })
            .unwrap_or_default();
        let is_gpu = |device: &AdapterDescription| device.kind > DeviceKind::Cpu && device.missing.is_empty();
        let has_gpu = devices.iter().any(|device| device.is_chosen && is_gpu(device));
        Self { rays: if has_gpu { RaysChoice::Compute } else { RaysChoice::Auto }, ..self }
    }
}

impl Default for EngineOptions {
    fn default() -> Self {
        Self {
            technique: TechniqueChoice::Mesh,
            reason: "asked for".to_owned(),
            rays: RaysChoice::Mipmap,
            workers: 1,
            device: DeviceChoice::from_environment(),
            size: [1280, 720],
            pixels: PixelPlaces::HOST,
            views: None,
            samples: 1,
            exaggeration: 1.0,
            sky_rgb: [150, 190, 235],
            has_air: false,
            skirt_low_m: None,
            has_tree_overlay: false,
            has_validation: false,
            has_depth: false,
            frames_in_flight: 2,
            elevation_path: ElevationPath::Best,
            can_import_colors: true,
            lose_device_at: None,
        }
    }
}
