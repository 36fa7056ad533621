//! Reads frames from a source, slot by slot.

use super::check::check_elevation;
use super::{Frame, FrameError, MAX_NODE_SIDE, MAX_TILES, TileFault, check_tile};
use crate::source::{Done, FrameSource, SourceShape};
use terravision_common::camera::Camera;
use terravision_common::ids::{FrameNumber, Generation, RingPosition, Sequence};
use terravision_common::rig::{MAX_VIEWS, View, Views};
use terravision_common::slot::{ElevationTile, FrameEnd, FrameMarker, Slot, SlotContent, TileSlot, ViewSlot};

/// Reads frames from a source.
#[derive(Debug)]
pub struct FrameReader {
    shape: SourceShape,
    size: [u32; 2],
    frame: Frame,
    is_open: bool,
    /// Views of the open frame, and how many it has.
    views: Vec<View>,
    view_count: u32,
    /// Number of the frame that comes next, or of the first that may.
    next: FrameNumber,
    /// How far frames were done with when reading began: those before are passed over.
    done: Done,
    /// Sequence of the last frame that was read.
    sequence: Sequence,
    /// Slots before the first marker may be the rest of a frame that nobody has the beginning of.
    may_begin_within: bool,
    /// Counts the frames that were opened.
    opened: u64,
    /// Of each colour slot: which opened frame named it last, and the generation.
    named: Vec<(u64, Generation)>,
}

/// Frames that may have been made and lost between two that are read, at most.
const MOST_LOST: u64 = 1 << 16;

impl FrameReader {
    /// For frames of this source and pictures of this size at most.
    ///
    /// # Errors
    /// The world is too large.
    pub fn new(shape: SourceShape, size: [u32; 2]) -> Result<Self, FrameError> {
        let side = shape.world.node_side(shape.world.levels() - 1);
        if side > MAX_NODE_SIDE {
            return Err(FrameError::WorldTooLarge { side });
        }
        let marker = FrameMarker { frame: shape.frames[0], ..bytemuck::Zeroable::zeroed() };
        let frame = Frame {
            pose: Camera::default(),
            views: Views::single(&Camera::default()),
            marker,
            elevations: Vec::with_capacity(4096),
            tiles: Vec::with_capacity(4096),
            end: bytemuck::Zeroable::zeroed(),
            elevation_start: 0,
            sequence: Sequence::NONE,
            slots_end: RingPosition::default(),
        };
        let mut reader = Self {
            named: vec![(0, Generation::NEVER_FILLED); shape.color_slots as usize],
            shape,
            size,
            frame,
            is_open: false,
            views: Vec::with_capacity(MAX_VIEWS),
            view_count: 0,
            next: FrameNumber::default(),
            done: shape.done,
            sequence: Sequence::NONE,
            may_begin_within: false,
            opened: 0,
        };
        reader.resume(shape.done);
        reader.may_begin_within = shape.is_resumed;
        Ok(reader)
    }

    /// Begins again behind the frames that are done with: those after them are read once more.
    pub fn resume(&mut self, done: Done) {
        self.is_open = false;
        self.may_begin_within = true;
        self.done = done;
        self.sequence = done.sequence;
        self.frame.end.elevation_end = done.elevation_end.get();
        // Frames may have been left out, but none has come twice.
        self.next = FrameNumber::new(self.shape.frames[0].saturating_add(done.sequence.get()));
    }

    /// How far frames are done with when this one is, [`FrameReader::frame`].
    #[must_use]
    pub fn done_with_frame(&self) -> Done {
        let Frame { sequence, end, slots_end, .. } = &self.frame;
        let elevation_end = RingPosition::new(end.elevation_end);
        Done { sequence: *sequence, elevation_end, slots_end: *slots_end }
    }

    /// Frames that are still to come; with gaps, at most.
    #[must_use]
    pub fn remaining(&self) -> u64 {
        self.shape.frames[1].saturating_sub(self.next.get())
    }

    /// The frame that [`FrameReader::add`] completed last.
    #[must_use]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Number of the frame that is being read or comes next.
    fn expected_frame(&self) -> FrameNumber {
        if self.is_open { self.frame.number() } else { self.next }
    }

