//! `--bounds`: the part of the data that becomes a world.
//!
//! First in longitude and latitude (or the CRS of the bounds), so that the world's plane is chosen
//! for that part; then as a rectangle of the world's CRS, which the world covers and for which
//! sources are read.

use super::TargetCrs;
use super::crs::{body_of, parse};
use super::raster::{Raster, traditional};
use crate::error::{IngestError, gdal_message};
use gdal::spatial_ref::{CoordTransform, SpatialRef};
use std::sync::Arc;

/// Points along a side of a region that are transformed.
const SIDE: usize = 33;
/// Margin around a part for kernels, in pixels, and as a share of its size.
const MARGIN_PX: f64 = 16.0;
const MARGIN_SHARE: f64 = 0.05;

/// The used part of a source.
#[derive(Debug, Clone)]
pub struct Crop {
    /// Longitudes and latitudes of the region, degrees, for a source around the whole body; empty
    /// for others.
    pub lon_lat: Arc<Vec<[f64; 2]>>,
    /// Least and greatest easting and northing in the world's CRS, once it is chosen.
    pub rect: Option<[[f64; 2]; 2]>,
}

impl Crop {
    /// Cuts what a source covers down to the rectangle and up to a post around it, so that the
    /// posts of the world cover it; on the source's own lattice if its samples are one.
    pub(crate) fn cut(&self, low: &mut [f64; 2], high: &mut [f64; 2], spacing: f64, is_lattice: bool) {
        let Some([from, to]) = self.rect else { return };
        for axis in 0..2 {
            let (first, last) = (low[axis], high[axis]);
            let (mut start, mut end) = (from[axis].clamp(first, last), to[axis].clamp(first, last));
            if is_lattice {
                let index = |v: f64| (v - first) / spacing;
                (start, end) =
                    (first + (index(start) + 1e-3).floor() * spacing, first + (index(end) - 1e-3).ceil() * spacing);
            } else {
                // Less than a whole post: the lattice must be inside.
                (start, end) = (start - 0.998 * spacing, end + 0.998 * spacing);
            }
            (low[axis], high[axis]) = (start.max(first), end.min(last));
        }
    }
}

/// Bounds as the user gave them, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    /// West, south, east, north; east is greater than west, beyond 180 degrees across the date
    /// line.
    bounds: [f64; 4],
    /// Their CRS; longitude and latitude when the user gave none.
    crs: Option<String>,
    typed: String,
}

impl Region {
    /// Checks bounds: west, south, east, north, in a CRS or in degrees.
    ///
    /// # Errors
    /// [`IngestError::Usage`]: reversed, empty, no place on a body.
    pub fn new(bounds: [f64; 4], crs: Option<&str>) -> Result<Self, IngestError> {
        let typed = bounds.map(|v| v.to_string()).join(",");
        let fail = |reason: String| Err(IngestError::usage(format!("--bounds {typed}: {reason}")));
        let [west, south, mut east, north] = bounds;
        if bounds.iter().any(|v| !v.is_finite()) {
            return fail("expected four finite numbers, west, south, east, north".to_owned());
        }
        if south == north || west == east {
            return fail("has no area".to_owned());
        }
        if south > north {
            return fail(format!(
                "the south, {south}, lies north of the north, {north}: expected W,S,E,N, here perhaps {west},{north},{east},{south}"
            ));
        }
        let is_degrees = match crs {
            Some(text) => parse("--bounds-crs", text)?.is_geographic(),
            None => true,
        };
        if is_degrees {
            if south < -90.0 || north > 90.0 || [west, east].iter().any(|v| v.abs() > 360.0) {
                let hint = if crs.is_none() { "; --bounds-crs EPSG:N tells another system" } else { "" };
                return fail(format!(
                    "expected degrees, longitudes from -180 to 360 and latitudes from -90 to 90{hint}"
                ));
            }
            if west > east {
                // Across the date line, unless that is most of the way around: then they were
                // exchanged.
                if east + 360.0 - west > 180.0 {
                    return fail(reversed(bounds));
                }
                east += 360.0;
            }
            if east - west > 360.0 {
                return fail("is more than once around".to_owned());
            }
        } else if west > east {
            return fail(reversed(bounds));
        }
        Ok(Self { bounds: [west, south, east, north], crs: crs.map(str::to_owned), typed })
    }

    /// The CRS of the bounds for data in `other`.
    fn srs(&self, other: &SpatialRef) -> Result<SpatialRef, IngestError> {
        match &self.crs {
            Some(text) => parse("--bounds-crs", text),
            None if body_of(other).name == "Earth" => parse("longitude and latitude", "EPSG:4326"),
            None => Ok(traditional(other.geog_cs().map_err(|e| {
                IngestError::usage(format!("--bounds has no meaning for the data: {}", gdal_message(&e)))
            })?)),
        }
    }

