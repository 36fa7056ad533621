//! How terrain is drawn. The mesh is drawn by a device, behind one drawing trait; rays are cast without any, so that their part
//! here is what a slot means to them.

mod mesh;
mod rays;
mod view;

pub use mesh::{LOD_BIAS, MAX_ANISOTROPY, MeshTechnique};
pub use rays::BlockReader;
pub use view::{NEAR_M, view_parameters};

use crate::frame::Frame;
use crate::gpu::{ColorPool, Elevation, GpuError, Recording};

/// Where the elevation arrays of a frame lie in the buffer that the device reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArrayPlaces<'a> {
    /// Index of the first value of the n-th array after the frame's first.
    pub starts: &'a [u32],
}

/// Draws a frame's tiles into a picture and its depth. It knows no sink.
///
/// One thread calls it: [`Technique::prepare`], then, within rendering, [`Technique::draw`] once for the picture and
/// perhaps once more for depth.
pub trait Technique: Send {
    /// What it is called in reports.
    fn name(&self) -> &'static str;

    /// Takes a checked frame in.
    ///
    /// # Errors
    /// The device is out of memory.
    fn prepare(
        &mut self,
        recording: &mut Recording<'_>,
        frame: &Frame,
        elevation: &Elevation,
        places: ArrayPlaces<'_>,
    ) -> Result<(), GpuError>;

    /// Draws the frame that was prepared last. `is_depth_only`: no picture, depth at pixel centres.
    fn draw(&self, recording: &mut Recording<'_>, colors: &ColorPool, is_depth_only: bool);

    /// Triangles of the frame that was prepared last.
    fn triangles(&self) -> u64;
}
