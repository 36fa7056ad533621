//! Where rasters over longitude and latitude lie on a body's lattice.

use crate::error::IngestError;
use crate::source::Raster;
use std::path::Path;

/// Rasters over degrees: the middle of the first pixel, and from pixel to pixel, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Degrees {
    pub(super) first: [f64; 2],
    pub(super) step: [f64; 2],
    /// Columns and rows.
    pub(super) size: [usize; 2],
}

/// Pixels that do not lie on the lattice to this share of its steps are of another one.
const ON_LATTICE: f64 = 0.02;

impl Degrees {
    /// Where a raster lies, if it is over longitude and latitude: geographic, or on a simple
    /// cylindrical plane, whose coordinates are degrees but for a factor.
    pub(super) fn of(raster: &Raster) -> Result<Option<Self>, IngestError> {
        let affine = raster.affine().0;
        if affine[2] != 0.0 || affine[4] != 0.0 {
            return Ok(None);
        }
        let srs = raster.srs()?;
        let (unit, lon_0) = if raster.is_geographic() {
            let unit = srs.angular_units().to_degrees();
            (if unit.is_finite() && unit > 0.0 { unit } else { 1.0 }, 0.0)
        } else {
            let Some((unit, lon_0)) = cylinder(&srs.to_proj4().unwrap_or_default()) else { return Ok(None) };
            (unit * srs.linear_units(), lon_0)
        };
        // A few units in the last place, from how files write them, are not a position.
        let tidy = |v: f64| (v * 1e10).round() / 1e10;
        let step = [affine[1] * unit, affine[5] * unit];
        let first = [tidy(affine[0] * unit + 0.5 * step[0] + lon_0), tidy(affine[3] * unit + 0.5 * step[1])];
        Ok(Some(Self { first, step, size: raster.size() }))
    }

    /// Degrees that its pixels cover, along longitude and latitude.
    pub(super) fn cover(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.step[axis].abs() * self.size[axis] as f64)
    }

    /// Latitude of its southernmost and its northernmost row.
    pub(super) fn latitudes(&self) -> [f64; 2] {
        let last = self.first[1] + self.step[1] * (self.size[1] - 1) as f64;
        [self.first[1].min(last), self.first[1].max(last)]
    }
}

/// Degrees per metre of a simple cylindrical plane whose parallels all have the equator's length, and
/// its middle longitude.
fn cylinder(proj4: &str) -> Option<(f64, f64)> {
    let value = |key: &str| proj4.split_whitespace().find_map(|word| word.strip_prefix(key));
    let number = |key: &str| value(key).and_then(|text| text.parse::<f64>().ok());
    if value("+proj=") != Some("eqc") || number("+lat_ts=").unwrap_or(0.0) != 0.0 {
        return None;
    }
    if [number("+x_0="), number("+y_0="), number("+lat_0=")].into_iter().flatten().any(|v| v != 0.0) {
        return None;
    }
    let known = match value("+datum=").or(value("+ellps=")) {
        Some("WGS84") => Some(6_378_137.0),
        _ => None,
    };
    let radius_m = number("+R=").or(number("+a=")).or(known)?;
    Some((1.0 / (radius_m * std::f64::consts::PI / 180.0), number("+lon_0=").unwrap_or(0.0)))
}

/// A body's lattice, as its elevation has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LatticePlace {
    /// Columns around.
    pub(super) columns: u32,
    /// The north pole's row.
    pub(super) rows: u32,
    pub(super) west_deg: f64,
    pub(super) first_row_deg: f64,
    pub(super) row_step_deg: f64,
}

impl LatticePlace {
    /// Of an elevation raster.
    pub(super) fn of(at: &Degrees, path: &Path) -> Result<Self, IngestError> {
        let fail = |reason: String| IngestError::source(path, reason);
        let [dx, dy] = at.step;
        if dx <= 0.0 {
            return Err(fail("has its columns from the east to the west, expected the other way round".to_owned()));
        }
        let around = 360.0 / dx;
        let columns = around.round();
        if (around - columns).abs() > ON_LATTICE * (columns / at.size[0] as f64).max(1.0) || columns < 4.0 {
            return Err(fail(format!(
                "has pixels of {dx} degrees of longitude, of which no whole number goes around: resample it (gdalwarp -tr)"
            )));
        }
        if at.size[0] as f64 > columns + 1.0 {
            return Err(fail(format!(
                "goes around the body more than once: {} columns of {dx} degrees, expected at most {} (and one that repeats \
                 the first)",
                at.size[0], columns
            )));
        }
        let [south, north] = at.latitudes();
        let step = snapped(dy.abs());
        if south < -90.0 - 1e-6 || north > 90.0 + 1e-6 {
            return Err(fail(format!(
                "has rows from {south:.4} to {north:.4} degrees of latitude, expected -90 to 90: are its axes exchanged?"
            )));
        }
        if !(-360.0..=360.0).contains(&at.first[0]) {
            return Err(fail(format!("begins at longitude {:.3}, expected -360 to 360", at.first[0])));
        }
        // From the pole to the row nearest to it: a whole number of steps when the pole is a row.
        let below = (south + 90.0) / step;
        let phase = below - below.floor();
        let (has_pole, phase) = match phase {
            phase if !(ON_LATTICE..=1.0 - ON_LATTICE).contains(&phase) => (true, 0.0),
            phase if (phase - 0.5).abs() < 1e-6 => (false, 0.5),
            phase => (false, phase),
        };
        let first_row_deg = if has_pole { -90.0 + step } else { -90.0 + phase * step };
        // Rows between the poles, and the north pole's.
        let between = ((90.0 - first_row_deg) / step - ON_LATTICE).ceil();
        let rows = between + 1.0;
        if rows > f64::from(1u32 << 27) || columns > f64::from(1u32 << 27) {
            return Err(fail(format!("has pixels of {step} degrees, expected larger ones")));
        }
        let west_deg = at.first[0];
        Ok(Self { columns: columns as u32, rows: rows as u32, west_deg, first_row_deg, row_step_deg: step })
    }

