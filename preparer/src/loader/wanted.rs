//! The loader of a run: readers of the pools, the want list for the prefetcher, and its outcomes.

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

/// For this many waits of [`WAIT_BOUND`] a dead prefetcher is left to the launcher, which reports
/// it; if the launcher restarts stages, there is no limit.
const PEER_GRACE: u32 = 10;

/// Asks the prefetcher for tiles. Allocates nothing in the steady state.
#[derive(Debug)]
pub struct WantedTiles {
    elevation: PoolIndex,
    color: PoolIndex,
    wants: WantListWriter,
    outcomes: Consumer<TileOutcome>,
    /// The current frame.
    sequence: Sequence,
    /// The missing tiles of the current frame, in the order in which it wants them.
    missing: Vec<Tile>,
    /// The tiles of the published list.
    asked: HashSet<Tile>,
    /// The published list differs from the missing tiles of the frame.
    is_stale: bool,
    unavailable: HashMap<Tile, TileFailure>,
    /// For each layer, the completed sequence at which it had no room.
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

    /// A loader with these pools, want list and ring.
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

    /// Begins a frame, at its first wanted tile.
    fn begin(&mut self, sequence: Sequence) {
        self.sequence = sequence;
        self.is_stale = true;
        self.no_room = [None; 2];
    }

    fn take(&mut self, outcome: &TileOutcome) {
        // An invalid outcome is ignored: the tile is still missing, and will be asked for again.
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

    /// Whether the layer is known to have no room. A frame that was completed since then may have
    /// made room.
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

    fn elevation_key(&self, node: NodeId) -> Option<SlotKey> {
        self.elevation.kept(node, self.sequence)
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
        // Tiles that cannot be read are on the list too: the prefetcher decides whether to try
        // again.
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
        // Within a frame, a list is replaced when it lacks wanted tiles. Tiles on it that are
        // resident by now do no harm.
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
        // Nothing came for a while: perhaps an outcome found its ring full. A repeated request gets
        // another outcome.
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
        // At most one ring's capacity at a time, so that a prefetcher that floods the ring cannot
        // block the frame.
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