    /// Takes the next slot; whether the frame is complete now.
    ///
    /// # Errors
    /// The slot is not one that may come now: see [`FrameError`].
    pub fn add(&mut self, slot: &Slot) -> Result<bool, FrameError> {
        let frame = self.expected_frame();
        let order = |found, expected| Err(FrameError::Order { frame, found, expected });
        match (slot.read(), self.is_open) {
            (Some(SlotContent::Marker(marker)), false) => self.open(frame, &marker).map(|()| false),
            (Some(SlotContent::View(view)), true) if !self.has_all_views() => {
                self.add_view(frame, &view).map(|()| false)
            }
            (Some(SlotContent::Elevation(slot)), true) if self.has_all_views() && self.frame.tiles.is_empty() => {
                slot.tiles().try_for_each(|tile| self.add_elevation(frame, &tile)).map(|()| false)
            }
            (Some(SlotContent::Tile(tile)), true) if self.has_all_views() => {
                self.add_tile(frame, &tile).map(|()| false)
            }
            (Some(SlotContent::End(end)), true) if self.has_all_views() => self.close(frame, &end).map(|()| true),
            // Its preparer was killed in the frame that is open.
            (Some(SlotContent::Marker(marker)), true) if marker.maker > self.frame.marker.maker => {
                self.is_open = false;
                self.open(self.next, &marker).map(|()| false)
            }
            (
                Some(SlotContent::View(_) | SlotContent::Elevation(_) | SlotContent::Tile(_) | SlotContent::End(_)),
                false,
            ) if self.may_begin_within => Ok(false),
            (Some(SlotContent::Marker(_)), true) => order("a frame marker", "a tile or the end of the frame"),
            (Some(SlotContent::View(_)), true) => order("a view", "a tile or the end of the frame"),
            (Some(SlotContent::View(_)), false) => order("a view", "a frame marker"),
            (Some(SlotContent::Elevation(_)), true) => order("elevation tiles", "a view, or tiles after them"),
            (Some(SlotContent::Elevation(_)), false) => order("elevation tiles", "a frame marker"),
            (Some(SlotContent::Tile(_)), true) => order("a tile", "a view"),
            (Some(SlotContent::End(_)), true) => order("the end of a frame", "a view"),
            (Some(SlotContent::Tile(_)), false) => order("a tile", "a frame marker"),
            (Some(SlotContent::End(_)), false) => order("the end of a frame", "a frame marker"),
            (None, _) => {
                order("a slot of no kind", "a frame marker, a view, elevation tiles, a tile or the end of a frame")
            }
        }
    }

    fn open(&mut self, expected: FrameNumber, marker: &FrameMarker) -> Result<(), FrameError> {
        let wrong = |field, found, wanted| Err(FrameError::Marker { frame: expected, field, found, expected: wanted });
        // A renderer that was killed had completed it, but not given it back.
        let is_stale = self.is_stale(Sequence::new(marker.sequence));
        let is_later = self.shape.has_gaps && (expected.get()..self.shape.frames[1]).contains(&marker.frame);
        if marker.frame != expected.get() && !is_later && !is_stale {
            return wrong("its number", marker.frame, expected.get());
        }
        let ahead = marker.sequence.wrapping_sub(self.sequence.get());
        if !is_stale && (ahead == 0 || ahead > if self.shape.has_gaps { MOST_LOST } else { 1 }) {
            return wrong("its place in the run", marker.sequence, self.sequence.get().wrapping_add(1));
        }
        let lost = marker.elevation_start.wrapping_sub(self.frame.end.elevation_end);
        if !is_stale && lost > self.shape.elevation_arrays {
            return wrong("its first elevation array", marker.elevation_start, self.frame.end.elevation_end);
        }
        let pose = Camera::new(marker.camera).map_err(|source| FrameError::Camera { frame: expected, source })?;
        let (found, most) = (marker.picture, self.size);
        if (0..2).any(|axis| found[axis] == 0 || found[axis] > most[axis]) {
            return Err(FrameError::PictureSize { frame: expected, found, most });
        }
        self.frame.marker = *marker;
        self.frame.pose = pose;
        self.views.clear();
        self.view_count = 0;
        self.frame.tiles.clear();
        self.frame.elevations.clear();
        self.frame.elevation_start = marker.elevation_start;
        self.frame.sequence = Sequence::new(marker.sequence);
        self.opened += 1;
        self.is_open = true;
        self.may_begin_within = false;
        Ok(())
    }

    fn is_stale(&self, sequence: Sequence) -> bool {
        sequence != Sequence::NONE && sequence <= self.done.sequence
    }

    fn has_all_views(&self) -> bool {
        self.view_count > 0 && self.views.len() == self.view_count as usize
    }

    fn add_view(&mut self, frame: FrameNumber, slot: &ViewSlot) -> Result<(), FrameError> {
        let index = self.views.len();
        let wrong = |field, found, expected| Err(FrameError::Marker { frame, field, found, expected });
        let most = MAX_VIEWS as u64;
        match slot.count {
            count if count == 0 || u64::from(count) > most => return wrong("the number of views", count.into(), most),
            count if index > 0 && count != self.view_count => {
                return wrong("the number of views", count.into(), self.view_count.into());
            }
            count => self.view_count = count,
        }
        if slot.index as usize != index {
            return wrong("the number of a view", slot.index.into(), index as u64);
        }
        let picture = self.frame.marker.picture;
        // The eye's cell has to be near enough for differences of 32 bits.
        let surface = self.shape.world.surface();
        let is_near = |view: &View| surface.is_countable_from(view.camera.eye(), MAX_NODE_SIDE);
        let Some(view) = slot.view().ok().filter(|view| view.is_within(picture) && is_near(view)) else {
            return Err(FrameError::View { frame, index, picture });
        };
        self.views.push(view);
        if self.has_all_views()
            && let Some(views) = Views::new(self.views.iter().copied())
        {
            self.frame.views = views;
        }
        Ok(())
    }

