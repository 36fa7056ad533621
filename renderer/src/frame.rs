//! Frames as they come out of the ring: read slot by slot, checked, kept in memory that is used again.
//!
//! Nothing that came through shared memory is trusted: whoever gets a [`Frame`] may index with its numbers.

use crate::source::{Done, FrameSource, SourceError, SourceShape};
use terravision_common::ids::{Generation, RingPosition, Sequence};
use terravision_common::node::NodeId;
use terravision_common::rig::{MAX_VIEWS, View, Views};
use terravision_common::slot::{FrameEnd, FrameMarker, Slot, SlotContent, TileSlot, ViewSlot};
use terravision_common::world::World;

/// Lattice coordinates stay below this, so that differences of two of them fit into 32 bits on the device.
const MAX_NODE_SIDE: u64 = 1 << 29;
/// Tiles of one frame: as many as a tree has nodes.
pub const MAX_TILES: usize = 65536;

/// What is wrong with a frame from the ring.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The source failed.
    #[error(transparent)]
    Source {
        /// Why.
        #[from]
        source: SourceError,
    },
    /// A slot is not the one that has to come now.
    #[error("the ring lost its order in frame {frame}: found {found}, expected {expected}")]
    Order {
        /// The frame being read.
        frame: u64,
        /// What the slot is.
        found: &'static str,
        /// What it should have been.
        expected: &'static str,
    },
    /// A number of a frame's first or last slot cannot be.
    #[error("frame {frame} from the ring is corrupt: {field} is {found}, expected {expected}")]
    Marker {
        /// The frame.
        frame: u64,
        /// Which number.
        field: &'static str,
        /// What it is.
        found: u64,
        /// What it should have been.
        expected: u64,
    },
    /// The camera that carries a frame's views is none.
    #[error("frame {frame} from the ring has no valid camera")]
    Camera {
        /// The frame.
        frame: u64,
    },
    /// A view of a frame cannot be drawn.
    #[error(
        "view {index} of frame {frame} from the ring has no valid camera within a picture of {}x{} pixels",
        .picture[0], .picture[1]
    )]
    View {
        /// The frame.
        frame: u64,
        /// Which of its views.
        index: usize,
        /// The size of the frame's picture.
        picture: [u32; 2],
    },
    /// The picture of a frame has another size than the run's.
    #[error(
        "frame {frame} from the ring is a picture of {}x{} pixels, expected {}x{}",
        .found[0], .found[1], .expected[0], .expected[1]
    )]
    PictureSize {
        /// The frame.
        frame: u64,
        /// Its size.
        found: [u32; 2],
        /// The run's.
        expected: [u32; 2],
    },
    /// A number of a tile cannot be.
    #[error("tile {index} of frame {frame} from the ring is corrupt: {fault}")]
    Tile {
        /// The frame.
        frame: u64,
        /// Which of its tiles.
        index: usize,
        /// What is wrong with it.
        fault: TileFault,
    },
    /// The world's lattice is too large for the device's 32-bit numbers.
    #[error("the world has nodes of {side} lattice units, at most 2^29 can be drawn")]
    WorldTooLarge {
        /// Side of the root.
        side: u64,
    },
}

/// What is wrong with a tile slot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TileFault {
    /// The block is empty or not inside its array.
    #[error("its block does not lie inside an elevation array")]
    Block,
    /// A level is not one of the world's.
    #[error("a level is not one of the world's")]
    Level,
    /// A corner is not that of a node.
    #[error("a lower left corner is not that of a node of the world")]
    Origin,
    /// The colour tile does not cover the block.
    #[error("its colour tile does not cover its block")]
    Cover,
    /// More vertices would collapse than an edge has, or fewer than inside of it.
    #[error("more vertices collapse than an edge has, or fewer than inside")]
    Snap,
    /// The colour slot is not one of the pool's.
    #[error("its colour slot is not one of the pool's")]
    ColorSlot,
    /// The elevation array is none of the frame's.
    #[error("its elevation array is none of the frame's")]
    Elevation,
    /// One colour slot has two generations in one frame.
    #[error("its colour slot has another generation than for an earlier tile of the frame")]
    Generation,
    /// A height of its block is not a number.
    #[error("a height of its block is no finite number")]
    Height,
    /// Another tile of the frame is at its place.
    #[error("another tile of the frame is at its place")]
    Occupied,
    /// The pool's slot holds another tile by now.
    #[error("its colour slot holds another generation than it names")]
    Stale,
}

