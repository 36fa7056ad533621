//! Implausible places: coordinates that do not fit the CRS that a file names.

use super::raster::traditional;
use super::{Note, Raster, TargetCrs};
use crate::error::IngestError;
use gdal::spatial_ref::{CoordTransform, SpatialRef};
use std::collections::BTreeMap;

/// Data may extend this far beyond areas of use, degrees, because neighbouring zones overlap.
const MARGIN_DEG: f64 = 1.0;
/// Pixels smaller than this many metres at coordinates that could be degrees are degrees.
const TINY_PIXEL: f64 = 0.02;

/// Warns of sources that lie outside the area of use of their CRS, once for each CRS.
///
/// # Errors
/// [`IngestError::Source`]: degrees under the name of a plane.
pub fn check(rasters: &[&Raster], note: &mut dyn FnMut(Note)) -> Result<(), IngestError> {
    let mut outside: BTreeMap<&str, (String, usize)> = BTreeMap::new();
    let mut places: BTreeMap<&str, Option<Place>> = BTreeMap::new();
    for raster in rasters {
        check_degrees(raster)?;
        let place = places
            .entry(raster.wkt())
            .or_insert_with(|| raster.srs().ok().and_then(|srs| Place::of(&srs, raster.epsg())));
        let Some(place) = place else { continue };
        let (xs, ys) = raster.grid(9, true);
        let Some(reason) = place.complaint(xs, ys) else { continue };
        let first = || (format!("{} {reason} {}", raster.path().display(), area_of(place, raster)), 0);
        outside.entry(raster.wkt()).or_insert_with(first).1 += 1;
    }
    for (text, count) in outside.into_values() {
        let others = if count > 1 { format!(", and so do {} other files", count - 1) } else { String::new() };
        note(Note::Warning(format!("{text}{others}: is the CRS right?")));
    }
    Ok(())
}

/// Warns when sources lie outside the area of use of the CRS that the user chose for the world.
pub fn check_target(target: &TargetCrs, rasters: &[&Raster], note: &mut dyn FnMut(Note)) {
    let Some(place) = target.srs().ok().and_then(|srs| Place::of(&srs, target.crs().epsg)) else { return };
    let Some(area) = &place.area else { return };
    let is_out = |raster: &&Raster| {
        let own = raster.srs().ok().and_then(|srs| Place::of(&srs, raster.epsg()))?;
        let (xs, ys) = raster.grid(9, true);
        let points = own.lon_lat(xs, ys);
        Some(!points.is_empty() && !points.iter().any(|p| area.has(*p)))
    };
    if !rasters.is_empty() && rasters.iter().all(|r| !target.is_of(r) && is_out(r) == Some(true)) {
        note(Note::Warning(format!(
            "{} lies outside the area of use of --crs {} ({area}): distances and directions are wrong there",
            rasters[0].path().display(),
            label(target.crs().epsg, &target.crs().name)
        )));
    }
}

fn check_degrees(raster: &Raster) -> Result<(), IngestError> {
    let (xs, ys) = raster.grid(2, false);
    let is_like_degrees = xs.iter().all(|x| x.abs() <= 360.0) && ys.iter().all(|y| y.abs() <= 90.0);
    let c = raster.affine().0;
    let pixel = c[1].hypot(c[4]).max(c[2].hypot(c[5]));
    if raster.is_geographic() || !is_like_degrees || pixel >= TINY_PIXEL {
        return Ok(());
    }
    Err(IngestError::source(
        raster.path(),
        format!(
            "has pixels of {pixel:.6} units at {:.4}, {:.4}, which are degrees and no coordinates of {}: is the CRS right? \
             (gdal_edit.py -a_srs EPSG:4326 names longitude and latitude)",
            xs[0],
            ys[0],
            label(raster.epsg(), raster.crs_name())
        ),
    ))
}

fn label(epsg: Option<u32>, name: &str) -> String {
    epsg.map_or_else(|| name.to_owned(), |code| format!("EPSG:{code}"))
}

fn area_of(place: &Place, raster: &Raster) -> String {
    let label = label(raster.epsg(), raster.crs_name());
    match &place.area {
        Some(area) => format!("the area of use of {label} ({area})"),
        None => format!("what {label} can show"),
    }
}

