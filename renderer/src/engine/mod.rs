//! Engines: they turn checked frames into pictures in memory, and know neither where frames come from nor where they go.
//! [`DeviceEngine`] draws with Vulkan, [`RaysEngine`] with the processor alone.

mod device;
mod rays;

pub use device::DeviceEngine;
pub use rays::RaysEngine;

use crate::frame::{Frame, FrameError};
use crate::gpu::{
    AdapterDescription, DeviceChoice, DeviceKind, ElevationPath, GpuError, Missing, Needs, describe_adapters,
};
use crate::pixels::Pixels;
use crate::source::{Done, FrameSource, SourceError};
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::{RingPosition, Sequence};
use terravision_common::rig::Views;
use terravision_common::run::{RaysChoice, TechniqueChoice};
use terravision_raycast::workers::WorkersError;

/// How frames are drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct EngineOptions {
    /// How the ground is drawn.
    pub technique: TechniqueChoice,
    /// How rays are cast, when they are.
    pub rays: RaysChoice,
    /// Threads that cast rays.
    pub workers: usize,
    /// Which device.
    pub device: DeviceChoice,
    /// Size of a frame's picture, which holds all of its views, pixels.
    pub size: [u32; 2],
    /// How large and how many the views of a frame are; `None` for one that is the whole picture.
    pub views: Option<ViewBounds>,
    /// Samples per pixel, 1 or 4.
    pub samples: u32,
    /// Colour of the sky.
    pub sky_rgb: [u8; 3],
    /// Height of the world's lowest ground as it is drawn, where it has a skirt down to it; `None` for no skirt.
    pub skirt_low_m: Option<f64>,
    /// Outlines of the colour leaves.
    pub has_tree_overlay: bool,
    /// The validation layer is asked for; its messages are errors.
    pub has_validation: bool,
    /// Depth comes back with the picture.
    pub has_depth: bool,
    /// Frames recorded or drawn at a time; 0 leaves it to the device ([`frames_in_flight`]).
    pub frames_in_flight: usize,
    /// How elevations reach the device.
    pub elevation_path: ElevationPath,
    /// Whether colour tiles may be copied from shared memory by the device itself.
    pub can_import_colors: bool,
    /// For tests: the device is lost when it is handed its so many-th frame, and so is every one that comes after it.
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
    fn view_bounds(&self) -> ViewBounds {
        self.views.unwrap_or(ViewBounds { size: self.size, count: 1 })
    }

    /// Whether a device casts rays.
    fn is_compute(&self) -> bool {
        self.technique == TechniqueChoice::Rays && self.rays == RaysChoice::Compute
    }

    /// Rays of which it is left open what casts them are a GPU's, if there is one.
    fn with_gpu_rays(self) -> Self {
        if self.technique != TechniqueChoice::Rays || self.rays != RaysChoice::Auto {
            return self;
        }
        // Without Vulkan there is none.
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
            rays: RaysChoice::Mipmap,
            workers: 1,
            device: DeviceChoice::from_environment(),
            size: [1280, 720],
            views: None,
            samples: 1,
            sky_rgb: [150, 190, 235],
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

/// A frame could not be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The device failed.
    #[error(transparent)]
    Gpu {
        /// Why.
        #[from]
        source: GpuError,
    },
    /// A frame from the ring cannot be.
    #[error(transparent)]
    Frame {
        /// Why.
        #[from]
        source: FrameError,
    },
    /// The source failed.
    #[error(transparent)]
    Source {
        /// Why.
        #[from]
        source: SourceError,
    },
    /// No threads for rays.
    #[error(transparent)]
    Workers {
        /// Why.
        #[from]
        source: WorkersError,
    },
    /// Pictures of rays have a largest size, as those of devices have.
    #[error("a picture of {}x{} pixels cannot be drawn by rays, at most {limit}x{limit} can", .size[0], .size[1])]
    PictureSize {
        /// What was asked for.
        size: [u32; 2],
        /// The longest side.
        limit: u32,
    },
    /// Something that only the mesh does was asked of rays.
    #[error("{what}: rays cannot do that, --technique mesh can")]
    MeshOnly {
        /// What.
        what: &'static str,
    },
}

