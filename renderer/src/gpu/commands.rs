//! Commands for the device: recorded, handed over, waited for, and recorded again.

use super::device::{Device, LONGEST_FRAME, SubmitValue};
use super::error::{During, GpuError};
use super::owned::{Owned, destroyer};
use ash::vk;
use std::sync::Arc;
use std::time::Duration;

/// A command buffer in a pool of its own, which knows whether the device has it.
#[derive(Debug)]
pub(super) struct Commands {
    pending: Option<SubmitValue>,
    raw: vk::CommandBuffer,
    pool: Owned<vk::CommandPool>,
}

impl Commands {
    /// Nothing yet; `name` is for messages and debuggers.
    pub(super) fn new(device: &Arc<Device>, name: &str) -> Result<Self, GpuError> {
        let info = vk::CommandPoolCreateInfo::default()
            .queue_family_index(device.queue_family())
            .flags(vk::CommandPoolCreateFlags::TRANSIENT);
        // SAFETY: the family is the device's own.
        let pool = unsafe { device.raw().create_command_pool(&info, None) }.during("creating a command pool")?;
        let pool = Owned::new(device, pool, destroyer!(destroy_command_pool));
        let allocate = vk::CommandBufferAllocateInfo::default().command_pool(pool.get()).command_buffer_count(1);
        // SAFETY: the pool is alive; the buffer goes with it.
        let raw = unsafe { device.raw().allocate_command_buffers(&allocate) }.during("allocating a command buffer")?[0];
        device.name(raw, name);
        Ok(Self { pending: None, raw, pool })
    }

    pub(super) fn device(&self) -> &Arc<Device> {
        self.pool.device()
    }

    pub(super) fn raw(&self) -> vk::CommandBuffer {
        self.raw
    }

    /// Whether they are with the device, or nobody has waited for them since.
    pub(super) fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    /// Waits until the device is done with them, `timeout` at most; whether it is.
    pub(super) fn wait(&self, timeout: Duration) -> Result<bool, GpuError> {
        self.pending.map_or(Ok(true), |value| self.device().wait(value, timeout))
    }

    /// Waits until the device is done with them; whether they were pending.
    pub(super) fn finish(&mut self) -> Result<bool, GpuError> {
        if self.wait(LONGEST_FRAME)? {
            Ok(self.pending.take().is_some())
        } else {
            Err(GpuError::Timeout { seconds: LONGEST_FRAME.as_secs() })
        }
    }

    /// Records from the beginning; what was recorded before is finished ([`Commands::finish`]).
    pub(super) fn begin(&mut self) -> Result<vk::CommandBuffer, GpuError> {
        if self.pending.is_some() {
            return Err(GpuError::TooMany { what: "frames in one slot", found: 2, limit: 1 });
        }
        let device = self.pool.device().raw();
        // SAFETY: nothing of the pool is pending.
        unsafe { device.reset_command_pool(self.pool.get(), vk::CommandPoolResetFlags::empty()) }
            .during("resetting a command pool")?;
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: the buffer was just reset.
        unsafe { device.begin_command_buffer(self.raw, &info) }.during("beginning commands")?;
        Ok(self.raw)
    }

    /// Ends the recording and hands it to the device.
    ///
    /// # Safety
    /// * They are being recorded, and all that was begun has ended.
    /// * All that they name stays alive and untouched by the processor until they are finished.
    pub(super) unsafe fn submit(&mut self) -> Result<(), GpuError> {
        // SAFETY: the caller's promise.
        unsafe { self.submit_between(None, None) }
    }

    /// Likewise, but not before one semaphore is signaled, and signals another one in the end.
    ///
    /// # Safety
    /// * As for [`Commands::submit`], and of the semaphores as for [`Device::submit`].
    pub(super) unsafe fn submit_between(
        &mut self,
        after: Option<vk::Semaphore>,
        before: Option<vk::Semaphore>,
    ) -> Result<(), GpuError> {
        let device = self.pool.device();
        // SAFETY: recording.
        unsafe { device.raw().end_command_buffer(self.raw) }.during("ending commands")?;
        // SAFETY: complete and not pending; the rest is the caller's promise.
        self.pending = Some(unsafe { device.submit(self.raw, after, before) }?);
        Ok(())
    }
}
