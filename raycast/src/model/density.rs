//! Density of the voxels of a column: 255 in the ground, 0 in the air, in between near the surface.
//! So the terrain is antialiased once, for all views (voxel-flythrough-1999 §3).

/// A density above this is ground.
pub const THRESHOLD: f32 = 127.5;

/// How densities are computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Filter {
    /// An oriented box: density falls linearly over [`BOX_HALF_WIDTH`] voxels to both sides of the
    /// surface, measured along its normal (Šrámek, Kaufman: "Alias-free voxelization of geometric
    /// objects", TVCG 1999). Keeps every height.
    #[default]
    OrientedBox,
    /// A three-dimensional Gaussian of [`SIGMA`] voxels. Rounds ridges and fills hollows of a voxel
    /// or two.
    Gaussian,
}

/// Half the width of the oriented box, voxels. Above 1, so that the transitions of neighbouring
/// columns overlap on any slope, and trilinear samples between them find the slope.
pub const BOX_HALF_WIDTH: f32 = 1.5;
/// Standard deviation of the Gaussian, voxels.
pub const SIGMA: f32 = 0.7;

impl Filter {
    /// How fast densities fall across a surface without cliffs, per voxel.
    #[must_use]
    pub(crate) fn fall(self) -> f32 {
        match self {
            Self::OrientedBox => THRESHOLD / BOX_HALF_WIDTH,
            // For a step: the height of the Gaussian.
            Self::Gaussian => 255.0 / (SIGMA * (2.0 * std::f32::consts::PI).sqrt()),
        }
    }

    /// Radius, in posts, of the neighbourhood that the densities of a column depend on.
    #[must_use]
    pub fn radius(self) -> usize {
        match self {
            Self::OrientedBox => 1,
            Self::Gaussian => 2,
        }
    }
}

/// A column and its neighbourhood: heights in voxels above the lowest layer.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeightColumn<'a> {
    /// Rows of heights, from south to north.
    pub(super) heights: &'a [f32],
    /// Heights from row to row.
    pub(super) stride: usize,
    /// The column's index in them.
    pub(super) at: usize,
}

impl HeightColumn<'_> {
    fn height(&self, east: isize, north: isize) -> f32 {
        self.heights[(self.at as isize + north * self.stride as isize + east) as usize]
    }

    /// Upward component of the surface's normal.
    pub(super) fn normal_up(&self) -> f32 {
        let east = 0.5 * (self.height(1, 0) - self.height(-1, 0));
        let north = 0.5 * (self.height(0, 1) - self.height(0, -1));
        1.0 / (1.0 + east * east + north * north).sqrt()
    }

    /// Fills a column of voxels, the lowest layer first.
    pub(super) fn fill(&self, filter: Filter, out: &mut [u8]) {
        match filter {
            Filter::OrientedBox => {
                let height = self.height(0, 0);
                let slope = THRESHOLD / BOX_HALF_WIDTH * self.normal_up();
                for (layer, out) in out.iter_mut().enumerate() {
                    // Rounds: the conversion itself truncates, and saturates out of range.
                    *out = (THRESHOLD + 0.5 + slope * (height - layer as f32)) as u8;
                }
            }
            Filter::Gaussian => self.fill_gaussian(out),
        }
    }

    fn fill_gaussian(&self, out: &mut [u8]) {
        let radius = Filter::Gaussian.radius() as isize;
        let weight = |offset: isize| (-0.5 * (offset as f32 / SIGMA).powi(2)).exp();
        let sum: f32 = (-radius..=radius).map(weight).sum();
        let mut sums = [0.0f32; 64];
        for (block, out) in out.chunks_mut(sums.len()).enumerate() {
            sums[..out.len()].fill(0.0);
            let lowest = (block * sums.len()) as f32;
            for north in -radius..=radius {
                for east in -radius..=radius {
                    let weight = weight(east) * weight(north) / (sum * sum);
                    let height = self.height(east, north);
                    for (layer, sum) in sums[..out.len()].iter_mut().enumerate() {
                        *sum += weight * step_response((height - lowest - layer as f32) / SIGMA);
                    }
                }
            }
            for (out, sum) in out.iter_mut().zip(&sums) {
                *out = (255.0 * sum + 0.5) as u8;
            }
        }
    }
}

/// A step filtered by a Gaussian of deviation 1: the logistic approximation of the normal
/// distribution function, off by 0.01 at most (Bowling et al., "A logistic approximation to the
/// cumulative normal distribution", 2009).
fn step_response(x: f32) -> f32 {
    1.0 / (1.0 + (-(1.5976 + 0.070_56 * x * x) * x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(east: f32, north: f32) -> Vec<f32> {
        (0..25).map(|k| 10.0 + east * (k % 5) as f32 + north * (k / 5) as f32).collect()
    }

    /// Height at which a column's density crosses the threshold.
    fn crossing(column: &[u8]) -> f32 {
        let below = column.iter().rposition(|&d| f32::from(d) > THRESHOLD).unwrap();
        let [a, b] = [column[below], column[below + 1]].map(f32::from);
        below as f32 + (a - THRESHOLD) / (a - b)
    }

    #[test]
    fn densities_fall_from_255_to_0_and_cross_the_threshold_at_the_surface() {
        for filter in [Filter::OrientedBox, Filter::Gaussian] {
            for (east, north) in [(0.0, 0.0), (0.3, -0.2), (2.5, 1.0)] {
                let heights = plane(east, north);
                let column = HeightColumn { heights: &heights, stride: 5, at: 12 };
                let mut out = [7u8; 40];
                column.fill(filter, &mut out);
                assert!(out.is_sorted_by(|a, b| a >= b), "{out:?}");
                assert_eq!((out[0], out[39]), (255, 0));
                let exact = heights[12];
                assert!((crossing(&out) - exact).abs() < 0.06, "{filter:?} {} {exact}", crossing(&out));
                assert!(out.iter().filter(|&&d| d > 0 && d < 255).count() >= 2, "antialiased: {out:?}");
            }
        }
    }

    #[test]
    fn the_gaussian_rounds_a_spike_and_the_box_keeps_it() {
        let mut heights = vec![10.0; 25];
        heights[12] = 14.0;
        let column = HeightColumn { heights: &heights, stride: 5, at: 12 };
        let found = [Filter::OrientedBox, Filter::Gaussian].map(|filter| {
            let mut out = [0u8; 30];
            column.fill(filter, &mut out);
            crossing(&out)
        });
        assert!((found[0] - 14.0).abs() < 0.05 && found[1] < 12.0, "{found:?}");
    }
}
