//! Frames from the shared memory of a run.

use super::{Completion, Done, ElevationPoolShape, FrameSource, Pools, Slots, SourceError, SourceShape, Telemetry};
use crate::gpu::HostMemory;
use std::sync::Arc;
use terravision_common::event::Event;
use terravision_common::ids::{RingPosition, SlotKey};
use terravision_common::rate::FrameTiming;
use terravision_common::shm::{
    Activity, Consumer, Control, Counter, ElevationReader, PoolReader, Producer, Stage, WaitError,
};
use terravision_common::slot::Slot;
use terravision_common::texels::TexelFormat;
use terravision_common::world::World;

/// The renderer's ends of a run's segments.
#[derive(Debug)]
pub struct LiveSource {
    control: Arc<Control>,
    ring: Consumer<Slot>,
    elevation: ElevationReader,
    colors: PoolReader,
    /// The elevation pool, where heights are read out of it in place.
    elevation_pool: Option<PoolReader>,
    events: Option<Producer<Event>>,
    world: World,
    frames: [u64; 2],
    has_gaps: bool,
    texels: TexelFormat,
    tile_bytes: u64,
}

impl LiveSource {
    /// Over the renderer's ends of a run's segments (in tests, of this process's memory); colour
    /// tiles with their format.
    ///
    /// # Errors
    /// They do not fit the world.
    pub fn new(
        control: Arc<Control>,
        ring: Consumer<Slot>,
        elevation: ElevationReader,
        (colors, texels): (PoolReader, TexelFormat),
        events: Option<Producer<Event>>,
        world: World,
        frames: [u64; 2],
    ) -> Result<Self, SourceError> {
        let expected = world.elevation_values() as u64;
        if elevation.array_len() < expected {
            return Err(SourceError::ElevationArraySize { found: elevation.array_len(), expected });
        }
        let tile_bytes = texels.tile_bytes(world.color_stored());
        if colors.slot_bytes() < tile_bytes {
            return Err(SourceError::ColorSlotSize { found: colors.slot_bytes(), expected: tile_bytes });
        }
        Ok(Self {
            control,
            ring,
            elevation,
            colors,
            elevation_pool: None,
            events,
            world,
            frames,
            has_gaps: false,
            texels,
            tile_bytes,
        })
    }

    /// Frames may be left out, as in realtime mode.
    #[must_use]
    pub fn with_gaps(self, has_gaps: bool) -> Self {
        Self { has_gaps, ..self }
    }

    /// Frames may name tiles of the elevation pool.
    ///
    /// # Errors
    /// It does not fit the world.
    pub fn with_elevation_pool(self, pool: PoolReader) -> Result<Self, SourceError> {
        let (found, expected) = (pool.slot_bytes() / 4, self.world.elevation_values() as u64);
        if found < expected {
            return Err(SourceError::ElevationArraySize { found, expected });
        }
        Ok(Self { elevation_pool: Some(pool), ..self })
    }

    /// How far frames are done with, by this renderer or those before it.
    fn done(&self) -> Done {
        Done {
            sequence: self.control.completed_sequence(),
            elevation_end: self.elevation.released_position(),
            slots_end: self.ring.position(),
        }
    }

    /// A frame that fills the whole ring cannot be held: what was taken of it is given back, and
    /// dies with this process.
    fn give_back_what_does_not_fit(&mut self) {
        if self.ring.is_all_held() {
            self.ring.give_back(self.ring.position());
        }
    }

    /// The run's control block.
    #[must_use]
    pub fn control(&self) -> &Arc<Control> {
        &self.control
    }
}

impl FrameSource for LiveSource {
    fn shape(&self) -> SourceShape {
        SourceShape {
            world: self.world,
            elevation_arrays: self.elevation.capacity().into(),
            done: self.done(),
            is_resumed: self.control.generation_of(Stage::Renderer) > 1,
            color_slots: self.colors.capacity(),
            elevation_pool: self
                .elevation_pool
                .as_ref()
                .map(|pool| ElevationPoolShape { slots: pool.capacity(), stride: pool.stride_f32() }),
            texels: self.texels,
            frames: self.frames,
            has_gaps: self.has_gaps,
        }
    }
}

