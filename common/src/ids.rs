//! Newtypes for numbers of the same width that must not be mixed up.
//!
//! Layouts in shared memory contain plain numbers; readers and writers convert explicitly, with
//! `new` and `get`.

use std::fmt;

macro_rules! number {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
        #[repr(transparent)]
        pub struct $name($inner);

        impl $name {
            /// From the number in a layout.
            #[must_use]
            pub const fn new(number: $inner) -> Self {
                Self(number)
            }

            /// The number for a layout.
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

impl FrameNumber {
    /// The one after it.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    /// How many frames it is after another one; `None` when it is before it.
    #[must_use]
    pub const fn since(self, first: Self) -> Option<u64> {
        self.0.checked_sub(first.0)
    }
}

number! {
    /// A frame's place among those of the run that are drawn, from 1, without gaps; 0 is before the
    /// first. Pools go by it: what frame `s` names stays until `s` is completed.
    Sequence(u64)
}

impl Sequence {
    /// Before the first frame: for tiles that no frame wants.
    pub const NONE: Self = Self(0);
    /// The first frame.
    pub const FIRST: Self = Self(1);

    /// The sequence of the next frame.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    /// This many frames later.
    #[must_use]
    pub const fn saturating_add(self, frames: u64) -> Self {
        Self(self.0.saturating_add(frames))
    }

    /// This many frames earlier, at most back to [`Sequence::NONE`].
    #[must_use]
    pub const fn saturating_sub(self, frames: u64) -> Self {
        Self(self.0.saturating_sub(frames))
    }
}

number! {
    /// Position of an item in a ring: counts all items ever written, so that it is never reused.
    RingPosition(u64)
}

number! {
    /// Index of a slot of a tile pool, from 0.
    SlotIndex(u32)
}

number! {
    /// How often a slot of a tile pool was filled: every tile in the slot has another generation. 0
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
    /// The generation of a slot that was never filled.
    pub const NEVER_FILLED: Self = Self(0);

    /// The next generation; never [`Generation::NEVER_FILLED`].
    #[must_use]
    pub const fn next(self) -> Self {
        match self.0.wrapping_add(1) {
            0 => Self(1),
            next => Self(next),
        }
    }
}

/// The place of a tile in its pool: a slot, and the generation that the slot must still have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SlotKey {
    /// The slot.
    pub slot: SlotIndex,
    /// Its generation.
    pub generation: Generation,
}

impl SlotKey {
    /// From the numbers in a layout.
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
