//! Heights and normals.

use super::tiles::{GroundScratch, GroundTiles, TileAt};
use super::{Answer, NoGround};
use crate::surface::tile::{GroundPoint, Interpolation, node_ground_with_slope};
use glam::{DVec2, DVec3};

/// The ground at a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundSample {
    /// Height and validity.
    pub ground: GroundPoint,
    /// The unit normal: east, north and up in the local frame of the foot.
    pub normal: DVec3,
}

impl GroundTiles<'_> {
    /// The ground at a foot, from the finest level that exists there.
    ///
    /// # Errors
    /// [`NoGround`]. A foot that is not a number is outside.
    pub fn sample(
        &self,
        foot: DVec2,
        interpolation: Interpolation,
        scratch: &mut GroundScratch,
    ) -> Result<Answer<GroundSample>, NoGround> {
        self.sample_from(foot, self.world.finest_elevation_level(), interpolation, scratch)
    }

    /// [`GroundTiles::sample`] from tiles of `level` or coarser ones.
    ///
    /// # Errors
    /// [`NoGround`].
    pub fn sample_from(
        &self,
        foot: DVec2,
        level: u8,
        interpolation: Interpolation,
        scratch: &mut GroundScratch,
    ) -> Result<Answer<GroundSample>, NoGround> {
        if !self.world.surface().holds(foot) {
            return Err(NoGround::Outside);
        }
        let tile = self.tile_at(foot, level, scratch).ok_or(NoGround::Unreadable)?;
        Ok(self.sample_of(&tile, foot, interpolation))
    }

    /// The ground at each of many feet, appended to `answers` in their order. Tiles are visited one
    /// after the other, so that each is read once, wherever the feet lie.
    pub fn sample_all(
        &self,
        feet: &[DVec2],
        interpolation: Interpolation,
        scratch: &mut GroundScratch,
        answers: &mut Vec<Result<Answer<GroundSample>, NoGround>>,
    ) {
        let (surface, level) = (self.world.surface(), self.world.finest_elevation_level());
        let first = answers.len();
        answers.resize(first + feet.len(), Err(NoGround::Outside));
        let mut order = std::mem::take(&mut scratch.order);
        order.clear();
        order.extend((0u32..).zip(feet).filter(|(_, foot)| surface.holds(**foot)).filter_map(|(at, foot)| {
            let node = surface.node_at(*foot, level)?;
            Some((node.pack(), at))
        }));
        order.sort_unstable();
        for group in order.chunk_by(|a, b| a.0 == b.0) {
            let foot_of = |at: u32| feet[at as usize];
            let tile = self.tile_at(foot_of(group[0].1), level, scratch);
            for (_, at) in group {
                answers[first + *at as usize] = match &tile {
                    Some(tile) => Ok(self.sample_of(tile, foot_of(*at), interpolation)),
                    None => Err(NoGround::Unreadable),
                };
            }
        }
        scratch.order = order;
    }

    fn sample_of(&self, tile: &TileAt, foot: DVec2, interpolation: Interpolation) -> Answer<GroundSample> {
        let surface = self.world.surface();
        let found = node_ground_with_slope(surface, tile.node, &tile.values, foot, interpolation);
        let normal = surface.normal(foot, tile.node, found.slope);
        Answer { found: GroundSample { ground: found.ground, normal }, is_finest: tile.is_finest }
    }
}
