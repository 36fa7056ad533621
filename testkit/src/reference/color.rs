//! The colour raster, averaged over a footprint.

use glam::DVec2;

/// RGB cells on a regular grid, with box-filtered halvings. Row 0 is the southern one. Averages are
/// taken of stored (gamma) values, as everywhere in the system.
#[derive(Debug, Clone)]
pub struct Colors {
    /// Easting and northing of the south west corner of the south west cell.
    origin: [f64; 2],
    texel_m: f64,
    mips: Vec<Mip>,
}

#[derive(Debug, Clone)]
struct Mip {
    width: usize,
    height: usize,
    rgb: Vec<[u8; 3]>,
}

/// Most taps along a footprint; longer ones are averaged from coarser halvings. Footprints this
/// thin occur on slopes that are seen nearly edge on, a few pixels in a picture.
const MOST_TAPS: f64 = 64.0;

impl Colors {
    /// A raster of `width` x `height` cells, `origin` the south west *corner*, rows from south to
    /// north.
    ///
    /// # Panics
    /// When `rgb` has another length, or no cell.
    #[must_use]
    pub fn new(width: usize, height: usize, origin: [f64; 2], texel_m: f64, rgb: Vec<[u8; 3]>) -> Self {
        assert!(width > 0 && height > 0 && rgb.len() == width * height, "a colour raster has width x height cells");
        let mut mips = vec![Mip { width, height, rgb }];
        while let Some(finer) = mips.last()
            && (finer.width > 1 || finer.height > 1)
        {
            let coarser = finer.halved();
            mips.push(coarser);
        }
        Self { origin, texel_m, mips }
    }

    /// Side of a cell, metres.
    #[must_use]
    pub fn texel_m(&self) -> f64 {
        self.texel_m
    }

    /// Colour of the cell that holds the point; cells at the border go on outside.
    #[must_use]
    pub fn nearest(&self, easting: f64, northing: f64) -> [u8; 3] {
        let mip = &self.mips[0];
        let p = self.texel(DVec2::new(easting, northing));
        mip.get(p.x.floor() as i64, p.y.floor() as i64)
    }

    fn texel(&self, p: DVec2) -> DVec2 {
        (p - DVec2::from_array(self.origin)) / self.texel_m
    }

    /// Average over the parallelogram of sides `across` and `along` (metres on the ground) around
    /// `centre`.
    ///
    /// Its Jacobian's singular values are the ellipse's axes; taps follow the long one, each tap
    /// trilinear at the halving whose cells are as wide as the short one.
    #[must_use]
    pub fn average(&self, centre: DVec2, across: DVec2, along: DVec2) -> [f64; 3] {
        let centre = self.texel(centre);
        let (a, b) = (across / self.texel_m, along / self.texel_m);
        // Singular values of [a b] from the 2x2 matrix J Jᵀ.
        let (xx, yy, xy) = (a.x * a.x + b.x * b.x, a.y * a.y + b.y * b.y, a.x * a.y + b.x * b.y);
        let mean = 0.5 * (xx + yy);
        let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        let long = (mean + spread).sqrt();
        let short = (mean - spread).max(0.0).sqrt().max(1.0).max(long / MOST_TAPS);
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let axis = DVec2::new(angle.cos(), angle.sin());
        let taps = (long / short).ceil().max(1.0);
        let lod = short.log2();
        let mut sum = [0.0; 3];
        for tap in 0..taps as usize {
            let offset = ((tap as f64 + 0.5) / taps - 0.5) * (long - short).max(0.0);
            let color = self.trilinear(centre + axis * offset, lod);
            for (sum, value) in sum.iter_mut().zip(color) {
                *sum += value;
            }
        }
        sum.map(|v| v / taps)
    }

    fn trilinear(&self, texel: DVec2, lod: f64) -> [f64; 3] {
        let lod = lod.clamp(0.0, (self.mips.len() - 1) as f64);
        let level = lod.floor();
        let fine = self.mips[level as usize].bilinear(texel * (-level).exp2());
        let fraction = lod - level;
        if fraction == 0.0 {
            return fine;
        }
        let coarse = self.mips[level as usize + 1].bilinear(texel * (-level - 1.0).exp2());
        std::array::from_fn(|c| fine[c] + (coarse[c] - fine[c]) * fraction)
    }
}

impl Mip {
    fn get(&self, x: i64, y: i64) -> [u8; 3] {
        let x = x.clamp(0, self.width as i64 - 1) as usize;
        let y = y.clamp(0, self.height as i64 - 1) as usize;
        self.rgb[y * self.width + x]
    }

    fn bilinear(&self, p: DVec2) -> [f64; 3] {
        let (x, y) = (p.x - 0.5, p.y - 0.5);
        let (i, j) = (x.floor(), y.floor());
        let (u, v) = (x - i, y - j);
        let (i, j) = (i as i64, j as i64);
        let corners = [self.get(i, j), self.get(i + 1, j), self.get(i, j + 1), self.get(i + 1, j + 1)];
        std::array::from_fn(|c| {
            let [sw, se, nw, ne] = corners.map(|corner| f64::from(corner[c]));
            (sw + (se - sw) * u) * (1.0 - v) + (nw + (ne - nw) * u) * v
        })
    }

    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut rgb = Vec::with_capacity(width * height);
        for y in 0..height {
            let rows = [2 * y, (2 * y + 1).min(self.height - 1)].map(|row| row * self.width);
            for x in 0..width {
                let columns = [2 * x, (2 * x + 1).min(self.width - 1)];
                rgb.push(std::array::from_fn(|c| {
                    let sum: u32 = rows.iter().flat_map(|r| columns.map(|x| u32::from(self.rgb[r + x][c]))).sum();
                    ((sum + 2) / 4) as u8
                }));
            }
        }
        Self { width, height, rgb }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stripes() -> Colors {
        let rgb = (0..64 * 64).map(|k| if (k % 64) % 2 == 0 { [0; 3] } else { [200; 3] }).collect();
        Colors::new(64, 64, [0.0, 0.0], 5.0, rgb)
    }

    #[test]
    fn a_point_between_cells_is_their_mean_and_a_small_footprint_does_not_blur() {
        let colors = stripes();
        let tiny = DVec2::splat(0.001);
        assert_eq!(colors.average(DVec2::new(7.5, 100.0), tiny, tiny), [200.0; 3]);
        assert_eq!(colors.average(DVec2::new(5.0, 100.0), tiny, tiny), [100.0; 3]);
        assert_eq!(colors.nearest(7.5, 100.0), [200; 3]);
    }

    #[test]
    fn a_footprint_across_the_stripes_averages_and_one_along_them_does_not() {
        let colors = stripes();
        let (x, y) = (DVec2::X, DVec2::Y);
        let across = colors.average(DVec2::new(157.5, 160.0), x * 80.0, y * 5.0);
        assert!((across[0] - 100.0).abs() < 10.0, "{across:?}");
        let along = colors.average(DVec2::new(157.5, 160.0), x * 0.1, y * 80.0);
        assert!(along[0] > 199.0, "{along:?}");
    }
}
