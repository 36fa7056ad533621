//! Questions to the ground of a world: heights and normals, lines of sight, swept spheres.
//!
//! [`GroundTiles`] has the tiles that questions are answered from, as many as fit its bound, for
//! any number of threads; each thread has a [`GroundScratch`]. Every question is answered from the
//! finest level that exists at a place, on the facets that are drawn at close range, or bilinearly
//! where that is asked for ([`Interpolation`]). Where a tile cannot be read, the next coarser one is
//! taken, as it is drawn then, and the answer says so.
//!
//! A foot is a point of the surface without a height, a position has one, both in world coordinates
//! ([`crate::surface`]); heights are not exaggerated.

mod cache;
mod descent;
mod point;
mod sample;
mod sight;
mod sphere;
mod tiles;
mod triangle;

pub use crate::surface::tile::Interpolation;
pub use point::{ground_at, ground_height};
pub use sample::GroundSample;
pub use sight::{LineOfSight, NEAR_GROUND_M};
pub use sphere::Touch;
pub use tiles::{GroundScratch, GroundTiles};

/// Why a question has no answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoGround {
    /// The place is not over the world.
    #[error("the place is outside of the world")]
    Outside,
    /// No tile of it can be read, not even a coarse one.
    #[error("no tile can be read there")]
    Unreadable,
}

/// An answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer<T> {
    /// What was found.
    pub found: T,
    /// Whether all tiles that it depends on are the finest that exist there: `false` where one
    /// could not be read and a coarser one was taken.
    pub is_finest: bool,
}
