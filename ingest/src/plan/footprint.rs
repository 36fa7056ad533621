//! The footprint of a source in the database's CRS, and the size of its pixels.

use super::lattice::Bounds;
use crate::IngestError;
use crate::source::raster::traditional;
use crate::source::{Raster, TargetCrs};
use gdal::spatial_ref::CoordTransform;

/// The footprint of a source in the database's CRS.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    /// Least easting and northing of its pixel centres.
    pub(super) low: [f64; 2],
    /// Greatest.
    pub(super) high: [f64; 2],
    /// Side of a square as large as one of its pixels, metres.
    pub(super) spacing: f64,
    /// Where that was measured.
    pub(super) focus: [f64; 2],
    /// Whether its pixel centres are a square lattice along the axes.
    pub(super) is_lattice: bool,
}

impl Footprint {
    pub(super) fn bounds(&self) -> Bounds {
        Bounds { low: self.low, high: self.high, pixel: self.spacing, focus: self.focus }
    }
}

/// A pixel position of a source at a point of the database's CRS; `None` outside the source.
fn pixel_at(raster: &Raster, target: &TargetCrs, point: [f64; 2]) -> Option<[f64; 2]> {
    let (mut x, mut y) = ([point[0]], [point[1]]);
    if !target.is_of(raster) {
        CoordTransform::new(&target.srs().ok()?, &raster.srs().ok()?)
            .ok()?
            .transform_coords(&mut x, &mut y, &mut [])
            .ok()?;
    }
    let pixel = raster.affine().inverse()?.apply(x[0], y[0]);
    (0..2).all(|a| pixel[a] >= 0.0 && pixel[a] < raster.size()[a] as f64).then_some(pixel)
}

/// What a source is in the database's CRS; its pixels are measured at `focus`, if that is in it,
/// else in its middle. (A map of the globe has no useful middle in a UTM zone.)
pub(super) fn footprint(
    raster: &Raster,
    target: &TargetCrs,
    focus: Option<[f64; 2]>,
) -> Result<Footprint, IngestError> {
    let (mut x, mut y) = raster.grid(65, true);
    let count = x.len();
    let asked = focus.and_then(|focus| pixel_at(raster, target, focus));
    for [c, r] in measuring_places(raster, asked) {
        for [mx, my] in [[c, r], [c + 1.0, r], [c, r + 1.0]].map(|[c, r]| raster.affine().apply(c, r)) {
            x.push(mx);
            y.push(my);
        }
    }
    let is_same = target.is_of(raster);
    let mut seam = (Vec::new(), Vec::new());
    if !is_same {
        let transform = CoordTransform::new(&traditional(raster.srs()?), &target.srs()?).map_err(|e| {
            let reason = format!("cannot be brought to {}: {}", target.crs().name, crate::error::gdal_message(&e));
            IngestError::source(raster.path(), reason)
        })?;
        // Points that cannot be transformed come back infinite and are left out below.
        transform.transform_coords(&mut x, &mut y, &mut []).ok();
        seam = at_seam(raster, &transform);
    }
    let spacing_at = |place: usize| {
        let step = |k: usize| [x[place + k] - x[place], y[place + k] - y[place]];
        let ([ax, ay], [bx, by]) = (step(1), step(2));
        (ax * by - ay * bx).abs().sqrt()
    };
    let place = typical((count..x.len()).step_by(3), spacing_at).unwrap_or(count);
    let spacing = spacing_at(place);
    let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
    let outline = x.iter().zip(&y).take(count).chain(seam.0.iter().zip(&seam.1));
    for (x, y) in outline.filter(|(x, y)| x.is_finite() && y.is_finite()) {
        for (axis, v) in [*x, *y].into_iter().enumerate() {
            low[axis] = low[axis].min(v);
            high[axis] = high[axis].max(v);
        }
    }
    if low[0] > high[0] || !(spacing.is_finite() && spacing > 1e-6) {
        return Err(IngestError::source(raster.path(), format!("has no place in {}", target.crs().name)));
    }
    let focus = [x[place], y[place]];
    let [_, dx, _, _, _, dy] = raster.affine().0;
    let is_square = (dx.abs() / dy.abs() - 1.0).abs() < 1e-6;
    let is_lattice = is_same && is_square && raster.affine().is_axis_parallel();
    if let Some(crop) = raster.crop() {
        crop.cut(&mut low, &mut high, spacing, is_lattice);
    }
    Ok(Footprint { low, high, spacing, focus, is_lattice })
}

/// Pixel centres of the middle row on both sides of where a plane cuts a source open that goes
/// around the body: a grid of few points misses the ends of the plane.
fn at_seam(raster: &Raster, transform: &CoordTransform) -> (Vec<f64>, Vec<f64>) {
    let none = (Vec::new(), Vec::new());
    let width = raster.size()[0];
    if !raster.is_geographic()
        || !raster.affine().is_axis_parallel()
        || raster.affine().0[1].abs() * (width as f64) < 180.0
    {
        return none;
    }
    let row = (raster.size()[1] / 2) as f64 + 0.5;
    let of = |columns: &mut dyn Iterator<Item = usize>| {
        let places = columns.map(|column| raster.affine().apply(column as f64 + 0.5, row));
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = places.map(|[x, y]| (x, y)).unzip();
        // Points that cannot be transformed come back infinite: this is not a jump, and the caller
        // leaves them out.
        transform.transform_coords(&mut x, &mut y, &mut []).ok();
        (x, y)
    };
    let step = width.div_ceil(1024);
    let (x, _) = of(&mut (0..width).step_by(step));
    let finite = || x.iter().copied().filter(|x| x.is_finite());
    let whole = finite().fold(f64::MIN, f64::max) - finite().fold(f64::MAX, f64::min);
    let jump = x.windows(2).position(|pair| (pair[1] - pair[0]).abs() > 0.5 * whole);
    jump.map_or(none, |at| of(&mut (at * step..=((at + 1) * step).min(width - 1))))
}

/// Where the pixels of a source are measured: at the requested place, otherwise in its middle; or,
/// in case its plane is cut open there (the far side of a globe from 0 to 360 degrees), elsewhere
/// along its middle row.
fn measuring_places(raster: &Raster, asked: Option<[f64; 2]>) -> Vec<[f64; 2]> {
    let [width, height] = raster.size().map(|v| v as f64);
    let shares = if asked.is_some() { &[][..] } else { &[0.5, 0.25, 0.75, 0.375, 0.625][..] };
    asked.into_iter().chain(shares.iter().map(|share| [share * width, 0.5 * height])).collect()
}

/// The first place, unless its spacing is more than twice or less than half the usual one; then a
/// place with the usual one.
fn typical(places: impl Iterator<Item = usize>, spacing_at: impl Fn(usize) -> f64) -> Option<usize> {
    let mut measured: Vec<(usize, f64)> = places.map(|place| (place, spacing_at(place))).collect();
    let first = *measured.first()?;
    measured.retain(|(_, spacing)| spacing.is_finite() && *spacing > 0.0);
    measured.sort_by(|a, b| a.1.total_cmp(&b.1));
    let usual = measured.get(measured.len() / 2)?;
    let is_usual = first.1.is_finite() && (0.5..2.0).contains(&(first.1 / usual.1));
    Some(if is_usual { first.0 } else { usual.0 })
}
