//! Reads the rasters that a world was ingested from, for the reference renderer: uncommon encodings are not needed,
//! independence of the code under test is.

use crate::reference::{Colors, Heights};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

/// Why a raster could not be read.
#[derive(Debug)]
pub struct GeoTiffError {
    message: String,
}

impl std::fmt::Display for GeoTiffError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for GeoTiffError {}

fn fail(path: &Path, what: impl std::fmt::Display) -> GeoTiffError {
    GeoTiffError { message: format!("{}: {what}", path.display()) }
}

struct Raster {
    width: usize,
    height: usize,
    /// Easting and northing of the north west *corner* of the first cell.
    north_west: [f64; 2],
    cell_m: f64,
    pixels: DecodingResult,
}

/// `GTRasterTypeGeoKey` (GeoTIFF 1.1, requirement 9) and its value for posts.
const RASTER_TYPE_KEY: u16 = 1025;
const PIXEL_IS_POINT: u16 = 2;

fn read(path: &Path) -> Result<Raster, GeoTiffError> {
    let file = File::open(path).map_err(|error| fail(path, error))?;
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(|error| fail(path, error))?;
    decoder = decoder.with_limits(Limits::unlimited());
    let (width, height) = decoder.dimensions().map_err(|error| fail(path, error))?;
    let scale = decoder.get_tag_f64_vec(Tag::ModelPixelScaleTag).map_err(|error| fail(path, error))?;
    let tie = decoder.get_tag_f64_vec(Tag::ModelTiepointTag).map_err(|error| fail(path, error))?;
    let ([cell_m, cell_y, ..], [i, j, _, x, y, ..]) = (&scale[..], &tie[..]) else {
        return Err(fail(path, "no complete georeference"));
    };
    if (cell_m - cell_y).abs() > 1e-9 * cell_m {
        return Err(fail(path, "cells are not square"));
    }
    let keys = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).map_err(|error| fail(path, error))?;
    let is_point = keys.chunks_exact(4).skip(1).any(|key| key[0] == RASTER_TYPE_KEY && key[3] == PIXEL_IS_POINT);
    let shift = if is_point { 0.5 * cell_m } else { 0.0 };
    let north_west = [x - i * cell_m - shift, y + j * cell_m + shift];
    let pixels = decoder.read_image().map_err(|error| fail(path, error))?;
    Ok(Raster { width: width as usize, height: height as usize, north_west, cell_m: *cell_m, pixels })
}

/// A float32 elevation raster; its posts are the centres of its cells.
///
/// # Errors
/// [`GeoTiffError`] when it cannot be read or is of another kind.
pub fn read_heights(path: &Path) -> Result<Heights, GeoTiffError> {
    let raster = read(path)?;
    let DecodingResult::F32(pixels) = raster.pixels else { return Err(fail(path, "not float32")) };
    let half = 0.5 * raster.cell_m;
    let origin =
        [raster.north_west[0] + half, raster.north_west[1] - (raster.height as f64 - 0.5) * raster.cell_m];
    let values = pixels.chunks_exact(raster.width).rev().flatten().copied().collect();
    Ok(Heights::new(raster.width, raster.height, origin, raster.cell_m, values))
}

/// An RGB (or RGBA) 8 bit raster.
///
/// # Errors
/// [`GeoTiffError`] when it cannot be read or is of another kind.
pub fn read_colors(path: &Path) -> Result<Colors, GeoTiffError> {
    let raster = read(path)?;
    let DecodingResult::U8(pixels) = raster.pixels else { return Err(fail(path, "not 8 bit")) };
    let bands = pixels.len() / (raster.width * raster.height);
    if !(3..=4).contains(&bands) || pixels.len() != bands * raster.width * raster.height {
        return Err(fail(path, format_args!("{bands} bands, expected 3 or 4")));
    }
    let origin = [raster.north_west[0], raster.north_west[1] - raster.height as f64 * raster.cell_m];
    let rgb = pixels
        .chunks_exact(raster.width * bands)
        .rev()
        .flat_map(|row| row.chunks_exact(bands).map(|p| [p[0], p[1], p[2]]))
        .collect();
    Ok(Colors::new(raster.width, raster.height, origin, raster.cell_m, rgb))
}

/// A single- or three-band float TIFF without georeference, as `still --depth` and `--ground` write them: width,
/// height, values as f64, rows from the top, bands interleaved.
///
/// # Errors
/// [`GeoTiffError`] when it cannot be read or is not of floats.
pub fn read_floats(path: &Path) -> Result<(usize, usize, Vec<f64>), GeoTiffError> {
    let file = File::open(path).map_err(|error| fail(path, error))?;
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(|error| fail(path, error))?;
    decoder = decoder.with_limits(Limits::unlimited());
    let (width, height) = decoder.dimensions().map_err(|error| fail(path, error))?;
    let values = match decoder.read_image().map_err(|error| fail(path, error))? {
        DecodingResult::F32(values) => values.into_iter().map(f64::from).collect(),
        DecodingResult::F64(values) => values,
        _ => return Err(fail(path, "not of floats")),
    };
    Ok((width as usize, height as usize, values))
}
