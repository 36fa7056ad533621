//! What became of the tiles that the preparer wants, as it travels from the prefetcher to the preparer.

use crate::database::{Layer, Tile};
use crate::ids::SlotKey;
use bytemuck::{Pod, Zeroable};

/// The tile is in its pool.
const RESIDENT: u32 = 0;
/// Not a cause, but that the pool has no room.
const NO_ROOM: u32 = u32::MAX;

/// One outcome; 32 bytes. [`TileOutcome::read`] says what it means, and whether it can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TileOutcome {
    /// [`Tile::pack`].
    tile: u64,
    /// 0 resident, else a cause; the highest number for no room.
    code: u32,
    /// Slot of the pool.
    slot: u32,
    /// Generation of the slot.
    generation: u32,
    reserved: u32,
    /// The completed sequence that was seen.
    completed: u64,
}

const _: () = assert!(size_of::<TileOutcome>() == 32);

/// What became of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It can be read.
    Resident {
        /// Where it lies in its pool.
        key: SlotKey,
    },
    /// It cannot be had.
    Unavailable {
        /// Why: 1 missing, 2 corrupt, 3 cannot be read, 4 refused, 5 not in the cache.
        code: u8,
    },
    /// No tile of its layer finds room: frames that are not completed hold all slots, and none is being filled.
    NoRoom {
        /// [`crate::shm::Control::completed_sequence`] as it was then: after a later one there may be room.
        completed: u64,
    },
}

impl TileOutcome {
    /// The outcome of a tile.
    #[must_use]
    pub fn new(tile: Tile, outcome: Outcome) -> Self {
        let record = Self { tile: tile.pack(), ..Self::zeroed() };
        match outcome {
            Outcome::Resident { key } => {
                Self { code: RESIDENT, slot: key.slot.get(), generation: key.generation.get(), ..record }
            }
            Outcome::Unavailable { code } => Self { code: u32::from(code).max(1), ..record },
            Outcome::NoRoom { completed } => Self { code: NO_ROOM, completed, ..record },
        }
    }

    /// What it says; `None` when it says nothing that can be (it came from shared memory). Whether the slot holds the
    /// tile is for the reader to check.
    #[must_use]
    pub fn read(&self) -> Option<(Tile, Outcome)> {
        let tile = Tile::unpack(self.tile)?;
        let outcome = match self.code {
            RESIDENT => Outcome::Resident { key: SlotKey::new(self.slot, self.generation) },
            NO_ROOM => Outcome::NoRoom { completed: self.completed },
            code => Outcome::Unavailable { code: u8::try_from(code).ok()? },
        };
        Some((tile, outcome))
    }
}

/// Whether a tile that could not be had for this cause may come soon, when the server answers again: it could not be read, or what
/// came was damaged. A server that has no such tile, or refuses it, will do so again.
#[must_use]
pub const fn may_come(code: u8) -> bool {
    matches!(code, 2 | 3)
}

/// The number of a layer in events: 0 elevation, 1 colour.
#[must_use]
pub const fn layer_number(layer: Layer) -> u64 {
    match layer {
        Layer::Elevation => 0,
        Layer::Color => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::NodeId;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_outcome_is_read_as_it_was_written(m in 0u32..100, code in 1u8.., slot: u32, generation: u32, completed: u64) {
            let tile = Tile { layer: Layer::Color, node: NodeId::new(m, 3, 2).unwrap() };
            for outcome in [
                Outcome::Resident { key: SlotKey::new(slot, generation) },
                Outcome::Unavailable { code },
                Outcome::NoRoom { completed },
            ] {
                prop_assert_eq!(TileOutcome::new(tile, outcome).read(), Some((tile, outcome)));
            }
        }

        #[test]
        fn any_bytes_are_an_outcome_or_none(bytes in prop::array::uniform32(any::<u8>())) {
            let record: TileOutcome = bytemuck::cast(bytes);
            if let Some((tile, outcome)) = record.read() {
                let (tile_again, outcome_again) = TileOutcome::new(tile, outcome).read().unwrap();
                prop_assert_eq!((tile_again, outcome_again), (tile, outcome));
            }
        }
    }
}
