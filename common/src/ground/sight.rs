//! Lines of sight.

use super::tiles::{GroundScratch, GroundTiles};
use super::triangle::crossing;
use super::{Answer, Interpolation, NoGround};
use crate::validity::Validity;
use glam::DVec3;

/// An end that is not as far above the ground as this, metres, counts as being that far above it: a
/// place on the ground can be seen, although it is part of what hides what is behind it. Heights in
/// tiles are exact to 1/128 m.
pub const NEAR_GROUND_M: f64 = 0.01;

/// Whether one place is seen from another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LineOfSight {
    /// No ground is between them.
    Visible,
    /// The ground hides it.
    Hidden {
        /// Where the line enters the ground first, world coordinates.
        at: DVec3,
        /// The same as a share of the line, 0 to 1.
        share: f64,
    },
}

/// Where an end of a line is with respect to the ground.
enum End {
    Below,
    /// Above it, where it was or a little higher.
    At(DVec3),
}

impl GroundTiles<'_> {
    /// Whether the straight line between two positions meets the ground, on its facets. Holes hide
    /// nothing.
    ///
    /// # Errors
    /// [`NoGround::Outside`] when an end is not over the world and no ground is met before;
    /// [`NoGround::Unreadable`].
    pub fn line_of_sight(
        &self,
        from: DVec3,
        to: DVec3,
        scratch: &mut GroundScratch,
    ) -> Result<Answer<LineOfSight>, NoGround> {
        let surface = self.world.surface();
        let is_over = surface.is_over(from) && surface.is_over(to);
        let (start, is_finest) = self.end(from, scratch)?;
        let End::At(start) = start else {
            return Ok(Answer { found: LineOfSight::Hidden { at: from, share: 0.0 }, is_finest });
        };
        let (end, is_end_finest) = match self.end(to, scratch)? {
            (End::At(end), is_finest) => (end, is_finest),
            // The line enters the ground before.
            (End::Below, is_finest) => (to, is_finest),
        };
        let way = self.way(start, end, 0.0);
        let mut looked = GroundScratch::default();
        let descent = self.first_met(&way, scratch, |facet| {
            let share = crossing(facet.corners, way.way).filter(|_| facet.has_ground)?;
            let at = surface.of_straight(way.start + way.way * share);
            self.is_ground(at, &mut looked).then_some((share, at))
        })?;
        let is_finest = is_finest && is_end_finest && descent.is_finest;
        match descent.first {
            Some((share, at)) => Ok(Answer { found: LineOfSight::Hidden { at, share }, is_finest }),
            None if is_over => Ok(Answer { found: LineOfSight::Visible, is_finest }),
            None => Err(NoGround::Outside),
        }
    }

    /// Where an end is; whether the tile there is the finest.
    fn end(&self, position: DVec3, scratch: &mut GroundScratch) -> Result<(End, bool), NoGround> {
        let surface = self.world.surface();
        let foot = surface.foot(position);
        let sample = match self.sample(foot, Interpolation::Facet, scratch) {
            Ok(sample) if sample.found.ground.validity != Validity::Hole => sample,
            Ok(sample) => return Ok((End::At(position), sample.is_finest)),
            Err(NoGround::Outside) => return Ok((End::At(position), true)),
            Err(error) => return Err(error),
        };
        let ground_m = sample.found.ground.height_m;
        let above_m = surface.height_above(position, ground_m);
        let end = match above_m {
            _ if above_m < -NEAR_GROUND_M => End::Below,
            _ if above_m < NEAR_GROUND_M => End::At(surface.position(foot, ground_m + NEAR_GROUND_M)),
            _ => End::At(position),
        };
        Ok((end, sample.is_finest))
    }

    /// Whether what a line meets at a position is ground, and neither a hole nor beside the world.
    fn is_ground(&self, position: DVec3, scratch: &mut GroundScratch) -> bool {
        // The cells of coarse tiles may reach beyond the world.
        if !self.world.has_validity() {
            return self.world.surface().is_over(position);
        }
        let foot = self.world.surface().foot(position);
        let sample = self.sample(foot, Interpolation::Facet, scratch);
        sample.is_ok_and(|sample| sample.found.ground.validity != Validity::Hole)
    }
}
