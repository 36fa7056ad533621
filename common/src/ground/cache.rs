//! Tiles in memory, as many as fit a bound; the ones that were not used for longest go.

use crate::node::NodeId;
use crate::node_hasher::NodeHasher;
use std::collections::HashMap;
use std::hash::BuildHasherDefault;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A tile that could not be read is asked for again after this time; its source may have recovered.
const REST: Duration = Duration::from_secs(5);

/// What is known of a tile.
#[derive(Debug, Clone)]
pub(super) enum Cached {
    /// Its values.
    Values(Arc<[f32]>),
    /// It could not be read at this moment.
    Failed(Instant),
}

/// A cache with a clock for a hand: a tile that was used since the hand last passed stays.
#[derive(Debug)]
pub(super) struct TileCache {
    capacity: usize,
    slots: HashMap<u64, usize, BuildHasherDefault<NodeHasher>>,
    entries: Vec<Entry>,
    hand: usize,
}

#[derive(Debug)]
struct Entry {
    node: NodeId,
    tile: Cached,
    is_used: bool,
}

impl TileCache {
    /// For this many tiles.
    pub(super) fn new(capacity: usize) -> Self {
        Self { capacity, slots: HashMap::default(), entries: Vec::new(), hand: 0 }
    }

    /// What is known of a tile.
    pub(super) fn get(&mut self, node: NodeId) -> Option<Cached> {
        let entry = self.entries.get_mut(*self.slots.get(&node.pack())?)?;
        if let Cached::Failed(at) = entry.tile
            && at.elapsed() > REST
        {
            return None;
        }
        entry.is_used = true;
        Some(entry.tile.clone())
    }

    /// Keeps a tile, in place of another when all places are taken.
    pub(super) fn put(&mut self, node: NodeId, tile: Cached) {
        if self.capacity == 0 {
            return;
        }
        let entry = Entry { node, tile, is_used: false };
        // Another thread may have brought it meanwhile, or it could not be read a while ago.
        if let Some(&at) = self.slots.get(&node.pack()) {
            self.entries[at] = entry;
            return;
        }
        if self.entries.len() < self.capacity {
            self.slots.insert(node.pack(), self.entries.len());
            self.entries.push(entry);
            return;
        }
        while std::mem::take(&mut self.entries[self.hand].is_used) {
            self.hand = (self.hand + 1) % self.capacity;
        }
        self.slots.remove(&self.entries[self.hand].node.pack());
        self.slots.insert(node.pack(), self.hand);
        self.entries[self.hand] = entry;
        self.hand = (self.hand + 1) % self.capacity;
    }

    /// Tiles that are kept.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn node(m: u32) -> NodeId {
        NodeId::new(m, 7, 3).unwrap()
    }

    fn values(m: u32) -> Cached {
        Cached::Values(Arc::from([m as f32]))
    }

    #[test]
    fn what_is_used_stays_and_no_more_than_fits_is_kept() {
        let mut cache = TileCache::new(8);
        for m in 0..1000 {
            cache.put(node(m), values(m));
            // The first is asked for again and again.
            assert!(matches!(cache.get(node(0)), Some(Cached::Values(tile)) if tile[0] == 0.0), "{m}");
            assert!(cache.len() <= 8 && cache.slots.len() == cache.len());
        }
        for m in 0..1000 {
            let is_kept = m == 0 || m >= 993;
            let found = cache.get(node(m));
            assert!(matches!(found, Some(Cached::Values(tile)) if tile[0] == m as f32) == is_kept, "{m}");
        }
    }

    #[test]
    fn a_tile_that_could_not_be_read_rests() {
        let mut cache = TileCache::new(2);
        cache.put(node(1), Cached::Failed(Instant::now()));
        assert!(matches!(cache.get(node(1)), Some(Cached::Failed(_))));
        if let Some(long_ago) = Instant::now().checked_sub(2 * REST) {
            cache.put(node(1), Cached::Failed(long_ago));
            assert!(cache.get(node(1)).is_none());
        }
        cache.put(node(1), values(1));
        assert!(matches!(cache.get(node(1)), Some(Cached::Values(_))));
        let mut none = TileCache::new(0);
        none.put(node(1), values(1));
        assert!(none.get(node(1)).is_none());
    }
}
