//! Records the frames of another source as they pass.

use super::{
    Completion, Done, FrameSource, Pools, RecordedFrame, Recording, RecordingBuilder, Slots, SourceError, SourceShape,
    Telemetry,
};
use crate::gpu::HostMemory;
use terravision_common::camera::Camera;
use terravision_common::event::Event;
use terravision_common::ids::{RingPosition, SlotKey};
use terravision_common::rate::FrameTiming;
use terravision_common::rig::{View, Views};
use terravision_common::shm::Counter;
use terravision_common::slot::{FrameMarker, Slot, SlotContent, TileSlot, ViewSlot};

/// A source that keeps a copy of all that it delivers.
#[derive(Debug)]
pub struct Recorder<S> {
    inner: S,
    builder: RecordingBuilder,
    marker: Option<FrameMarker>,
    views: Vec<View>,
    tiles: Vec<TileSlot>,
    /// Position, in the inner source, of the recording's first array of the frame that is passing.
    frame_start: Option<u64>,
    array: Vec<f32>,
    texels: Vec<u8>,
}

impl<S: FrameSource> Recorder<S> {
    /// Records what `inner` delivers from now on.
    pub fn new(inner: S) -> Self {
        let SourceShape { world, texels, .. } = inner.shape();
        Self {
            inner,
            builder: RecordingBuilder::new(world).with_texels(texels),
            marker: None,
            views: Vec::new(),
            tiles: Vec::new(),
            frame_start: None,
            array: vec![0.0; world.elevation_values()],
            texels: vec![0; texels.tile_bytes(world.color_stored()) as usize],
        }
    }

    /// The recording of the frames that passed completely.
    #[must_use]
    pub fn finish(self) -> Recording {
        self.builder.finish()
    }

    fn record(&mut self, slot: &Slot) -> Result<(), SourceError> {
        match slot.read() {
            Some(SlotContent::Marker(marker)) => {
                self.marker = Some(marker);
                self.views.clear();
                self.tiles.clear();
            }
            // One that is not valid is refused by who reads the frame.
            Some(SlotContent::View(ViewSlot { camera, at, .. })) => {
                self.views.extend(Camera::new(camera).map(|camera| View { camera, at }));
            }
            Some(SlotContent::Tile(tile)) => self.tiles.push(tile),
            Some(SlotContent::End(end)) => {
                let (Some(marker), Some(views)) = (self.marker.take(), Views::new(self.views.iter().copied())) else {
                    return Ok(());
                };
                let lowest = self.tiles.iter().map(|tile| tile.elevation_position).min();
                let start = self.frame_start.or(lowest).unwrap_or(end.elevation_end);
                let count = end.elevation_end.wrapping_sub(start);
                if count > self.inner.shape().elevation_arrays {
                    return Ok(());
                }
                let first = self.builder.arrays();
                for position in start..start + count {
                    if !self.inner.read_elevation(position, &mut self.array)? {
                        return Ok(());
                    }
                    self.builder.add_elevations(&self.array);
                }
                let mut tiles = self.tiles.clone();
                for tile in &mut tiles {
                    let key = tile.color();
                    if !self.builder.has_color(key) && self.inner.read_color(key, &mut self.texels) {
                        self.builder.add_color(key, &self.texels);
                    }
                    tile.elevation_position = tile.elevation_position.wrapping_sub(start).wrapping_add(first);
                }
                self.frame_start = Some(end.elevation_end);
                let end = terravision_common::slot::FrameEnd { elevation_end: first + count, ..end };
                self.builder.add_frame(RecordedFrame { marker, views, elevations: Vec::new(), tiles, end });
            }
            // A recording has arrays.
            Some(SlotContent::Elevation(_)) => self.marker = None,
            None => {}
        }
        Ok(())
    }
}

impl<S: FrameSource> FrameSource for Recorder<S> {
    fn shape(&self) -> SourceShape {
        self.inner.shape()
    }
}

impl<S: FrameSource> Slots for Recorder<S> {
    fn try_next(&mut self) -> Result<Option<Slot>, SourceError> {
        let slot = self.inner.try_next()?;
        if let Some(slot) = &slot {
            self.record(slot)?;
        }
        Ok(slot)
    }

    fn next(&mut self) -> Result<Slot, SourceError> {
        let slot = self.inner.next()?;
        self.record(&slot)?;
        Ok(slot)
    }

    fn position(&self) -> RingPosition {
        self.inner.position()
    }

    fn rewind(&mut self) -> Done {
        self.inner.rewind()
    }
}

impl<S: FrameSource> Pools for Recorder<S> {
    fn elevation_memory(&self) -> Option<HostMemory> {
        self.inner.elevation_memory()
    }

    fn color_memory(&self) -> Option<HostMemory> {
        self.inner.color_memory()
    }

    fn elevation_offset(&mut self, position: u64) -> Result<Option<u64>, SourceError> {
        self.inner.elevation_offset(position)
    }

    fn read_elevation(&mut self, position: u64, out: &mut [f32]) -> Result<bool, SourceError> {
        self.inner.read_elevation(position, out)
    }

    fn elevation_pool(&self) -> &[f32] {
        self.inner.elevation_pool()
    }

    fn has_elevation_tile(&self, key: SlotKey) -> bool {
        self.inner.has_elevation_tile(key)
    }

    fn color_offset(&mut self, key: SlotKey) -> Option<u64> {
        self.inner.color_offset(key)
    }

    fn color(&self, key: SlotKey) -> Option<&[u8]> {
        self.inner.color(key)
    }

    fn read_color(&mut self, key: SlotKey, out: &mut [u8]) -> bool {
        self.inner.read_color(key, out)
    }
}

impl<S: FrameSource> Completion for Recorder<S> {
    fn complete(&mut self, done: &Done) -> Result<(), SourceError> {
        self.inner.complete(done)
    }

    fn release_elevations(&mut self, upto: RingPosition) -> Result<(), SourceError> {
        self.inner.release_elevations(upto)
    }

    fn check(&mut self) -> Result<(), SourceError> {
        self.inner.check()
    }
}

impl<S: FrameSource> Telemetry for Recorder<S> {
    fn timed(&mut self, timing: &FrameTiming) {
        self.inner.timed(timing);
    }

    fn written(&mut self, count: u64) {
        self.inner.written(count);
    }

    fn event(&mut self, event: &Event) {
        self.inner.event(event);
    }

    fn count(&mut self, counter: Counter, by: u64) {
        self.inner.count(counter, by);
    }
}
