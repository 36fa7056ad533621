//! Reads float TIFFs: depth and ground positions, as `still --depth` and `--ground` write them.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use tiff::TiffError;
use tiff::decoder::{Decoder, DecodingResult, Limits};

/// Width, height, and values as f64, rows from the top, bands interleaved.
///
/// # Errors
/// When it cannot be read or is not of floats.
pub fn read_floats(path: &Path) -> Result<(usize, usize, Vec<f64>), TiffError> {
    let mut decoder = Decoder::new(BufReader::new(File::open(path)?))?.with_limits(Limits::unlimited());
    let (width, height) = decoder.dimensions()?;
    let values = match decoder.read_image()? {
        DecodingResult::F32(values) => values.into_iter().map(f64::from).collect(),
        DecodingResult::F64(values) => values,
        _ => return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, "its values are no floats").into()),
    };
    Ok((width as usize, height as usize, values))
}
