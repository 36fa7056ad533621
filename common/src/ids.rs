//! Numbers of the same width that must not be taken for one another, each a type of its own.
//!
//! A layout in shared memory keeps plain numbers; whoever writes or reads it converts, with `get`
//! and `new`. Nothing converts by itself.

use std::fmt;

macro_rules! number {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
        #[repr(transparent)]
        pub struct $name($inner);

        impl $name {
            /// From the number that a layout has.
            #[must_use]
            pub const fn new(number: $inner) -> Self {
                Self(number)
            }

            /// As the number that a layout has.
            #[must_use]
            pub const fn get(self) -> $inner {
                self.0
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, concat!(stringify!($name), "({})"), self.0)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

number! {
    /// Number of a frame: its place in the film, from 0. In real time frames are left out, so
    /// numbers have gaps.
    FrameNumber(u64)
}

number! {
    /// A frame's place among those of the run that are drawn, from 1, without gaps; 0 is before the
    /// first. Pools go by it: what frame `s` names stays until `s` is completed.
    Sequence(u64)
}

impl Sequence {
    /// Before the first frame: of what no frame wants.
    pub const NONE: Self = Self(0);
    /// Of the first frame.
    pub const FIRST: Self = Self(1);

    /// That of the next frame.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    /// So many frames later.
    #[must_use]
    pub const fn saturating_add(self, frames: u64) -> Self {
        Self(self.0.saturating_add(frames))
    }

    /// So many frames earlier, at most back to [`Sequence::NONE`].
    #[must_use]
    pub const fn saturating_sub(self, frames: u64) -> Self {
        Self(self.0.saturating_sub(frames))
    }
}

number! {
    /// Position of an item in a ring: counts up over all that was ever put in, so it is never used
    /// twice.
    RingPosition(u64)
}

number! {
    /// Index of a slot of a tile pool, from 0.
    SlotIndex(u32)
}

number! {
    /// How often a slot of a tile pool was filled: another tile in the slot, another generation. 0
    /// before the first.
    Generation(u32)
}

impl SlotIndex {
    /// As an index into a table in memory.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl Generation {
    /// Of a slot that was never filled.
    pub const NEVER_FILLED: Self = Self(0);

    /// The one after it; never [`Generation::NEVER_FILLED`].
    #[must_use]
    pub const fn next(self) -> Self {
        match self.0.wrapping_add(1) {
            0 => Self(1),
            next => Self(next),
        }
    }
}

/// Where a tile lies in its pool: a slot, and the generation that the slot must still have for the
/// tile to be in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SlotKey {
    /// The slot.
    pub slot: SlotIndex,
    /// Its generation.
    pub generation: Generation,
}

impl SlotKey {
    /// From the numbers that a layout has.
    #[must_use]
    pub const fn new(slot: u32, generation: u32) -> Self {
        Self { slot: SlotIndex(slot), generation: Generation(generation) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_generation_follows_that_is_the_one_of_an_empty_slot() {
        assert_eq!(Generation::NEVER_FILLED.next(), Generation::new(1));
        assert_eq!(Generation::new(7).next(), Generation::new(8));
        assert_eq!(Generation::new(u32::MAX).next(), Generation::new(1));
    }

    #[test]
    fn a_number_is_shown_as_it_is_and_debugged_with_its_type() {
        assert_eq!(
            (SlotIndex::new(3).to_string(), format!("{:?}", SlotIndex::new(3))),
            ("3".into(), "SlotIndex(3)".into())
        );
    }
}
