//! The pool as its only writer sees it: who is in it. Which tile goes when room is needed is
//! decided in [`eviction`].

mod eviction;

use super::node_hasher::NodeHasher;
use super::reader::{PoolBytes, PoolReader, bytes, numbered, slots};
use super::{check_is_pool, table};
use crate::ids::{Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::shm::error::ShmError;
use crate::shm::header::{Role, RoleClaim, Segment};
use crate::shm::kind::SegmentKind;
use crate::shm::run_id::RunId;
use crate::shm::segments::open_segment;
use crate::shm::slot_words::{SlotInfo, SlotWords};
use std::collections::HashMap;
use std::hash::BuildHasherDefault;
use std::sync::Arc;

/// Fills a tile pool, evicts from it, and knows where each node's tile is. One per pool.
#[derive(Debug)]
pub struct PoolWriter {
    place: Arc<WriterPlace>,
    /// Slot of each node that is in the pool or was put into a slot that has not been claimed
    /// again.
    slot_of: HashMap<u64, SlotIndex, BuildHasherDefault<NodeHasher>>,
    /// The node that [`PoolWriter::slot_of`] has for each slot.
    node_of: Vec<Option<NodeId>>,
    /// Sequence at which each slot's tile was last expected ([`PoolWriter::expect`]).
    expected_at: Vec<Sequence>,
    /// Slots to claim next, the least recently wanted last, with the sequence that they had.
    candidates: Vec<(Sequence, SlotIndex)>,
    /// The completed sequence of that look.
    looked_at: Sequence,
}

/// The writer's place, which lasts until its last fill guard is gone: guards are dropped on other
/// threads.
#[derive(Debug)]
struct WriterPlace {
    segment: Arc<Segment>,
    _claim: RoleClaim,
}

impl WriterPlace {
    fn words(&self, slot: SlotIndex) -> Option<&SlotWords> {
        table(&self.segment).get(slot.index())
    }
}

/// Whether a node's tile is in a pool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Residency {
    /// It is not.
    Absent,
    /// It is being loaded.
    Filling,
    /// It is, and can be read.
    Resident {
        /// Where it lies.
        key: SlotKey,
    },
}

