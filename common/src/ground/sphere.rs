//! Spheres that move along straight ways.

use super::tiles::{GroundScratch, GroundTiles};
use super::triangle::touch;
use super::{Answer, Interpolation, NoGround};
use crate::validity::Validity;
use glam::DVec3;

/// Where a sphere touches the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// The share of its way that it has gone, 0 to 1.
    pub share: f64,
    /// Where its centre is then, world coordinates.
    pub center: DVec3,
    /// The point of the ground that it touches, world coordinates.
    pub contact: DVec3,
    /// Unit vector out of the ground there: to the centre, or the ground's normal where the centre
    /// is in the ground.
    pub normal: DVec3,
}

impl GroundTiles<'_> {
    /// Where a sphere whose centre moves straight from one position to another touches the ground
    /// first, on its facets; `None` where it does not. A sphere that touches it, or is in it, from
    /// the beginning, touches it at share 0. A facet that is a hole at all its corners is not there.
    ///
    /// # Errors
    /// [`NoGround::Outside`] when an end is not over the world and nothing is touched before;
    /// [`NoGround::Unreadable`].
    pub fn sweep_sphere(
        &self,
        from: DVec3,
        to: DVec3,
        radius_m: f64,
        scratch: &mut GroundScratch,
    ) -> Result<Answer<Option<Touch>>, NoGround> {
        let surface = self.world.surface();
        let foot = surface.foot(from);
        match self.sample(foot, Interpolation::Facet, scratch) {
            Ok(Answer { found, is_finest }) if found.ground.validity != Validity::Hole => {
                let ground_m = found.ground.height_m;
                if surface.height_above(from, ground_m) < 0.0 {
                    let contact = surface.position(foot, ground_m);
                    let touch = Touch { share: 0.0, center: from, contact, normal: found.normal };
                    return Ok(Answer { found: Some(touch), is_finest });
                }
            }
            Err(NoGround::Unreadable) => return Err(NoGround::Unreadable),
            _ => {}
        }
        let way = self.way(from, to, radius_m);
        let descent = self.first_met(&way, scratch, |facet| {
            let (share, contact) = touch(facet.corners, way.way, radius_m).filter(|_| facet.has_ground)?;
            let up = (facet.corners[1] - facet.corners[0]).cross(facet.corners[2] - facet.corners[0]);
            Some((share, (contact, up)))
        })?;
        let found = descent.first.map(|(share, (contact, up))| {
            let center = way.way * share;
            // A sphere whose centre is on the ground is pushed out along the ground's normal.
            let normal = (center - contact).try_normalize().unwrap_or(up.normalize_or_zero());
            let contact = surface.of_straight(way.start + contact);
            let normal = surface.to_local(contact, normal);
            Touch { share, center: surface.of_straight(way.start + center), contact, normal }
        });
        match found {
            None if !(surface.is_over(from) && surface.is_over(to)) => Err(NoGround::Outside),
            found => Ok(Answer { found, is_finest: descent.is_finest }),
        }
    }
}
