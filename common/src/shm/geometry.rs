//! Where the items of a segment lie: computed in the same way by its creator and by those who open
//! it.

use super::kind::SegmentKind;
use crate::tree::{TreeHeader, TreeNode};

/// Bytes of a half of the ping-pong buffer that holds `nodes` nodes.
pub(crate) const fn half_bytes(nodes: u64) -> u64 {
    size_of::<TreeHeader>() as u64 + nodes * size_of::<TreeNode>() as u64
}

/// Offset of a segment's control words: the header comes before them.
pub(crate) const WORDS_OFFSET: u64 = 256;
/// Bytes of control words, without the tables of pools.
pub(crate) const WORDS_BYTES: u64 = 4096 - WORDS_OFFSET;
/// Bytes of an entry of a pool's table.
pub(crate) const TABLE_ENTRY_BYTES: u64 = 32;

/// Where the items of a segment lie. All offsets are from its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Geometry {
    pub(crate) kind: SegmentKind,
    /// Number of items.
    pub(crate) capacity: u64,
    /// Bytes of an item that are used.
    pub(crate) item_bytes: u64,
    /// Bytes from an item to the next.
    pub(crate) stride: u64,
    /// Offset of a pool's table; the items' offset in other segments.
    pub(crate) table_offset: u64,
    /// Offset of the first item.
    pub(crate) data_offset: u64,
    /// Bytes of the whole segment, a multiple of 4096.
    pub(crate) total_bytes: u64,
}

impl Geometry {
    /// The geometry of a segment that this program creates; its numbers are too small to overflow.
    pub(crate) fn new(kind: SegmentKind, capacity: u64, item_bytes: u64) -> Self {
        Self::checked(kind, capacity, item_bytes).unwrap_or(Self {
            kind,
            capacity,
            item_bytes,
            stride: item_bytes,
            table_offset: 0,
            data_offset: 0,
            // Never fits: creating this segment fails with "too little room".
            total_bytes: u64::MAX / 64,
        })
    }

    /// The geometry of a segment with this many items of this size; `None` for invalid numbers (a
    /// count that has to be a power of two and is not, or sizes that overflow). Numbers may come
    /// from a segment's header.
    pub(crate) fn checked(kind: SegmentKind, capacity: u64, item_bytes: u64) -> Option<Self> {
        let (align, has_table, is_ring) = match kind {
            SegmentKind::Control => (1, false, false),
            SegmentKind::PingPong => (4096, false, true),
            SegmentKind::ElevationRing | SegmentKind::StreamRing => (64, false, true),
            SegmentKind::ColorPool => (4096, true, false),
            SegmentKind::ElevationPool => (64, true, false),
            SegmentKind::WantList => (8, false, false),
            SegmentKind::VehicleTable => (128, false, true),
            _ => (8, false, true),
        };
        if capacity == 0 || capacity > 1 << 31 || item_bytes > 1 << 40 || (is_ring && !capacity.is_power_of_two()) {
            return None;
        }
        let stride = item_bytes.next_multiple_of(align);
        let table_offset = WORDS_OFFSET + WORDS_BYTES;
        let table_bytes = if has_table { capacity.checked_mul(TABLE_ENTRY_BYTES)? } else { 0 };
        let data_offset = table_offset.checked_add(table_bytes)?.checked_next_multiple_of(4096)?;
        let data_end = capacity.checked_mul(stride)?.checked_add(data_offset)?;
        let total_bytes = data_end.checked_next_multiple_of(4096)?;
        Some(Self { kind, capacity, item_bytes, stride, table_offset, data_offset, total_bytes })
    }
}