impl PoolWriter {
    /// Opens a run's pool ([`SegmentKind::ColorPool`] or [`SegmentKind::ElevationPool`]) to write;
    /// waits a moment for the segment to become ready. After a writer that was killed, the tiles
    /// that it published stay, and slots that it was filling are free.
    ///
    /// # Errors
    /// See [`ShmError`]; [`ShmError::RoleTaken`] while another writer lives.
    pub fn open(run: &RunId, kind: SegmentKind) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, kind)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        check_is_pool(segment)?;
        let claim = RoleClaim::take(segment, Role::Writer)?;
        let place = Arc::new(WriterPlace { segment: Arc::clone(segment), _claim: claim });
        let capacity = segment.geometry().capacity as usize;
        // Twice the room: a map of this fill never grows, it only cleans itself in place.
        let mut slot_of = HashMap::with_capacity_and_hasher(2 * capacity, BuildHasherDefault::default());
        let mut node_of = vec![None; capacity];
        for ((slot, words), node_of) in numbered(segment).zip(&mut node_of) {
            words.recover();
            let info = words.info(slot);
            if let (Some(node), true) = (info.node, info.state.is_readable()) {
                *node_of = Some(node);
                slot_of.insert(node.pack(), slot);
            }
        }
        Ok(Self {
            place,
            slot_of,
            node_of,
            expected_at: vec![Sequence::NONE; capacity],
            candidates: Vec::with_capacity(capacity),
            looked_at: Sequence::NONE,
        })
    }

    /// Number of slots.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.place.segment.geometry().capacity as u32
    }

    /// Bytes of a slot.
    #[must_use]
    pub fn slot_bytes(&self) -> u64 {
        self.place.segment.geometry().item_bytes
    }

    /// A reader of the same pool.
    #[must_use]
    pub fn reader(&self) -> PoolReader {
        PoolReader::of(&self.place.segment)
    }

    /// Whether a node's tile is in the pool. Costs one look into a hash table.
    #[must_use]
    pub fn residency(&self, node: NodeId) -> Residency {
        let Some(&slot) = self.slot_of.get(&node.pack()) else { return Residency::Absent };
        let Some(words) = self.place.words(slot) else { return Residency::Absent };
        let usage = words.usage();
        match usage.state {
            super::SlotState::Free => Residency::Absent,
            super::SlotState::Filling => Residency::Filling,
            super::SlotState::Ready | super::SlotState::Locked => {
                Residency::Resident { key: SlotKey { slot, generation: words.generation() } }
            }
        }
    }

    /// Where a node's tile lies, if it can be read. Costs one look into a hash table.
    #[must_use]
    pub fn find(&self, node: NodeId) -> Option<SlotKey> {
        match self.residency(node) {
            Residency::Resident { key } => Some(key),
            Residency::Absent | Residency::Filling => None,
        }
    }

    /// A slot for a node's tile, which frame `sequence` wants. Takes a free slot, else the one
    /// wanted least recently whose last frame is at most `completed_sequence`
    /// ([`crate::shm::Control::completed_sequence`]) and that is not locked. `None` when there is
    /// none (wait for a frame to complete), or when the tile is in the pool or being loaded
    /// ([`PoolWriter::residency`] tells which).
    ///
    /// Allocates no memory. The guard may be filled and published on any thread.
    pub fn allocate(&mut self, node: NodeId, sequence: Sequence, completed_sequence: Sequence) -> Option<FillGuard> {
        self.fill(node, sequence, completed_sequence, None)
    }

    /// A slot for a tile that no frame wants yet, but one is expected to, as of frame `sequence`.
    /// Takes a free slot, else one that was neither wanted nor expected since before `sequence`.
    /// Nothing but that order protects the tile.
    pub fn allocate_expected(
        &mut self,
        node: NodeId,
        sequence: Sequence,
        completed_sequence: Sequence,
    ) -> Option<FillGuard> {
        let guard = self.fill(node, Sequence::NONE, completed_sequence, Some(sequence))?;
        self.expected_at[guard.key.slot.index()] = sequence;
        Some(guard)
    }

    fn fill(
        &mut self,
        node: NodeId,
        sequence: Sequence,
        completed: Sequence,
        limit: Option<Sequence>,
    ) -> Option<FillGuard> {
        if self.residency(node) != Residency::Absent {
            return None;
        }
        let key = self.claim(node, sequence, completed, limit)?;
        let slot = key.slot;
        self.expected_at[slot.index()] = Sequence::NONE;
        let before = self.node_of.get_mut(slot.index())?.replace(node);
        if let Some(before) = before
            && self.slot_of.get(&before.pack()) == Some(&slot)
        {
            self.slot_of.remove(&before.pack());
        }
        self.slot_of.insert(node.pack(), slot);
        Some(FillGuard { place: Arc::clone(&self.place), key, is_open: true })
    }

    /// A view that is expected at frame `sequence` wants a node's tile: it is evicted as if that
    /// frame had wanted it. Unlike a wish ([`PoolWriter::touch_node`]) this protects nothing.
    /// Returns what it found.
    pub fn expect(&mut self, node: NodeId, sequence: Sequence) -> Residency {
        let residency = self.residency(node);
        if let (true, Some(&slot)) = (residency != Residency::Absent, self.slot_of.get(&node.pack())) {
            let at = &mut self.expected_at[slot.index()];
            *at = (*at).max(sequence);
        }
        residency
    }

    /// Slots that [`PoolWriter::allocate_expected`] would take. Looks through the whole table.
    #[must_use]
    pub fn unexpected_slots(&self, sequence: Sequence, completed_sequence: Sequence) -> u32 {
        let slots = numbered(&self.place.segment);
        slots.filter(|(slot, words)| self.rank(*slot, words, completed_sequence).is_some_and(|r| r < sequence)).count()
            as u32
    }

    /// Slots that hold a tile. Looks through the whole table.
    #[must_use]
    pub fn used_slots(&self) -> u32 {
        table(&self.place.segment).iter().filter(|words| words.usage().state.is_readable()).count() as u32
    }

    /// Frame `sequence` wants the tile in this slot (or the one that is being loaded into it): it
    /// stays until that frame is completed. `false` when the slot holds nothing or does not exist.
    pub fn touch(&self, slot: SlotIndex, sequence: Sequence) -> bool {
        self.place.words(slot).is_some_and(|words| words.touch(None, sequence))
    }

    /// [`PoolWriter::touch`] by node: of the tile that is in the pool or being loaded. Returns what
    /// it found.
    pub fn touch_node(&self, node: NodeId, sequence: Sequence) -> Residency {
        let residency = self.residency(node);
        if residency != Residency::Absent
            && let Some(&slot) = self.slot_of.get(&node.pack())
        {
            self.touch(slot, sequence);
        }
        residency
    }

    /// Keeps the tile in this slot for ever; `false` when the slot holds none.
    pub fn lock(&self, slot: SlotIndex) -> bool {
        self.place.words(slot).is_some_and(SlotWords::lock)
    }

    /// The tile of this key, in place; `None` when its slot does not exist or holds another.
    #[must_use]
    pub fn bytes(&self, key: SlotKey) -> Option<PoolBytes<'_>> {
        bytes(&self.place.segment, key)
    }

    /// What the slots hold.
    pub fn slots(&self) -> impl Iterator<Item = SlotInfo> {
        slots(&self.place.segment)
    }
}

/// A slot that is being filled, on whichever thread. Dropped without [`FillGuard::publish`] the
/// slot is free again.
#[derive(Debug)]
#[must_use]
pub struct FillGuard {
    place: Arc<WriterPlace>,
    key: SlotKey,
    is_open: bool,
}

impl FillGuard {
    /// Where the tile will lie.
    #[must_use]
    pub fn key(&self) -> SlotKey {
        self.key
    }

    /// The slot's bytes, with whatever an earlier tile left there.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        let segment = &self.place.segment;
        let offset = segment.item_offset(self.key.slot.get().into());
        // SAFETY: the claim made the slot ours alone (no frame in flight names it, and no reader
        // takes a slot that is being filled); the slice borrows `self`, the one guard of the slot.
        unsafe { segment.region().slice_mut(offset, segment.geometry().item_bytes) }
    }

    /// The slot's bytes as numbers.
    pub fn f32_mut(&mut self) -> &mut [f32] {
        let bytes = self.bytes_mut();
        let whole = bytes.len() / 4 * 4;
        bytemuck::cast_slice_mut(&mut bytes[..whole])
    }

    /// Leaves the slot as a process that is killed here would.
    #[cfg(test)]
    pub(crate) fn abandon_as_if_killed(mut self) {
        self.is_open = false;
    }

    /// Makes the tile visible. Returns where it lies.
    pub fn publish(mut self) -> SlotKey {
        self.is_open = false;
        if let Some(words) = self.place.words(self.key.slot) {
            words.publish();
        }
        self.key
    }
}

impl Drop for FillGuard {
    fn drop(&mut self) {
        if self.is_open
            && let Some(words) = self.place.words(self.key.slot)
        {
            words.abandon();
        }
    }
}
