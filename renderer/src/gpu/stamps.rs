//! Timestamps: how long a frame took by the device's own clock, and pieces of it.

use super::device::Device;
use super::error::{During, GpuError};
use super::owned::{Owned, destroyer};
use ash::vk;
use std::sync::Arc;

/// Pieces of a frame that have a time of their own: its draws.
pub const MOST_PIECES: usize = 24;
/// Stamps of a frame: its begin and end, and those of its pieces, each recorded in at most three
/// parts (before rendering, the picture, its depth).
const MOST_STAMPS: usize = 2 + 2 * 3 * MOST_PIECES;

/// Times of a frame by the device's clock.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FrameTimes {
    /// From its begin to the end of its last copy, nanoseconds; `None` where the device has no
    /// clock.
    pub whole: Option<f64>,
    pieces: [f64; MOST_PIECES],
}

impl FrameTimes {
    /// What a piece took, nanoseconds; `None` where the device has no clock.
    #[must_use]
    pub fn piece(&self, piece: usize) -> Option<f64> {
        self.whole.and(self.pieces.get(piece)).copied()
    }
}

/// The stamps of a frame slot.
#[derive(Debug)]
pub(super) struct Stamps {
    queries: Owned<vk::QueryPool>,
    /// Of each stamp behind the first two, in order, the piece that ends there, since the stamp
    /// before.
    pieces: Vec<Option<usize>>,
    period_nanos: f64,
}

impl Stamps {
    /// `None` where the device has no clock.
    pub(super) fn new(device: &Arc<Device>) -> Result<Option<Self>, GpuError> {
        let Some(period_nanos) = device.capabilities().timestamp_period_nanos else { return Ok(None) };
        let info =
            vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(MOST_STAMPS as u32);
        // SAFETY: the queue has timestamps.
        let queries = unsafe { device.raw().create_query_pool(&info, None) }.during("creating timestamps")?;
        let queries = Owned::new(device, queries, destroyer!(destroy_query_pool));
        Ok(Some(Self { queries, pieces: Vec::with_capacity(MOST_STAMPS), period_nanos }))
    }

    /// Begins a frame.
    ///
    /// # Safety
    /// * `commands` is being recorded, outside of rendering, and no submit that uses the stamps is
    ///   pending.
    pub(super) unsafe fn begin(&mut self, commands: vk::CommandBuffer) {
        self.pieces.clear();
        let device = self.queries.device().raw();
        // SAFETY: the caller's promise; the pool has this many queries.
        unsafe { device.cmd_reset_query_pool(commands, self.queries.get(), 0, MOST_STAMPS as u32) };
        // SAFETY: likewise.
        unsafe { self.write(commands, vk::PipelineStageFlags2::TOP_OF_PIPE, 0) };
    }

    /// A piece of the frame ends here, or, without one, the next one begins.
    ///
    /// # Safety
    /// * `commands` is being recorded, since [`Stamps::begin`].
    pub(super) unsafe fn stamp(&mut self, commands: vk::CommandBuffer, piece: Option<usize>) {
        let query = 2 + self.pieces.len();
        if query < MOST_STAMPS {
            self.pieces.push(piece);
            // SAFETY: the caller's promise; the query was reset and not written since.
            unsafe { self.write(commands, vk::PipelineStageFlags2::ALL_COMMANDS, query) };
        }
    }

    /// Ends a frame.
    ///
    /// # Safety
    /// * `commands` is being recorded, since [`Stamps::begin`], outside of rendering.
    pub(super) unsafe fn end(&self, commands: vk::CommandBuffer) {
        // SAFETY: the caller's promise.
        unsafe { self.write(commands, vk::PipelineStageFlags2::ALL_COMMANDS, 1) };
    }

    unsafe fn write(&self, commands: vk::CommandBuffer, stage: vk::PipelineStageFlags2, query: usize) {
        // SAFETY: the caller's promise.
        unsafe {
            self.queries.device().raw().cmd_write_timestamp2(commands, stage, self.queries.get(), query as u32);
        }
    }

    /// The times of the slot's frame, which has been waited for.
    pub(super) fn times(&self) -> Option<FrameTimes> {
        let mut stamps = [0u64; MOST_STAMPS];
        let stamps = &mut stamps[..2 + self.pieces.len()];
        let flags = vk::QueryResultFlags::TYPE_64;
        // SAFETY: these queries were written by a submit that has been waited for; where it was
        // not, they are not ready.
        unsafe { self.queries.device().raw().get_query_pool_results(self.queries.get(), 0, stamps, flags) }.ok()?;
        let between = |from: u64, to: u64| to.wrapping_sub(from) as f64 * self.period_nanos;
        let mut times = FrameTimes { whole: Some(between(stamps[0], stamps[1])), ..FrameTimes::default() };
        for (pair, piece) in stamps[2..].windows(2).zip(&self.pieces[1.min(self.pieces.len())..]) {
            if let Some(time) = piece.and_then(|piece| times.pieces.get_mut(piece)) {
                *time += between(pair[0], pair[1]);
            }
        }
        Some(times)
    }
}
