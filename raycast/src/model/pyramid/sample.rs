//! The surface of the pyramid at single points: what the kernels of a sweep read for sixteen.

use super::{Pyramid, TileSource};
use glam::DVec2;
use terravision_common::surface::facet::facet_linear;

impl Pyramid {
    /// A plane of numbers at a lattice point over a tile, blended into the next level as heights are;
    /// heights are not exaggerated. `away2`: the square of the point's distance from the eye,
    /// metres²; `pool`: the whole pool. NaN where the pool does not have it.
    pub(crate) fn sample(&self, source: &TileSource, plane: usize, point: DVec2, away2: f32, pool: &[f32]) -> f32 {
        let corner = DVec2::from_array(source.origin.map(f64::from));
        let own = (point - corner) / f64::from(1u32 << source.level);
        let value = self.of_tile(source.first, plane, own, pool);
        let over = source.until2 - source.blend_from2;
        if !(over.is_finite() && over > 0.0 && away2 > source.blend_from2) {
            return value;
        }
        let share = ((away2 - source.blend_from2) / over).min(1.0);
        let next = DVec2::from_array(source.next_corner.map(f64::from)) + 0.5 * own;
        value + share * (self.of_tile(source.next_first, plane, next, pool) - value)
    }

    /// A plane of the tile that begins at `first` in the pool, at a place in its cells.
    fn of_tile(&self, first: u32, plane: usize, place: DVec2, pool: &[f32]) -> f32 {
        let cells = self.surface.cells();
        let place = place.clamp(DVec2::ZERO, DVec2::splat(f64::from(cells)));
        let [i, j] = [place.x, place.y].map(|at| (at as u32).min(cells - 1));
        let posts = cells as usize + 1;
        let south = first as usize + plane * posts * posts + j as usize * posts + i as usize;
        let (Some(&[sw, se]), Some(&[nw, ne])) =
            (pool.get(south..south + 2), pool.get(south + posts..south + posts + 2))
        else {
            return f32::NAN;
        };
        facet_linear(sw, se, nw, ne, (place.x - f64::from(i)) as f32, (place.y - f64::from(j)) as f32)
    }

    /// The lowest and the highest post of a source's tile and of the one that it is blended into,
    /// metres, exaggerated.
    pub(crate) fn range_of(&self, source: &TileSource) -> [f32; 2] {
        let [own, next] = self.kept_of(source).map(|kept| kept.range_m);
        [own[0].min(next[0]), own[1].max(next[1])].map(|height| height * self.shape.exaggeration)
    }

    /// Whether some of a source's ground may be a hole, or may have been filled.
    pub(crate) fn is_partly_unmeasured(&self, source: &TileSource) -> bool {
        self.kept_of(source).into_iter().any(|kept| kept.is_partly_unmeasured)
    }
}
