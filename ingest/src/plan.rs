//! The world's geometry: where posts and texels of the finest levels lie.
//!
//! A single source that is already in the database's CRS, with square pixels along the axes, gives the lattice: its
//! pixel centres become posts, so its heights are copied. Else posts lie on multiples of the spacing, which is the
//! ground size of the finest source's pixels.

use crate::IngestError;
use crate::sample::Bounds;
use crate::sample::mapper::Lattice;
use crate::source::raster::traditional;
use crate::source::{Note, Raster, TargetCrs};
use gdal::spatial_ref::CoordTransform;
use terravision_common::world::{World, WorldFields};

/// Tile sizes and wishes of the user.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanOptions {
    /// Nz.
    pub elevation_tile: u32,
    /// Nc.
    pub color_tile: u32,
    /// Wanted spacing of posts, metres.
    pub spacing_m: Option<f64>,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self { elevation_tile: 16, color_tile: 256, spacing_m: None }
    }
}

/// Where everything will be.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The geometry.
    pub world: World,
    /// Posts of the finest elevation level.
    pub elevation: Lattice,
    /// Texel centres of the finest colour level.
    pub color: Lattice,
    /// Where the elevation sources lie.
    pub elevation_bounds: Vec<Bounds>,
    /// Where the colour sources lie.
    pub color_bounds: Vec<Bounds>,
    /// The level that is about as fine as each elevation source.
    pub elevation_levels: Vec<u8>,
    /// The level that is about as fine as each colour source.
    pub color_levels: Vec<u8>,
    /// Whether the finest levels are only made where the data are.
    pub is_nested: bool,
}

/// What a source is in the database's CRS.
#[derive(Debug, Clone, Copy)]
struct Footprint {
    /// Least easting and northing of its pixel centres.
    low: [f64; 2],
    /// Greatest.
    high: [f64; 2],
    /// Side of a square as large as one of its pixels, metres.
    spacing: f64,
    /// Where that was measured.
    focus: [f64; 2],
    /// Whether its pixel centres are a square lattice along the axes.
    is_lattice: bool,
}