/// Checks the numbers of a tile against the world and the pool. Positions in the elevation ring are checked when the
/// frame is complete.
///
/// # Errors
/// The first fault.
pub fn check_tile(tile: &TileSlot, world: &World, color_slots: u32) -> Result<(), TileFault> {
    let intervals = world.elevation_tile();
    let block = |axis: usize| (u32::from(tile.start[axis]), u32::from(tile.end[axis]));
    if (0..2).any(|axis| block(axis).0 >= block(axis).1 || block(axis).1 > intervals) {
        return Err(TileFault::Block);
    }
    let levels = world.levels();
    if tile.elevation_level >= levels || tile.color_level >= levels {
        return Err(TileFault::Level);
    }
    let is_node = |origin: [u32; 2], level: u8| {
        let side = world.node_side(level);
        (0..2).all(|axis| u64::from(origin[axis]).is_multiple_of(side) && origin[axis] < world.extent()[axis])
    };
    if !is_node(tile.elevation_origin, tile.elevation_level) || !is_node(tile.color_origin, tile.color_level) {
        return Err(TileFault::Origin);
    }
    let is_covered = |axis: usize| {
        let at = |post: u32| u64::from(tile.elevation_origin[axis]) + (u64::from(post) << tile.elevation_level);
        let first = u64::from(tile.color_origin[axis]);
        first <= at(block(axis).0) && at(block(axis).1) <= first + world.node_side(tile.color_level)
    };
    if !is_covered(0) || !is_covered(1) {
        return Err(TileFault::Cover);
    }
    if tile.edge_snap.iter().any(|&snap| u32::from(snap) > intervals.ilog2() || snap < tile.grid_snap) {
        return Err(TileFault::Snap);
    }
    let is_between = |post: u16| u32::from(post) & ((1 << tile.grid_snap) - 1) != 0;
    if tile.start.into_iter().chain(tile.end).any(is_between) {
        return Err(TileFault::Block);
    }
    if tile.color_slot >= color_slots {
        return Err(TileFault::ColorSlot);
    }
    Ok(())
}

