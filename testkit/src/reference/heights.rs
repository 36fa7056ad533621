//! The height field, and the pyramid of maxima that lets a ray skip what it cannot touch.

/// Elevation posts on a regular grid. Row 0 is the southern one; the posts are the corners of
/// bilinear cells.
#[derive(Debug, Clone)]
pub struct Heights {
    columns: usize,
    rows: usize,
    origin: [f64; 2],
    spacing_m: f64,
    values: Vec<f32>,
    /// `maxima[k]`: the highest post of each block of 2^k x 2^k cells (their borders included).
    maxima: Vec<Grid>,
}

#[derive(Debug, Clone)]
struct Grid {
    columns: usize,
    rows: usize,
    values: Vec<f32>,
}

impl Heights {
    /// A height field of `columns` x `rows` posts, the south west one at `origin` (easting,
    /// northing), heights in metres, rows from south to north.
    ///
    /// # Panics
    /// When there are fewer than 2 x 2 posts or `values` has another length.
    #[must_use]
    pub fn new(columns: usize, rows: usize, origin: [f64; 2], spacing_m: f64, values: Vec<f32>) -> Self {
        assert!(columns >= 2 && rows >= 2 && values.len() == columns * rows, "a height field has at least 2 x 2 posts");
        let mut heights = Self { columns, rows, origin, spacing_m, values, maxima: Vec::new() };
        heights.maxima.push(heights.cell_maxima());
        while let Some(finer) = heights.maxima.last()
            && (finer.columns > 1 || finer.rows > 1)
        {
            let coarser = finer.halved();
            heights.maxima.push(coarser);
        }
        heights
    }

    fn cell_maxima(&self) -> Grid {
        let (columns, rows) = (self.columns - 1, self.rows - 1);
        let mut values = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let [a, b, c, d] = self.corners(i, j);
                values.push(a.max(b).max(c).max(d) as f32);
            }
        }
        Grid { columns, rows, values }
    }

    /// Heights at the corners of cell `(i, j)`: south west, south east, north west, north east.
    pub(super) fn corners(&self, i: usize, j: usize) -> [f64; 4] {
        let south = j * self.columns + i;
        let north = south + self.columns;
        [self.values[south], self.values[south + 1], self.values[north], self.values[north + 1]].map(f64::from)
    }

    /// Highest post of block `(i, j)` of 2^level cells a side.
    pub(super) fn maximum(&self, level: usize, i: usize, j: usize) -> f64 {
        let grid = &self.maxima[level];
        f64::from(grid.values[j * grid.columns + i])
    }

    pub(super) fn coarsest_level(&self) -> usize {
        self.maxima.len() - 1
    }

    /// Number of cells east and north.
    #[must_use]
    pub fn cells(&self) -> [usize; 2] {
        [self.columns - 1, self.rows - 1]
    }

    /// Distance of two posts, metres.
    #[must_use]
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Easting and northing of the south west post.
    #[must_use]
    pub fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Side lengths in metres, east and north.
    #[must_use]
    pub fn extent_m(&self) -> [f64; 2] {
        [self.columns as f64 - 1.0, self.rows as f64 - 1.0].map(|n| n * self.spacing_m)
    }

    /// All posts, rows from south to north.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Bilinear height at a point of the CRS; `None` outside.
    #[must_use]
    pub fn at(&self, easting: f64, northing: f64) -> Option<f64> {
        let u = (easting - self.origin[0]) / self.spacing_m;
        let v = (northing - self.origin[1]) / self.spacing_m;
        let [columns, rows] = self.cells();
        if !(0.0..=columns as f64).contains(&u) || !(0.0..=rows as f64).contains(&v) {
            return None;
        }
        let (i, j) = ((u as usize).min(columns - 1), (v as usize).min(rows - 1));
        let (u, v) = (u - i as f64, v - j as f64);
        let [a, b, c, d] = self.corners(i, j);
        Some((a + (b - a) * u) * (1.0 - v) + (c + (d - c) * u) * v)
    }
}

impl Grid {
    fn halved(&self) -> Self {
        let (columns, rows) = (self.columns.div_ceil(2), self.rows.div_ceil(2));
        let mut values = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let mut highest = f32::NEG_INFINITY;
                for row in 2 * j..(2 * j + 2).min(self.rows) {
                    for column in 2 * i..(2 * i + 2).min(self.columns) {
                        highest = highest.max(self.values[row * self.columns + column]);
                    }
                }
                values.push(highest);
            }
        }
        Self { columns, rows, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_bilinear_between_posts_and_nothing_outside() {
        let heights = Heights::new(3, 2, [100.0, 200.0], 10.0, vec![0.0, 10.0, 20.0, 5.0, 15.0, 25.0]);
        assert_eq!(heights.at(100.0, 200.0), Some(0.0));
        assert_eq!(heights.at(115.0, 205.0), Some(17.5));
        assert_eq!(heights.at(120.0, 210.0), Some(25.0));
        assert_eq!(heights.at(120.1, 210.0), None);
        assert_eq!(heights.maximum(heights.coarsest_level(), 0, 0), 25.0);
    }
}
