//! The world's geometry: where posts and texels of the finest levels lie.
//!
//! A single source that is already in the database's CRS, with square pixels along the axes,
//! defines the lattice: its pixel centres become posts, so its heights are copied. Otherwise posts
//! lie on multiples of the spacing, which is the ground size of the finest source's pixels.

mod footprint;
mod lattice;
mod nesting;

pub use lattice::{Bounds, Lattice};

use crate::IngestError;
use crate::source::{Note, Raster, TargetCrs};
use footprint::{Footprint, footprint};
use nesting::{is_nested, own_level};
use terravision_common::world::{World, WorldFields};

/// Tile sizes, and options of the user.
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
        Self { elevation_tile: 32, color_tile: 256, spacing_m: None }
    }
}

/// The plan of a world.
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
    /// Whether the finest levels exist only where there are data.
    pub is_nested: bool,
}

/// Rounds a spacing to three digits.
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

/// Posts of the finest elevation level.
struct Posts {
    spacing: f64,
    origin: [f64; 2],
    intervals: [u64; 2],
}

/// Fails when no image overlaps the elevation, and reports those that do not.
fn check_overlap(
    color: &[Raster],
    prints: &[Footprint],
    [low, high]: [[f64; 2]; 2],
    note: &mut dyn FnMut(Note),
) -> Result<(), IngestError> {
    let overlaps = |p: &Footprint| (0..2).all(|a| p.low[a] - p.spacing < high[a] && p.high[a] + p.spacing > low[a]);
    let beside: Vec<&Raster> =
        color.iter().zip(prints).filter(|(_, print)| !overlaps(print)).map(|(raster, _)| raster).collect();
    if let Some(first) = beside.first().filter(|_| beside.len() == color.len()) {
        return Err(IngestError::source(first.path(), "(colour) does not overlap the elevation"));
    }
    for raster in beside {
        note(Note::Warning(format!(
            "{} (colour) does not overlap the elevation: it is left out",
            raster.path().display()
        )));
    }
    Ok(())
}

/// The world's numbers: levels for both layers. Colour that is very much finer than the elevation
/// draws its posts closer.
fn world_fields(
    Posts { mut spacing, origin, mut intervals }: Posts,
    color_spacing: f64,
    options: PlanOptions,
    note: &mut dyn FnMut(Note),
) -> Result<WorldFields, IngestError> {
    let (nz, nc) = (options.elevation_tile, options.color_tile);
    let depth = i32::from(nc.ilog2() as u8) - i32::from(nz.ilog2() as u8);
    // How many levels the finest colour is above the one that shares a node with the finest
    // elevation. Texels may be up to 7 % coarser than the photo's pixels, rather than almost twice
    // as fine.
    let offset = |spacing: f64| {
        if color_spacing.is_finite() { ((color_spacing / spacing).log2() + 0.1).floor() as i32 + depth } else { depth }
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
        body: None,
    };
    if !(fields.lattice_unit_m > 1e-6 && fields.lattice_unit_m < 1e6) {
        return Err(IngestError::usage(format!(
            "posts would be {} m apart, expected from a thousandth of a millimetre to 1000 km: is the CRS of the data right? \
             (--spacing METRES chooses another distance)",
            fields.lattice_unit_m
        )));
    }
    Ok(fields)
}

impl Plan {
    /// Plans the world of these sources.
    ///
    /// # Errors
    /// [`IngestError`]: a source that has no place in the CRS, colour beside the elevation, a world
    /// too large.
    pub fn new(
        target: &TargetCrs,
        elevation: &[Raster],
        color: &[Raster],
        options: PlanOptions,
        note: &mut dyn FnMut(Note),
    ) -> Result<Self, IngestError> {
        let prints = elevation.iter().map(|r| footprint(r, target, None)).collect::<Result<Vec<_>, _>>()?;
        let (spacing, origin, intervals) = post_lattice(&prints, options.spacing_m)?;
        let high = [0, 1].map(|a| origin[a] + intervals[a] as f64 * spacing);
        let focus = [0, 1].map(|a| 0.5 * (origin[a] + high[a]));
        let color_prints = color.iter().map(|r| footprint(r, target, Some(focus))).collect::<Result<Vec<_>, _>>()?;
        check_overlap(color, &color_prints, [origin, high], note)?;
        let color_spacing = color_prints.iter().map(|p| p.spacing).fold(f64::INFINITY, f64::min);
        let fields = world_fields(Posts { spacing, origin, intervals }, color_spacing, options, note)?;
        let spacing = fields.lattice_unit_m * f64::from(1u32 << fields.finest_elevation_level);
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

    /// Bytes that the levels need on disk while the database is made, and the database itself at
    /// most.
    #[must_use]
    pub fn disk_bytes(&self) -> u64 {
        if self.is_nested {
            let bytes = |bounds: &[Bounds], each: f64| -> f64 {
                bounds.iter().map(|b| each * samples(b).iter().product::<f64>()).sum()
            };
            // Heights, tiles, the highest ground in cells; a tint as fine as the elevation.
            let elevation = bytes(&self.elevation_bounds, 4.0 + 2.0 + 1.0 + 3.0 + 1.0);
            return ((elevation + bytes(&self.color_bounds, 3.0 + 1.0)) * 4.0 / 3.0) as u64;
        }
        let area = |size: [u64; 2]| size[0].saturating_mul(size[1]);
        let elevation = area(self.elevation_size(self.world.finest_elevation_level())).saturating_mul(4 + 2 + 1);
        let color = area(self.color_size(self.world.finest_color_level())).saturating_mul(3 + 1);
        elevation.saturating_add(color).saturating_mul(4) / 3
    }

    /// Approximate number of tiles of both layers, when the finest levels exist only where there
    /// are data.
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
        let [x0, dx, _, y0, _, dy] = raster.affine().0;
        let is_same = |d: f64| (d.abs() / lattice.step - 1.0).abs() < 1e-6;
        let is_on = |edge: f64, d: f64, first: f64| {
            let offset = (edge + 0.5 * d - first) / lattice.step;
            (offset - offset.round()).abs() < 1e-3
        };
        target.is_of(raster)
            && raster.affine().is_axis_parallel()
            && is_same(dx)
            && is_same(dy)
            && is_on(x0, dx, lattice.first[0])
            && is_on(y0, dy, lattice.first[1])
    }
}

/// Approximate number of samples of a source, columns and rows.
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
