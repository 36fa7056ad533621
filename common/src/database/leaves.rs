//! A cache of leaf directories, bounded in bytes: the least recently used ones are dropped.
//!
//! The directories of a database that is small on disk can be thousands of times larger in memory.
//! So the bound is on bytes in memory, not on sizes that the database states.

use super::archive_layout::Directory;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Upper bound of the bytes of leaf directories in memory for an archive: those of 1.4 million
/// tiles. Others are read again when needed.
pub const MOST_LEAF_BYTES: usize = 32 << 20;
/// Memory of a directory in addition to its entries: map entry and allocations.
const OVERHEAD_BYTES: usize = 256;

/// The most recently used leaf directories of an archive, by their entry in the root. May be used
/// by any thread.
#[derive(Debug)]
pub struct Leaves {
    most_bytes: usize,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    clock: u64,
    bytes: usize,
    by_index: HashMap<usize, (u64, Arc<Directory>)>,
}

impl Held {
    fn get(&mut self, index: usize) -> Option<Arc<Directory>> {
        self.clock += 1;
        let (used, leaf) = self.by_index.get_mut(&index)?;
        *used = self.clock;
        Some(Arc::clone(leaf))
    }

    fn put(&mut self, index: usize, leaf: &Arc<Directory>, most_bytes: usize) {
        self.clock += 1;
        self.bytes += cost(leaf);
        if let Some((_, old)) = self.by_index.insert(index, (self.clock, Arc::clone(leaf))) {
            self.bytes -= cost(&old);
        }
        while self.bytes > most_bytes {
            // There are a few hundred of them in a database written by ingest: a linear search
            // costs less than to keep them sorted.
            let oldest = self.by_index.iter().min_by_key(|(_, (used, _))| *used).map(|(index, _)| *index);
            let Some((_, old)) = oldest.and_then(|index| self.by_index.remove(&index)) else { break };
            self.bytes -= cost(&old);
        }
    }
}

fn cost(leaf: &Directory) -> usize {
    leaf.memory_bytes() + OVERHEAD_BYTES
}

impl Default for Leaves {
    fn default() -> Self {
        Self::new(MOST_LEAF_BYTES)
    }
}

impl Leaves {
    /// A cache of at most `most_bytes` bytes.
    #[must_use]
    pub fn new(most_bytes: usize) -> Self {
        Self { most_bytes, held: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A cached directory.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<Arc<Directory>> {
        self.lock().get(index)
    }

    /// The directory with this index, from the cache or made by `parse`. Only one is parsed at a
    /// time, so that concurrent readers do not need more memory than one of them.
    ///
    /// # Errors
    /// The error of `parse`.
    pub fn get_or_parse<E>(
        &self,
        index: usize,
        parse: impl FnOnce() -> Result<Directory, E>,
    ) -> Result<Arc<Directory>, E> {
        let mut held = self.lock();
        if let Some(leaf) = held.get(index) {
            return Ok(leaf);
        }
        let leaf = Arc::new(parse()?);
        held.put(index, &leaf, self.most_bytes);
        Ok(leaf)
    }

    /// Bytes in the cache.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    #[test]
    fn the_directories_used_last_stay_within_the_bound() {
        let one = Directory::of_entries(100);
        let leaves = Leaves::new(3 * cost(&one));
        let put = |index| leaves.get_or_parse(index, || Ok::<_, Infallible>(Directory::of_entries(100))).unwrap();
        (0..3).for_each(|index| drop(put(index)));
        assert!(leaves.get(0).is_some());
        put(3);
        assert!(leaves.get(1).is_none(), "unused for longest");
        assert!([0, 2, 3].into_iter().all(|index| leaves.get(index).is_some()));
        assert!(leaves.bytes() <= 3 * cost(&one));
        leaves.get_or_parse(3, || -> Result<_, Infallible> { unreachable!("it is there") }).unwrap();
        // A directory that is larger than the bound is used, but not cached.
        leaves.get_or_parse(9, || Ok::<_, Infallible>(Directory::of_entries(1000))).unwrap();
        assert!(leaves.get(9).is_none() && leaves.bytes() <= 3 * cost(&one));
        assert_eq!(leaves.get_or_parse(10, || Err("damaged")).unwrap_err(), "damaged");
    }
}