/// A checked frame.
#[derive(Debug)]
pub struct Frame {
    /// Its first slot. The camera is valid.
    pub marker: FrameMarker,
    /// Its views. Their cameras are valid, and they lie within the frame's picture.
    pub views: Views,
    /// Its tiles, near to far.
    pub tiles: Vec<TileSlot>,
    /// Its last slot.
    pub end: FrameEnd,
    /// Position of its first elevation array.
    pub elevation_start: u64,
    /// Counts the frames of the run that were made from 1.
    pub sequence: Sequence,
    /// One past its last slot.
    pub slots_end: RingPosition,
}

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
    next: u64,
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
    /// For frames of this source and pictures of this size.
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
            views: Views::single(&marker.camera),
            marker,
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
            next: 0,
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
        self.next = self.shape.frames[0].saturating_add(done.sequence.get());
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
        self.shape.frames[1].saturating_sub(self.next)
    }

    /// The frame that [`FrameReader::add`] completed last.
    #[must_use]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Number of the frame that is being read or comes next.
    fn expected_frame(&self) -> u64 {
        if self.is_open { self.frame.marker.frame } else { self.next }
    }

    /// Takes the next slot; whether the frame is complete now.
    ///
    /// # Errors
    /// The slot cannot be: see [`FrameError`].
    pub fn add(&mut self, slot: &Slot) -> Result<bool, FrameError> {
        let frame = self.expected_frame();
        let order = |found, expected| Err(FrameError::Order { frame, found, expected });
        match (slot.read(), self.is_open) {
            (Some(SlotContent::Marker(marker)), false) => self.open(frame, &marker).map(|()| false),
            (Some(SlotContent::View(view)), true) if !self.has_all_views() => {
                self.add_view(frame, &view).map(|()| false)
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
            (Some(SlotContent::View(_) | SlotContent::Tile(_) | SlotContent::End(_)), false)
                if self.may_begin_within =>
            {
                Ok(false)
            }
            (Some(SlotContent::Marker(_)), true) => order("a frame marker", "a tile or the end of the frame"),
            (Some(SlotContent::View(_)), true) => order("a view", "a tile or the end of the frame"),
            (Some(SlotContent::View(_)), false) => order("a view", "a frame marker"),
            (Some(SlotContent::Tile(_)), true) => order("a tile", "a view"),
            (Some(SlotContent::End(_)), true) => order("the end of a frame", "a view"),
            (Some(SlotContent::Tile(_)), false) => order("a tile", "a frame marker"),
            (Some(SlotContent::End(_)), false) => order("the end of a frame", "a frame marker"),
            (None, _) => order("a slot of no kind", "a frame marker, a view, a tile or the end of a frame"),
        }
    }

    fn open(&mut self, expected: u64, marker: &FrameMarker) -> Result<(), FrameError> {
        let wrong = |field, found, wanted| Err(FrameError::Marker { frame: expected, field, found, expected: wanted });
        // A renderer that was killed had completed it, but not given it back.
        let is_stale = self.is_stale(Sequence::new(marker.sequence));
        let is_later = self.shape.has_gaps && (expected..self.shape.frames[1]).contains(&marker.frame);
        if marker.frame != expected && !is_later && !is_stale {
            return wrong("its number", marker.frame, expected);
        }
        let ahead = marker.sequence.wrapping_sub(self.sequence.get());
        if !is_stale && (ahead == 0 || ahead > if self.shape.has_gaps { MOST_LOST } else { 1 }) {
            return wrong("its place in the run", marker.sequence, self.sequence.get().wrapping_add(1));
        }
        let lost = marker.elevation_start.wrapping_sub(self.frame.end.elevation_end);
        if !is_stale && lost > self.shape.elevation_arrays {
            return wrong("its first elevation array", marker.elevation_start, self.frame.end.elevation_end);
        }
        if !marker.camera.is_valid() {
            return Err(FrameError::Camera { frame: expected });
        }
        if marker.picture != self.size {
            return Err(FrameError::PictureSize { frame: expected, found: marker.picture, expected: self.size });
        }
        self.frame.marker = *marker;
        self.views.clear();
        self.view_count = 0;
        self.frame.tiles.clear();
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

    fn add_view(&mut self, frame: u64, slot: &ViewSlot) -> Result<(), FrameError> {
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
        let view = View { camera: slot.camera, at: slot.at };
        let picture = self.frame.marker.picture;
        // The eye's cell has to be near enough for differences of 32 bits.
        let surface = self.shape.world.surface();
        let eye_on_lattice = surface.lattice_of_foot(surface.foot(view.camera.eye()));
        let is_near = eye_on_lattice.abs().max_element() <= MAX_NODE_SIDE as f64;
        if !view.camera.is_valid() || !view.is_within(picture) || !is_near {
            return Err(FrameError::View { frame, index, picture });
        }
        self.views.push(view);
        if self.has_all_views()
            && let Some(views) = Views::new(self.views.iter().copied())
        {
            self.frame.views = views;
        }
        Ok(())
    }

    fn add_tile(&mut self, frame: u64, tile: &TileSlot) -> Result<(), FrameError> {
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

    fn close(&mut self, frame: u64, end: &FrameEnd) -> Result<(), FrameError> {
        let count = self.frame.tiles.len() as u64;
        let start = self.frame.elevation_start;
        let arrays = end.elevation_end.wrapping_sub(start);
        let wrong = |field, found, expected| Err(FrameError::Marker { frame, field, found, expected });
        if end.frame != frame {
            return wrong("the number at its end", end.frame, frame);
        }
        if u64::from(end.tile_count) != count {
            return wrong("the number of its tiles", u64::from(end.tile_count), count);
        }
        if arrays > self.shape.elevation_arrays {
            return wrong("the number of its elevation arrays", arrays, self.shape.elevation_arrays);
        }
        let is_ours = |tile: &TileSlot| tile.elevation_position.wrapping_sub(start) < arrays;
        if let Some(index) = self.frame.tiles.iter().position(|tile| !is_ours(tile)) {
            return Err(FrameError::Tile { frame, index, fault: TileFault::Elevation });
        }
        self.is_open = false;
        if self.is_stale(self.frame.sequence) {
            return Ok(());
        }
        self.frame.end = *end;
        self.sequence = self.frame.sequence;
        self.next = frame.saturating_add(1);
        Ok(())
    }

    /// Reads on: with `may_wait`, when no frame is with the device or on its way to a sink, until a frame is complete, else
    /// as far as slots are there. Whether a frame is complete.
    ///
    /// # Errors
    /// The source failed, or a slot cannot be.
    pub fn read(&mut self, source: &mut dyn FrameSource, may_wait: bool) -> Result<bool, FrameError> {
        loop {
            if may_wait && self.is_open && !self.is_stale(self.frame.sequence) {
                // Arrays that a killed stage has left between the frames: the preparer may be waiting for them.
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

/// Level of the colour leaf of a tile, for overlays; 0 when its node's number is none.
#[must_use]
pub fn leaf_level(tile: &TileSlot) -> u8 {
    tile.node().map_or(0, NodeId::q)
}
