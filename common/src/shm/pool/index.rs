//! A reader's index of a pool: where each node's tile is, and which tiles the reader pins.

use super::reader::{PoolBytes, PoolReader};
use crate::ids::{Generation, Sequence, SlotIndex, SlotKey};
use crate::node::NodeId;
use crate::node_hasher::NodeHasher;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;

/// A reader with a map from node to slot. The map is built from outcomes, each of which is checked
/// against the pool's table; an entry whose slot has been refilled finds nothing. Allocates nothing
/// after construction.
#[derive(Debug)]
pub struct PoolIndex {
    reader: PoolReader,
    slot_of: HashMap<u64, SlotIndex, BuildHasherDefault<NodeHasher>>,
    entries: Vec<Option<Entry>>,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    node: NodeId,
    generation: Generation,
    /// Sequence of the last frame for which this reader pins it; `None` before the first.
    kept_for: Option<Sequence>,
}

impl PoolIndex {
    /// An index of the current content of a pool.
    #[must_use]
    pub fn new(reader: PoolReader) -> Self {
        let capacity = reader.capacity() as usize;
        // Twice the capacity: a map that is half full never grows, it only rehashes in place.
        let slot_of = HashMap::with_capacity_and_hasher(2 * capacity, BuildHasherDefault::default());
        let mut index = Self { reader: reader.clone(), slot_of, entries: vec![None; capacity] };
        for info in reader.slots() {
            if let (Some(node), true) = (info.node, info.state.is_readable()) {
                index.note(node, info.key());
            }
        }
        index
    }

    /// The reader.
    #[must_use]
    pub fn reader(&self) -> &PoolReader {
        &self.reader
    }

    /// Records the place of a node's tile. `false` when the tile is not there: it has been evicted
    /// since, or the key is not valid.
    pub fn note(&mut self, node: NodeId, key: SlotKey) -> bool {
        let SlotKey { slot, generation } = key;
        let is_there = self
            .reader
            .info(slot)
            .is_some_and(|info| info.node == Some(node) && info.key() == key && info.state.is_readable());
        let Some(entry) = self.entries.get_mut(slot.index()).filter(|_| is_there) else { return false };
        let kept_for = entry.filter(|e| e.node == node && e.generation == generation).and_then(|e| e.kept_for);
        let before = entry.replace(Entry { node, generation, kept_for });
        if let Some(before) = before
            && self.slot_of.get(&before.node.pack()) == Some(&slot)
        {
            self.slot_of.remove(&before.node.pack());
        }
        self.slot_of.insert(node.pack(), slot);
        true
    }

    /// Pins a node's tile for frame `sequence`: it stays until that frame is completed. `false`
    /// when it is not resident.
    pub fn keep(&mut self, node: NodeId, sequence: Sequence) -> bool {
        let Some(&slot) = self.slot_of.get(&node.pack()) else { return false };
        let Some(Some(entry)) = self.entries.get_mut(slot.index()) else { return false };
        // Pin first, then check: a tile that is readable after pinning stays readable.
        let key = SlotKey { slot, generation: entry.generation };
        let is_kept = self.reader.touch(key, sequence) && self.reader.bytes(key).is_some();
        if is_kept {
            entry.kept_for = Some(sequence);
        }
        is_kept
    }

    /// The place of a node's tile, if it is pinned for frame `sequence`. A tile that arrived after
    /// the frame looked is not pinned: it might be evicted while the frame is drawn.
    #[must_use]
    pub fn kept(&self, node: NodeId, sequence: Sequence) -> Option<SlotKey> {
        let slot = *self.slot_of.get(&node.pack())?;
        let entry = self.entries.get(slot.index())?.filter(|entry| entry.kept_for == Some(sequence))?;
        Some(SlotKey { slot, generation: entry.generation })
    }

    /// The bytes of a node's tile, if it is pinned for frame `sequence`.
    #[must_use]
    pub fn bytes(&self, node: NodeId, sequence: Sequence) -> Option<PoolBytes<'_>> {
        self.reader.bytes(self.kept(node, sequence)?)
    }
}
