//! A Vulkan object with the device that it is of; destroyed when dropped.

use super::device::Device;
use std::fmt;
use std::sync::Arc;

/// Owns one object of the device. Dropping it waits for the submits so far, which may use it;
/// objects go when a run ends or when a buffer grows, never in the steady state.
pub(super) struct Owned<H: Copy> {
    handle: H,
    destroy: fn(&ash::Device, H),
    device: Arc<Device>,
}

impl<H: Copy> Owned<H> {
    /// Takes `handle`, fresh from the device, into ownership; `destroy` calls the matching destroy
    /// function.
    pub(super) fn new(device: &Arc<Device>, handle: H, destroy: fn(&ash::Device, H)) -> Self {
        Self { handle, destroy, device: Arc::clone(device) }
    }

    /// The handle, valid as long as the owner lives.
    pub(super) fn get(&self) -> H {
        self.handle
    }

    /// The device.
    pub(super) fn device(&self) -> &Arc<Device> {
        &self.device
    }
}

impl<H: Copy> Drop for Owned<H> {
    fn drop(&mut self) {
        // A device that hangs keeps the object: leaking it is better than destroying what is in
        // use.
        if self.device.wait_for_all() {
            (self.destroy)(self.device.raw(), self.handle);
        }
    }
}

impl<H: Copy + fmt::Debug> fmt::Debug for Owned<H> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.handle.fmt(f)
    }
}

/// A destroy function for [`Owned::new`]: `destroyer!(destroy_buffer)`.
macro_rules! destroyer {
    ($function:ident) => {
        |device, handle| {
            // SAFETY: `Owned` calls this once, with a handle that it was given at creation by this
            // device, after all submits that may use the object.
            unsafe { device.$function(handle, None) }
        }
    };
}
pub(super) use destroyer;
