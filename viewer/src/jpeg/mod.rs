//! JPEG files: by libjpeg-turbo, or in builds without the feature `turbojpeg` by an encoder in Rust,
//! which takes more than three times as long (docs/viewer.md, *Measured*).
//!
//! Both take RGBA, rows from the top, and make files of the same size to half a percent.

#[cfg(not(feature = "turbojpeg"))]
mod rust;
#[cfg(feature = "turbojpeg")]
mod turbo;

#[cfg(not(feature = "turbojpeg"))]
use rust::compress;
#[cfg(feature = "turbojpeg")]
use turbo::compress;

/// How a file is made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct JpegQuality {
    /// 1 to 100.
    pub(crate) quality: u8,
    /// One sample of chroma for four pixels (4:2:0).
    pub(crate) has_halved_chroma: bool,
}

/// Why there is no file.
#[derive(Debug, thiserror::Error)]
pub(crate) enum JpegError {
    /// The pixels are not those of the size.
    #[error("expected {expected} bytes of pixels, found {found}")]
    Size {
        /// Four for each pixel.
        expected: usize,
        /// Bytes there are.
        found: usize,
    },
    /// The encoder refuses.
    #[error("the encoder refuses: {0}")]
    Encoder(String),
}

/// A picture as a file.
pub(crate) fn encode(rgba: &[u8], [width, height]: [u32; 2], quality: JpegQuality) -> Result<Vec<u8>, JpegError> {
    let expected = 4 * width as usize * height as usize;
    if rgba.len() != expected {
        return Err(JpegError::Size { expected, found: rgba.len() });
    }
    compress(rgba, [width, height], quality)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOVING: JpegQuality = JpegQuality { quality: 75, has_halved_chroma: true };
    const REST: JpegQuality = JpegQuality { quality: 90, has_halved_chroma: false };

    fn pixels(count: u32) -> Vec<u8> {
        (0..count).flat_map(|i| [i as u8, (i / 7) as u8, (i * i) as u8, 255]).collect()
    }

    /// How finely each component is sampled, from the frame header (ITU-T T.81, B.2.2).
    fn sampling(file: &[u8]) -> Vec<u8> {
        let mut at = 2;
        loop {
            let (kind, length) = (file[at + 1], usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]])));
            if kind == 0xC0 {
                return (0..usize::from(file[at + 9])).map(|i| file[at + 11 + 3 * i]).collect();
            }
            at += 2 + length;
        }
    }

    #[test]
    fn better_quality_is_a_larger_file_and_sizes_may_be_odd() {
        let rgba = pixels(63 * 31);
        let [moving, rest] = [MOVING, REST].map(|quality| encode(&rgba, [63, 31], quality).unwrap());
        assert!(moving.len() > 300 && rest.len() > moving.len(), "{} {}", moving.len(), rest.len());
        assert_eq!((sampling(&moving), sampling(&rest)), (vec![0x22, 0x11, 0x11], vec![0x11; 3]));
        assert!(encode(&pixels(1), [1, 1], MOVING).is_ok());
    }

    #[test]
    fn pixels_of_another_size_are_refused() {
        assert!(matches!(encode(&pixels(9), [3, 4], REST), Err(JpegError::Size { expected: 48, found: 36 })));
    }
}
