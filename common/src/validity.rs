//! Validity: which ground was measured, which was made up, and where there are holes.
//!
//! A database whose sources have voids stores two shares for every post beside its height, 0 to 1:
//! how much of the area around the post is *ground* (the rest is a hole), and how much of it was
//! *measured* (the rest was made up: interpolated from its surroundings). Every post has a height,
//! so geometry and height ranges continue under holes, and no crack can open at the rim of a hole.
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
/// Index of the plane with shares of ground.
pub const GROUND_PLANE: usize = 1;
/// Index of the plane with shares of measured ground.
pub const MEASURED_PLANE: usize = 2;
/// Where the share of ground is less than this, there is a hole; where the share of measured ground
/// is less, the ground was made up.
pub const HALF: f32 = 0.5;

/// The validity of the ground at a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Validity {
    /// The sources have data there.
    Measured,
    /// The sources have no data there: the height was made up from its surroundings.
    MadeUp,
    /// There is no ground, although there is a height.
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
