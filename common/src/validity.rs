//! Which ground was measured, which was made up, and where there is none.
//!
//! A database whose sources have voids keeps two shares for every post beside its height, 0 to 1:
//! how much of the ground around the post is *ground* (the rest is a hole), and how much of it was
//! *measured* (the rest was made up from around it). Heights are there in any case, so geometry and
//! height ranges go on under holes, and no crack can open at a hole's rim.
//!
//! Tiles and elevation arrays of such a world have three planes of `(Nz + 1)²` numbers, one behind
//! the other:
//!
//! ```text
//! heights, metres | share of ground | share that was measured
//! ```
//!
//! On the finest level shares are 0 or 1. Shares of a coarser level are `[1, 2, 1]` filtered, as
//! smooth as what is drawn of them, so that a hole's rim keeps its place from level to level, and
//! holes narrower than the posts' distance fade. Shares are interpolated as heights are: between
//! levels with the same weights, then linearly over the facet. A point is in a hole, or was made
//! up, where the share is below [`HALF`].

/// Planes of elevation in a world with validity.
pub const PLANES: usize = 3;
/// Which plane has shares of ground.
pub const GROUND_PLANE: usize = 1;
/// Which plane has shares of measured ground.
pub const MEASURED_PLANE: usize = 2;
/// Where the share of ground is less, there is no ground; where the share that was measured is
/// less, it was made up.
pub const HALF: f32 = 0.5;

/// What is known of the ground at a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Validity {
    /// The sources have data there.
    Measured,
    /// They have none: the height was made up from around it.
    MadeUp,
    /// There is no ground, whatever the height.
    Hole,
}

impl Validity {
    /// From the shares of ground and of measured ground at a point.
    #[must_use]
    pub fn of_shares(ground: f64, measured: f64) -> Self {
        match (ground < f64::from(HALF), measured < f64::from(HALF)) {
            (true, _) => Self::Hole,
            (false, true) => Self::MadeUp,
            (false, false) => Self::Measured,
        }
    }
}
