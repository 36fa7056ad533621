//! What the renderer needs of a device, as one table and one pure function that returns all that is
//! missing.

use serde::{Deserialize, Serialize};
use std::fmt;
use terravision_common::texels::TexelFormat;

/// What kind of device it is; ordered from the least to the most wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DeviceKind {
    /// Something that the specification did not name.
    Other,
    /// The processor itself (lavapipe).
    Cpu,
    /// A slice of a GPU, lent by a hypervisor.
    Virtual,
    /// A GPU that shares the processor's memory.
    Integrated,
    /// A GPU with memory of its own.
    Discrete,
}

/// What a device can do, as far as it matters here.
#[derive(Debug, Clone, PartialEq)]
pub struct Capabilities {
    /// Its name.
    pub name: String,
    /// Its driver's name and version.
    pub driver: String,
    /// Its kind.
    pub kind: DeviceKind,
    /// Vulkan version, major and minor.
    pub api_version: [u32; 2],
    /// Whether it has a queue for graphics.
    pub has_graphics_queue: bool,
    /// Feature `dynamicRendering`.
    pub has_dynamic_rendering: bool,
    /// Feature `synchronization2`.
    pub has_synchronization2: bool,
    /// Feature `timelineSemaphore`.
    pub has_timeline_semaphore: bool,
    /// Feature `robustBufferAccess`.
    pub has_robust_buffer_access: bool,
    /// RGBA8 can be sampled with linear filtering, drawn to and copied both ways.
    pub has_color_format: bool,
    /// D32 can be drawn to and copied from.
    pub has_depth_format: bool,
    /// Feature `textureCompressionBC`: BC1 can be sampled with linear filtering and copied to.
    pub has_block_compression: bool,
    /// Largest side of a 2D image.
    pub max_image_side: u32,
    /// Most layers of an image.
    pub max_image_layers: u32,
    /// Largest picture that can be drawn.
    pub max_framebuffer: [u32; 2],
    /// Bit set of sample counts of both colour and depth.
    pub sample_counts: u32,
    /// Largest range of a storage buffer, bytes.
    pub max_storage_range: u64,
    /// Bytes of push constants.
    pub max_push_constants: u32,
    /// Largest anisotropy of a sampler; 1 without the feature.
    pub max_anisotropy: f32,
    /// Alignment of imported host memory; `None` without `VK_EXT_external_memory_host`.
    pub host_import_alignment: Option<u64>,
    /// Nanoseconds per step of the timestamp counter; `None` when the queue has none.
    pub timestamp_period_nanos: Option<f64>,
    /// Whether it can show pictures in windows.
    pub has_swapchain: bool,
}

/// What one run needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Needs {
    /// Picture size, pixels.
    pub size: [u32; 2],
    /// Samples per pixel.
    pub samples: u32,
    /// Layers of the colour pool.
    pub color_layers: u32,
    /// Side of a stored colour tile, texels.
    pub color_tile_side: u32,
    /// How the pool holds colour tiles.
    pub texels: TexelFormat,
}

impl Needs {
    /// The least that any run needs; what `doctor` asks for.
    pub const LEAST: Self =
        Self { size: [1280, 720], samples: 1, color_layers: 256, color_tile_side: 264, texels: TexelFormat::Rgba8 };
}

/// Bytes of push constants that the passes use.
pub(super) const PUSH_CONSTANT_BYTES: u32 = 96;

/// One thing that a device lacks.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Missing {
    /// A Vulkan that is too old.
    Version {
        /// Major and minor version found.
        found: [u32; 2],
    },
    /// A feature, format or queue, by name.
    Feature(&'static str),
    /// A limit that is too low.
    Limit {
        /// What is limited.
        what: &'static str,
        /// How much is needed.
        needed: u64,
        /// How much there is.
        found: u64,
    },
    /// The picture is larger than the device can draw.
    PictureSize {
        /// Size asked for.
        needed: [u32; 2],
        /// Largest size.
        found: [u32; 2],
    },
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Missing::Version { found: [major, minor] } => write!(f, "it has Vulkan {major}.{minor}, 1.3 is needed"),
            Missing::Feature(name) => write!(f, "it lacks {name}"),
            Missing::Limit { what, needed, found } => write!(f, "it allows {found} {what}, {needed} are needed"),
            Missing::PictureSize { needed: [w, h], found: [max_w, max_h] } => {
                write!(f, "a picture of {w}x{h} pixels is larger than its limit of {max_w}x{max_h}")
            }
        }
    }
}