    fn add_elevation(&mut self, frame: FrameNumber, tile: &ElevationTile) -> Result<(), FrameError> {
        let index = self.frame.elevations.len();
        if index >= MAX_TILES {
            let field = "the number of elevation tiles";
            return Err(FrameError::Marker { frame, field, found: index as u64 + 1, expected: MAX_TILES as u64 });
        }
        let slots = self.shape.elevation_pool.map_or(0, |pool| pool.slots);
        check_elevation(tile, &self.shape.world, slots).map_err(|fault| FrameError::Elevation {
            frame,
            index,
            fault,
        })?;
        self.frame.elevations.push(*tile);
        Ok(())
    }

    fn add_tile(&mut self, frame: FrameNumber, tile: &TileSlot) -> Result<(), FrameError> {
        let index = self.frame.tiles.len();
        let fail = |fault| Err(FrameError::Tile { frame, index, fault });
        if index >= MAX_TILES {
            let field = "the number of tiles";
            return Err(FrameError::Marker { frame, field, found: index as u64 + 1, expected: MAX_TILES as u64 });
        }
        if let Err(fault) = check_tile(tile, &self.shape.world, self.shape.color_slots) {
            return fail(fault);
        }
        let key = tile.color();
        let named = &mut self.named[key.slot.index()];
        if named.0 == self.opened && named.1 != key.generation {
            return fail(TileFault::Generation);
        }
        *named = (self.opened, key.generation);
        self.frame.tiles.push(*tile);
        Ok(())
    }

    fn close(&mut self, frame: FrameNumber, end: &FrameEnd) -> Result<(), FrameError> {
        let count = self.frame.tiles.len() as u64;
        let start = self.frame.elevation_start;
        let arrays = end.elevation_end.wrapping_sub(start);
        let wrong = |field, found, expected| Err(FrameError::Marker { frame, field, found, expected });
        if end.frame != frame.get() {
            return wrong("the number at its end", end.frame, frame.get());
        }
        if u64::from(end.tile_count) != count {
            return wrong("the number of its tiles", u64::from(end.tile_count), count);
        }
        if arrays > self.shape.elevation_arrays {
            return wrong("the number of its elevation arrays", arrays, self.shape.elevation_arrays);
        }
        let elevations = &self.frame.elevations;
        if u64::from(end.elevation_tile_count) != elevations.len() as u64 {
            let found = u64::from(end.elevation_tile_count);
            return wrong("the number of its elevation tiles", found, elevations.len() as u64);
        }
        let is_ours = |tile: &TileSlot| {
            if elevations.is_empty() {
                return tile.elevation_position.wrapping_sub(start) < arrays;
            }
            let named = usize::try_from(tile.elevation_position).ok().and_then(|at| elevations.get(at)?.node());
            named.is_some_and(|node| {
                let origin = self.shape.world.node_origin(node).map(|v| v as u32);
                node.q() == tile.elevation_level && origin == tile.elevation_origin
            })
        };
        if let Some(index) = self.frame.tiles.iter().position(|tile| !is_ours(tile)) {
            return Err(FrameError::Tile { frame, index, fault: TileFault::Elevation });
        }
        self.is_open = false;
        if self.is_stale(self.frame.sequence) {
            return Ok(());
        }
        self.frame.end = *end;
        self.sequence = self.frame.sequence;
        self.next = frame.next();
        Ok(())
    }

    /// Reads on: with `may_wait`, when no frame is with the device or on its way to a sink, until a
    /// frame is complete, else as far as slots are there. Whether a frame is complete.
    ///
    /// # Errors
    /// The source failed, or a slot is not one that may come now.
    pub fn read(&mut self, source: &mut dyn FrameSource, may_wait: bool) -> Result<bool, FrameError> {
        loop {
            if may_wait && self.is_open && !self.is_stale(self.frame.sequence) {
                // Arrays that a killed stage has left between the frames: the preparer may be
                // waiting for them.
                source.release_elevations(RingPosition::new(self.frame.elevation_start))?;
            }
            let slot = if may_wait { Some(source.next()?) } else { source.try_next()? };
            let Some(slot) = slot else { return Ok(false) };
            if !self.add(&slot)? {
                continue;
            }
            self.frame.slots_end = source.position();
            if !self.is_stale(self.frame.sequence) {
                return Ok(true);
            }
            source.complete(&Done {
                elevation_end: RingPosition::new(self.frame.elevation_start),
                ..self.done_with_frame()
            })?;
        }
    }
}
