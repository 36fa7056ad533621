//! Aligned extents of an archive: small tiles are read with their neighbours.

use crate::cache::Key;
use crate::memory::Piece;
use bytes::{Bytes, BytesMut};
use std::ops::Range;
use std::sync::Arc;

/// Elevation tiles are read in aligned extents of this size: about 150 tiles.
pub(super) const EXTENT_BYTES: u64 = 32 << 10;

/// The aligned extents of a file that cover a range; the last one ends with the file.
pub(super) fn extents(file: &'static str, range: &Range<u64>, file_bytes: u64) -> Vec<Key> {
    let key = |number: u64| Key { file, range: number * EXTENT_BYTES..((number + 1) * EXTENT_BYTES).min(file_bytes) };
    (range.start / EXTENT_BYTES..range.end.div_ceil(EXTENT_BYTES)).map(key).collect()
}

/// The bytes of a range, from consecutive pieces that cover it.
pub(super) fn assemble(keys: &[Key], pieces: &[Arc<Piece>], range: &Range<u64>) -> Bytes {
    let part = |key: &Key, piece: &Piece| {
        let start = range.start.max(key.range.start) - key.range.start;
        let end = range.end.min(key.range.end) - key.range.start;
        piece.bytes.slice(start as usize..end as usize)
    };
    match (keys, pieces) {
        ([key], [piece]) => part(key, piece),
        _ => {
            let mut bytes = BytesMut::with_capacity((range.end - range.start) as usize);
            keys.iter().zip(pieces).for_each(|(key, piece)| bytes.extend_from_slice(&part(key, piece)));
            bytes.freeze()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn extents_cover_a_range_and_give_its_bytes(file_bytes in 1u64..200_000, a: prop::sample::Index, b: prop::sample::Index) {
            let (a, b) = (a.index(file_bytes as usize) as u64, b.index(file_bytes as usize) as u64);
            let range = a.min(b)..a.max(b) + 1;
            let keys = extents("x", &range, file_bytes);
            let byte = |at: u64| (at * 31 % 251) as u8;
            let piece = |key: &Key| Arc::new(Piece::new(key.range.clone().map(byte).collect(), false));
            let pieces: Vec<_> = keys.iter().map(piece).collect();
            prop_assert!(keys.iter().all(|key| key.range.end <= file_bytes && key.range.start % EXTENT_BYTES == 0));
            prop_assert_eq!(assemble(&keys, &pieces, &range), range.map(byte).collect::<Vec<_>>());
        }
    }
}
