//! The picture of a body: its colour sources, or a tint of its heights.

use super::base::Base;
use super::image::{Image, RowMap};
use super::place::Degrees;
use crate::IngestError;
use crate::source::readers::{ColorReader, Reader};
use crate::source::values::ColorValues;
use crate::source::{Note, Raster};
use crate::store::{Level, Rect, Rgb};
use crate::tint::{Place, Tint};
use crate::work::Work;
use std::io;
use std::path::Path;
use terravision_common::tint::HeightColors;

/// Pixels that are read at a time.
const MOST_PIXELS: usize = 2 << 20;
/// A picture may end this many degrees before a pole; its last row is repeated there.
const WIDEST_GAP_DEG: f64 = 10.0;

/// Pixels of a tint are as large as the lattice's cells.
pub(super) fn tint(base: &Base, body: &str, folder: &Path, work: &Work) -> Result<(Image, HeightColors), IngestError> {
    let fail = |source: io::Error| IngestError::Output { source, path: folder.to_owned() };
    let grid = &base.grid;
    let fields = grid.world.fields();
    let spacing_m = fields.body.map_or(1.0, |at| at.semi_major_m * at.row_step_deg.to_radians());
    let (overview, halvings) = base.overview(1 << 20);
    let overview = (overview, spacing_m * f64::from(1u32 << halvings));
    let place = Place { body, latitude_deg: None };
    let tint = Tint::new(base.finest(), spacing_m, spacing_m, overview, place).map_err(fail)?;
    let colors = tint.colors();
    let (columns, rows) = (grid.columns() as usize, u64::from(grid.rows()) + 1);
    let level = Level::<Rgb>::create(folder, [columns as u64, rows]).map_err(fail)?;
    work.each(
        "tint",
        rows as usize,
        || Ok(()),
        |(), row| {
            let row = row as i64;
            let near = [row - 1, row, row + 1].map(|row| base.row(0, row));
            let [south, own, north] = near;
            let (south, own, north) = (south.map_err(fail)?, own.map_err(fail)?, north.map_err(fail)?);
            let per_row = grid.columns_per_row(row as u64);
            let spacing = [spacing_m / per_row.min(1e6), spacing_m];
            let pixels: Vec<Rgb> = (0..columns)
                .map(|k| {
                    let along = own[(k + 1) % columns] - own[(k + columns - 1) % columns];
                    // All around a pole slopes have no direction.
                    let along = if per_row > 1e6 { 0.0 } else { along / (2.0 * spacing[0]) as f32 };
                    let shade = tint.shade_of([along, (north[k] - south[k]) / (2.0 * spacing[1]) as f32]);
                    colors.color(own[k]).map(|v| (v * shade).round().clamp(0.0, 255.0) as u8)
                })
                .collect();
            level.write(Rect::new([0, row], [columns, 1]), &pixels).map_err(fail)
        },
    )?;
    let half_column = std::f64::consts::PI / f64::from(grid.columns());
    let image = Image::of(level, grid.globe.longitude(0) - half_column, RowMap::Lattice, folder, work)?;
    Ok((image, colors))
}

/// The picture of a colour source that goes all around.
pub(super) fn of_source(
    (raster, values): &(Raster, ColorValues),
    folder: &Path,
    work: &Work,
    note: &mut dyn FnMut(Note),
) -> Result<Image, IngestError> {
    let fail = |source: io::Error| IngestError::Output { source, path: folder.to_owned() };
    let wrong = |reason: String| IngestError::source(raster.path(), format!("(colour) {reason}"));
    let at =
        Degrees::of(raster)?.ok_or_else(|| wrong("is not over longitude and latitude, as a body's is".to_owned()))?;
    let [dx, dy] = at.step;
    let around = (360.0 / dx).round();
    let columns = around as usize;
    if dx <= 0.0 || (360.0 / dx - around).abs() > 0.5 || at.size[0] < columns || at.size[0] > columns + 1 {
        return Err(wrong(format!(
            "covers {:.2} degrees of longitude, expected 360: a body's picture goes all around",
            at.cover()[0]
        )));
    }
    let [south, north] = at.latitudes();
    let height = dy.abs();
    let gaps = [south - 0.5 * height + 90.0, 90.0 - north - 0.5 * height];
    if gaps.iter().any(|gap| *gap > WIDEST_GAP_DEG || *gap < -0.6 * height) {
        return Err(wrong(format!(
            "has rows from {south:.2} to {north:.2} degrees of latitude, expected them from pole to pole within {WIDEST_GAP_DEG} degrees"
        )));
    }
    // Rows of pixels from pole to pole: whole ones, so that a picture without gaps keeps its own.
    let missing = gaps.map(|gap| (gap / height).round().max(0.0) as usize);
    let rows = missing[0] + at.size[1] + missing[1];
    let level = Level::<Rgb>::create(folder, [columns as u64, rows as u64]).map_err(fail)?;
    let at_once = (MOST_PIXELS / columns).clamp(1, 256);
    let chunks = at.size[1].div_ceil(at_once);
    let mut voids = 0u64;
    work.in_order(
        "colour",
        chunks,
        || ColorReader::open(raster, values),
        |reader, chunk| {
            let top = chunk * at_once;
            let count = at_once.min(at.size[1] - top);
            let window = reader.read([0, top], [columns, count])?;
            let mut unknown = 0;
            for line in 0..count {
                let pixels: Vec<Rgb> = (0..columns)
                    .map(|column| match window.known(line * columns + column) {
                        Some(pixel) => pixel.map(|v| v.round().clamp(0.0, 255.0) as u8),
                        None => {
                            unknown += 1;
                            [0; 3]
                        }
                    })
                    .collect();
                let from_south = if dy > 0.0 { top + line } else { at.size[1] - 1 - top - line };
                let rect = Rect::new([0, (missing[0] + from_south) as i64], [columns, 1]);
                level.write(rect, &pixels).map_err(fail)?;
            }
            Ok(unknown)
        },
        |unknown| {
            voids += unknown;
            Ok(())
        },
    )?;
    if voids > 0 {
        note(Note::Warning(format!(
            "{} (colour) has no data at {voids} pixels: they are black",
            raster.path().display()
        )));
    }
    let line = |row: usize| Rect::new([0, row as i64], [columns, 1]);
    for (gap, edge) in [(0..missing[0], missing[0]), (rows - missing[1]..rows, rows - missing[1] - 1)] {
        let nearest = level.read(line(edge)).map_err(fail)?;
        gap.into_iter().try_for_each(|row| level.write(line(row), &nearest)).map_err(fail)?;
    }
    let west = (at.first[0] - 0.5 * dx).to_radians();
    Image::of(level, west, RowMap::Degrees, folder, work)
}
