//! Reads the rasters that a world was ingested from, for the reference renderer, and writes worlds
//! for tests: uncommon encodings are not needed, independence of the code under test is.

use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::Path;
use terravision_testkit::reference::{Colors, Heights};
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::encoder::{TiffEncoder, TiffValue, colortype};
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
    let origin = [raster.north_west[0] + half, raster.north_west[1] - (raster.height as f64 - 0.5) * raster.cell_m];
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

/// GeoKeys of a projected CRS, WGS 84 / UTM zone 32N; the raster type is to be set.
fn utm_keys(raster_type: u16) -> [u16; 16] {
    [1, 1, 0, 3, 1024, 0, 1, 1, RASTER_TYPE_KEY, 0, 1, raster_type, 3072, 0, 1, 32632]
}

/// Writes posts, rows from south to north, the south west one at `origin`, as a float32 GeoTIFF.
///
/// # Panics
/// When it cannot be written.
pub fn write_heights(path: &Path, columns: usize, rows: usize, origin: [f64; 2], spacing_m: f64, posts: &[f32]) {
    let north = origin[1] + (rows - 1) as f64 * spacing_m;
    let flipped: Vec<f32> = posts.chunks_exact(columns).rev().flatten().copied().collect();
    let tie = [0.0, 0.0, 0.0, origin[0], north, 0.0];
    write::<colortype::Gray32Float>(path, [columns, rows], tie, spacing_m, PIXEL_IS_POINT, &flipped);
}

/// Writes cells, rows from south to north, the south west corner at `origin`, as an RGB GeoTIFF.
///
/// # Panics
/// When it cannot be written.
pub fn write_colors(path: &Path, width: usize, height: usize, origin: [f64; 2], texel_m: f64, rgb: &[[u8; 3]]) {
    let north = origin[1] + height as f64 * texel_m;
    let flipped: Vec<u8> = rgb.chunks_exact(width).rev().flatten().flatten().copied().collect();
    let tie = [0.0, 0.0, 0.0, origin[0], north, 0.0];
    write::<colortype::RGB8>(path, [width, height], tie, texel_m, 1, &flipped);
}

fn write<C: colortype::ColorType>(
    path: &Path,
    [width, height]: [usize; 2],
    tie: [f64; 6],
    cell_m: f64,
    raster_type: u16,
    values: &[C::Inner],
) where
    [C::Inner]: TiffValue,
{
    let written = File::create(path).map_err(tiff::TiffError::from).and_then(|file| {
        let mut encoder = TiffEncoder::new(BufWriter::new(file))?;
        let mut image = encoder.new_image::<C>(width as u32, height as u32)?;
        image.encoder().write_tag(Tag::ModelPixelScaleTag, &[cell_m, cell_m, 0.0][..])?;
        image.encoder().write_tag(Tag::ModelTiepointTag, &tie[..])?;
        image.encoder().write_tag(Tag::GeoKeyDirectoryTag, &utm_keys(raster_type)[..])?;
        image.write_data(values)
    });
    written.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rasters_come_back_where_they_were_written() {
        let folder = crate::folder::TestFolder::new("geotiff");
        let posts: Vec<f32> = (0..12).map(|k| k as f32).collect();
        write_heights(&folder.join("h.tif"), 4, 3, [100.0, 200.0], 10.0, &posts);
        let heights = read_heights(&folder.join("h.tif")).unwrap();
        assert_eq!((heights.origin(), heights.extent_m()), ([100.0, 200.0], [30.0, 20.0]));
        assert_eq!(heights.at(110.0, 220.0), Some(9.0));
        let cells: Vec<[u8; 3]> = (0..12).map(|k| [k, 0, 255 - k]).collect();
        write_colors(&folder.join("c.tif"), 4, 3, [100.0, 200.0], 5.0, &cells);
        let colors = read_colors(&folder.join("c.tif")).unwrap();
        assert_eq!(colors.nearest(102.0, 202.0), [0, 0, 255]);
        assert_eq!(colors.nearest(118.0, 213.0), [11, 0, 244]);
    }
}
