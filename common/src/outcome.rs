//! Outcomes of the tiles that the preparer wants, sent by the prefetcher.

use crate::database::Tile;
use crate::ids::{Sequence, SlotKey};
use bytemuck::{Pod, Zeroable};

/// The tile is in its pool.
const RESIDENT: u32 = 0;
/// Not a cause: the pool has no room.
const NO_ROOM: u32 = u32::MAX;

/// One outcome; 32 bytes. [`TileOutcome::read`] decodes and checks it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TileOutcome {
    /// [`Tile::pack`].
    tile: u64,
    /// 0: resident; the highest number: no room; otherwise the number of a [`TileFailure`].
    code: u32,
    /// Slot of the pool.
    slot: u32,
    /// Generation of the slot.
    generation: u32,
    reserved: u32,
    /// The completed sequence at that time.
    completed: u64,
}

const _: () = assert!(size_of::<TileOutcome>() == 32);

/// Why a tile cannot be read: the only list of causes, for outcomes, events, reports and metrics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum TileFailure {
    /// The database has no such tile.
    Missing = 1,
    /// It is damaged.
    Damaged = 2,
    /// It could not be read.
    Unreadable = 3,
    /// The server refuses it, and will do so again.
    Refused = 4,
    /// It is not in the disk cache, and the network must not be used.
    NotCached = 5,
}

impl TileFailure {
    /// All of them, by their numbers.
    pub const ALL: [Self; 5] = [Self::Missing, Self::Damaged, Self::Unreadable, Self::Refused, Self::NotCached];

    /// Its number, in outcomes and events.
    #[must_use]
    pub const fn number(self) -> u8 {
        self as u8
    }

    /// The failure with this number; `None` for an invalid number (it came from shared memory).
    #[must_use]
    pub fn from_number(number: u64) -> Option<Self> {
        Self::ALL.into_iter().find(|failure| u64::from(failure.number()) == number)
    }

    /// Its name in metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Missing => "missing",
            Self::Damaged => "corrupt",
            Self::Unreadable => "read_error",
            Self::Refused => "refused",
            Self::NotCached => "not_cached",
        }
    }

    /// In reports and messages: the tile is …
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Missing => "missing",
            Self::Damaged => "corrupt",
            Self::Unreadable => "read error",
            Self::Refused => "refused",
            Self::NotCached => "not in the cache",
        }
    }

    /// Whether the tile may arrive soon, when the server answers again: it could not be read, or
    /// arrived damaged. A server that has no such tile, or refuses it, will do so again.
    #[must_use]
    pub const fn may_pass(self) -> bool {
        matches!(self, Self::Damaged | Self::Unreadable)
    }
}

/// The outcome of a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is resident.
    Resident {
        /// Where it lies in its pool.
        key: SlotKey,
    },
    /// It cannot be read.
    Unavailable {
        /// Why.
        failure: TileFailure,
    },
    /// No tile of its layer finds room: uncompleted frames hold all slots, and no slot is being
    /// filled.
    NoRoom {
        /// [`crate::shm::Control::completed_sequence`] at that time: when it has grown, there may
        /// be room.
        completed: Sequence,
    },
}

impl TileOutcome {
    /// Encodes the outcome of a tile.
    #[must_use]
    pub fn new(tile: Tile, outcome: Outcome) -> Self {
        let record = Self { tile: tile.pack(), ..Self::zeroed() };
        match outcome {
            Outcome::Resident { key } => {
                Self { code: RESIDENT, slot: key.slot.get(), generation: key.generation.get(), ..record }
            }
            Outcome::Unavailable { failure } => Self { code: u32::from(failure.number()), ..record },
            Outcome::NoRoom { completed } => Self { code: NO_ROOM, completed: completed.get(), ..record },
        }
    }

    /// Decodes it; `None` when it is not valid (it came from shared memory). The reader has to
    /// check whether the slot holds the tile.
    #[must_use]
    pub fn read(&self) -> Option<(Tile, Outcome)> {
        let tile = Tile::unpack(self.tile)?;
        let outcome = match self.code {
            RESIDENT => Outcome::Resident { key: SlotKey::new(self.slot, self.generation) },
            NO_ROOM => Outcome::NoRoom { completed: Sequence::new(self.completed) },
            number => Outcome::Unavailable { failure: TileFailure::from_number(number.into())? },
        };
        Some((tile, outcome))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::database::Layer;
    use crate::node::NodeId;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_outcome_is_read_as_it_was_written(m in 0u32..100, number in 1u64..=5, slot: u32, generation: u32, completed: u64) {
            let tile = Tile { layer: Layer::Color, node: NodeId::new(m, 3, 2).unwrap() };
            for outcome in [
                Outcome::Resident { key: SlotKey::new(slot, generation) },
                Outcome::Unavailable { failure: TileFailure::from_number(number).unwrap() },
                Outcome::NoRoom { completed: Sequence::new(completed) },
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

    #[test]
    fn each_failure_has_a_number_and_a_name_of_its_own() {
        for failure in TileFailure::ALL {
            let has_name = |other: &&TileFailure| other.name() == failure.name() || other.words() == failure.words();
            assert_eq!(TileFailure::ALL.iter().filter(has_name).count(), 1);
            assert_eq!(TileFailure::from_number(failure.number().into()), Some(failure));
        }
        assert!([0, 6, 255, 256, u64::MAX].into_iter().all(|number| TileFailure::from_number(number).is_none()));
    }
}
