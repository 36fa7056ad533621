//! Vulkan, through `ash`: the only place of the renderer that contains `unsafe` and names `vk`
//! handles.
//!
//! Layers, each holding an `Arc` of the one before it: `instance` → `device` → resources (`buffer`,
//! `image`, `color_pool`, `elevation`, `target`, `readback`, `picture`) → `passes` → `frame`. What is recorded and
//! submitted is `commands`. With windows
//! (`feature = "window"`): `surface` → `swapchain` → `presenter`.
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
mod commands;
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
#[cfg(feature = "window")]
mod presenter;
mod readback;
mod requirements;
mod stamps;
#[cfg(feature = "window")]
mod surface;
#[cfg(feature = "window")]
mod swapchain;
mod target;
#[cfg(feature = "window")]
mod window_faults;

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
pub use picture::{DevicePicture, Outputs, Place};
#[cfg(feature = "window")]
pub use presenter::{Presenter, ShowOptions, Shown, check_showing};
pub use readback::Readback;
pub use requirements::{Capabilities, DeviceKind, Missing, Needs, missing_of};
pub use stamps::{FrameTimes, MOST_PIECES};
#[cfg(feature = "window")]
pub use surface::ShowTarget;
pub use target::Target;
#[cfg(feature = "window")]
pub use window_faults::WindowFaults;
