//! By libjpeg-turbo.

use super::{JpegError, JpegQuality};
use turbojpeg::{Compressor, Image, PixelFormat, Subsamp};

pub(super) fn compress(rgba: &[u8], size: [u32; 2], quality: JpegQuality) -> Result<Vec<u8>, JpegError> {
    let refused = |error: turbojpeg::Error| JpegError::Encoder(error.to_string());
    let [width, height] = size.map(|side| side as usize);
    let mut compressor = Compressor::new().map_err(refused)?;
    compressor.set_quality(i32::from(quality.quality));
    compressor.set_subsamp(if quality.has_halved_chroma { Subsamp::Sub2x2 } else { Subsamp::None });
    let image = Image { pixels: rgba, width, pitch: 4 * width, height, format: PixelFormat::RGBA };
    compressor.compress_to_vec(image).map_err(refused)
}