impl Footprint {
    fn bounds(&self) -> Bounds {
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
    let pixel = raster.affine.inverse()?.apply(x[0], y[0]);
    (0..2).all(|a| pixel[a] >= 0.0 && pixel[a] < raster.size[a] as f64).then_some(pixel)
}

/// What a source is in the database's CRS; its pixels are measured at `focus`, if that is in it, else in its middle.
/// (A map of the globe has no useful middle in a UTM zone.)
fn footprint(raster: &Raster, target: &TargetCrs, focus: Option<[f64; 2]>) -> Result<Footprint, IngestError> {
    let (mut x, mut y) = raster.grid(65, true);
    let count = x.len();
    let asked = focus.and_then(|focus| pixel_at(raster, target, focus));
    for [c, r] in measuring_places(raster, asked) {
        for [mx, my] in [[c, r], [c + 1.0, r], [c, r + 1.0]].map(|[c, r]| raster.affine.apply(c, r)) {
            x.push(mx);
            y.push(my);
        }
    }
    let is_same = target.is_of(raster);
    let mut seam = (Vec::new(), Vec::new());
    if !is_same {
        let transform = CoordTransform::new(&traditional(raster.srs()?), &target.srs()?).map_err(|e| {
            let reason = format!("cannot be brought to {}: {}", target.crs.name, crate::error::gdal_message(&e));
            IngestError::source(&raster.path, reason)
        })?;
        // What cannot be transformed comes back infinite and is left out below.
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
        return Err(IngestError::source(&raster.path, format!("has no place in {}", target.crs.name)));
    }
    let focus = [x[place], y[place]];
    let [_, dx, _, _, _, dy] = raster.affine.0;
    let is_square = (dx.abs() / dy.abs() - 1.0).abs() < 1e-6;
    let is_lattice = is_same && is_square && raster.affine.is_axis_parallel();
    if let Some(crop) = &raster.crop {
        crop.cut(&mut low, &mut high, spacing, is_lattice);
    }
    Ok(Footprint { low, high, spacing, focus, is_lattice })
}

/// Pixel centres of the middle row on both sides of where a plane cuts a source open that goes around the body: a grid of few
/// points misses the ends of the plane.
fn at_seam(raster: &Raster, transform: &CoordTransform) -> (Vec<f64>, Vec<f64>) {
    let none = (Vec::new(), Vec::new());
    let width = raster.size[0];
    if !raster.is_geographic || !raster.affine.is_axis_parallel() || raster.affine.0[1].abs() * (width as f64) < 180.0 {
        return none;
    }
    let row = (raster.size[1] / 2) as f64 + 0.5;
    let of = |columns: &mut dyn Iterator<Item = usize>| {
        let places = columns.map(|column| raster.affine.apply(column as f64 + 0.5, row));
        let (mut x, mut y): (Vec<f64>, Vec<f64>) = places.map(|[x, y]| (x, y)).unzip();
        // What has no place comes back infinite: it is no jump, and left out by who asks.
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

/// Where a source's pixels are measured: where it is asked for, else in its middle, and in case that this is where its
/// plane is cut open (the far side of a globe from 0 to 360 degrees), elsewhere along its middle row.
fn measuring_places(raster: &Raster, asked: Option<[f64; 2]>) -> Vec<[f64; 2]> {
    let [width, height] = raster.size.map(|v| v as f64);
    let shares = if asked.is_some() { &[][..] } else { &[0.5, 0.25, 0.75, 0.375, 0.625][..] };
    asked.into_iter().chain(shares.iter().map(|share| [share * width, 0.5 * height])).collect()
}

/// The first place, unless its spacing is more than twice or less than half the usual one: then a place that has that.
fn typical(places: impl Iterator<Item = usize>, spacing_at: impl Fn(usize) -> f64) -> Option<usize> {
    let mut measured: Vec<(usize, f64)> = places.map(|place| (place, spacing_at(place))).collect();
    let first = *measured.first()?;
    measured.retain(|(_, spacing)| spacing.is_finite() && *spacing > 0.0);
    measured.sort_by(|a, b| a.1.total_cmp(&b.1));
    let usual = measured.get(measured.len() / 2)?;
    let is_usual = first.1.is_finite() && (0.5..2.0).contains(&(first.1 / usual.1));
    Some(if is_usual { first.0 } else { usual.0 })
}

/// Rounds to three digits: a spacing that people can say.
fn round_spacing(spacing: f64) -> f64 {
    let unit = 10f64.powf(spacing.log10().floor() - 2.0);
    let rounded = (spacing / unit).round() * unit;
    // Through text: 25.7 rather than 25.700000000000003.
    format!("{rounded:.9}").parse().unwrap_or(rounded)
}

/// Lattice of posts: spacing, origin and intervals along each axis.
fn post_lattice(prints: &[Footprint], wanted: Option<f64>) -> Result<(f64, [f64; 2], [u64; 2]), IngestError> {
    let finest = prints.iter().min_by(|a, b| a.spacing.total_cmp(&b.spacing));
    let finest = finest.ok_or_else(|| IngestError::usage("no elevation was given"))?;
    let is_copied = finest.is_lattice && wanted.is_none_or(|s| (s / finest.spacing - 1.0).abs() < 1e-6);
    let (spacing, anchor) = if is_copied {
        (finest.spacing, finest.low)
    } else {
        (wanted.unwrap_or_else(|| round_spacing(finest.spacing)), [0.0; 2])
    };
    let (mut origin, mut intervals) = ([0.0; 2], [0; 2]);
    for axis in 0..2 {
        let low = prints.iter().map(|p| p.low[axis]).fold(f64::MAX, f64::min);
        let high = prints.iter().map(|p| p.high[axis]).fold(f64::MIN, f64::max);
        let mut first = ((low - anchor[axis]) / spacing - 1e-3).ceil();
        let mut last = ((high - anchor[axis]) / spacing + 1e-3).floor();
        if last <= first {
            first = ((low - anchor[axis]) / spacing).floor();
            last = ((high - anchor[axis]) / spacing).ceil().max(first + 1.0);
        }
        origin[axis] = anchor[axis] + first * spacing;
        intervals[axis] = (last - first) as u64;
    }
    Ok((spacing, origin, intervals))
}

/// Below this share of the world, data that are finer than the rest get levels of their own.
const MOST_NESTED: f64 = 0.75;
/// Places along a side at which it is looked which sources cover the world.
const PROBES: usize = 64;

/// The level for a source whose spacing is so many times that of the finest level: at most 7 % coarser than the source.
fn own_level(world: &World, ratio: f64, finest: u8) -> u8 {
    let above = (ratio.log2() + 0.1).floor().max(0.0) as u8;
    finest.saturating_add(above).min(world.root().q())
}

/// Whether data of the finest levels cover so little of the world that these levels are only made there.
fn is_nested(world: &World, elevation: (&[Footprint], &[u8]), color: (&[Footprint], &[u8])) -> bool {
    let (origin, size) = (world.fields().origin, world.extent_m());
    let share = |prints: &[&Footprint]| {
        let place = |k: usize, axis: usize| origin[axis] + size[axis] * (k as f64 + 0.5) / PROBES as f64;
        let covers = |k: &usize| {
            let at = [place(k % PROBES, 0), place(k / PROBES, 1)];
            prints.iter().any(|p| (0..2).all(|a| p.low[a] - p.spacing <= at[a] && at[a] <= p.high[a] + p.spacing))
        };
        (0..PROBES * PROBES).filter(covers).count() as f64 / (PROBES * PROBES) as f64
    };
    let finest_of = |(prints, levels): (&[Footprint], &[u8]), finest: u8| -> Vec<Footprint> {
        prints.iter().zip(levels).filter(|(_, level)| **level == finest).map(|(print, _)| *print).collect()
    };
    let is_mixed = |levels: &[u8], finest: u8| levels.iter().any(|level| *level > finest);
    let [z, c] = [world.finest_elevation_level(), world.finest_color_level()];
    let (fine_z, fine_c) = (finest_of(elevation, z), finest_of(color, c));
    // Where no elevation is as fine as the finest level, colour that is much finer wants it.
    let wants: Vec<&Footprint> = if fine_z.is_empty() { fine_c.iter().collect() } else { fine_z.iter().collect() };
    let is_elevation_nested = is_mixed(elevation.1, z) && share(&wants) < MOST_NESTED;
    let is_above_tint = i32::from(c) < i32::from(z) + world.elevation_over_color_levels();
    let is_color_mixed = is_mixed(color.1, c) || is_above_tint || is_mixed(elevation.1, z);
    let has_color = !color.0.is_empty();
    let is_color_nested = has_color && is_color_mixed && share(&fine_c.iter().collect::<Vec<_>>()) < MOST_NESTED;
    is_elevation_nested || is_color_nested
}

impl Plan {
    /// Plans the world of these sources.
    ///
    /// # Errors
    /// [`IngestError`]: a source that has no place in the CRS, colour beside the elevation, a world too large.
    pub fn new(
        target: &TargetCrs,
        elevation: &[Raster],
        color: &[Raster],
        options: PlanOptions,
        note: &mut dyn FnMut(Note),
    ) -> Result<Self, IngestError> {
        let prints = elevation.iter().map(|r| footprint(r, target, None)).collect::<Result<Vec<_>, _>>()?;
        let (mut spacing, origin, mut intervals) = post_lattice(&prints, options.spacing_m)?;
        let high = [0, 1].map(|a| origin[a] + intervals[a] as f64 * spacing);
        let focus = [0, 1].map(|a| 0.5 * (origin[a] + high[a]));
        let color_prints = color.iter().map(|r| footprint(r, target, Some(focus))).collect::<Result<Vec<_>, _>>()?;
        let overlaps =
            |p: &Footprint| (0..2).all(|a| p.low[a] - p.spacing < high[a] && p.high[a] + p.spacing > origin[a]);
        let beside: Vec<&Raster> =
            color.iter().zip(&color_prints).filter(|(_, p)| !overlaps(p)).map(|(raster, _)| raster).collect();
        if let Some(first) = beside.first().filter(|_| beside.len() == color.len()) {
            return Err(IngestError::source(&first.path, "(colour) does not overlap the elevation"));
        }
        for raster in beside {
            note(Note::Warning(format!(
                "{} (colour) does not overlap the elevation: it is left out",
                raster.path.display()
            )));
        }
        let (nz, nc) = (options.elevation_tile, options.color_tile);
        let depth = i32::from(nc.ilog2() as u8) - i32::from(nz.ilog2() as u8);
        let color_spacing = color_prints.iter().map(|p| p.spacing).fold(f64::INFINITY, f64::min);
        // How many levels the finest colour is above the one that shares a node with the finest elevation. Texels may
        // be up to 7 % coarser than the photo's pixels, rather than almost twice as fine.
        let offset = |spacing: f64| {
            if color_spacing.is_finite() {
                ((color_spacing / spacing).log2() + 0.1).floor() as i32 + depth
            } else {
                depth
            }
        };
        let mut above = offset(spacing);
        let most = nz.ilog2().cast_signed();
        if -above > most {
            let finer = (-above - most).min(12);
            note(Note::Info(format!(
                "colour is {:.0} times finer than elevation: elevation posts are put {} times closer, interpolated",
                spacing / color_spacing,
                1 << finer
            )));
            spacing /= f64::from(1 << finer);
            intervals = intervals.map(|n| n << finer);
            above = offset(spacing).max(-most);
        }
        let finest_elevation = (-above).max(0).cast_unsigned() as u8;
        let extent = intervals.map(|n| n << finest_elevation);
        let longer = extent[0].max(extent[1]);
        if longer > 1 << 28 {
            return Err(IngestError::usage(format!(
                "the world would have {longer} lattice intervals along a side, expected at most {}; choose a coarser --spacing",
                1 << 28
            )));
        }
        let levels = longer.div_ceil(u64::from(nz)).next_power_of_two().ilog2() as u8 + 1;
        let levels = levels.max(finest_elevation + 1);
        let fields = WorldFields {
            origin,
            lattice_unit_m: spacing / f64::from(1u32 << finest_elevation),
            extent: extent.map(|n| n as u32),
            elevation_tile: nz,
            color_tile: nc,
            levels,
            finest_elevation_level: finest_elevation,
            finest_color_level: (above.max(0).cast_unsigned() as u8).min(levels - 1),
        };
        if !(fields.lattice_unit_m > 1e-6 && fields.lattice_unit_m < 1e6) {
            return Err(IngestError::usage(format!(
                "posts would be {} m apart, expected from a thousandth of a millimetre to 1000 km: is the CRS of the data right? \
                 (--spacing METRES chooses another distance)",
                fields.lattice_unit_m
            )));
        }
        let world = World::new(fields)
            .map_err(|e| IngestError::usage(format!("the data make no world that can be stored: {e}")))?;
        let cell = world.color_spacing_m(world.finest_color_level());
        let elevation_levels: Vec<u8> =
            prints.iter().map(|p| own_level(&world, p.spacing / spacing, world.finest_elevation_level())).collect();
        let color_levels: Vec<u8> =
            color_prints.iter().map(|p| own_level(&world, p.spacing / cell, world.finest_color_level())).collect();
        let is_nested = is_nested(&world, (&prints, &elevation_levels), (&color_prints, &color_levels));
        Ok(Self {
            elevation_levels,
            color_levels,
            is_nested,
            world,
            elevation: Lattice { first: origin, step: spacing },
            color: Lattice { first: origin.map(|v| v + 0.5 * cell), step: cell },
            elevation_bounds: prints.iter().map(Footprint::bounds).collect(),
            color_bounds: color_prints.iter().map(Footprint::bounds).collect(),
        })
    }

    /// Posts of elevation level `q`, columns and rows: they cover the extent.
    #[must_use]
    pub fn elevation_size(&self, q: u8) -> [u64; 2] {
        self.world.extent().map(|e| u64::from(e).div_ceil(1 << q) + 1)
    }

    /// Texels of colour level `q`, columns and rows: they cover the extent.
    #[must_use]
    pub fn color_size(&self, q: u8) -> [u64; 2] {
        let (nz, nc) = (u64::from(self.world.elevation_tile()), u64::from(self.world.color_tile()));
        self.world.extent().map(|e| (u64::from(e) * nc).div_ceil(nz << q))
    }

    /// Bytes that the levels need on disk while the database is made, and the database itself at most.
    #[must_use]
    pub fn disk_bytes(&self) -> u64 {
        if self.is_nested {
            let bytes = |bounds: &[Bounds], each: f64| -> f64 {
                bounds.iter().map(|b| each * samples(b).iter().product::<f64>()).sum()
            };
            // A tint as fine as the elevation.
            let elevation = bytes(&self.elevation_bounds, 4.0 + 2.0 + 3.0 + 1.0);
            return ((elevation + bytes(&self.color_bounds, 3.0 + 1.0)) * 4.0 / 3.0) as u64;
        }
        let area = |size: [u64; 2]| size[0].saturating_mul(size[1]);
        let elevation = area(self.elevation_size(self.world.finest_elevation_level())).saturating_mul(4 + 2);
        let color = area(self.color_size(self.world.finest_color_level())).saturating_mul(3 + 1);
        elevation.saturating_add(color).saturating_mul(4) / 3
    }

    /// Tiles of both layers, about, when the finest levels are only made where the data are.
    #[must_use]
    pub fn nested_nodes(&self) -> u64 {
        // Half a tile more on each side, and the rim of coarser nodes around.
        let nodes = |bounds: &[Bounds], side: f64| -> f64 {
            bounds.iter().map(|b| samples(b).iter().map(|n| n / side + 4.0).product::<f64>()).sum()
        };
        let elevation = nodes(&self.elevation_bounds, f64::from(self.world.elevation_tile()));
        let color = nodes(&self.color_bounds, f64::from(self.world.color_tile()));
        (2.0 * (elevation + color)) as u64
    }

    /// Whether a source's samples are copied, not resampled, to a finest level.
    #[must_use]
    pub fn is_exact(lattice: &Lattice, target: &TargetCrs, raster: &Raster) -> bool {
        let [x0, dx, _, y0, _, dy] = raster.affine.0;
        let is_same = |d: f64| (d.abs() / lattice.step - 1.0).abs() < 1e-6;
        let is_on = |edge: f64, d: f64, first: f64| {
            let offset = (edge + 0.5 * d - first) / lattice.step;
            (offset - offset.round()).abs() < 1e-3
        };
        target.is_of(raster)
            && raster.affine.is_axis_parallel()
            && is_same(dx)
            && is_same(dy)
            && is_on(x0, dx, lattice.first[0])
            && is_on(y0, dy, lattice.first[1])
    }
}

/// Samples of a source, about, columns and rows.
fn samples(bounds: &Bounds) -> [f64; 2] {
    [0, 1].map(|a| (bounds.high[a] - bounds.low[a]) / bounds.pixel + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spacings_are_rounded_to_three_digits() {
        assert_eq!(round_spacing(25.6789), 25.7);
        assert_eq!(round_spacing(0.123_456), 0.123);
        assert_eq!(round_spacing(9_273.4), 9270.0);
    }

    #[test]
    fn a_lattice_of_its_own_is_kept() {
        let print =
            Footprint { low: [105.0, 7.5], high: [205.0, 57.5], spacing: 10.0, focus: [0.0; 2], is_lattice: true };
        let (spacing, origin, intervals) = post_lattice(&[print], None).unwrap();
        assert_eq!((spacing, origin, intervals), (10.0, [105.0, 7.5], [10, 5]));
    }

    #[test]
    fn other_data_get_a_lattice_of_multiples_inside() {
        let print =
            Footprint { low: [101.0, 7.5], high: [199.0, 57.5], spacing: 10.04, focus: [0.0; 2], is_lattice: false };
        let (spacing, origin, intervals) = post_lattice(&[print], None).unwrap();
        assert_eq!(spacing, 10.0);
        assert_eq!((origin, intervals), ([110.0, 10.0], [8, 4]));
        let (_, _, single) = post_lattice(&[Footprint { high: [101.0, 7.5], ..print }], None).unwrap();
        assert_eq!(single, [1, 1]);
    }
}
