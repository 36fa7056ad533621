//! How terrain is drawn. A device draws the mesh, or casts rays, behind one drawing trait; the
//! processor casts rays without any, so that its part here is what a slot means to rays.

mod compute;
mod device_terms;
mod draw;
mod mesh;
mod rays;
mod view_parameters;

pub use compute::ComputeRays;
pub use draw::{Draw, TileSubset};
pub use mesh::{LOD_BIAS, MAX_ANISOTROPY, MeshTechnique};
pub use rays::BlockReader;
pub use view_parameters::{NEAR_M, view_parameters};

use crate::frame::{Frame, FrameError, leaf_level};
use crate::gpu::{ColorPool, Elevation, FrameRecording, GpuError};
use terravision_common::run::TechniqueChoice;
use terravision_common::slot::TileSlot;

/// A frame could not be drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DrawError {
    /// The device failed.
    #[error(transparent)]
    Gpu {
        /// Why.
        #[from]
        source: GpuError,
    },
    /// A tile of the frame is wrong.
    #[error(transparent)]
    Frame {
        /// Why.
        #[from]
        source: FrameError,
    },
}

/// Where the elevation arrays of a frame lie in the buffer that the device reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArrayPlaces<'a> {
    /// Index of the first value of the n-th array after the frame's first.
    pub starts: &'a [u32],
}

/// Draws subsets of a frame's tiles into the pictures of its views and their depth, where other
/// techniques may draw others. It knows no sink.
///
/// One thread calls it: [`Technique::prepare`] with all draws of a frame, then, within rendering,
/// [`Technique::draw`] of each once for the picture and perhaps once more for depth.
pub trait Technique: Send {
    /// What it is.
    fn choice(&self) -> TechniqueChoice;

    /// Whether a tile is to be drawn where a view may see no facet of it ([`TileSlot::unseen_by`]).
    fn wants_unseen(&self) -> bool;

    /// Takes the draws of a checked frame in.
    ///
    /// # Errors
    /// The device is out of memory, or a tile of the frame is wrong.
    fn prepare(
        &mut self,
        recording: &mut FrameRecording<'_>,
        frame: &Frame,
        draws: &mut dyn Iterator<Item = Draw<'_>>,
        elevation: &Elevation,
        places: ArrayPlaces<'_>,
    ) -> Result<(), DrawError>;

    /// Draws one of the draws, counted from 0, that were prepared last. `is_depth_only`: no
    /// picture, depth at pixel centres.
    fn draw(&self, draw: usize, recording: &mut FrameRecording<'_>, colors: &ColorPool, is_depth_only: bool);

    /// Triangles of such a draw.
    fn triangles(&self, draw: usize) -> u64;
}

/// Outline colours by level, finest first: neighbours in level differ in hue and in brightness.
const OUTLINES: [[u8; 3]; 8] = [
    [255, 64, 64],
    [255, 200, 0],
    [64, 220, 64],
    [0, 220, 255],
    [64, 96, 255],
    [220, 64, 255],
    [255, 255, 255],
    [255, 140, 80],
];

/// Colour of a tile's outline, RGBA8.
pub(crate) fn outline_of(tile: &TileSlot) -> u32 {
    let [r, g, b] = OUTLINES[usize::from(leaf_level(tile)) % OUTLINES.len()];
    u32::from_le_bytes([r, g, b, 255])
}
