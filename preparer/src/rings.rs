//! The output of frames: slots go to the ring, elevation arrays to the elevation ring.

use crate::frame::{FrameError, FrameOutput};
use crate::heights::TileVanished;
use terravision_common::event::monotonic_nanos;
use terravision_common::ids::Sequence;
use terravision_common::shm::{Control, ElevationWriter, Producer, WaitError};
use terravision_common::slot::{FrameMarker, Slot, SlotContent};

/// Slots that are collected before they are written to the ring together.
pub(crate) const SLOTS_AT_ONCE: usize = 1024;

/// The rings as a frame's output.
#[derive(Debug)]
pub(crate) struct Rings<'a> {
    pub(crate) ring: &'a mut Producer<Slot>,
    pub(crate) elevation: &'a mut ElevationWriter,
    pub(crate) control: &'a Control,
    pub(crate) slots: &'a mut Vec<Slot>,
    pub(crate) sequence: Sequence,
    pub(crate) maker: u64,
    /// Time spent waiting for room in one of them.
    pub(crate) waited_nanos: u64,
}

impl FrameOutput for Rings<'_> {
    fn array(&mut self, fill: &mut dyn FnMut(&mut [f32]) -> Result<(), TileVanished>) -> Result<u64, FrameError> {
        if !self.elevation.has_room().map_err(WaitError::from)? {
            // Arrays left by a killed preparer or renderer are given back when the frame's marker
            // is read.
            self.finish()?;
            let started = monotonic_nanos();
            drop(self.elevation.begin(self.control)?);
            self.waited_nanos += monotonic_nanos() - started;
        }
        let mut array = self.elevation.begin(self.control)?;
        fill(array.values_mut())?;
        Ok(array.publish())
    }

    fn slot(&mut self, slot: &SlotContent) -> Result<(), FrameError> {
        if self.slots.len() == SLOTS_AT_ONCE {
            self.finish()?;
        }
        let (sequence, maker, elevation_start) = (self.sequence.get(), self.maker, self.next_position());
        self.slots.push(match slot {
            SlotContent::Marker(marker) => {
                Slot::new(&SlotContent::Marker(FrameMarker { sequence, elevation_start, maker, ..*marker }))
            }
            other => Slot::new(other),
        });
        Ok(())
    }

    fn next_position(&self) -> u64 {
        self.elevation.next_position()
    }

    fn finish(&mut self) -> Result<(), FrameError> {
        self.waited_nanos += self.ring.push_all(self.slots, self.control)?;
        self.slots.clear();
        Ok(())
    }
}
