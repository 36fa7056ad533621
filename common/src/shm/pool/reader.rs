//! Readers of a pool.

use super::{check_is_pool, table};
use crate::ids::{Generation, Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::shm::error::ShmError;
use crate::shm::header::Segment;
use crate::shm::kind::SegmentKind;
use crate::shm::run_id::RunId;
use crate::shm::segments::{SegmentMemory, open_segment};
use crate::shm::slot_words::{SlotInfo, SlotWords};
use std::ops::Deref;
use std::sync::Arc;

/// Reads a tile pool. There may be several.
#[derive(Debug, Clone)]
pub struct PoolReader {
    segment: Arc<Segment>,
}

impl PoolReader {
    /// Opens a run's pool ([`SegmentKind::ColorPool`] or [`SegmentKind::ElevationPool`]); waits a
    /// short time for the segment to become ready.
    ///
    /// # Errors
    /// See [`ShmError`].
    pub fn open(run: &RunId, kind: SegmentKind) -> Result<Self, ShmError> {
        Self::attach(&open_segment(run, kind)?)
    }

    pub(crate) fn attach(segment: &Arc<Segment>) -> Result<Self, ShmError> {
        check_is_pool(segment)?;
        Ok(Self::of(segment))
    }

    pub(super) fn of(segment: &Arc<Segment>) -> Self {
        Self { segment: Arc::clone(segment) }
    }

    /// Number of slots.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.segment.geometry().capacity as u32
    }

    /// Bytes of a slot.
    #[must_use]
    pub fn slot_bytes(&self) -> u64 {
        self.segment.geometry().item_bytes
    }

    /// Bytes from the start of the segment to the slot; `None` for a slot that does not exist.
    #[must_use]
    pub fn slot_offset(&self, slot: SlotIndex) -> Option<u64> {
        let slot = u64::from(slot.get());
        (slot < self.segment.geometry().capacity).then(|| self.segment.item_offset(slot))
    }

    /// The whole segment, for import into a device: address and length are multiples of 4096.
    #[must_use]
    pub fn memory(&self) -> SegmentMemory {
        SegmentMemory::new(&self.segment)
    }

    /// The tile of this key, in place; `None` when its slot does not exist or holds another.
    ///
    /// The bytes do not change while a frame that wanted the slot is not completed: read them only
    /// for such frames.
    #[must_use]
    pub fn bytes(&self, key: SlotKey) -> Option<PoolBytes<'_>> {
        bytes(&self.segment, key)
    }

    /// Numbers from the beginning of a slot to that of the next.
    #[must_use]
    pub fn stride_f32(&self) -> u32 {
        (self.segment.geometry().stride / 4) as u32
    }

    /// All slots as numbers, one behind the other, [`PoolReader::stride_f32`] apart: the table that
    /// vector instructions gather from, each lane out of another tile.
    ///
    /// Only the numbers of slots that a frame names which is not completed, of the generation that
    /// it names, are those of a tile, and do not change: load no others, and do not look at the
    /// slice as a whole.
    ///
    /// This is the one slice that reaches beyond what its reader may load. A slice for each slot, or
    /// atomic loads, would have every lane looked up and loaded by itself, which is what gathering
    /// saves. It stays within the rule that nobody reads what a peer may be writing, since a reader
    /// forms each place from a slot whose key it has checked and from a place within that slot, and
    /// checks all keys again after the last load ([`PoolReader::bytes`]): a picture of a slot that was
    /// refilled is not shown.
    #[must_use]
    pub fn all_f32(&self) -> &[f32] {
        let geometry = self.segment.geometry();
        let len = geometry.capacity * geometry.stride / 4;
        // SAFETY: the range lies within the mapping, which outlives the slice, and any bits are a
        // number. Slots that frames in flight name are published (SYNC pool.publish) and not refilled,
        // as in `PoolReader::bytes`, so what is loaded by the contract above does not change. What
        // changes is written by the prefetcher, another process, and is not loaded: no value, length or
        // index comes from it. A reader that broke the contract would see other numbers, and no other
        // memory: places are bounded by the length of the slice.
        unsafe { self.segment.region().slice(geometry.data_offset, len) }
    }

    /// The content of a slot; `None` for a slot that does not exist.
    #[must_use]
    pub fn info(&self, slot: SlotIndex) -> Option<SlotInfo> {
        table(&self.segment).get(slot.index()).map(|words| words.info(slot))
    }

    /// The contents of the slots, each read consistently.
    pub fn slots(&self) -> impl Iterator<Item = SlotInfo> {
        slots(&self.segment)
    }

    /// The place of a node's tile, if it is readable. Searches the whole table.
    #[must_use]
    pub fn find(&self, node: NodeId) -> Option<SlotKey> {
        self.slots().find(|info| info.node == Some(node) && info.state.is_readable()).map(|info| info.key())
    }

    /// Pins the tile of this key for frame `sequence`: it stays until that frame is completed.
    /// `false` when it has already been evicted.
    #[must_use]
    pub fn touch(&self, key: SlotKey, sequence: Sequence) -> bool {
        table(&self.segment).get(key.slot.index()).is_some_and(|words| words.touch(Some(key.generation), sequence))
    }
}

/// The contents of the slots of a pool, each read consistently.
pub(super) fn slots(segment: &Segment) -> impl Iterator<Item = SlotInfo> {
    numbered(segment).map(|(slot, words)| words.info(slot))
}

/// The slots of a pool, with their numbers.
pub(super) fn numbered(segment: &Segment) -> impl Iterator<Item = (SlotIndex, &SlotWords)> {
    (0u32..).map(SlotIndex::new).zip(table(segment))
}

pub(super) fn bytes(segment: &Segment, key: SlotKey) -> Option<PoolBytes<'_>> {
    let words = table(segment).get(key.slot.index())?;
    if !words.is_readable(key.generation) {
        return None;
    }
    let offset = segment.item_offset(key.slot.get().into());
    // SAFETY: published (SYNC pool.publish), and not refilled before the frames that want it are
    // completed, by the protocol that `PoolReader::bytes` states.
    let bytes = unsafe { segment.region().slice(offset, segment.geometry().item_bytes) };
    Some(PoolBytes { bytes, words, generation: key.generation })
}

/// The bytes of a tile in its slot.
#[derive(Debug, Clone, Copy)]
pub struct PoolBytes<'a> {
    bytes: &'a [u8],
    words: &'a SlotWords,
    generation: Generation,
}

impl<'a> PoolBytes<'a> {
    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// The bytes as numbers; a slot begins at a multiple of 64.
    #[must_use]
    pub fn f32(&self) -> &'a [f32] {
        let whole = self.bytes.len() / 4 * 4;
        bytemuck::cast_slice(&self.bytes[..whole])
    }

    /// Whether the slot still holds this tile. Within the protocol it does; a reader that violated
    /// it can detect that.
    #[must_use]
    pub fn is_still_valid(&self) -> bool {
        self.words.is_readable(self.generation)
    }
}

impl Deref for PoolBytes<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.bytes
    }
}
