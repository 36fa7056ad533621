//! What the draws of a frame cost, as measured.

use crate::gpu::MOST_PIECES;
use terravision_common::run::TechniqueChoice;

/// What one draw of a frame cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrawCost {
    /// What drew.
    pub technique: TechniqueChoice,
    /// Which view of the frame, from 0.
    pub view: usize,
    /// How many tiles.
    pub tiles: u32,
    /// Their triangles; 0 of rays.
    pub triangles: u64,
    /// Time by the device's own clock, or of all processor cores together where they draw; `None`
    /// where a device has no clock.
    pub nanos: Option<u64>,
}

/// Of all draws of a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DrawCosts {
    costs: [Option<DrawCost>; MOST_PIECES],
}

impl DrawCosts {
    /// Adds a draw's; more than a frame can have are passed over.
    pub(super) fn push(&mut self, cost: DrawCost) {
        if let Some(free) = self.costs.iter_mut().find(|place| place.is_none()) {
            *free = Some(cost);
        }
    }

    /// Each draw's, in the order of drawing.
    pub fn iter(&self) -> impl Iterator<Item = &DrawCost> {
        self.costs.iter().flatten()
    }

    /// The same, to be completed.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = &mut DrawCost> {
        self.costs.iter_mut().flatten()
    }

    /// Triangles of all draws.
    #[must_use]
    pub fn triangles(&self) -> u64 {
        self.iter().map(|cost| cost.triangles).sum()
    }
}
