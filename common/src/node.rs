//! The quad tree's node id.
//!
//! Two conventions hold everywhere: **level 0 is the finest**, and a node's origin is its **lower
//! left (south west) corner**. Public formats (tile pyramids numbered from the root, rows counted
//! from the north) are converted by the code that reads or writes them.

use std::fmt;

/// Highest level a [`NodeId`] can have. 2^24 nodes along a side at level 0 are more than any planet
/// needs at 1 cm.
pub const MAX_LEVEL: u8 = 24;

/// Node `(m, n, q)`: column `m` counted from the west, row `n` from the south, level `q` (0 is the
/// finest).
///
/// It covers the square of side `b·2^q` whose lower left corner is `(m·b·2^q, n·b·2^q)`, where `b`
/// is the side of a node of level 0.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId {
    q: u8,
    n: u32,
    m: u32,
}

impl NodeId {
    /// The node at column `m`, row `n`, level `q`; `None` when the level is above [`MAX_LEVEL`] or
    /// a coordinate does not fit in 28 bits (the packed form's limit).
    #[must_use]
    pub const fn new(m: u32, n: u32, q: u8) -> Option<Self> {
        if q > MAX_LEVEL || m >= 1 << 28 || n >= 1 << 28 { None } else { Some(Self { q, n, m }) }
    }

    /// The root of a tree of `levels` levels.
    #[must_use]
    pub const fn root(levels: u8) -> Self {
        Self { q: levels.saturating_sub(1), n: 0, m: 0 }
    }

    /// Column, counted from the west.
    #[must_use]
    pub const fn m(self) -> u32 {
        self.m
    }

    /// Row, counted from the south.
    #[must_use]
    pub const fn n(self) -> u32 {
        self.n
    }

    /// Level; 0 is the finest.
    #[must_use]
    pub const fn q(self) -> u8 {
        self.q
    }

    /// The node of the next coarser level that contains this one.
    #[must_use]
    pub const fn parent(self) -> Self {
        Self { q: self.q + 1, n: self.n >> 1, m: self.m >> 1 }
    }

    /// The ancestor at level `q`, or the node itself when `q` is its own level. `q` must not be
    /// finer than the node.
    #[must_use]
    pub const fn ancestor(self, q: u8) -> Self {
        debug_assert!(q >= self.q);
        let up = q - self.q;
        Self { q, n: self.n >> up, m: self.m >> up }
    }

    /// Child `(2m+i, 2n+j, q-1)`, with `i` and `j` the low two bits of `index` (0 = SW, 1 = SE, 2 =
    /// NW, 3 = NE); `None` at level 0.
    #[must_use]
    pub const fn child(self, index: u8) -> Option<Self> {
        if self.q == 0 {
            return None;
        }
        Some(Self { q: self.q - 1, n: 2 * self.n + ((index as u32 >> 1) & 1), m: 2 * self.m + (index as u32 & 1) })
    }

    /// The id as one number, for shared memory and hash keys: level in the top byte, then 28 bits
    /// of row and column.
    #[must_use]
    pub const fn pack(self) -> u64 {
        (self.q as u64) << 56 | (self.n as u64) << 28 | self.m as u64
    }

    /// The id that [`NodeId::pack`] packed; `None` for an invalid number (it may come from shared
    /// memory).
    #[must_use]
    pub const fn unpack(packed: u64) -> Option<Self> {
        let mask = (1 << 28) - 1;
        Self::new((packed & mask) as u32, ((packed >> 28) & mask) as u32, (packed >> 56) as u8)
    }
}

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "({}, {}, {})", self.m, self.n, self.q)
    }
}

impl fmt::Debug for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pack_and_unpack_are_inverse(m in 0u32..1 << 28, n in 0u32..1 << 28, q in 0u8..=MAX_LEVEL) {
            let node = NodeId::new(m, n, q).unwrap();
            prop_assert_eq!(NodeId::unpack(node.pack()), Some(node));
        }

        #[test]
        fn any_number_unpacks_to_an_id_or_to_none(packed: u64) {
            if let Some(node) = NodeId::unpack(packed) {
                prop_assert_eq!(node.pack(), packed);
            }
        }

        #[test]
        fn every_child_has_its_parent(m in 0u32..1 << 20, n in 0u32..1 << 20, q in 1u8..MAX_LEVEL, i in 0u8..4) {
            let node = NodeId::new(m, n, q).unwrap();
            let child = node.child(i).unwrap();
            prop_assert_eq!(child.parent(), node);
            prop_assert_eq!(child.ancestor(q), node);
        }
    }
}
