//! Maps the samples of a target block to positions in a source.
//!
//! Transforming every sample is slow: positions are transformed on a coarse grid and interpolated
//! between, as GDAL's approximate transformer does, where that is good to a hundredth of a pixel;
//! else each is transformed.

use crate::error::{IngestError, gdal_message};
use crate::plan::Lattice;
use crate::source::{Raster, TargetCrs};
use crate::store::Rect;
use gdal::spatial_ref::CoordTransform;

/// Samples between two nodes of the coarse grid.
const STEP: usize = 16;
/// Allowed error of interpolation, pixels.
const TOLERANCE_PX: f64 = 0.01;

/// Maps target samples into one source.
#[derive(Debug)]
pub struct Mapper {
    transform: Option<CoordTransform>,
    /// From the source's CRS to pixel positions, corners whole.
    inverse: [f64; 6],
    size: [f64; 2],
    /// Pixels around the body, for a source in degrees that may be entered from either side.
    period: Option<f64>,
}

impl Mapper {
    /// A mapper for a source.
    ///
    /// # Errors
    /// [`IngestError::Source`] when no transformation exists between the two systems.
    pub fn new(target: &TargetCrs, raster: &Raster) -> Result<Self, IngestError> {
        let transform = if target.is_of(raster) {
            None
        } else {
            let (from, to) = (target.srs()?, raster.srs()?);
            let transform = CoordTransform::new(&from, &to).map_err(|e| {
                let reason = format!("cannot be brought to {}: {}", target.crs().name, gdal_message(&e));
                IngestError::source(raster.path(), reason)
            })?;
            Some(transform)
        };
        let inverse =
            raster.affine().inverse().ok_or_else(|| IngestError::source(raster.path(), "has pixels without area"))?;
        let size = raster.size().map(|v| v as f64);
        let turn = 360.0 / raster.affine().0[1].abs();
        let period = (raster.is_geographic() && raster.affine().is_axis_parallel()).then_some(turn);
        Ok(Self { transform, inverse: inverse.0, size, period })
    }

    /// Pixel positions (centres whole) of points in the database's CRS; not finite where they
    /// cannot be transformed.
    fn positions(&self, mut x: Vec<f64>, mut y: Vec<f64>) -> (Vec<f64>, Vec<f64>) {
        if let Some(transform) = &self.transform {
            // Points that cannot be transformed come back infinite, which is sufficient here.
            transform.transform_coords(&mut x, &mut y, &mut []).ok();
        }
        let c = &self.inverse;
        for (x, y) in x.iter_mut().zip(&mut y) {
            let (column, row) = (c[0] + c[1] * *x + c[2] * *y - 0.5, c[3] + c[4] * *x + c[5] * *y - 0.5);
            (*x, *y) = (column, row);
        }
        (x, y)
    }

    /// The size of a lattice step in source pixels, along columns and rows, at a target point.
    #[must_use]
    pub fn scale_at(&self, [x, y]: [f64; 2], step: f64) -> [f64; 2] {
        let (mut u, v) = self.positions(vec![x, x + step, x], vec![y, y, y + step]);
        if let Some(period) = self.period {
            // A step across the seam of the source's longitudes is not a step around the body.
            let first = u[0];
            u.iter_mut().for_each(|u| *u -= ((*u - first) / period).round() * period);
        }
        let along = |p: &[f64]| (p[1] - p[0]).hypot(p[2] - p[0]);
        [along(&u), along(&v)].map(|s| if s.is_finite() { s } else { 1.0 })
    }

    /// Positions in the source of the samples of a block, row by row; `None` outside the source.
    #[must_use]
    pub fn map(&self, lattice: &Lattice, block: Rect) -> Vec<Option<[f64; 2]>> {
        let [w, h] = block.size;
        let place = |i: f64, j: f64| lattice.at(block.origin[0] as f64 + i, block.origin[1] as f64 + j);
        let (u, v) = if self.transform.is_some() && w > 2 && h > 2 {
            match self.interpolated(&place, [w, h]) {
                Some(positions) => positions,
                None => self.exact(&place, [w, h]),
            }
        } else {
            self.exact(&place, [w, h])
        };
        u.into_iter().zip(v).map(|(u, v)| self.inside(u, v)).collect()
    }

