//! Frame slots: what one frame in flight has of its own. A slot is recorded, submitted, and reused
//! when its submit's value has passed.

use super::barrier::{self, Access};
use super::commands::Commands;
use super::device::Device;
use super::error::GpuError;
use super::picture::Outputs;
use super::stamps::{FrameTimes, Stamps};
use super::target::Target;
use ash::vk;
use std::sync::Arc;
use std::time::Duration;

/// One of the frames that may be in flight at a time.
#[derive(Debug)]
pub struct FrameSlot {
    outputs: Option<Outputs>,
    commands: Commands,
    stamps: Option<Stamps>,
    index: usize,
}

impl FrameSlot {
    /// Slot number `index` of its run.
    ///
    /// # Errors
    /// The device is out of memory.
    pub fn new(device: &Arc<Device>, index: usize) -> Result<Self, GpuError> {
        let commands = Commands::new(device, &format!("frame slot {index}"))?;
        let stamps = Stamps::new(device)?;
        Ok(Self { outputs: None, commands, stamps, index })
    }

    /// Whether a frame of this slot is with the device, or has come back and was not taken yet.
    #[must_use]
    pub fn is_pending(&self) -> bool {
        self.commands.is_pending()
    }

    /// Waits until the slot's frame is finished, `timeout` at most; whether it is (true also
    /// without a frame).
    ///
    /// # Errors
    /// The device was lost.
    pub fn wait(&self, timeout: Duration) -> Result<bool, GpuError> {
        self.commands.wait(timeout)
    }

    /// The pixels of the slot's frame and the times that the device took; waits for them. `None`
    /// without a frame.
    ///
    /// # Errors
    /// The device was lost, or hangs.
    pub fn take(&mut self) -> Result<Option<(Outputs, FrameTimes)>, GpuError> {
        let was_pending = self.commands.finish()?;
        let Some(outputs) = self.outputs.take() else { return Ok(None) };
        let times = self.stamps.as_ref().filter(|_| was_pending).and_then(Stamps::times);
        Ok(Some((outputs, times.unwrap_or_default())))
    }

    /// Begins the slot's next frame; what was read back of the last one must have been taken.
    ///
    /// # Errors
    /// The device was lost or is out of memory, or the slot's last frame is not finished and taken.
    pub fn begin(&mut self) -> Result<FrameRecording<'_>, GpuError> {
        let commands = self.commands.begin()?;
        if let Some(stamps) = &mut self.stamps {
            // SAFETY: recording, outside of rendering; the slot's last frame is finished.
            unsafe { stamps.begin(commands) };
        }
        let device = Arc::clone(self.commands.device());
        Ok(FrameRecording { slot: self, device, has_copied: false })
    }
}

/// A frame being recorded. It proves that nothing of its slot is in use by the device.
#[derive(Debug)]
pub struct FrameRecording<'a> {
    slot: &'a mut FrameSlot,
    device: Arc<Device>,
    /// Whether a view was copied to the read-back buffer.
    has_copied: bool,
}

impl FrameRecording<'_> {
    /// Number of the slot.
    #[must_use]
    pub fn slot_index(&self) -> usize {
        self.slot.index
    }

    pub(super) fn device(&self) -> &Arc<Device> {
        &self.device
    }

    pub(super) fn commands(&self) -> vk::CommandBuffer {
        self.slot.commands.raw()
    }

    /// Records a piece of work, whose time by the device's clock comes back with the frame
    /// ([`FrameTimes::piece`]), added up where pieces of one number are several.
    pub fn timed<T>(&mut self, piece: usize, work: impl FnOnce(&mut Self) -> T) -> T {
        self.begin_pieces();
        let made = work(self);
        self.end_piece(piece);
        made
    }

    /// A piece begins here, before rendering begins: software devices draw what was recorded when
    /// they meet a stamp, and clear the picture more cheaply while they draw.
    pub fn begin_pieces(&mut self) {
        self.stamp(None);
    }

    /// A piece ends here, and another one may begin.
    pub fn end_piece(&mut self, piece: usize) {
        self.stamp(Some(piece));
    }

    fn stamp(&mut self, piece: Option<usize>) {
        let commands = self.slot.commands.raw();
        if let Some(stamps) = &mut self.slot.stamps {
            // SAFETY: recording; `begin` was called for this frame.
            unsafe { stamps.stamp(commands, piece) };
        }
    }

    /// Copies the view of this size that was drawn to `target` to its place in the outputs.
    pub fn copy_view(&mut self, target: &mut Target, outputs: &Outputs, size: [u32; 2], at: [u32; 2]) {
        if std::mem::replace(&mut self.has_copied, true) {
            // Views beside each other share rows of the buffer, if no byte of them.
            // SAFETY: recording, outside of rendering.
            unsafe { barrier::memory(&self.device, self.commands(), Access::CopyTarget, Access::CopyTarget) };
        } else if let Some(picture) = outputs.picture() {
            // SAFETY: recording, outside of rendering.
            unsafe { picture.begin(self.commands()) };
        }
        target.copy_to_outputs(self, outputs, size, at);
    }

    /// All views were copied; the outputs come back with the slot.
    pub fn put_out(&mut self, outputs: Outputs) {
        if let Some(picture) = outputs.picture().filter(|_| self.has_copied) {
            // SAFETY: recording, outside of rendering; it was begun with the first view.
            unsafe { picture.end(self.commands()) };
        }
        self.slot.outputs = Some(outputs);
    }

    /// Hands the frame to the device.
    ///
    /// # Errors
    /// The device was lost or is out of memory.
    pub fn submit(self) -> Result<(), GpuError> {
        let Self { slot, device, .. } = self;
        let commands = slot.commands.raw();
        // SAFETY: recording, outside of rendering.
        unsafe { barrier::memory(&device, commands, Access::CopyTarget, Access::HostRead) };
        if let Some(stamps) = &slot.stamps {
            // SAFETY: recording; `begin` was called for this frame.
            unsafe { stamps.end(commands) };
        }
        // SAFETY: recording, and all that was begun has ended. Every object that the commands name is
        // an `Owned`, which waits for this submit before it destroys it; the processor touches a
        // slot's buffers only through a `FrameRecording`.
        unsafe { slot.commands.submit() }
    }
}