/// The transformation of a CRS to longitude and latitude, and its area of use.
struct Place {
    to_degrees: Option<CoordTransform>,
    area: Option<Area>,
}

/// West, south, east, north, degrees; west is the greater one across the date line.
#[derive(Debug, PartialEq)]
struct Area([f64; 4]);

impl Area {
    fn has(&self, [lon, lat]: [f64; 2]) -> bool {
        let [west, south, east, north] = self.0;
        let width = (east - west).rem_euclid(360.0);
        // Around the whole body is 360, not 0.
        let width = if width == 0.0 { 360.0 } else { width };
        let offset = (lon - west + MARGIN_DEG).rem_euclid(360.0);
        offset <= width + 2.0 * MARGIN_DEG && lat >= south - MARGIN_DEG && lat <= north + MARGIN_DEG
    }
}

impl std::fmt::Display for Area {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [west, south, east, north] = self.0.map(|v| (v * 10.0).round() / 10.0 + 0.0);
        let axis = |v: f64, letters: [char; 2]| (v.abs(), letters[usize::from(v < 0.0)]);
        let range = |a: f64, b: f64, letters| {
            let ((a, first), (b, last)) = (axis(a, letters), axis(b, letters));
            if first == last { format!("{a} to {b} {last}") } else { format!("{a} {first} to {b} {last}") }
        };
        write!(f, "{}, {}", range(west, east, ['E', 'W']), range(south, north, ['N', 'S']))
    }
}

impl Place {
    fn of(srs: &SpatialRef, epsg: Option<u32>) -> Option<Self> {
        // WKT as databases and files have it has no area; PROJ knows it by the code.
        let known = epsg.and_then(|code| SpatialRef::from_epsg(code).ok());
        let area = known
            .as_ref()
            .unwrap_or(srs)
            .area_of_use()
            .map(|a| Area([a.west_lon_degree, a.south_lat_degree, a.east_lon_degree, a.north_lat_degree]));
        // Areas of use are in Greenwich degrees; other bodies have none.
        let geographic = match &area {
            Some(_) => SpatialRef::from_epsg(4326).ok()?,
            None => srs.geog_cs().ok()?,
        };
        let is_same = srs.is_geographic() && area.is_none();
        let to_degrees = if is_same { None } else { CoordTransform::new(srs, &traditional(geographic)).ok() };
        (is_same || to_degrees.is_some()).then_some(Self { to_degrees, area })
    }

    /// Longitudes and latitudes of positions, without those that cannot be transformed.
    fn lon_lat(&self, mut xs: Vec<f64>, mut ys: Vec<f64>) -> Vec<[f64; 2]> {
        if let Some(transform) = &self.to_degrees {
            // Positions that cannot be transformed come back infinite.
            transform.transform_coords(&mut xs, &mut ys, &mut []).ok();
        }
        let points = xs.into_iter().zip(ys).map(|(x, y)| [x, y]);
        points.filter(|[x, y]| x.is_finite() && y.is_finite() && y.abs() <= 90.5).collect()
    }

    /// A complaint if all positions lie outside of the area of use of the CRS.
    fn complaint(&self, xs: Vec<f64>, ys: Vec<f64>) -> Option<&'static str> {
        let points = self.lon_lat(xs, ys);
        match &self.area {
            _ if points.is_empty() => Some("lies outside"),
            Some(area) => (!points.iter().any(|p| area.has(*p))).then_some("lies outside"),
            None => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_of_use_go_across_the_date_line_and_have_a_margin() {
        let europe = Area([6.0, 38.76, 12.0, 84.33]);
        assert!(europe.has([9.0, 47.0]) && europe.has([12.9, 47.0]) && !europe.has([4.5, 47.0]));
        assert!(!europe.has([9.0, 0.0]));
        assert_eq!(europe.to_string(), "6 to 12 E, 38.8 to 84.3 N");
        let fiji = Area([176.81, -20.81, -178.15, -12.42]);
        assert!(fiji.has([179.0, -17.0]) && fiji.has([-179.0, -17.0]) && fiji.has([181.0, -17.0]));
        assert!(!fiji.has([0.0, -17.0]));
        assert_eq!(fiji.to_string(), "176.8 E to 178.2 W, 20.8 to 12.4 S");
        assert!(Area([-180.0, -90.0, 180.0, 90.0]).has([275.0, 10.0]));
    }
}
