//! The colour tile: a JPEG of `(Nc + 8)²` texels, then "TVc1" and the crc32 of all bytes before it.

use crate::bug::contained;
use crate::texels::TexelFormat;
use crate::world::{COLOR_MIPS, World};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const MAGIC: &[u8; 4] = b"TVc1";
const TRAILER_BYTES: usize = 8;

/// Why bytes are not a colour tile.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ColorCodecError {
    /// They do not end like a colour tile.
    #[error("it is not a colour tile ({found} bytes)")]
    NotATile {
        /// How many there are.
        found: usize,
    },
    /// They have changed since they were written.
    #[error("its checksum is {found:08x}, expected {expected:08x}")]
    Checksum {
        /// What the tile says.
        expected: u32,
        /// What its bytes give.
        found: u32,
    },
    /// It is of another size.
    #[error("it has {}x{} texels, expected {expected}x{expected}", found[0], found[1])]
    Size {
        /// What the world has.
        expected: u32,
        /// What the picture has.
        found: [usize; 2],
    },
    /// It is not a picture.
    #[error("its picture does not decode: {message}")]
    Picture {
        /// What the decoder says.
        message: String,
    },
}

/// Bytes of a decoded colour tile: RGBA8 of its mip levels back to back.
#[must_use]
pub fn color_tile_bytes(world: &World) -> usize {
    TexelFormat::Rgba8.tile_bytes(world.color_stored()) as usize
}

/// Appends the trailer that makes a picture a tile.
pub fn seal_color_tile(picture: &mut Vec<u8>) {
    let checksum = crc32fast::hash(picture);
    picture.extend(MAGIC);
    picture.extend(checksum.to_le_bytes());
}

/// Verifies the checksum of a tile, and returns the picture in it.
///
/// # Errors
/// [`ColorCodecError`].
pub(crate) fn open_color_tile(bytes: &[u8]) -> Result<&[u8], ColorCodecError> {
    let Some((picture, trailer)) = bytes.split_last_chunk::<TRAILER_BYTES>() else {
        return Err(ColorCodecError::NotATile { found: bytes.len() });
    };
    if &trailer[..4] != MAGIC {
        return Err(ColorCodecError::NotATile { found: bytes.len() });
    }
    let expected = u32::from_le_bytes([trailer[4], trailer[5], trailer[6], trailer[7]]);
    let found = crc32fast::hash(picture);
    if found != expected {
        return Err(ColorCodecError::Checksum { expected, found });
    }
    Ok(picture)
}

/// Decodes a tile of `side` texels, borders included, into RGBA8 mip levels back to back, row 0 in
/// the north.
///
/// # Errors
/// [`ColorCodecError`].
///
/// # Panics
/// When `out` is shorter than [`color_tile_bytes`].
pub fn decode_color_tile(bytes: &[u8], side: u32, out: &mut [u8]) -> Result<(), ColorCodecError> {
    decode_color_picture(bytes, side, out)?;
    make_color_mips(out, side);
    Ok(())
}

/// [`decode_color_tile`], the first level alone.
///
/// # Errors
/// [`ColorCodecError`].
///
/// # Panics
/// When `out` is shorter than that level.
pub fn decode_color_picture(bytes: &[u8], side: u32, out: &mut [u8]) -> Result<(), ColorCodecError> {
    let picture = open_color_tile(bytes)?;
    let decoded = contained(|| decode_picture(picture, side as usize, out));
    decoded.unwrap_or_else(|error| Err(ColorCodecError::Picture { message: error.to_string() }))
}

fn decode_picture(picture: &[u8], side: usize, out: &mut [u8]) -> Result<(), ColorCodecError> {
    // Check limits first: nothing is allocated for a picture of another size.
    let options = DecoderOptions::new_fast()
        .set_strict_mode(true)
        .set_max_width(side)
        .set_max_height(side)
        .jpeg_set_out_colorspace(ColorSpace::RGBA);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(picture), options);
    let failed = |e: zune_jpeg::errors::DecodeErrors| ColorCodecError::Picture { message: e.to_string() };
    decoder.decode_headers().map_err(failed)?;
    let found = decoder.info().map_or([0; 2], |info| [usize::from(info.width), usize::from(info.height)]);
    if found != [side; 2] || decoder.output_buffer_size() != Some(side * side * 4) {
        return Err(ColorCodecError::Size { expected: side as u32, found });
    }
    decoder.decode_into(&mut out[..side * side * 4]).map_err(failed)
}

/// The mean of two texels and the two below them, rounded to nearest. Two channels at a time, in 16
/// bits each of a word, which took 17 µs for the levels of a tile of 264 texels in place of 41.
fn mean_of_four(upper: [u8; 8], lower: [u8; 8]) -> [u8; 4] {
    const EVEN: u64 = 0x00ff_00ff_00ff_00ff;
    let (upper, lower) = (u64::from_le_bytes(upper), u64::from_le_bytes(lower));
    let [even, odd] = [0, 8].map(|shift| {
        let sums = ((upper >> shift) & EVEN) + ((lower >> shift) & EVEN);
        // Of the left and of the right texel: at most 1020 and 2.
        let sums = (sums & 0xffff_ffff) + (sums >> 32) + 0x0002_0002;
        ((sums >> 2) & 0x00ff_00ff) as u32
    });
    (even | (odd << 8)).to_le_bytes()
}

/// Fills the mip levels after the first, each texel the mean of four (stored values; rounded to
/// nearest).
///
/// # Panics
/// When `out` is shorter than all levels.
pub fn make_color_mips(out: &mut [u8], side: u32) {
    let mut rest = out;
    let mut side = side as usize;
    for _ in 1..COLOR_MIPS {
        let (fine, after) = rest.split_at_mut(side * side * 4);
        let half = side / 2;
        for (row, coarse) in after[..half * half * 4].chunks_exact_mut(half * 4).enumerate() {
            let (upper, lower) = fine[2 * row * side * 4..][..2 * side * 4].split_at(side * 4);
            let (upper, lower) = (upper.as_chunks().0, lower.as_chunks().0);
            for (texel, (upper, lower)) in coarse.as_chunks_mut().0.iter_mut().zip(upper.iter().zip(lower)) {
                *texel = mean_of_four(*upper, *lower);
            }
        }
        (rest, side) = (after, half);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_coarse_texel_is_the_mean_of_four(upper in any::<[u8; 8]>(), lower in any::<[u8; 8]>(), ends in any::<u8>()) {
            // Some of the channels as dark or as bright as can be.
            let at = |texels: [u8; 8]| -> [u8; 8] {
                std::array::from_fn(|n| match (ends >> n) & 1 {
                    0 => texels[n],
                    _ => if texels[n] < 128 { 0 } else { 255 },
                })
            };
            let (upper, lower) = (at(upper), at(lower));
            let mean = |channel: usize| {
                let four = [upper[channel], upper[channel + 4], lower[channel], lower[channel + 4]];
                ((four.iter().map(|v| u32::from(*v)).sum::<u32>() + 2) / 4) as u8
            };
            prop_assert_eq!(mean_of_four(upper, lower), [0, 1, 2, 3].map(mean));
        }
    }
}
