//! Pieces of archives, and the few of them that are kept in memory: extents of small tiles.

use crate::cache::Key;
use bytes::Bytes;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Bytes of an archive that were read together.
#[derive(Debug)]
pub(crate) struct Piece {
    pub(crate) bytes: Bytes,
    /// When it was requested, if the request was repeated because the first one took much longer
    /// than usual.
    pub(crate) resent_at: Option<Instant>,
    /// Whether it is in the disk cache, or about to be written to it.
    is_on_disk: AtomicBool,
}

impl Piece {
    pub(crate) fn new(bytes: Bytes, is_on_disk: bool) -> Self {
        Self { bytes, resent_at: None, is_on_disk: AtomicBool::new(is_on_disk) }
    }

    /// A piece that was read over the network.
    pub(crate) fn fetched(bytes: Bytes, resent_at: Option<Instant>) -> Self {
        Self { resent_at, ..Self::new(bytes, false) }
    }

    /// Whether it has yet to be written to disk: true for only one caller.
    pub(crate) fn begin_keeping(&self) -> bool {
        // Relaxed: it publishes no other data; exactly one caller sees the change.
        !self.is_on_disk.swap(true, Ordering::Relaxed)
    }
}

/// The most recently used pieces, up to a number of bytes.
#[derive(Debug)]
pub(crate) struct Memory {
    most_bytes: usize,
    pieces: Mutex<Pieces>,
}

#[derive(Debug, Default)]
struct Pieces {
    clock: u64,
    bytes: usize,
    by_key: HashMap<Key, (u64, Arc<Piece>)>,
}

impl Memory {
    pub(crate) fn new(most_bytes: usize) -> Self {
        Self { most_bytes, pieces: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Pieces> {
        self.pieces.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn get(&self, key: &Key) -> Option<Arc<Piece>> {
        let mut pieces = self.lock();
        pieces.clock += 1;
        let clock = pieces.clock;
        let (used, piece) = pieces.by_key.get_mut(key)?;
        *used = clock;
        Some(Arc::clone(piece))
    }

    pub(crate) fn put(&self, key: &Key, piece: &Arc<Piece>) {
        let mut pieces = self.lock();
        pieces.clock += 1;
        let entry = (pieces.clock, Arc::clone(piece));
        pieces.bytes += piece.bytes.len();
        if let Some((_, old)) = pieces.by_key.insert(key.clone(), entry) {
            pieces.bytes -= old.bytes.len();
        }
        while pieces.bytes > self.most_bytes {
            // There are a few hundred pieces: a linear search costs less than to keep them sorted.
            let oldest = pieces.by_key.iter().min_by_key(|(_, (used, _))| *used).map(|(key, _)| key.clone());
            let Some((_, old)) = oldest.and_then(|key| pieces.by_key.remove(&key)) else { break };
            pieces.bytes -= old.bytes.len();
        }
    }

    pub(crate) fn remove(&self, key: &Key) {
        let mut pieces = self.lock();
        if let Some((_, old)) = pieces.by_key.remove(key) {
            pieces.bytes -= old.bytes.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pieces_used_last_stay_within_the_bound() {
        let memory = Memory::new(1000);
        let key = |n: u64| Key { file: "x", range: n..n + 300 };
        let piece = |n: u8| Arc::new(Piece::new(Bytes::from(vec![n; 300]), false));
        for n in 0..3 {
            memory.put(&key(n), &piece(n as u8));
        }
        assert!(memory.get(&key(0)).is_some());
        memory.put(&key(3), &piece(3));
        assert!(memory.get(&key(1)).is_none(), "unused for longest");
        assert!([0, 2, 3].into_iter().all(|n| memory.get(&key(n)).is_some_and(|p| p.bytes[0] == n as u8)));
        memory.put(&key(3), &piece(9));
        memory.remove(&key(0));
        let pieces = memory.lock();
        assert_eq!((pieces.bytes, pieces.by_key.len()), (600, 2));
    }

    #[test]
    fn a_piece_goes_to_disk_once() {
        let piece = Piece::new(Bytes::new(), false);
        assert!(piece.begin_keeping() && !piece.begin_keeping());
        assert!(!Piece::new(Bytes::new(), true).begin_keeping());
    }
}
