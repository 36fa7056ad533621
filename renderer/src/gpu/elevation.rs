//! Elevation arrays for the vertex shader: read in place from the shared ring where the device can
//! import it, else copied into a buffer of the frame.

use super::buffer::{Buffer, BufferUse};
use super::device::Device;
use super::error::GpuError;
use super::frame::FrameRecording;
use super::host_memory::HostMemory;
use ash::vk;
use std::sync::Arc;

/// How elevation arrays reach the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ElevationPath {
    /// In place where possible, else staged.
    Best,
    /// Always copied into a buffer of the frame.
    Staged,
}

/// Values that a frame's staging buffer has room for at first; it grows.
const FIRST_STAGED_VALUES: u64 = 1 << 18;

/// The elevation arrays of the frames in flight.
#[derive(Debug)]
pub struct Elevation {
    imported: Option<Buffer>,
    staged: Vec<Option<Buffer>>,
}

impl Elevation {
    /// Over the shared ring, if there is one and the device can read it in place, else staged.
    /// `slots`: frame slots.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(
        device: &Arc<Device>,
        path: ElevationPath,
        shared: Option<&HostMemory>,
        slots: usize,
    ) -> Result<Self, GpuError> {
        let fits = |pages: &&HostMemory| pages.len() as u64 <= device.capabilities().max_storage_range;
        let imported = match shared.filter(|_| path == ElevationPath::Best).filter(fits) {
            Some(pages) => {
                Buffer::import(device, pages, vk::BufferUsageFlags::STORAGE_BUFFER, "shared elevation ring")?
            }
            None => None,
        };
        Ok(Self { imported, staged: (0..slots).map(|_| None).collect() })
    }

    /// Whether arrays are read from shared memory in place.
    #[must_use]
    pub fn is_imported(&self) -> bool {
        self.imported.is_some()
    }

    /// Values in the imported memory; 0 when it is staged.
    #[must_use]
    pub fn imported_values(&self) -> u64 {
        self.imported.as_ref().map_or(0, |buffer| buffer.len() / 4)
    }

    /// Room for `values` elevations of the frame being recorded, for the caller to fill.
    ///
    /// # Errors
    /// Out of memory, or more than the device can bind.
    pub fn stage(&mut self, recording: &FrameRecording<'_>, values: u64) -> Result<&mut [f32], GpuError> {
        let index = recording.slot_index();
        let slots = self.staged.len() as u64;
        let device = recording.device();
        let limit = device.capabilities().max_storage_range / 4;
        if values > limit {
            return Err(GpuError::TooMany { what: "elevations of a frame", found: values, limit });
        }
        let Some(place) = self.staged.get_mut(index) else {
            return Err(GpuError::TooMany { what: "frame slots", found: index as u64 + 1, limit: slots });
        };
        if place.as_ref().is_none_or(|buffer| buffer.len() < values * 4) {
            let len = values.next_power_of_two().max(FIRST_STAGED_VALUES).min(limit) * 4;
            *place = Some(Buffer::new(device, len, BufferUse::Storage, "staged elevations")?);
        }
        let bytes = place.as_mut().map_or(&mut [][..], Buffer::bytes_mut);
        Ok(&mut bytemuck::cast_slice_mut(bytes)[..values as usize])
    }

    /// The buffer that the slot's frame reads; `None` before anything was staged.
    pub(super) fn buffer(&self, slot: usize) -> Option<&Buffer> {
        self.imported.as_ref().or_else(|| self.staged.get(slot)?.as_ref())
    }
}