    fn exact(&self, place: &dyn Fn(f64, f64) -> [f64; 2], [w, h]: [usize; 2]) -> (Vec<f64>, Vec<f64>) {
        let points = (0..w * h).map(|at| place((at % w) as f64, (at / w) as f64));
        let (x, y) = points.map(|[x, y]| (x, y)).unzip();
        self.positions(x, y)
    }

    /// A position inside the source, shifted around the body if necessary.
    fn inside(&self, u: f64, v: f64) -> Option<[f64; 2]> {
        let mut u = u;
        if let Some(period) = self.period.filter(|_| u.is_finite()) {
            let low = -0.5;
            if u < low || u > self.size[0] - 0.5 {
                u = low + (u - low).rem_euclid(period);
            }
        }
        // A pixel covers half a step on each side of its centre; a little more, for rounding.
        let is_in = |at: f64, count: f64| at >= -0.500_01 && at <= count - 0.499_99;
        (is_in(u, self.size[0]) && is_in(v, self.size[1])).then_some([u, v])
    }

    fn interpolated(&self, place: &dyn Fn(f64, f64) -> [f64; 2], [w, h]: [usize; 2]) -> Option<(Vec<f64>, Vec<f64>)> {
        let [columns, rows] = [w, h].map(|n| (n - 1).div_ceil(STEP));
        // Nodes are evenly spread over the block, the last ones on its last samples.
        let [dx, dy] = [(w - 1) as f64 / columns as f64, (h - 1) as f64 / rows as f64];
        let nodes = (columns + 1) * (rows + 1);
        let mut points: Vec<[f64; 2]> =
            (0..nodes).map(|k| place((k % (columns + 1)) as f64 * dx, (k / (columns + 1)) as f64 * dy)).collect();
        // Check interpolation at the middles of cells.
        points.extend(
            (0..columns * rows).map(|k| place(((k % columns) as f64 + 0.5) * dx, ((k / columns) as f64 + 0.5) * dy)),
        );
        let (x, y) = points.into_iter().map(|[x, y]| (x, y)).unzip();
        let (mut u, v) = self.positions(x, y);
        if u.iter().chain(&v).any(|p| !p.is_finite()) {
            return None;
        }
        if let Some(period) = self.period {
            // One side of the date line for all, or interpolation would run around the body.
            let first = u[0];
            u.iter_mut().for_each(|u| *u -= ((*u - first) / period).round() * period);
        }
        let cell = |p: &[f64], i: usize, j: usize, s: f64, t: f64| {
            let at = j * (columns + 1) + i;
            let south = p[at] + s * (p[at + 1] - p[at]);
            let north = p[at + columns + 1] + s * (p[at + columns + 2] - p[at + columns + 1]);
            south + t * (north - south)
        };
        for k in 0..columns * rows {
            let (i, j) = (k % columns, k / columns);
            let is_off = |p: &[f64]| (cell(p, i, j, 0.5, 0.5) - p[nodes + k]).abs() > TOLERANCE_PX;
            if is_off(&u) || is_off(&v) {
                return None;
            }
        }
        let mut out = (Vec::with_capacity(w * h), Vec::with_capacity(w * h));
        for row in 0..h {
            let t = row as f64 / dy;
            let j = (t as usize).min(rows - 1);
            for column in 0..w {
                let s = column as f64 / dx;
                let i = (s as usize).min(columns - 1);
                out.0.push(cell(&u, i, j, s - i as f64, t - j as f64));
                out.1.push(cell(&v, i, j, s - i as f64, t - j as f64));
            }
        }
        Some(out)
    }
}