impl Slots for LiveSource {
    fn try_next(&mut self) -> Result<Option<Slot>, SourceError> {
        Ok(self.ring.try_take()?)
    }

    fn next(&mut self) -> Result<Slot, SourceError> {
        // Nothing but the open frame is held: who waits has nothing with the device.
        self.give_back_what_does_not_fit();
        let control = Arc::clone(&self.control);
        let taken = self.ring.take_unless(&control, || control.is_all_completed())?;
        taken.ok_or_else(|| WaitError::Finished.into())
    }

    fn position(&self) -> RingPosition {
        self.ring.position()
    }

    fn rewind(&mut self) -> Done {
        self.ring.put_back();
        self.done()
    }
}

impl Pools for LiveSource {
    fn elevation_memory(&self) -> Option<HostMemory> {
        HostMemory::of_segment(self.elevation.memory())
    }

    fn color_memory(&self) -> Option<HostMemory> {
        HostMemory::of_segment(self.colors.memory())
    }

    fn elevation_offset(&mut self, position: u64) -> Result<Option<u64>, SourceError> {
        let (start, stride) = (self.elevation.data_offset(), self.elevation.stride_bytes());
        Ok(self.elevation.index_of(position)?.map(|index| start + u64::from(index) * stride))
    }

    fn read_elevation(&mut self, position: u64, out: &mut [f32]) -> Result<bool, SourceError> {
        let Some(values) = self.elevation.read_array(position)?.and_then(|array| array.get(..out.len())) else {
            return Ok(false);
        };
        out.copy_from_slice(values);
        Ok(true)
    }

    fn elevation_pool(&self) -> &[f32] {
        self.elevation_pool.as_ref().map_or(&[], PoolReader::all_f32)
    }

    fn has_elevation_tile(&self, key: SlotKey) -> bool {
        self.elevation_pool.as_ref().is_some_and(|pool| pool.bytes(key).is_some())
    }

    fn color_offset(&mut self, key: SlotKey) -> Option<u64> {
        self.colors.bytes(key)?;
        self.colors.slot_offset(key.slot)
    }

    fn color(&self, key: SlotKey) -> Option<&[u8]> {
        self.colors.bytes(key)?.bytes().get(..self.tile_bytes as usize)
    }

    fn read_color(&mut self, key: SlotKey, out: &mut [u8]) -> bool {
        let Some(tile) = self.colors.bytes(key) else { return false };
        let Some(bytes) = tile.bytes().get(..out.len().min(self.tile_bytes as usize)) else { return false };
        out[..bytes.len()].copy_from_slice(bytes);
        tile.is_still_valid()
    }
}

impl Completion for LiveSource {
    fn complete(&mut self, done: &Done) -> Result<(), SourceError> {
        // This first: a frame that is completed is not drawn again, whether its slots and arrays
        // were given back or not.
        self.control.set_completed_sequence(done.sequence);
        self.ring.give_back(done.slots_end);
        Ok(self.elevation.released(done.elevation_end)?)
    }

    fn release_elevations(&mut self, upto: RingPosition) -> Result<(), SourceError> {
        Ok(self.elevation.released(upto)?)
    }

    fn is_over(&self) -> bool {
        self.control.is_all_completed()
    }

    fn is_supervised(&self) -> bool {
        self.control.is_supervised()
    }

    fn check(&mut self) -> Result<(), SourceError> {
        self.control.heartbeat(Stage::Renderer);
        self.control.check_running()?;
        if self.control.is_launcher_alive() { Ok(()) } else { Err(WaitError::LauncherGone.into()) }
    }
}

impl Telemetry for LiveSource {
    fn timed(&mut self, timing: &FrameTiming) {
        self.control.publish_timing(timing);
    }

    fn written(&mut self, count: u64) {
        self.control.set_written_frames(count);
    }

    fn event(&mut self, event: &Event) {
        if let Some(events) = &mut self.events
            && events.try_push(*event).is_err()
        {
            self.control.count(Counter::EventsDropped, 1);
        }
    }

    fn count(&mut self, counter: Counter, by: u64) {
        self.control.count(counter, by);
    }

    fn awaits(&mut self, activity: Activity) {
        self.control.awaits(activity);
    }

    fn progress(&mut self) {
        self.control.progress();
    }
}
