//! The id of a tile: a node of one of the two pyramids.

use super::Layer;
use crate::node::NodeId;

/// A tile of one of the two pyramids.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Tile {
    /// The pyramid.
    pub layer: Layer,
    /// The node.
    pub node: NodeId,
}

/// The bit of a packed tile that means colour. Packed nodes do not use it: levels are far below
/// 128.
const COLOR: u64 = 1 << 63;

impl Tile {
    /// The tile as one number, for shared memory: [`NodeId::pack`], with the highest bit set for
    /// colour.
    #[must_use]
    pub const fn pack(self) -> u64 {
        match self.layer {
            Layer::Elevation => self.node.pack(),
            Layer::Color => self.node.pack() | COLOR,
        }
    }

    /// The tile that [`Tile::pack`] packed; `None` for an invalid number (it may come from shared
    /// memory).
    #[must_use]
    pub const fn unpack(packed: u64) -> Option<Self> {
        let layer = if packed & COLOR == 0 { Layer::Elevation } else { Layer::Color };
        match NodeId::unpack(packed & !COLOR) {
            Some(node) => Some(Self { layer, node }),
            None => None,
        }
    }
}

impl std::fmt::Display for Tile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} tile {}", self.layer, self.node)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pack_and_unpack_are_inverse(packed: u64, is_color: bool) {
            if let Some(tile) = Tile::unpack(packed) {
                prop_assert_eq!(tile.pack(), packed);
            }
            if let Some(node) = NodeId::unpack(packed) {
                let tile = Tile { layer: if is_color { Layer::Color } else { Layer::Elevation }, node };
                prop_assert_eq!(Tile::unpack(tile.pack()), Some(tile));
            }
        }
    }
}
