//! Engines: they turn checked frames into pictures in memory, and know neither where frames come
//! from nor where they go. [`DeviceEngine`] draws with Vulkan, [`RaysEngine`] with the processor
//! alone, both behind one trait ([`Engine`]).

mod cost;
mod device;
mod error;
mod finished;
mod options;
mod parts;
mod rays;

pub use cost::{DrawCost, DrawCosts};
pub use device::DeviceEngine;
pub use error::EngineError;
pub use finished::{Finished, Submitted};
pub use options::{EngineOptions, ViewBounds};
pub use parts::{MOST_PARTS, Parts};
pub use rays::RaysEngine;

use crate::frame::Frame;
use crate::pixels::Pixels;
use crate::source::{FrameSource, Pools};
use std::fmt::Debug;
use std::time::Duration;
use terravision_common::camera::Camera;
use terravision_common::run::TechniqueChoice;
use terravision_raycast::EdgeStretch;

/// What draws.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Described {
    /// The technique: `mesh` or `rays`.
    pub technique: &'static str,
    /// Why it draws, a clause.
    pub reason: String,
    /// The device.
    pub device: String,
    /// The device's driver, or how rays are cast.
    pub driver: String,
}

/// Draws frames. One thread calls it.
pub trait Engine: Debug {
    /// What draws.
    fn describe(&self) -> Described;

    /// Frames recorded or drawn at a time.
    fn frames_in_flight(&self) -> usize;

    /// A buffer for pictures to come back in.
    ///
    /// # Errors
    /// Out of memory.
    fn new_pixels(&self) -> Result<Pixels, EngineError>;

    /// Whether another frame can be submitted before one has come back.
    fn has_room(&self) -> bool;

    /// Whether frames are being drawn.
    fn is_busy(&self) -> bool;

    /// Takes a frame in; its pixels will come back in `pixels`, or in a new buffer when they are of
    /// another engine's kind. There must be room.
    ///
    /// # Errors
    /// The device failed, or the frame names what is not there.
    fn submit(&mut self, frame: &Frame, pools: &mut dyn Pools, pixels: Pixels) -> Result<Submitted, EngineError>;

    /// The oldest frame that was taken in, if it is finished within `timeout`.
    ///
    /// # Errors
    /// The device was lost, or the validation layer said something.
    fn poll(&mut self, timeout: Duration) -> Result<Option<Finished>, EngineError>;

    /// The edge of the ground along the west, east, south or north side of the world (0 to 3), as a
    /// camera sees it of the frame that was taken in last, where that frame's heights are in place:
    /// stretches in order, from the south or west.
    fn edge(&mut self, _camera: &Camera, _pools: &dyn Pools, _side: usize, _put: &mut dyn FnMut(EdgeStretch)) {}

    /// Whether frames from now on have outlines of the tree's colour leaves.
    ///
    /// # Errors
    /// The device failed.
    fn set_tree_overlay(&mut self, has_overlay: bool) -> Result<(), EngineError>;

    /// Whether the validation layer has been silent, where there is one.
    ///
    /// # Errors
    /// It has not.
    fn check_validation(&self) -> Result<(), EngineError> {
        Ok(())
    }
}

/// The engine for frames of this source.
///
/// # Errors
/// No device, or it lacks something; or rays are asked for what they cannot do.
pub fn open(options: EngineOptions, source: &dyn FrameSource) -> Result<Box<dyn Engine>, EngineError> {
    let options = options.with_gpu_rays();
    if options.technique == TechniqueChoice::Rays && !options.is_compute() {
        return Ok(Box::new(RaysEngine::new(options, source)?));
    }
    Ok(Box::new(DeviceEngine::new(options, source)?))
}
