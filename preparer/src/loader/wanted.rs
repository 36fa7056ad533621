//! The loader of a run: the pools as a reader sees them, the want list that the prefetcher reads, and what it answers.

use super::{TileLoader, TileState};
use crate::frame_tree::Tile;
use crate::truncation::Tiles;
use std::collections::{HashMap, HashSet};
use terravision_common::database::Layer;
use terravision_common::ids::{FrameNumber, Sequence, SlotKey};
use terravision_common::node::NodeId;
use terravision_common::outcome::{Outcome, TileFailure, TileOutcome};
use terravision_common::shm::{
    Activity, Consumer, Control, PoolIndex, PoolReader, RunId, SegmentKind, ShmError, Stage, WAIT_BOUND, WaitError,
    WantHead, WantListWriter,
};

/// Waits of [`WAIT_BOUND`] for which a dead prefetcher is left to the launcher, which says so; where it starts another, it is left to
/// it for ever.
const PEER_GRACE: u32 = 10;

/// Asks the prefetcher for tiles. In the steady state it allocates nothing.
#[derive(Debug)]
pub struct WantedTiles {
    elevation: PoolIndex,
    color: PoolIndex,
    wants: WantListWriter,
    outcomes: Consumer<TileOutcome>,
    /// The frame that wants now.
    sequence: Sequence,
    /// What it wants and lacks, in the order in which it wants it.
    missing: Vec<Tile>,
    /// What the list that is out names.
    asked: HashSet<Tile>,
    /// The list that is out is not what the frame lacks.
    is_stale: bool,
    unavailable: HashMap<Tile, TileFailure>,
    /// By layer: the completed sequence at which it had no room.
    no_room: [Option<Sequence>; 2],
    loading: usize,
    waits_with_dead_peer: u32,
}

impl WantedTiles {
    /// Opens a run's segments.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId) -> Result<Self, ShmError> {
        Ok(Self::new(
            PoolReader::open(run, SegmentKind::ElevationPool)?,
            PoolReader::open(run, SegmentKind::ColorPool)?,
            WantListWriter::open(run)?,
            Consumer::open(run, SegmentKind::TileOutcomes)?,
        ))
    }

    /// Over any pools, list and ring.
    #[must_use]
    pub fn new(
        elevation: PoolReader,
        color: PoolReader,
        wants: WantListWriter,
        outcomes: Consumer<TileOutcome>,
    ) -> Self {
        let capacity = wants.capacity() as usize;
        Self {
            elevation: PoolIndex::new(elevation),
            color: PoolIndex::new(color),
            wants,
            outcomes,
            sequence: Sequence::NONE,
            missing: Vec::with_capacity(capacity),
            asked: HashSet::with_capacity(capacity),
            is_stale: true,
            unavailable: HashMap::new(),
            no_room: [None; 2],
            loading: 0,
            waits_with_dead_peer: 0,
        }
    }

    fn index(&self, layer: Layer) -> &PoolIndex {
        match layer {
            Layer::Elevation => &self.elevation,
            Layer::Color => &self.color,
        }
    }

    fn index_mut(&mut self, layer: Layer) -> &mut PoolIndex {
        match layer {
            Layer::Elevation => &mut self.elevation,
            Layer::Color => &mut self.color,
        }
    }

    /// A frame's first wish.
    fn begin(&mut self, sequence: Sequence) {
        self.sequence = sequence;
        self.is_stale = true;
        self.no_room = [None; 2];
    }

    fn take(&mut self, outcome: &TileOutcome) {
        // What says nothing that can be is passed over: the tile is still missing, and will be asked for again.
        let Some((tile, outcome)) = outcome.read() else { return };
        match outcome {
            Outcome::Resident { key } => {
                if self.index_mut(tile.layer).note(tile.node, key) {
                    self.unavailable.remove(&tile);
                }
            }
            Outcome::Unavailable { failure } => {
                self.unavailable.insert(tile, failure);
            }
            Outcome::NoRoom { completed } => self.no_room[tile.layer as usize] = Some(completed),
        }
    }

    /// Whether the layer is known to have no room; a frame that was completed since may have made some.
    fn has_no_room(&mut self, layer: Layer, control: &Control) -> bool {
        let Some(completed) = self.no_room[layer as usize] else { return false };
        if control.completed_sequence() > completed {
            self.no_room[layer as usize] = None;
            self.is_stale = true;
            return false;
        }
        true
    }
}

impl Tiles for WantedTiles {
    fn color(&self, node: NodeId) -> Option<SlotKey> {
        self.color.kept(node, self.sequence)
    }

    fn elevation(&self, node: NodeId) -> Option<&[f32]> {
        self.elevation.bytes(node, self.sequence).map(|bytes| bytes.f32())
    }
}

impl TileLoader for WantedTiles {
    fn want(&mut self, tile: Tile, _frame: FrameNumber, sequence: Sequence, control: &Control) -> TileState {
        if sequence != self.sequence {
            self.begin(sequence);
        }
        if self.index_mut(tile.layer).keep(tile.node, sequence) {
            return TileState::Resident;
        }
        // What cannot be read is on the list, too: whether to try again is the prefetcher's business.
        if self.missing.len() < self.missing.capacity() {
            self.missing.push(tile);
        }
        if let Some(failure) = self.unavailable.get(&tile) {
            return TileState::Unavailable { may_come: failure.may_pass() };
        }
        if self.has_no_room(tile.layer, control) {
            return TileState::NoRoom;
        }
        self.is_stale |= !self.asked.contains(&tile);
        self.loading += 1;
        TileState::Loading
    }

    fn ask(&mut self, frame: FrameNumber, sequence: Sequence) {
        if sequence != self.sequence {
            self.begin(sequence);
        }
        // Within a frame a list is replaced when more is wanted than it names. What it names and is there by now does no
        // harm.
        if self.is_stale {
            self.wants.publish(WantHead { sequence, frame, is_last: false }, &self.missing);
            self.asked.clear();
            self.asked.extend(self.missing.iter().take(self.wants.capacity() as usize));
            self.is_stale = false;
        }
    }

    fn wait(&mut self, control: &Control) -> Result<(), WaitError> {
        control.awaits(Activity::Awaits(Stage::Prefetcher));
        if self.outcomes.wait(control)? {
            self.waits_with_dead_peer = 0;
            return Ok(());
        }
        // Nothing for a while: perhaps an outcome found its ring full. What is asked again is answered again.
        self.is_stale = true;
        self.waits_with_dead_peer = if !control.is_supervised() && control.is_stage_dead(Stage::Prefetcher) {
            self.waits_with_dead_peer + 1
        } else {
            0
        };
        if self.waits_with_dead_peer >= PEER_GRACE {
            return Err(WaitError::PeerGone { stage: Stage::Prefetcher });
        }
        Ok(())
    }

    fn drain(&mut self) -> Result<(), WaitError> {
        self.missing.clear();
        self.loading = 0;
        // At most a ring full at a time, so that a prefetcher that floods it cannot keep the frame from being made.
        for _ in 0..self.outcomes.capacity() {
            match self.outcomes.try_pop()? {
                Some(outcome) => self.take(&outcome),
                None => break,
            }
        }
        Ok(())
    }

    fn in_flight(&self) -> usize {
        self.loading
    }

    fn capacity(&self, layer: Layer) -> u32 {
        self.index(layer).reader().capacity()
    }

    fn close(&mut self) {
        self.wants.publish(WantHead { sequence: self.sequence, frame: FrameNumber::default(), is_last: true }, &[]);
    }
}

const _: () = assert!(WAIT_BOUND.as_millis() == 100, "PEER_GRACE is meant for a second");
