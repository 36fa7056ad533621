//! The edge of the ground as a sweep of heights in place draws it, for walls that go down from it.

use super::surface::Plane;
use crate::model::{Source, TileSource};
use crate::scene::JUST_INSIDE;
use glam::DVec2;
use terravision_common::validity::GROUND_PLANE;

/// An edge has fewer stretches. A bound on the loop that holds whatever rounding does.
const MOST_STRETCHES: u32 = 1 << 20;
/// How much further the way along an edge goes at least, lattice units.
const LEAST_WAY: f64 = 1e-6;
/// Share of a square without a tile after which it is looked again whether it is one at that distance.
const LOOKED_AGAIN: f64 = 1.0 / 16.0;

/// Ground along a stretch of a side of the world, linear between its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeStretch {
    /// From the side's south or west end, metres.
    pub ends_m: [f64; 2],
    /// Metres above the eye.
    pub heights_m: [f64; 2],
    /// Shares of ground ([`terravision_common::validity`]); 1 in a world without.
    pub ground: [f32; 2],
}

impl Plane<'_> {
    /// The edge of the ground along the west, east, south or north side (0 to 3).
    pub(super) fn edge(&self, side: usize, has_validity: bool, put: &mut dyn FnMut(EdgeStretch)) {
        let shape = self.scene.ground.shape();
        let (unit_m, cells) = (shape.surface.unit_m(), shape.surface.cells());
        let end = self.scene.ground.end().map(|end| f64::from(end) - JUST_INSIDE);
        let (across, along) = (side / 2, 1 - side / 2);
        let beside = if side.is_multiple_of(2) { 0.0 } else { end[across] };
        let point = |at: f64| if along == 0 { DVec2::new(at, beside) } else { DVec2::new(beside, at) };
        let mut at = 0.0;
        for _ in 0..MOST_STRETCHES {
            if at >= end[along] {
                return;
            }
            let (source, _, _) = self.seen_at(point(at));
            let Source::Tile(source) = source else {
                let Source::Hole { corner, log, until2 } = source else { return };
                let side = (1u64 << log) as f64;
                let end = f64::from(corner[along]) + side;
                // Far parts of a square without a tile have that of the level above.
                let next = if until2.is_finite() { end.min(at + side * LOOKED_AGAIN) } else { end };
                at = next.max(at + LEAST_WAY);
                continue;
            };
            let next = next_edge(at, beside, f64::from(1u32 << source.level));
            // What lies behind the tile's end is another tile's.
            let tile_end = f64::from(source.origin[along]) + (u64::from(cells) << source.level) as f64;
            let next = next.min(tile_end).min(end[along]).max(at + LEAST_WAY);
            let ends = [at, next].map(|at| self.on(&source, point(at), has_validity));
            put(EdgeStretch {
                ends_m: [at, next].map(|at| at * unit_m),
                heights_m: ends.map(|(height, _)| height),
                ground: ends.map(|(_, ground)| ground),
            });
            at = next;
        }
    }

    /// Height above the eye, metres, and share of ground of a point by a tile that it is over.
    fn on(&self, source: &TileSource, point: DVec2, has_validity: bool) -> (f64, f32) {
        let (_, _, away2) = self.seen_at(point);
        let sample = |plane| self.pyramid.sample(source, plane, point, away2, self.scene.heights);
        let height = sample(0) * self.pyramid.exaggeration() - self.scene.eye_height;
        (f64::from(height), if has_validity { sample(GROUND_PLANE) } else { 1.0 })
    }
}

/// The next edge of a facet along a line of the lattice, `beside` away from the other axis, by
/// cells of this size: between two cells, or their diagonal.
fn next_edge(at: f64, beside: f64, cell: f64) -> f64 {
    let begin = (at / cell).floor();
    let diagonal = begin + (beside / cell).fract();
    let next = if diagonal * cell > at + LEAST_WAY { diagonal } else { begin + 1.0 };
    next * cell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_goes_from_cell_to_cell_and_over_their_diagonals() {
        assert_eq!([next_edge(0.0, 0.0, 4.0), next_edge(4.0, 0.0, 4.0), next_edge(5.0, 0.0, 4.0)], [4.0, 8.0, 8.0]);
        // A line that cuts cells at a quarter.
        assert_eq!([next_edge(0.0, 9.0, 4.0), next_edge(1.0, 9.0, 4.0), next_edge(4.0, 9.0, 4.0)], [1.0, 4.0, 5.0]);
    }
}