    fn grid(&self) -> Vec<[f64; 2]> {
        let [west, south, east, north] = self.bounds;
        grid([west, south], [east, north])
    }

    /// Points of the region in another CRS, without those that cannot be transformed.
    fn points_in(&self, srs: &SpatialRef) -> Result<Vec<[f64; 2]>, IngestError> {
        transformed(self.grid(), &self.srs(srs)?, srs)
    }

    /// The parts of sources that lie in the region, before the world's CRS is chosen.
    ///
    /// # Errors
    /// [`IngestError::Usage`] when no source has a part in it.
    pub(crate) fn parts(&self, rasters: &[Raster]) -> Result<Vec<Raster>, IngestError> {
        let mut parts = Vec::new();
        for raster in rasters {
            let srs = raster.srs()?;
            let points = self.points_in(&srs)?;
            let Some(part) = window(raster, &points) else { continue };
            let turn = 360.0 / part.affine().0[1].abs();
            let is_around = part.is_geographic() && part.size()[0] as f64 > 0.99 * turn;
            let lon_lat = Arc::new(if is_around { points } else { Vec::new() });
            parts.push(part.with_crop(Crop { lon_lat, rect: None }));
        }
        if parts.is_empty() {
            return Err(IngestError::usage(format!(
                "--bounds {} lies outside the elevation{}",
                self.typed,
                self.covered(rasters).map_or(String::new(), |[w, s, e, n]| format!(
                    ", which covers {w:.4},{s:.4},{e:.4},{n:.4} (west, south, east, north)"
                ))
            )));
        }
        Ok(parts)
    }

    /// What sources cover, in the CRS of the bounds.
    fn covered(&self, rasters: &[Raster]) -> Option<[f64; 4]> {
        let mut all: Option<[f64; 4]> = None;
        for raster in rasters {
            let srs = raster.srs().ok()?;
            let (xs, ys) = raster.grid(SIDE, false);
            let points = xs.into_iter().zip(ys).map(|(x, y)| [x, y]).collect();
            for [x, y] in transformed(points, &srs, &self.srs(&srs).ok()?).ok()? {
                let [w, s, e, n] = all.unwrap_or([x, y, x, y]);
                all = Some([w.min(x), s.min(y), e.max(x), n.max(y)]);
            }
        }
        all
    }

    /// The bounding rectangle of the region in the world's CRS.
    ///
    /// # Errors
    /// [`IngestError::Usage`] when it cannot be transformed.
    pub(crate) fn rect_in(&self, target: &TargetCrs) -> Result<[[f64; 2]; 2], IngestError> {
        let points = self.points_in(&target.srs()?)?;
        let rect = points.iter().fold(None, |rect: Option<[[f64; 2]; 2]>, [x, y]| {
            let [low, high] = rect.unwrap_or([[*x, *y]; 2]);
            Some([[low[0].min(*x), low[1].min(*y)], [high[0].max(*x), high[1].max(*y)]])
        });
        rect.ok_or_else(|| IngestError::usage(format!("--bounds {} has no place in {}", self.typed, target.crs().name)))
    }
}

/// The parts of sources that a rectangle of the world's CRS needs, without sources outside of it.
pub(crate) fn parts_in(
    rasters: Vec<Raster>,
    rect: [[f64; 2]; 2],
    target: &TargetCrs,
) -> Result<Vec<Raster>, IngestError> {
    let from = target.srs()?;
    let mut parts = Vec::new();
    for raster in rasters {
        let points = transformed(grid(rect[0], rect[1]), &from, &raster.srs()?)?;
        let crop = Crop { lon_lat: Arc::default(), rect: Some(rect) };
        parts.extend(window(&raster, &points).map(|part| part.with_crop(crop)));
    }
    Ok(parts)
}

fn reversed([west, south, east, north]: [f64; 4]) -> String {
    format!(
        "the west, {west}, lies east of the east, {east}: expected W,S,E,N, here perhaps {east},{south},{west},{north} (across \
         the date line west is the greater one, as in 170,-20,-170,-10)"
    )
}

fn grid(low: [f64; 2], high: [f64; 2]) -> Vec<[f64; 2]> {
    let along = |k: usize, axis: usize| low[axis] + (high[axis] - low[axis]) * k as f64 / (SIDE - 1) as f64;
    (0..SIDE * SIDE).map(|k| [along(k % SIDE, 0), along(k / SIDE, 1)]).collect()
}

