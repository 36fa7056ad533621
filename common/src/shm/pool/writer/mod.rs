//! The only writer of a pool, which knows where each tile is. [`eviction`] decides which tile is
//! evicted.

mod eviction;

use super::reader::{PoolBytes, PoolReader, bytes, numbered, slots};
use super::{check_is_pool, table};
use crate::ids::{Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::node_hasher::NodeHasher;
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
    /// The slot of each node that is in the pool, or was in a slot that has not been claimed again.
    slot_of: HashMap<u64, SlotIndex, BuildHasherDefault<NodeHasher>>,
    /// The node of each slot, the inverse of [`PoolWriter::slot_of`].
    node_of: Vec<Option<NodeId>>,
    /// Sequence at which each slot's tile was last predicted ([`PoolWriter::expect`]).
    expected_at: Vec<Sequence>,
    /// Slots to claim next, the least recently wanted last, with their sequences at the time of the
    /// scan.
    candidates: Vec<(Sequence, SlotIndex)>,
    /// The completed sequence at the time of the scan.
    looked_at: Sequence,
}

/// The writer's role, which is held until its last fill guard is dropped, possibly on another
/// thread.
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
    /// It is not in the pool.
    Absent,
    /// It is being loaded.
    Filling,
    /// It is in the pool, and can be read.
    Resident {
        /// Where it lies.
        key: SlotKey,
    },
}

impl PoolWriter {
    /// Opens a run's pool ([`SegmentKind::ColorPool`] or [`SegmentKind::ElevationPool`]) for
    /// writing; waits a short time for the segment to become ready. After a killed writer, the
    /// tiles that it published remain, and the slots that it was filling are free.
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

    /// Whether a node's tile is in the pool. Costs one hash table lookup.
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

    /// The place of a node's tile, if it can be read. Costs one hash table lookup.
    #[must_use]
    pub fn find(&self, node: NodeId) -> Option<SlotKey> {
        match self.residency(node) {
            Residency::Resident { key } => Some(key),
            Residency::Absent | Residency::Filling => None,
        }
    }

    /// A slot for a node's tile that frame `sequence` wants. Takes a free slot, otherwise the least
    /// recently wanted one that is not locked and whose last frame is at most `completed_sequence`
    /// ([`crate::shm::Control::completed_sequence`]). `None` when there is no such slot (wait for a
    /// frame to complete), or when the tile is in the pool or being loaded
    /// ([`PoolWriter::residency`] tells which).
    ///
    /// Allocates no memory. The guard may be filled and published on any thread.
    pub fn allocate(&mut self, node: NodeId, sequence: Sequence, completed_sequence: Sequence) -> Option<FillGuard> {
        self.fill(node, sequence, completed_sequence, None)
    }

    /// A slot for a predicted tile that no frame wants yet, as of frame `sequence`. Takes a free
    /// slot, otherwise one that was neither wanted nor predicted since `sequence`. The tile is not
    /// pinned.
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
        Some(FillGuard { place: Arc::clone(&self.place), key, is_open: true, has_memory: before.is_some() })
    }

    /// Records that a predicted view at frame `sequence` wants a node's tile: for eviction, this
    /// counts as if that frame had wanted it. Unlike [`PoolWriter::touch_node`], this does not pin
    /// the tile. Returns the residency of the tile.
    pub fn expect(&mut self, node: NodeId, sequence: Sequence) -> Residency {
        let residency = self.residency(node);
        if let (true, Some(&slot)) = (residency != Residency::Absent, self.slot_of.get(&node.pack())) {
            let at = &mut self.expected_at[slot.index()];
            *at = (*at).max(sequence);
        }
        residency
    }

    /// Number of slots that [`PoolWriter::allocate_expected`] would take. Scans the whole table.
    #[must_use]
    pub fn unexpected_slots(&self, sequence: Sequence, completed_sequence: Sequence) -> u32 {
        let slots = numbered(&self.place.segment);
        slots.filter(|(slot, words)| self.rank(*slot, words, completed_sequence).is_some_and(|r| r < sequence)).count()
            as u32
    }

    /// Number of slots that hold a tile. Scans the whole table.
    #[must_use]
    pub fn used_slots(&self) -> u32 {
        table(&self.place.segment).iter().filter(|words| words.usage().state.is_readable()).count() as u32
    }

    /// Pins the tile in this slot (or the one that is being loaded into it) for frame `sequence`:
    /// it stays until that frame is completed. `false` when the slot is empty or does not exist.
    pub fn touch(&self, slot: SlotIndex, sequence: Sequence) -> bool {
        self.place.words(slot).is_some_and(|words| words.touch(None, sequence))
    }

    /// [`PoolWriter::touch`] by node, for a tile that is in the pool or being loaded. Returns the
    /// residency of the tile.
    pub fn touch_node(&self, node: NodeId, sequence: Sequence) -> Residency {
        let residency = self.residency(node);
        if residency != Residency::Absent
            && let Some(&slot) = self.slot_of.get(&node.pack())
        {
            self.touch(slot, sequence);
        }
        residency
    }

    /// Locks the tile in this slot: it is never evicted. `false` when the slot holds no tile.
    pub fn lock(&self, slot: SlotIndex) -> bool {
        self.place.words(slot).is_some_and(SlotWords::lock)
    }

    /// The tile of this key, in place; `None` when its slot does not exist or holds another.
    #[must_use]
    pub fn bytes(&self, key: SlotKey) -> Option<PoolBytes<'_>> {
        bytes(&self.place.segment, key)
    }

    /// The contents of the slots.
    pub fn slots(&self) -> impl Iterator<Item = SlotInfo> {
        slots(&self.place.segment)
    }
}

/// A slot that is being filled, on any thread. If dropped without [`FillGuard::publish`], the slot
/// is free again.
#[derive(Debug)]
#[must_use]
pub struct FillGuard {
    place: Arc<WriterPlace>,
    key: SlotKey,
    is_open: bool,
    /// Whether the slot has been filled before, and its memory is there.
    has_memory: bool,
}

impl FillGuard {
    /// The place of the tile.
    #[must_use]
    pub fn key(&self) -> SlotKey {
        self.key
    }

    /// The slot's bytes, with the content of an earlier tile.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        let segment = &self.place.segment;
        let offset = segment.item_offset(self.key.slot.get().into());
        if !std::mem::replace(&mut self.has_memory, true) {
            segment.region().populate(offset, segment.geometry().item_bytes);
        }
        // SAFETY: the claim gave us exclusive access to the slot (no frame in flight uses it, and
        // no reader takes a slot that is being filled); the slice borrows `self`, the only guard of
        // the slot.
        unsafe { segment.region().slice_mut(offset, segment.geometry().item_bytes) }
    }

    /// The slot's bytes as numbers.
    pub fn f32_mut(&mut self) -> &mut [f32] {
        let bytes = self.bytes_mut();
        let whole = bytes.len() / 4 * 4;
        bytemuck::cast_slice_mut(&mut bytes[..whole])
    }

    /// For tests: leaves the slot as if the process were killed here.
    #[cfg(test)]
    pub(crate) fn abandon_as_if_killed(mut self) {
        self.is_open = false;
    }

    /// Makes the tile visible. Returns its place.
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
