//! Slots that open a frame, describe its views, and close it.

use crate::camera::{Camera, CameraError, CameraFields};
use crate::rig::View;
use bytemuck::{Pod, Zeroable};

/// Opens a frame.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FrameMarker {
    /// The frame's number.
    pub frame: u64,
    /// The camera for which the tree was made: the pose that carries the frame's views. Heights of
    /// the frame's elevation arrays are metres above its eye; its own size and field of view are
    /// not those of a picture.
    pub camera: CameraFields,
    /// Wanted screen resolution of facets, pixels.
    pub r_z_px: f64,
    /// Wanted screen resolution of texels, pixels.
    pub r_c_px: f64,
    /// The frame's place among those of the run that were prepared, from 1
    /// ([`crate::ids::Sequence`]).
    pub sequence: u64,
    /// Position of its first array in the elevation ring. Arrays between the end of the frame
    /// before and this position belong to no frame: their preparer was killed.
    pub elevation_start: u64,
    /// Which preparer of the run makes it, counted from 1: a restarted preparer aborts the frame
    /// before.
    pub maker: u64,
    /// Width and height of the picture that holds all views, pixels.
    pub picture: [u32; 2],
}

/// One view of a frame; follows the marker, in the order of the run's rig. All of a frame's views
/// are drawn from the same tiles.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ViewSlot {
    /// The camera that draws it, and the size of its picture.
    pub camera: CameraFields,
    /// How far right of the line of sight the middle of its picture is, pixels.
    pub lens_shift_px: f64,
    /// Its upper left corner in the frame's picture, pixels.
    pub at: [u32; 2],
    /// Which of the frame's views it is, from 0.
    pub index: u32,
    /// How many views the frame has, 1 to [`crate::rig::MAX_VIEWS`].
    pub count: u32,
}

impl ViewSlot {
    /// The slot of a view.
    #[must_use]
    pub fn new(view: &View, index: u32, count: u32) -> Self {
        let (camera, lens_shift_px) = (*view.camera.fields(), view.camera.lens_shift_px());
        Self { camera, lens_shift_px, at: view.at, index, count }
    }

    /// The view.
    ///
    /// # Errors
    /// [`CameraError`]: its numbers make no camera.
    pub fn view(&self) -> Result<View, CameraError> {
        let camera = Camera::new(self.camera)?.with_lens_shift(self.lens_shift_px)?;
        Ok(View { camera, at: self.at })
    }
}

/// Closes a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct FrameEnd {
    /// The frame's number, again.
    pub frame: u64,
    /// Number of tile slots since the marker, with which the reader checks its own count.
    pub tile_count: u32,
    /// Tiles that the frame wanted and that could not be read; 0 for a settled frame.
    pub unavailable_count: u32,
    /// One past the last position of the elevation ring that the frame uses: the reader releases up
    /// to here.
    pub elevation_end: u64,
    /// Tiles (colour and elevation) that the frame wanted.
    pub wanted_count: u32,
    /// Nodes of the frame's tree after truncation.
    pub node_count: u32,
    /// Tiles of the elevation pool that the frame names: with some it has no elevation arrays.
    pub elevation_tile_count: u32,
    /// 0.
    pub reserved: u32,
}
