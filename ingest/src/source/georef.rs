//! Where pixels lie: an affine map from pixel coordinates to a CRS.

use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, Metadata};
use std::path::Path;

/// `x = c0 + c1·column + c2·row`, `y = c3 + c4·column + c5·row`; pixel corners are whole numbers
/// (GDAL's order).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Affine(pub [f64; 6]);

impl Affine {
    /// Where a pixel position lies.
    #[must_use]
    pub fn apply(&self, column: f64, row: f64) -> [f64; 2] {
        let c = &self.0;
        [c[0] + c[1] * column + c[2] * row, c[3] + c[4] * column + c[5] * row]
    }

    /// The inverse map; `None` when pixels have no area.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let c = &self.0;
        let det = c[1] * c[5] - c[2] * c[4];
        if !(det.is_finite() && det.abs() > 1e-300 && c.iter().all(|v| v.is_finite())) {
            return None;
        }
        let (a, b, d, e) = (c[5] / det, -c[2] / det, -c[4] / det, c[1] / det);
        Some(Self([-(a * c[0] + b * c[3]), a, b, -(d * c[0] + e * c[3]), d, e]))
    }

    /// Whether rows and columns run along the axes.
    #[must_use]
    pub fn is_axis_parallel(&self) -> bool {
        self.0[2] == 0.0 && self.0[4] == 0.0
    }
}

/// A dataset's affine map: its geotransform, or the one that fits its ground control points to half
/// a pixel.
pub(crate) fn affine_of(dataset: &Dataset) -> Option<Affine> {
    if let Ok(transform) = dataset.geo_transform() {
        let affine = Affine(transform);
        return affine.inverse().map(|_| affine);
    }
    let points: Vec<[f64; 4]> = dataset.gcps().iter().map(|p| [p.pixel(), p.line(), p.x(), p.y()]).collect();
    fit(&points)
}

/// For a raster whose position is not given by an affine map: a message with the command that
/// straightens it; `None` when it has no position at all. Continues the sentence that begins with
/// the file.
pub(crate) fn bent(dataset: &Dataset, path: &Path, srs: Option<&SpatialRef>) -> Option<String> {
    let file = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let stem = path.file_stem().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let code = srs.and_then(super::crs::epsg_of).unwrap_or(4326);
    let warp = |how: &str| {
        let (from, gap) = (path.display(), if how.is_empty() { "" } else { " " });
        format!("gdalwarp{gap}{how} -t_srs EPSG:{code} {from} {stem}-straight.tif")
    };
    let has = |domain: &str| dataset.metadata_domain(domain).is_some_and(|items| !items.is_empty());
    match dataset.gcps().len() {
        0 if has("RPC") => Some(format!(
            "is placed by rational polynomials (RPC), not by an affine map: {} straightens {file} (with -to \
             RPC_DEM=FILE over an elevation model)",
            warp("-rpc")
        )),
        0 if has("GEOLOCATION") => Some(format!(
            "is placed by arrays of longitudes and latitudes, not by an affine map: {} straightens it",
            warp("-geoloc")
        )),
        0 => None,
        count @ 1..3 => Some(format!("has {count} control points, which are too few to place it: expected at least 3")),
        count => {
            let unknown = if srs.is_none() { "-s_srs EPSG:N" } else { "" };
            Some(format!("is bent: its {count} control points lie on no affine map: {} straightens it", warp(unknown)))
        }
    }
}

/// Least squares fit of an affine map to points `[column, row, x, y]`; `None` when they are too
/// few, lie on a line, or are not on any affine map to within half a pixel.
fn fit(points: &[[f64; 4]]) -> Option<Affine> {
    if points.len() < 3 {
        return None;
    }
    let count = points.len() as f64;
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / count;
    let center = [mean(0), mean(1), mean(2), mean(3)];
    let moment = |a: usize, b: usize| points.iter().map(|p| (p[a] - center[a]) * (p[b] - center[b])).sum::<f64>();
    let (uu, uv, vv) = (moment(0, 0), moment(0, 1), moment(1, 1));
    let det = uu * vv - uv * uv;
    if det.abs() < 1e-9 * (uu * vv).max(1e-30) {
        return None;
    }
    let row = |k: usize| {
        let (uk, vk) = (moment(0, k), moment(1, k));
        let (along, across) = ((vv * uk - uv * vk) / det, (uu * vk - uv * uk) / det);
        [center[k] - along * center[0] - across * center[1], along, across]
    };
    let ([a, b, c], [d, e, f]) = (row(2), row(3));
    // Coefficients that are zero but for rounding would make an axis-parallel raster look rotated.
    let tidy = |v: f64, other: f64| if v.abs() < 1e-9 * other.abs() { 0.0 } else { v };
    let affine = Affine([a, b, tidy(c, b), d, tidy(e, f), f]);
    let inverse = affine.inverse()?;
    let is_near = |p: &[f64; 4]| {
        let [column, row] = inverse.apply(p[2], p[3]);
        (column - p[0]).abs() < 0.5 && (row - p[1]).abs() < 0.5
    };
    points.iter().all(is_near).then_some(affine)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_takes_back() {
        let affine = Affine([100.0, 2.0, 0.5, 900.0, 0.25, -3.0]);
        let [x, y] = affine.apply(7.0, 9.0);
        let [column, row] = affine.inverse().unwrap().apply(x, y);
        assert!((column - 7.0).abs() < 1e-12 && (row - 9.0).abs() < 1e-12);
        assert_eq!(Affine([0.0, 1.0, 2.0, 0.0, 2.0, 4.0]).inverse(), None);
    }

    #[test]
    fn tie_points_on_a_grid_give_its_map() {
        let affine = Affine([4_302_000.0, 1000.0, 0.0, 2_811_000.0, 0.0, -1000.0]);
        let points = [[124.0, 126.0], [338.0, 5.0], [349.0, 189.0], [492.0, 0.0]].map(|[c, r]| {
            let [x, y] = affine.apply(c, r);
            [c, r, x, y]
        });
        let fitted = fit(&points).unwrap();
        assert!(fitted.is_axis_parallel());
        assert!(fitted.0.iter().zip(affine.0).all(|(a, b)| (a - b).abs() < 1e-6));
        let mut bent = points;
        bent[0][2] += 5000.0;
        assert_eq!(fit(&bent), None);
        assert_eq!(fit(&points[..2]), None);
    }
}
