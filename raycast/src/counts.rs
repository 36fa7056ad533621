//! What was done for a picture.

use std::ops::Add;

/// What was done for a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Rays.
    pub rays: u64,
    /// Samples along rays.
    pub samples: u64,
    /// Samples whose density was interpolated.
    pub densities: u64,
    /// Rays without a witness: no ray below them proved that any part of them is in the air.
    pub without_witness: u64,
    /// Rays that had to check unproven intervals before the start that their witness gave them.
    pub partly_proven: u64,
    /// Steps back out of the ground.
    pub steps_back: u64,
    /// Rays that hit ground.
    pub hits: u64,
    /// How often rays passed below the ground's edge.
    pub under: u64,
}

impl Add for Counts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            rays: self.rays + other.rays,
            samples: self.samples + other.samples,
            densities: self.densities + other.densities,
            without_witness: self.without_witness + other.without_witness,
            partly_proven: self.partly_proven + other.partly_proven,
            steps_back: self.steps_back + other.steps_back,
            hits: self.hits + other.hits,
            under: self.under + other.under,
        }
    }
}
