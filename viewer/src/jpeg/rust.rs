//! By an encoder in Rust.

use super::{JpegError, JpegQuality};
use jpeg_encoder::{ColorType, Encoder, EncodingError, SamplingFactor};

pub(super) fn compress(rgba: &[u8], size: [u32; 2], quality: JpegQuality) -> Result<Vec<u8>, JpegError> {
    let mut file = Vec::with_capacity(rgba.len() / 16);
    let mut encoder = Encoder::new(&mut file, quality.quality);
    encoder.set_sampling_factor(if quality.has_halved_chroma { SamplingFactor::F_2_2 } else { SamplingFactor::F_1_1 });
    let [width, height] = size.map(|side| u16::try_from(side).unwrap_or(u16::MAX));
    let refused = |error: EncodingError| JpegError::Encoder(error.to_string());
    encoder.encode(rgba, width, height, ColorType::Rgba).map_err(refused)?;
    Ok(file)
}
