//! Vulkan, through `ash`: the only place of the renderer that contains `unsafe` and names `vk`
//! handles.
//!
//! Layers, each holding an `Arc` of the one before it: `instance` → `device` → resources (`buffer`,
//! `image`, `color_pool`, `elevation`, `target`, `readback`, `picture`) → `passes` → `frame`.
//!
//! Destruction order: every object is owned by `owned::Owned` from the moment it exists, so a
//! constructor that fails half-way destroys what it made. Dropping an owner waits for the submits
//! so far, then destroys the object; memory goes after the object that is bound to it (fields drop
//! in order), then the device, then the instance.
//!
//! One clock: each submit signals the next value of the device's timeline semaphore. A resource
//! that the GPU may be using belongs to a frame slot and is touched again only after the slot's
//! value has passed.
#![expect(unsafe_code, reason = "Vulkan's functions are unsafe; this module offers safe operations built of them")]

mod adapter;
mod barrier;
mod buffer;
mod color_pool;
mod device;
mod elevation;
mod error;
mod frame;
mod host_memory;
mod image;
mod instance;
mod owned;
mod passes;
mod picture;
mod readback;
mod requirements;
mod stamps;
mod target;

pub use adapter::{AdapterDescription, describe_adapters};
pub use color_pool::{ColorPool, Filtering};
pub use device::{Device, DeviceChoice, SubmitValue};
pub use elevation::{Elevation, ElevationPath};
pub use error::GpuError;
pub use frame::{FrameRecording, FrameSlot};
pub use host_memory::HostMemory;
pub use instance::Instance;
pub use passes::floor::FloorPass;
pub use passes::rays::{RayNode, RayTile, RayView, RaysPass};
pub use passes::terrain::{Block, Sides, TerrainPass, TerrainView, TileParameters, ViewParameters};
pub use picture::{DevicePicture, Outputs};
pub use readback::Readback;
pub use requirements::{Capabilities, DeviceKind, Missing, Needs, missing_of};
pub use stamps::{FrameTimes, MOST_PIECES};
pub use target::Target;