fn transformed(points: Vec<[f64; 2]>, from: &SpatialRef, to: &SpatialRef) -> Result<Vec<[f64; 2]>, IngestError> {
    let transform = CoordTransform::new(from, to)
        .map_err(|e| IngestError::usage(format!("--bounds cannot be brought to the data: {}", gdal_message(&e))))?;
    let (mut x, mut y): (Vec<f64>, Vec<f64>) = points.into_iter().map(|[x, y]| (x, y)).unzip();
    // Points that cannot be transformed come back infinite and are left out.
    transform.transform_coords(&mut x, &mut y, &mut []).ok();
    Ok(x.into_iter().zip(y).filter(|(x, y)| x.is_finite() && y.is_finite()).map(|(x, y)| [x, y]).collect())
}

/// The part of a raster around points of its CRS, a margin for kernels included; `None` when they
/// lie beside it.
fn window(raster: &Raster, points: &[[f64; 2]]) -> Option<Raster> {
    let inverse = raster.affine().inverse()?;
    let mut pixels: Vec<[f64; 2]> = points.iter().map(|[x, y]| inverse.apply(*x, *y)).collect();
    let is_around = raster.is_geographic() && raster.affine().is_axis_parallel();
    let period = 360.0 / raster.affine().0[1].abs();
    if is_around {
        // All on one side of the date line, near the first.
        let first = pixels.first()?[0];
        pixels.iter_mut().for_each(|p| p[0] -= ((p[0] - first) / period).round() * period);
    }
    let size = raster.size().map(|v| v as f64);
    let range = |axis: usize, shift: f64| {
        let values = || pixels.iter().map(|p| p[axis] + shift);
        let (low, high) = (values().fold(f64::MAX, f64::min), values().fold(f64::MIN, f64::max));
        (low < size[axis] && high > 0.0).then_some([low.max(0.0), high.min(size[axis])])
    };
    // Around the body a raster may be met from either side, or from both.
    let turns: &[f64] = if is_around { &[-2.0, -1.0, 0.0, 1.0, 2.0] } else { &[0.0] };
    let columns = turns.iter().filter_map(|turn| range(0, turn * period));
    let columns = columns.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
    let mut first = [0; 2];
    let mut part = [0; 2];
    for (axis, [low, high]) in [columns, range(1, 0.0)?].into_iter().enumerate() {
        let margin = MARGIN_PX + MARGIN_SHARE * (high - low);
        first[axis] = (low - margin).floor().max(0.0) as usize;
        part[axis] = ((high + margin).ceil().min(size[axis]) as usize).checked_sub(first[axis]).filter(|n| *n > 0)?;
    }
    raster.part(first, part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_checked_and_may_cross_the_date_line() {
        assert_eq!(Region::new([170.0, -20.0, -170.0, -10.0], None).unwrap().bounds, [170.0, -20.0, 190.0, -10.0]);
        let message = |bounds| Region::new(bounds, None).unwrap_err().to_string();
        assert!(message([19.0, 36.0, 6.0, 48.0]).contains("perhaps 6,36,19,48"));
        assert!(message([6.0, 48.0, 19.0, 36.0]).contains("perhaps 6,36,19,48"));
        assert!(message([6.0, 36.0, 6.0, 48.0]).contains("no area"));
        assert!(message([500_000.0, 5e6, 501_000.0, 5.1e6]).contains("--bounds-crs"));
        assert!(message([f64::NAN, 36.0, 19.0, 48.0]).contains("finite"));
        assert!(Region::new([500_000.0, 5e6, 501_000.0, 5.1e6], Some("EPSG:32632")).is_ok());
        assert!(Region::new([501_000.0, 5e6, 500_000.0, 5.1e6], Some("EPSG:32632")).is_err());
    }

    #[test]
    fn a_cut_keeps_to_the_lattice_and_covers_the_rectangle() {
        let cut = |from, to, is_lattice| {
            let (mut low, mut high) = ([5.0, 5.0], [105.0, 105.0]);
            Crop { lon_lat: Arc::default(), rect: Some([from, to]) }.cut(&mut low, &mut high, 10.0, is_lattice);
            (low, high)
        };
        assert_eq!(cut([22.0, -50.0], [61.0, 65.0], true), ([15.0, 5.0], [65.0, 65.0]));
        assert_eq!(cut([22.0, 22.0], [23.0, 23.0], true), ([15.0, 15.0], [25.0, 25.0]));
        let (low, high) = cut([22.0, -50.0], [61.0, 100.0], false);
        assert!((low[0] - 12.02).abs() < 1e-9 && low[1] == 5.0 && (high[0] - 70.98).abs() < 1e-9 && high[1] == 105.0);
    }
}