/// All that `found` lacks of what `needs` asks for; empty when the device will do.
#[must_use]
pub fn missing_of(found: &Capabilities, needs: &Needs) -> Vec<Missing> {
    let mut missing = Vec::new();
    if found.api_version < [1, 3] {
        missing.push(Missing::Version { found: found.api_version });
    }
    let features = [
        (found.has_graphics_queue, "a graphics queue"),
        (found.has_dynamic_rendering, "the feature dynamicRendering"),
        (found.has_synchronization2, "the feature synchronization2"),
        (found.has_timeline_semaphore, "the feature timelineSemaphore"),
        (found.has_robust_buffer_access, "the feature robustBufferAccess"),
        (found.has_color_format, "drawing and linear sampling of R8G8B8A8_UNORM"),
        (found.has_depth_format, "depth buffers of D32_SFLOAT"),
        (found.has_block_compression || !needs.texels.is_compressed(), "the feature textureCompressionBC"),
        (found.sample_counts & needs.samples != 0, "the asked number of samples per pixel"),
    ];
    missing.extend(features.iter().filter(|(has, _)| !has).map(|(_, name)| Missing::Feature(name)));
    let limits = [
        ("texels along an image", needs.color_tile_side, found.max_image_side),
        ("image layers", needs.color_layers, found.max_image_layers),
        ("bytes of push constants", PUSH_CONSTANT_BYTES, found.max_push_constants),
    ];
    for (what, needed, found) in limits {
        if needed > found {
            missing.push(Missing::Limit { what, needed: needed.into(), found: found.into() });
        }
    }
    let largest = found.max_framebuffer.map(|side| side.min(found.max_image_side));
    if needs.size[0] > largest[0] || needs.size[1] > largest[1] {
        missing.push(Missing::PictureSize { needed: needs.size, found: largest });
    }
    missing
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> Capabilities {
        Capabilities {
            name: "invented".into(),
            driver: "none".into(),
            kind: DeviceKind::Discrete,
            api_version: [1, 3],
            has_graphics_queue: true,
            has_dynamic_rendering: true,
            has_synchronization2: true,
            has_timeline_semaphore: true,
            has_robust_buffer_access: true,
            has_color_format: true,
            has_depth_format: true,
            has_block_compression: false,
            max_image_side: 4096,
            max_image_layers: 256,
            max_framebuffer: [4096, 4096],
            sample_counts: 1 | 4,
            max_storage_range: 1 << 27,
            max_push_constants: 128,
            max_anisotropy: 1.0,
            host_import_alignment: None,
            timestamp_period_nanos: None,
            has_swapchain: true,
        }
    }

    #[test]
    fn a_device_that_has_everything_lacks_nothing() {
        assert_eq!(missing_of(&good(), &Needs::LEAST), []);
        assert_eq!(missing_of(&good(), &Needs { samples: 4, ..Needs::LEAST }), []);
        assert_eq!(missing_of(&Capabilities { api_version: [2, 0], ..good() }, &Needs::LEAST), []);
    }

    #[test]
    fn each_missing_thing_is_reported_alone() {
        let cases: [fn(&mut Capabilities); 12] = [
            |c| c.api_version = [1, 2],
            |c| c.has_graphics_queue = false,
            |c| c.has_dynamic_rendering = false,
            |c| c.has_synchronization2 = false,
            |c| c.has_timeline_semaphore = false,
            |c| c.has_robust_buffer_access = false,
            |c| c.has_color_format = false,
            |c| c.has_depth_format = false,
            |c| c.sample_counts = 4,
            |c| c.max_image_layers = 255,
            |c| c.max_push_constants = 79,
            |c| c.max_framebuffer = [4096, 719],
        ];
        for (index, spoil) in cases.iter().enumerate() {
            let mut device = good();
            spoil(&mut device);
            assert_eq!(missing_of(&device, &Needs::LEAST).len(), 1, "case {index}");
        }
    }

    #[test]
    fn block_compression_is_needed_only_for_compressed_tiles() {
        let needs = Needs { texels: TexelFormat::Bc1, ..Needs::LEAST };
        assert_eq!(missing_of(&good(), &needs), [Missing::Feature("the feature textureCompressionBC")]);
        assert_eq!(missing_of(&Capabilities { has_block_compression: true, ..good() }, &needs), []);
    }

    #[test]
    fn all_that_is_missing_is_reported_at_once() {
        let device = Capabilities { has_color_format: false, max_image_side: 200, api_version: [1, 1], ..good() };
        let needs = Needs { samples: 2, ..Needs::LEAST };
        let missing = missing_of(&device, &needs);
        assert_eq!(missing.len(), 5, "{missing:?}");
        assert!(missing.contains(&Missing::PictureSize { needed: [1280, 720], found: [200, 200] }));
    }

    #[test]
    fn real_gpus_are_preferred_to_the_processor() {
        use DeviceKind::{Cpu, Discrete, Integrated, Other, Virtual};
        let mut kinds = [Cpu, Discrete, Other, Integrated, Virtual];
        kinds.sort();
        assert_eq!(kinds, [Other, Cpu, Virtual, Integrated, Discrete]);
    }
}
