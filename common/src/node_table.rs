//! A hash table from node to number that is cleared in constant time and never allocates after
//! construction.

use crate::node::NodeId;

/// Maps up to a fixed number of nodes to a `u32` each. Open addressing with linear probing, at most
/// half full. Clearing begins a new epoch, so that it costs nothing: each frame clears the table,
/// and the cost of a frame must not depend on its capacity.
#[derive(Debug, Clone)]
pub struct NodeTable {
    entries: Vec<Entry>,
    mask: usize,
    epoch: u32,
    len: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    key: u64,
    epoch: u32,
    value: u32,
}

impl NodeTable {
    /// An empty table for up to `capacity` nodes.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        let len = (capacity.max(1) * 2).next_power_of_two();
        Self { entries: vec![Entry::default(); len], mask: len - 1, epoch: 1, len: 0 }
    }

    /// Removes all nodes.
    pub fn clear(&mut self) {
        self.len = 0;
        self.epoch = self.epoch.wrapping_add(1);
        if self.epoch == 0 {
            self.entries.fill(Entry::default());
            self.epoch = 1;
        }
    }

    /// Number of nodes in it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it has no node.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Index of the node's entry, or of the free entry for it.
    fn find(&self, node: NodeId) -> usize {
        let key = node.pack();
        // Fibonacci hashing: the multiplier is 2^64 over the golden ratio (Knuth, TAOCP 3, §6.4);
        // the high bits are the well mixed ones.
        let mut at = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & self.mask;
        while self.entries[at].epoch == self.epoch && self.entries[at].key != key {
            at = (at + 1) & self.mask;
        }
        at
    }

    /// The node's number.
    #[must_use]
    pub fn get(&self, node: NodeId) -> Option<u32> {
        let entry = self.entries[self.find(node)];
        (entry.epoch == self.epoch).then_some(entry.value)
    }

    /// Sets the node's number and returns the previous one. A full table takes no new node and
    /// returns the number as an error.
    ///
    /// # Errors
    /// The number, when the table is full.
    pub fn insert(&mut self, node: NodeId, value: u32) -> Result<Option<u32>, u32> {
        let at = self.find(node);
        let old = self.entries[at];
        if old.epoch == self.epoch {
            self.entries[at].value = value;
            return Ok(Some(old.value));
        }
        if self.len * 2 >= self.entries.len() {
            return Err(value);
        }
        self.entries[at] = Entry { key: node.pack(), epoch: self.epoch, value };
        self.len += 1;
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;

    proptest! {
        #[test]
        fn it_does_what_a_map_does(steps in prop::collection::vec((0u32..20, 0u32..20, 0u8..3, 0u32..100), 0..200)) {
            let mut table = NodeTable::new(200);
            let mut map = HashMap::new();
            for (m, n, q, value) in steps {
                let node = NodeId::new(m, n, q).expect("in range");
                if value == 0 {
                    table.clear();
                    map.clear();
                } else {
                    prop_assert_eq!(table.insert(node, value), Ok(map.insert(node, value)));
                }
                prop_assert_eq!(table.len(), map.len());
            }
            for (m, n, q) in (0..20).flat_map(|m| (0..20).flat_map(move |n| (0..3).map(move |q| (m, n, q)))) {
                let node = NodeId::new(m, n, q).expect("in range");
                prop_assert_eq!(table.get(node), map.get(&node).copied());
            }
        }
    }

    #[test]
    fn a_full_table_takes_nothing_new_and_still_answers() {
        let mut table = NodeTable::new(4);
        let node = |m| NodeId::new(m, 0, 0).expect("in range");
        for m in 0..4 {
            assert_eq!(table.insert(node(m), m), Ok(None));
        }
        assert_eq!(table.insert(node(9), 7), Err(7));
        assert_eq!(table.insert(node(3), 8), Ok(Some(3)));
        assert_eq!((table.get(node(9)), table.get(node(3))), (None, Some(8)));
    }

    #[test]
    fn an_epoch_that_wraps_forgets_too() {
        let mut table = NodeTable::new(4);
        let node = NodeId::new(1, 2, 3).expect("in range");
        table.epoch = u32::MAX;
        assert_eq!(table.insert(node, 5), Ok(None));
        table.clear();
        assert_eq!(table.get(node), None);
    }
}