    /// The lattice column and row of the middle of a raster's first pixel, and whether rows go north
    /// from there. The row is counted from the south pole's, 0.
    pub(super) fn offset(&self, at: &Degrees, path: &Path) -> Result<([i64; 2], bool), IngestError> {
        let column_step = 360.0 / f64::from(self.columns);
        let other = |what: &str| {
            IngestError::source(
                path,
                format!(
                    "{what} than the first elevation file: a body is made of files on one grid (gdalbuildvrt, gdalwarp)"
                ),
            )
        };
        let drift = |step: f64, own: f64, count: usize| (own.abs() / step - 1.0).abs() * count as f64;
        if drift(column_step, at.step[0], at.size[0]) > 0.5 || drift(self.row_step_deg, at.step[1], at.size[1]) > 0.5 {
            return Err(other("has pixels of another size"));
        }
        let column = (at.first[0] - self.west_deg) / column_step;
        let row = 1.0 + (at.first[1] - self.first_row_deg) / self.row_step_deg;
        // Of a row at a pole, which may lie nearer to the next one.
        let row = if at.first[1] > 90.0 - 1e-6 { f64::from(self.rows) } else { row };
        if (column - column.round()).abs() > 0.1 || (row - row.round()).abs() > 0.1 {
            return Err(other("has pixels at other places"));
        }
        Ok(([(column.round() as i64).rem_euclid(self.columns.into()), row.round() as i64], at.step[1] > 0.0))
    }
}

/// A step of which a whole number makes 180 degrees, if it is one but for rounding.
fn snapped(step: f64) -> f64 {
    let count = 180.0 / step;
    let whole = count.round();
    if whole >= 1.0 && (count - whole).abs() < 1e-3 { 180.0 / whole } else { step }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(first: [f64; 2], step: f64, size: [usize; 2]) -> Result<LatticePlace, String> {
        let at = Degrees { first, step: [step, -step], size };
        LatticePlace::of(&at, Path::new("a.tif")).map_err(|e| e.to_string())
    }

    #[test]
    fn pixels_with_areas_put_the_poles_half_a_step_away() {
        let place = place([-179.5, 89.5], 1.0, [360, 180]).unwrap();
        assert_eq!((place.columns, place.rows, place.first_row_deg), (360, 181, -89.5));
    }

    #[test]
    fn points_may_have_rows_at_the_poles_and_repeat_a_column() {
        for columns in [360, 361] {
            let place = place([0.0, 90.0], 1.0, [columns, 181]).unwrap();
            assert_eq!((place.columns, place.rows, place.first_row_deg, place.west_deg), (360, 180, -89.0, 0.0));
        }
    }

    #[test]
    fn gaps_at_the_poles_get_rows() {
        let step = 1.0 / 128.0;
        let place = place([0.5 * step, 88.0 - 0.5 * step], step, [46_080, 22_528]).unwrap();
        assert_eq!((place.columns, place.rows), (46_080, 23_041));
        let at = Degrees { first: [0.5 * step, 88.0 - 0.5 * step], step: [step, -step], size: [46_080, 22_528] };
        assert_eq!(place.offset(&at, Path::new("a.tif")).unwrap(), ([0, 23_041 - 1 - 256], false));
    }

    #[test]
    fn what_goes_around_more_than_once_or_beyond_the_poles_is_refused() {
        assert!(place([0.0, 90.0], 1.0, [362, 181]).unwrap_err().contains("more than once"));
        assert!(place([0.0, 91.0], 1.0, [360, 181]).unwrap_err().contains("axes exchanged"));
        assert!(place([0.0, 90.0], 7.1, [50, 26]).unwrap_err().contains("no whole number"));
        assert!(place([900.0, 90.0], 1.0, [360, 181]).unwrap_err().contains("longitude 900"));
    }

    #[test]
    fn simple_cylinders_are_degrees_but_for_a_factor() {
        let (unit, lon_0) =
            cylinder("+proj=eqc +lat_ts=0 +lat_0=0 +lon_0=180 +x_0=0 +y_0=0 +R=3396190 +units=m").unwrap();
        assert!((unit * 3_396_190.0 * std::f64::consts::PI - 180.0).abs() < 1e-9 && lon_0 == 180.0);
        assert_eq!(cylinder("+proj=eqc +lat_ts=30 +R=3396190"), None);
        assert_eq!(cylinder("+proj=utm +zone=32"), None);
    }
}
