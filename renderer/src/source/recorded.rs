//! Frames recorded in memory: for tests, and for benches that feed the renderer without the stages
//! before it.

use super::{Completion, Done, ElevationPoolShape, FrameSource, Pools, Slots, SourceError, SourceShape, Telemetry};
use crate::gpu::HostMemory;
use std::collections::HashMap;
use std::sync::Arc;
use terravision_common::event::Event;
use terravision_common::ids::{RingPosition, SlotKey};
use terravision_common::node::NodeId;
use terravision_common::rate::FrameTiming;
use terravision_common::rig::Views;
use terravision_common::shm::Counter;
use terravision_common::slot::{
    ElevationSlot, ElevationTile, FrameEnd, FrameMarker, Slot, SlotContent, TileSlot, ViewSlot,
};
use terravision_common::texels::TexelFormat;
use terravision_common::world::World;

/// One frame's slots. Positions of elevations count arrays of the recording from 0.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedFrame {
    /// Its first slot.
    pub marker: FrameMarker,
    /// Its views.
    pub views: Views,
    /// Tiles of the elevation pool in which its heights lie; empty where it has arrays.
    pub elevations: Vec<ElevationTile>,
    /// Its tiles, near to far.
    pub tiles: Vec<TileSlot>,
    /// Its last slot.
    pub end: FrameEnd,
}

/// Frames with all elevations and colours that they name.
#[derive(Debug)]
pub struct Recording {
    world: World,
    texels: TexelFormat,
    frames: Vec<RecordedFrame>,
    elevations: HostMemory,
    arrays: u64,
    /// The elevation pool, slots as long as arrays.
    pool: Vec<f32>,
    colors: HostMemory,
    /// Where each colour tile lies.
    color_offsets: HashMap<SlotKey, u64>,
    color_slots: u32,
}

impl Recording {
    /// The frames.
    #[must_use]
    pub fn frames(&self) -> &[RecordedFrame] {
        &self.frames
    }

    /// The world that it is of.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    fn pool_shape(&self) -> ElevationPoolShape {
        let stride = self.world.elevation_values();
        ElevationPoolShape { slots: (self.pool.len() / stride) as u32, stride: stride as u32 }
    }

    /// Bytes of elevations and colours.
    #[must_use]
    pub fn total_bytes(&self) -> u64 {
        (self.elevations.len() + size_of_val(&self.pool[..]) + self.colors.len()) as u64
    }
}

/// Puts a [`Recording`] together.
#[derive(Debug)]
pub struct RecordingBuilder {
    world: World,
    texels: TexelFormat,
    frames: Vec<RecordedFrame>,
    elevations: Vec<f32>,
    pool: Vec<f32>,
    colors: Vec<u8>,
    color_offsets: HashMap<SlotKey, u64>,
    color_slots: u32,
}

impl RecordingBuilder {
    /// An empty recording of this world.
    #[must_use]
    pub fn new(world: World) -> Self {
        Self {
            world,
            texels: TexelFormat::Rgba8,
            frames: Vec::new(),
            elevations: Vec::new(),
            pool: Vec::new(),
            colors: Vec::new(),
            color_offsets: HashMap::new(),
            color_slots: 1,
        }
    }

    /// Colour tiles are of this format.
    #[must_use]
    pub fn with_texels(self, texels: TexelFormat) -> Self {
        Self { texels, ..self }
    }

    /// Adds an elevation array (its posts, row 0 south, and the planes of validity of a world that
    /// has them) and returns its position.
    pub fn add_elevations(&mut self, values: &[f32]) -> u64 {
        let count = self.world.elevation_values();
        let start = self.elevations.len();
        self.elevations.extend_from_slice(&values[..values.len().min(count)]);
        self.elevations.resize(start + count, 0.0);
        self.arrays() - 1
    }

    /// Adds a tile of the elevation pool (its posts, metres, row 0 south) in a slot of its own.
    pub fn add_elevation_tile(&mut self, node: NodeId, values: &[f32]) -> ElevationTile {
        let count = self.world.elevation_values();
        let slot = self.pool.len() / count;
        self.pool.extend_from_slice(&values[..values.len().min(count)]);
        self.pool.resize((slot + 1) * count, 0.0);
        ElevationTile::new(node, SlotKey::new(slot as u32, 1))
    }

    /// Number of arrays so far.
    #[must_use]
    pub fn arrays(&self) -> u64 {
        (self.elevations.len() / self.world.elevation_values()) as u64
    }

