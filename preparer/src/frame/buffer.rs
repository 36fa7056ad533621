//! A frame in memory.

use super::{FrameError, FrameOutput};
use crate::heights::TileVanished;
use terravision_common::slot::{Slot, SlotContent};

/// The slots of the last frame, for tests and benches that need no shared memory.
#[derive(Debug, Default)]
pub struct FrameBuffer {
    arrays: Vec<f32>,
    array_f32: usize,
    array_count: usize,
    slots: Vec<Slot>,
}

impl FrameBuffer {
    /// Room for `arrays` arrays of `array_f32` numbers.
    #[must_use]
    pub fn new(arrays: usize, array_f32: usize) -> Self {
        Self { arrays: vec![0.0; arrays * array_f32], array_f32, array_count: 0, slots: Vec::with_capacity(4 * arrays) }
    }

    /// Removes the frame.
    pub fn clear(&mut self) {
        self.array_count = 0;
        self.slots.clear();
    }

    /// The slots.
    #[must_use]
    pub fn slots(&self) -> &[Slot] {
        &self.slots
    }

    /// An elevation array; `None` past the last.
    #[must_use]
    pub fn array(&self, position: u64) -> Option<&[f32]> {
        let position = usize::try_from(position).ok().filter(|p| *p < self.array_count)?;
        self.arrays.get(position * self.array_f32..(position + 1) * self.array_f32)
    }
}

impl FrameOutput for FrameBuffer {
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError> {
        let begin = self.array_count * self.array_f32;
        if self.arrays.len() < begin + self.array_f32 {
            self.arrays.resize(begin + self.array_f32, 0.0);
        }
        fill(&mut self.arrays[begin..begin + self.array_f32])?;
        self.array_count += 1;
        Ok(self.array_count as u64 - 1)
    }

    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError> {
        self.slots.push(Slot::new(slot));
        Ok(())
    }

    fn next_position(&self) -> u64 {
        self.array_count as u64
    }

    fn finish(&mut self) -> Result<(), FrameError> {
        Ok(())
    }
}