impl EngineError {
    /// Whether it says that no Vulkan device of this machine can draw at all.
    fn is_without_device(&self) -> bool {
        let Self::Gpu { source } = self else { return false };
        match source {
            GpuError::NoLoader { .. } | GpuError::NoDevice => true,
            GpuError::Unsuitable { missing, .. } => {
                !missing.iter().any(|lack| matches!(lack, Missing::PictureSize { .. }))
            }
            _ => false,
        }
    }

    /// Whether the device was lost: another one may do.
    #[must_use]
    pub fn is_device_lost(&self) -> bool {
        matches!(self, Self::Gpu { source } if source.is_device_lost())
    }
}

/// What recording a frame took.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Submitted {
    /// Colour tiles uploaded.
    pub uploads: u32,
    /// When staging them began, nanoseconds of the monotonic clock.
    pub upload_started_nanos: u64,
    /// Nanoseconds spent on finding and staging them.
    pub upload_nanos: u64,
}

/// A frame that the device is done with.
#[derive(Debug)]
pub struct Finished {
    /// Its number.
    pub frame: u64,
    /// Counts the frames of the run from 1.
    pub sequence: Sequence,
    /// One past its last position in the elevation ring.
    pub elevation_end: RingPosition,
    /// One past its last slot in the ring.
    pub slots_end: RingPosition,
    /// The camera that its tree was made for.
    pub pose: Camera,
    /// What its picture shows, and where.
    pub views: Views,
    /// Screen resolutions of facets and texels that its tree was made for, pixels.
    pub r_px: [f64; 2],
    /// Whether every tile that it wanted was there.
    pub is_settled: bool,
    /// Triangles drawn.
    pub triangles: u64,
    /// When recording it began, nanoseconds of the monotonic clock.
    pub started_nanos: u64,
    /// When it was handed to the device, nanoseconds of the monotonic clock.
    pub submitted_nanos: u64,
    /// When it was found finished.
    pub finished_nanos: u64,
    /// Time that the device took by its own clock, if it has one.
    pub gpu_nanos: Option<f64>,
    /// Its pixels.
    pub pixels: Pixels,
}

/// A frame that was taken in, without its picture yet.
#[derive(Debug, Clone, Copy)]
struct InFlight {
    frame: u64,
    done: Done,
    pose: Camera,
    views: Views,
    r_px: [f64; 2],
    is_settled: bool,
    triangles: u64,
    started_nanos: u64,
    submitted_nanos: u64,
}

impl InFlight {
    fn new(frame: &Frame, triangles: u64, started_nanos: u64, submitted_nanos: u64) -> Self {
        Self {
            frame: frame.marker.frame,
            done: Done {
                sequence: frame.sequence,
                elevation_end: RingPosition::new(frame.end.elevation_end),
                slots_end: frame.slots_end,
            },
            pose: frame.marker.camera,
            views: frame.views,
            r_px: [frame.marker.r_z_px, frame.marker.r_c_px],
            is_settled: frame.end.unavailable_count == 0,
            triangles,
            started_nanos,
            submitted_nanos,
        }
    }

    /// The frame with its picture, now.
    fn finish(self, gpu_nanos: Option<f64>, pixels: Pixels) -> Finished {
        let Self { frame, done, pose, views, r_px, is_settled, triangles, started_nanos, submitted_nanos } = self;
        let Done { sequence, elevation_end, slots_end } = done;
        Finished {
            frame,
            sequence,
            elevation_end,
            slots_end,
            pose,
            views,
            r_px,
            is_settled,
            triangles,
            started_nanos,
            submitted_nanos,
            finished_nanos: monotonic_nanos(),
            gpu_nanos,
            pixels,
        }
    }
}

impl Finished {
    /// How far frames are done with when this one is.
    #[must_use]
    pub fn done(&self) -> Done {
        Done { sequence: self.sequence, elevation_end: self.elevation_end, slots_end: self.slots_end }
    }
}