    /// Whether the tile is there already.
    #[must_use]
    pub fn has_color(&self, key: SlotKey) -> bool {
        self.color_offsets.contains_key(&key)
    }

    /// Adds a colour tile: its mips back to back, row 0 north, in the recording's format.
    pub fn add_color(&mut self, key: SlotKey, texels: &[u8]) {
        self.color_offsets.insert(key, self.colors.len() as u64);
        self.colors.extend_from_slice(texels);
        self.color_slots = self.color_slots.max(key.slot.get().saturating_add(1));
    }

    /// The frame that was added last names these tiles of the elevation pool.
    pub fn name_elevation_tiles(&mut self, tiles: &[ElevationTile]) {
        if let Some(frame) = self.frames.last_mut() {
            frame.elevations = tiles.to_vec();
            frame.end.elevation_tile_count = tiles.len() as u32;
        }
    }

    /// Adds a frame.
    pub fn add_frame(&mut self, frame: RecordedFrame) {
        self.frames.push(frame);
    }

    /// The finished recording.
    #[must_use]
    pub fn finish(self) -> Recording {
        Recording {
            arrays: self.arrays(),
            world: self.world,
            texels: self.texels,
            frames: self.frames,
            pool: self.pool,
            elevations: HostMemory::copy_of(bytemuck::cast_slice(&self.elevations)),
            colors: HostMemory::copy_of(&self.colors),
            color_offsets: self.color_offsets,
            color_slots: self.color_slots,
        }
    }
}

/// Plays a recording, several times over if asked: later laps have later frame numbers and
/// positions.
#[derive(Debug)]
pub struct RecordedSource {
    recording: Arc<Recording>,
    laps: u64,
    lap: u64,
    frame: usize,
    /// 0: the marker; then views, tiles, and the end.
    slot: usize,
    /// Slots that were delivered.
    position: u64,
    done: Done,
    written: u64,
}

impl RecordedSource {
    /// Plays `recording` `laps` times.
    #[must_use]
    pub fn new(recording: Arc<Recording>, laps: u64) -> Self {
        Self { recording, laps, lap: 0, frame: 0, slot: 0, position: 0, done: Done::default(), written: 0 }
    }

    /// Frames that were said to have left the sink.
    #[must_use]
    pub fn written_frames(&self) -> u64 {
        self.written
    }

    fn first_frame(&self) -> u64 {
        self.recording.frames.first().map_or(0, |frame| frame.marker.frame)
    }

    fn values(&self, position: u64) -> Option<u64> {
        let values = self.recording.world.elevation_values() as u64;
        (position >= self.done.elevation_end.get() && self.recording.arrays > 0)
            .then(|| position % self.recording.arrays * values)
    }
}

impl FrameSource for RecordedSource {
    fn shape(&self) -> SourceShape {
        let first = self.first_frame();
        SourceShape {
            world: self.recording.world,
            elevation_arrays: self.recording.arrays,
            done: Done::default(),
            is_resumed: false,
            color_slots: self.recording.color_slots,
            elevation_pool: Some(self.recording.pool_shape()).filter(|pool| pool.slots > 0),
            texels: self.recording.texels,
            frames: [first, first + self.laps * self.recording.frames.len() as u64],
            has_gaps: false,
        }
    }
}

impl Slots for RecordedSource {
    fn try_next(&mut self) -> Result<Option<Slot>, SourceError> {
        if self.lap >= self.laps {
            return Err(SourceError::Ended);
        }
        let Some(frame) = self.recording.frames.get(self.frame) else { return Err(SourceError::Ended) };
        let frames = self.lap * self.recording.frames.len() as u64;
        let arrays = self.lap * self.recording.arrays;
        let views = frame.views.len();
        let elevation_slots = frame.elevations.len().div_ceil(ElevationSlot::MOST);
        let before_tiles = 1 + views + elevation_slots;
        let content = if self.slot == 0 {
            let before = self.frame.checked_sub(1).and_then(|before| self.recording.frames.get(before));
            SlotContent::Marker(FrameMarker {
                frame: frame.marker.frame + frames,
                sequence: frames + self.frame as u64 + 1,
                elevation_start: before.map_or(0, |before| before.end.elevation_end).wrapping_add(arrays),
                maker: 1,
                ..frame.marker
            })
        } else if let Some(view) = frame.views.get(self.slot - 1) {
            let (index, count) = (self.slot as u32 - 1, views as u32);
            SlotContent::View(ViewSlot::new(view, index, count))
        } else if self.slot < before_tiles {
            let named = frame.elevations.chunks(ElevationSlot::MOST).nth(self.slot - 1 - views);
            SlotContent::Elevation(ElevationSlot::of(named.unwrap_or_default()))
        } else if let Some(tile) = frame.tiles.get(self.slot - before_tiles) {
            let by = if frame.elevations.is_empty() { arrays } else { 0 };
            SlotContent::Tile(TileSlot { elevation_position: tile.elevation_position.wrapping_add(by), ..*tile })
        } else {
            let end = frame.end;
            SlotContent::End(FrameEnd {
                frame: end.frame + frames,
                elevation_end: end.elevation_end.wrapping_add(arrays),
                ..end
            })
        };
        self.slot += 1;
        self.position += 1;
        if self.slot > before_tiles + frame.tiles.len() {
            (self.slot, self.frame) = (0, self.frame + 1);
            if self.frame == self.recording.frames.len() {
                (self.frame, self.lap) = (0, self.lap + 1);
            }
        }
        Ok(Some(Slot::new(&content)))
    }

