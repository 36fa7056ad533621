//! The finest level of a body's heights: the samples of its sources, where they have them.

use super::base::mean;
use super::grid::Grid;
use super::place::{Degrees, LatticePlace};
use crate::IngestError;
use crate::sample::elevation::quantized;
use crate::source::readers::{ElevationReader, Reader};
use crate::source::values::ElevationValues;
use crate::source::{Note, Raster};
use crate::store::{Level, Rect};
use crate::work::Work;
use std::path::Path;

/// A gap at a pole may be so wide, degrees.
const WIDEST_GAP_DEG: f64 = 10.0;
/// Samples that are read at a time.
const MOST_SAMPLES: usize = 4 << 20;
/// Rows that lie together in most files, and columns.
const FILE_BLOCK: usize = 256;

/// A source on the lattice.
struct Placed<'a> {
    raster: &'a Raster,
    values: &'a ElevationValues,
    /// Lattice column and row of its first pixel.
    first: [i64; 2],
    goes_north: bool,
    /// Columns that are used: one that repeats the first is not.
    columns: usize,
}

impl Placed<'_> {
    /// Its pixels in lattice columns `from` to `to`: the first pixel, the first lattice column, and how
    /// many. Two pieces, where it begins within.
    fn pieces(&self, from: usize, to: usize, around: usize) -> impl Iterator<Item = [usize; 3]> {
        let (first, end) = (self.first[0] as usize, self.first[0] as usize + self.columns);
        [0, around].into_iter().filter_map(move |turn| {
            let (low, high) = (first.max(from + turn), end.min(to + turn));
            (low < high).then(|| [low - first, low - turn, high - low])
        })
    }

    /// Its row of pixels in a lattice row, if it has one.
    fn pixel_row(&self, row: i64) -> Option<usize> {
        let pixel = if self.goes_north { row - self.first[1] } else { self.first[1] - row };
        usize::try_from(pixel).ok().filter(|pixel| *pixel < self.raster.size()[1])
    }
}

/// What the sources have.
#[derive(Debug)]
pub(super) struct Heights {
    /// All lattice rows, the south pole's first.
    pub(super) level: Level<f32>,
    pub(super) range: [f32; 2],
}

/// Reads all sources.
pub(super) fn read(
    grid: &Grid,
    place: &LatticePlace,
    sources: &[(Raster, ElevationValues)],
    folder: &Path,
    work: &Work,
    note: &mut dyn FnMut(Note),
) -> Result<Heights, IngestError> {
    let fail = |source| IngestError::Output { source, path: folder.to_owned() };
    let placed = sources
        .iter()
        .map(|(raster, values)| {
            let at = Degrees::of(raster)?.ok_or_else(|| {
                IngestError::source(raster.path(), "is not over longitude and latitude, as the first elevation file is")
            })?;
            let (first, goes_north) = place.offset(&at, raster.path())?;
            let columns = raster.size()[0].min(place.columns as usize);
            Ok(Placed { raster, values, first, goes_north, columns })
        })
        .collect::<Result<Vec<_>, IngestError>>()?;
    let columns = grid.columns() as usize;
    let last = i64::from(grid.rows());
    let level = Level::create(folder, [columns as u64, last as u64 + 1]).map_err(fail)?;
    let with_data: Vec<i64> = (0..=last).filter(|row| placed.iter().any(|p| p.pixel_row(*row).is_some())).collect();
    let [from, to] = match (with_data.first(), with_data.last()) {
        (Some(from), Some(to)) => [*from, *to],
        _ => return Err(IngestError::source(sources[0].0.path(), "has no row between the poles")),
    };
    check_gaps(place, [from, last - to], sources[0].0.path())?;
    let at_once = (MOST_SAMPLES / columns.max(1)).clamp(1, FILE_BLOCK);
    // Whole blocks of the file: a block that two threads read is unpacked twice.
    let (at_once, wide) = match at_once < FILE_BLOCK {
        true => (FILE_BLOCK, MOST_SAMPLES / FILE_BLOCK / FILE_BLOCK * FILE_BLOCK),
        false => (at_once, columns),
    };
    let across = columns.div_ceil(wide);
    let chunks = ((to - from + 1) as usize).div_ceil(at_once) * across;
    let mut range = [f32::MAX, f32::MIN];
    work.in_order(
        "elevation",
        chunks,
        || placed.iter().map(|p| ElevationReader::open(p.raster, p.values)).collect::<Result<Vec<_>, _>>(),
        |readers, chunk| {
            // From the north, as most files are.
            let north = to - (chunk / across * at_once) as i64;
            let south = (north - at_once as i64 + 1).max(from);
            let west = chunk % across * wide;
            let east = (west + wide).min(columns);
            let rows = read_rows(&placed, readers, [south, north], [west, east], columns)?;
            let rect = Rect::new([west as i64, south], [east - west, (north - south + 1) as usize]);
            level.write(rect, &rows).map_err(fail)?;
            Ok(rows.iter().fold([f32::MAX, f32::MIN], |r, h| [r[0].min(*h), r[1].max(*h)]))
        },
        |part| {
            range = [range[0].min(part[0]), range[1].max(part[1])];
            Ok(())
        },
    )?;
    let made_up = finish_poles(&level, [from, to, last], columns).map_err(fail)?;
    tell_gaps(place, made_up, note);
    Ok(Heights { level, range })
}

