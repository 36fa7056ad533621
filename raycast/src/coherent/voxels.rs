//! Samples of the voxels of a tile.

use crate::model::{LOG_BLOCK, Span, THRESHOLD};
use glam::Vec3;

/// The tile that the rays of a line are in: neighbouring rays often share it.
#[derive(Clone, Copy)]
pub(crate) struct Current<'a> {
    pub(crate) index: u32,
    pub(crate) spans: &'a [Span],
    /// Heights of posts, metres above the ground's datum.
    pub(crate) heights: &'a [f32],
    pub(crate) densities: &'a [u8],
    pub(crate) blocks: &'a [u16],
    pub(crate) cells: [u32; 2],
    pub(crate) layers: usize,
    pub(crate) is_accurate: bool,
    pub(crate) per_m: f32,
    /// The eye's position in cells and layers.
    pub(crate) at_0: Vec3,
    /// The ground's datum in layers.
    pub(crate) datum: f32,
}

/// The whole part of a number, as an index and as a float. A negative number gives an index beyond
/// any cell count. A whole number may give the cell that ends there.
#[inline(always)]
pub(crate) fn cell(at: f32) -> (u32, f32) {
    // Adding 1.5 times 2^23 leaves no bits for fractions. A conversion would have to check for
    // numbers that do not fit.
    let rounded = (at - 0.5) + 12_582_912.0;
    (rounded.to_bits().wrapping_sub(0x4b40_0000), rounded - 12_582_912.0)
}

/// How fast [`Current::density_by_height`] falls per layer. Chosen so that up to a slope of 45
/// degrees it falls no faster across the surface than densities of voxels do.
const DENSITY_PER_LAYER: f32 = 60.0;

impl Current<'_> {
    /// Position of a point of a ray in cells and layers.
    #[inline(always)]
    pub(crate) fn at(&self, per_s: Vec3, s: f32) -> Vec3 {
        per_s * s + self.at_0
    }

    #[inline(always)]
    pub(crate) fn is_over(&self, at: Vec3) -> bool {
        cell(at.x).0 < self.cells[0] && cell(at.y).0 < self.cells[1]
    }

    /// The cell below a point, and its corner; `None` outside of the tile. `is_found`: the tree
    /// says that the point is over the tile, so that a difference is rounding, and the point is
    /// moved to the border.
    #[inline(always)]
    pub(crate) fn cell_at(&self, at: &mut Vec3, is_found: bool) -> Option<([u32; 2], [f32; 2])> {
        let [columns, rows] = self.cells;
        let ((mut i, mut low_u), (mut j, mut low_v)) = (cell(at.x), cell(at.y));
        if i >= columns || j >= rows {
            if !is_found {
                return None;
            }
            (at.x, at.y) = (at.x.clamp(0.0, columns as f32), at.y.clamp(0.0, rows as f32));
            (i, j) = ((at.x as u32).min(columns - 1), (at.y as u32).min(rows - 1));
            (low_u, low_v) = (i as f32, j as f32);
        }
        Some(([i, j], [low_u, low_v]))
    }

    /// Index of the block that holds a cell.
    #[inline(always)]
    pub(crate) fn block_of(&self, i: u32, j: u32) -> u32 {
        (j >> LOG_BLOCK) * self.cells[0].div_ceil(1 << LOG_BLOCK) + (i >> LOG_BLOCK)
    }

    /// Density at a point in the cell `(i, j)`, whose corner is `low`: of voxels, or by height.
    #[inline(always)]
    pub(crate) fn density_in(&self, cell: [u32; 2], low: [f32; 2], at: Vec3, has_voxels: bool) -> f32 {
        if has_voxels { self.density(cell, low, at) } else { self.density_by_height(cell, low, at) }
    }

    #[inline(always)]
    pub(crate) fn span(&self, i: u32, j: u32) -> Span {
        self.spans.get(j as usize * self.cells[0] as usize + i as usize).copied().unwrap_or_default()
    }

    /// Density at a point in the cell `(i, j)`, whose corner is `low`, of a tile without voxels:
    /// the threshold on the surface that is bilinear between the cell's posts, and linear in the
    /// height above it.
    #[inline(always)]
    pub(crate) fn density_by_height(&self, [i, j]: [u32; 2], low: [f32; 2], at: Vec3) -> f32 {
        let (fu, fv) = (at.x - low[0], at.y - low[1]);
        let south = j as usize * (self.cells[0] as usize + 1) + i as usize;
        let north = south + self.cells[0] as usize + 1;
        let pair = |at: usize| match self.heights.get(at..at + 2) {
            Some(&[west, east]) => west + (east - west) * fu,
            _ => f32::NEG_INFINITY,
        };
        let (south, north) = (pair(south), pair(north));
        let height = (south + (north - south) * fv) * self.per_m + self.datum;
        THRESHOLD + DENSITY_PER_LAYER * (height - at.z)
    }

    /// Trilinear density at a point in the cell `(i, j)`, whose corner is `low`.
    #[inline(always)]
    pub(crate) fn density(&self, [i, j]: [u32; 2], low: [f32; 2], at: Vec3) -> f32 {
        let height = at.z.clamp(0.0, (self.layers - 2) as f32 + 1.0);
        let (k, lower) = if height > 0.5 { cell(height) } else { (0, 0.0) };
        let (fu, fv, fk) = (at.x - low[0], at.y - low[1], height - lower);
        let row = (self.cells[0] as usize + 1) * self.layers;
        let south = j as usize * row + i as usize * self.layers + k as usize;
        let north = south + row;
        let pair = |at: usize| match self.densities.get(at..at + 2) {
            Some(&[low, high]) => (f32::from(low), f32::from(high)),
            _ => (0.0, 0.0),
        };
        let (sw, se, nw, ne) = (pair(south), pair(south + self.layers), pair(north), pair(north + self.layers));
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let low = lerp(lerp(sw.0, se.0, fu), lerp(nw.0, ne.0, fu), fv);
        let high = lerp(lerp(sw.1, se.1, fu), lerp(nw.1, ne.1, fu), fv);
        lerp(low, high, fk)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_parts_are_indices_and_negative_numbers_are_none() {
        for (at, expected) in [(0.0, 0), (0.2, 0), (0.999, 0), (1.001, 1), (700.4, 700), (511.5, 511)] {
            assert_eq!(cell(at), (expected, expected as f32), "{at}");
        }
        for whole in 1..600 {
            let (index, low) = cell(whole as f32);
            assert!((whole - 1..=whole).contains(&index) && low == index as f32);
        }
        for at in [-1e-3f32, -0.2, -0.5, -3.0, -1e6, -1e9, 1e9, f32::NAN, f32::INFINITY] {
            assert!(cell(at).0 > 1 << 22, "{at}");
        }
    }
}