    fn next(&mut self) -> Result<Slot, SourceError> {
        self.try_next()?.ok_or(SourceError::Ended)
    }

    fn position(&self) -> RingPosition {
        RingPosition::new(self.position)
    }

    fn rewind(&mut self) -> Done {
        let frames = self.recording.frames.len().max(1) as u64;
        (self.lap, self.frame) = (self.done.sequence.get() / frames, (self.done.sequence.get() % frames) as usize);
        (self.slot, self.position) = (0, self.done.slots_end.get());
        self.done
    }
}

impl Pools for RecordedSource {
    fn elevation_memory(&self) -> Option<HostMemory> {
        Some(self.recording.elevations.clone())
    }

    fn color_memory(&self) -> Option<HostMemory> {
        Some(self.recording.colors.clone())
    }

    fn elevation_offset(&mut self, position: u64) -> Result<Option<u64>, SourceError> {
        Ok(self.values(position).map(|value| value * 4))
    }

    fn read_elevation(&mut self, position: u64, out: &mut [f32]) -> Result<bool, SourceError> {
        let bytes = self.recording.elevations.constant_bytes();
        let (Some(start), Some(bytes)) = (self.values(position), bytes) else { return Ok(false) };
        let all: &[f32] = bytemuck::cast_slice(bytes);
        let Some(values) = all.get(start as usize..start as usize + out.len()) else { return Ok(false) };
        out.copy_from_slice(values);
        Ok(true)
    }

    fn elevation_pool(&self) -> &[f32] {
        &self.recording.pool
    }

    fn has_elevation_tile(&self, key: SlotKey) -> bool {
        key.generation.get() == 1 && key.slot.get() < self.recording.pool_shape().slots
    }

    fn color_offset(&mut self, key: SlotKey) -> Option<u64> {
        self.recording.color_offsets.get(&key).copied()
    }

    fn color(&self, key: SlotKey) -> Option<&[u8]> {
        let offset = *self.recording.color_offsets.get(&key)? as usize;
        let Recording { world, texels, .. } = &*self.recording;
        let bytes = texels.tile_bytes(world.color_stored()) as usize;
        self.recording.colors.constant_bytes()?.get(offset..offset + bytes)
    }

    fn read_color(&mut self, key: SlotKey, out: &mut [u8]) -> bool {
        let Some(offset) = self.color_offset(key) else { return false };
        let all = self.recording.colors.constant_bytes().unwrap_or_default();
        let Some(bytes) = all.get(offset as usize..offset as usize + out.len()) else { return false };
        out.copy_from_slice(bytes);
        true
    }
}

impl Completion for RecordedSource {
    fn complete(&mut self, done: &Done) -> Result<(), SourceError> {
        self.done = *done;
        Ok(())
    }

    fn release_elevations(&mut self, upto: RingPosition) -> Result<(), SourceError> {
        self.done.elevation_end = self.done.elevation_end.max(upto);
        Ok(())
    }

    fn check(&mut self) -> Result<(), SourceError> {
        Ok(())
    }
}

impl Telemetry for RecordedSource {
    fn timed(&mut self, _timing: &FrameTiming) {}

    fn written(&mut self, count: u64) {
        self.written = count;
    }

    fn event(&mut self, _event: &Event) {}

    fn count(&mut self, _counter: Counter, _by: u64) {}
}