fn check_gaps(place: &LatticePlace, gaps: [i64; 2], path: &Path) -> Result<(), IngestError> {
    let widest = gaps[0].max(gaps[1]) as f64 * place.row_step_deg;
    if widest <= WIDEST_GAP_DEG {
        return Ok(());
    }
    Err(IngestError::source(
        path,
        format!(
            "ends {widest:.1} degrees before a pole, expected at most {WIDEST_GAP_DEG}: a body needs elevation from pole to pole \
             (--plane makes a plane of it)"
        ),
    ))
}

fn tell_gaps(place: &LatticePlace, made_up: [u64; 2], note: &mut dyn FnMut(Note)) {
    let [south, north] = made_up.map(|rows| rows as f64 * place.row_step_deg);
    // Of a pole between two rows nothing need be told.
    if made_up.iter().any(|rows| *rows > 1) {
        note(Note::Info(format!(
            "elevation ends {south:.2} degrees before the south pole and {north:.2} degrees before the north pole: heights \
             there are made up, from the last row to its mean at the pole"
        )));
    }
}

/// Heights of lattice rows from `south` to `north`, and of columns from `west` to before `east`.
fn read_rows(
    placed: &[Placed<'_>],
    readers: &[ElevationReader<'_>],
    [south, north]: [i64; 2],
    [west, east]: [usize; 2],
    around: usize,
) -> Result<Vec<f32>, IngestError> {
    let width = east - west;
    let mut rows = vec![f32::NAN; width * (north - south + 1) as usize];
    // The topmost last.
    for (source, reader) in placed.iter().zip(readers).rev() {
        let with_data: Vec<i64> = (south..=north).filter(|row| source.pixel_row(*row).is_some()).collect();
        let (Some(first), Some(last)) = (with_data.first(), with_data.last()) else { continue };
        let pixels = [*first, *last].map(|row| source.pixel_row(row).unwrap_or(0));
        let top = pixels[0].min(pixels[1]);
        for [pixel, column, count] in source.pieces(west, east, around) {
            let window = reader.read([pixel, top], [count, pixels[0].max(pixels[1]) - top + 1])?;
            for row in *first..=*last {
                let pixel_row = source.pixel_row(row).unwrap_or(top) - top;
                let line = &mut rows[(row - south) as usize * width + column - west..][..count];
                for (k, to) in line.iter_mut().enumerate() {
                    if let Some([height]) = window.known(pixel_row * count + k) {
                        *to = quantized(height);
                    }
                }
            }
        }
    }
    match rows.iter().position(|height| height.is_nan()) {
        None => Ok(rows),
        Some(at) => {
            let voids = rows.iter().filter(|height| height.is_nan()).count();
            Err(IngestError::source(
                placed[0].raster.path(),
                format!(
                    "has no data at {voids} or more places (lattice column {}, row {}): elevation of a body must go all around, \
                     without voids (gdal_fillnodata.py fills them; --plane makes a plane of it)",
                    west + at % width,
                    south + (at / width) as i64
                ),
            ))
        }
    }
}

/// Makes up the rows beyond the sources, and gives each pole one height. Returns how many rows were
/// made up in the south and in the north.
fn finish_poles(level: &Level<f32>, [from, to, last]: [i64; 3], columns: usize) -> std::io::Result<[u64; 2]> {
    let row_rect = |row: i64| Rect::new([0, row], [columns, 1]);
    for (nearest, pole) in [(from, 0), (to, last)] {
        let edge = level.read(row_rect(nearest))?;
        let middle = quantized(mean(&edge));
        let gap = (nearest - pole).abs();
        for step in 1..=gap {
            let share = step as f32 / gap as f32;
            let row = nearest + step * (pole - nearest).signum();
            let heights: Vec<f32> = edge.iter().map(|h| quantized(h + share * (middle - h))).collect();
            level.write(row_rect(row), &heights)?;
        }
        level.write(row_rect(pole), &vec![middle; columns])?;
    }
    Ok([from as u64, (last - to) as u64])
}