/// What draws.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Described {
    /// The technique: `mesh` or `rays`.
    pub technique: &'static str,
    /// The device.
    pub device: String,
    /// The device's driver, or how rays are cast.
    pub driver: String,
}

/// Draws frames.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "there is one of them")]
pub enum Engine {
    /// With Vulkan.
    Device(DeviceEngine),
    /// With the processor alone.
    Rays(RaysEngine),
}

impl Engine {
    /// Makes all that frames of this source need. When the technique is left open, rays are cast where no Vulkan device is.
    ///
    /// # Errors
    /// No device, or it lacks something; or rays are asked for what they cannot do.
    pub fn new(options: EngineOptions, source: &dyn FrameSource) -> Result<Self, EngineError> {
        let options = options.with_gpu_rays();
        if options.technique == TechniqueChoice::Rays && !options.is_compute() {
            return Ok(Self::Rays(RaysEngine::new(options, source)?));
        }
        match DeviceEngine::new(options.clone(), source) {
            Ok(engine) => Ok(Self::Device(engine)),
            Err(error) if options.technique == TechniqueChoice::Auto && error.is_without_device() => {
                Ok(Self::Rays(RaysEngine::new(EngineOptions { samples: 1, ..options }, source)?))
            }
            Err(error) => Err(error),
        }
    }

    /// What draws.
    #[must_use]
    pub fn describe(&self) -> Described {
        match self {
            Self::Device(engine) => engine.describe(),
            Self::Rays(engine) => engine.describe(),
        }
    }

    /// Frames recorded or drawn at a time.
    #[must_use]
    pub fn frames_in_flight(&self) -> usize {
        match self {
            Self::Device(engine) => engine.frames_in_flight(),
            Self::Rays(_) => 1,
        }
    }

    /// A buffer for pictures to come back in.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new_pixels(&self) -> Result<Pixels, EngineError> {
        match self {
            Self::Device(engine) => Ok(Pixels::Device(engine.new_readback()?)),
            Self::Rays(engine) => Ok(engine.new_pixels()),
        }
    }

    /// Whether another frame can be submitted before one has come back.
    #[must_use]
    pub fn has_room(&self) -> bool {
        match self {
            Self::Device(engine) => engine.has_room(),
            Self::Rays(engine) => !engine.is_busy(),
        }
    }

    /// Whether frames are being drawn.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        match self {
            Self::Device(engine) => engine.is_busy(),
            Self::Rays(engine) => engine.is_busy(),
        }
    }

    /// Takes a frame in; its pixels will come back in `pixels`. There must be room.
    ///
    /// # Errors
    /// The device failed, or the frame names what is not there.
    pub fn submit(
        &mut self,
        frame: &Frame,
        source: &mut dyn FrameSource,
        pixels: Pixels,
    ) -> Result<Submitted, EngineError> {
        match (self, pixels) {
            (Self::Device(engine), Pixels::Device(readback)) => engine.submit(frame, source, readback),
            (Self::Device(engine), Pixels::Memory(_)) => {
                let readback = engine.new_readback()?;
                engine.submit(frame, source, readback)
            }
            (Self::Rays(engine), pixels) => engine.submit(frame, source, pixels),
        }
    }

    /// The oldest frame that was taken in, if it is finished within `timeout`.
    ///
    /// # Errors
    /// The device was lost, or the validation layer said something.
    pub fn poll(&mut self, timeout: Duration) -> Result<Option<Finished>, EngineError> {
        match self {
            Self::Device(engine) => engine.poll(timeout),
            Self::Rays(engine) => Ok(engine.take_finished()),
        }
    }

    /// Whether the validation layer has been silent, where there is one.
    ///
    /// # Errors
    /// It has not.
    pub fn check_validation(&self) -> Result<(), EngineError> {
        match self {
            Self::Device(engine) => Ok(engine.device().instance().check_validation()?),
            Self::Rays(_) => Ok(()),
        }
    }
}
