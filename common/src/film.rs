//! What renderer and launcher share about films: the renderer makes the pictures, the launcher
//! writes the stream, so that the stream survives when the renderer dies.
//!
//! ```text
//! renderer ──frames──▶ stream ring (shared memory) ──▶ launcher: each frame once ──▶ ffmpeg's input, or standard output
//!    └─────packets───▶ pipe: which frame lies where ────┘
//! ```

use serde::{Deserialize, Serialize};

/// What the pipe says of a frame that lies in the stream ring, whole.
///
/// Two little-endian `u64`. A killed renderer may leave half a packet at the end of its pipe, which
/// is discarded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// Number of the frame in its flight.
    pub frame: u64,
    /// Its position in the ring.
    pub position: u64,
}

impl Packet {
    /// In place of a frame: all before this position is void. The first packet of a renderer, because
    /// one before it may have been killed before it told of a frame.
    pub const BEGIN: u64 = u64::MAX;
    /// Length in the pipe, bytes.
    pub const SIZE: usize = 16;

    /// Encodes it.
    #[must_use]
    pub fn to_bytes(self) -> [u8; Self::SIZE] {
        let mut out = [0; Self::SIZE];
        out[..8].copy_from_slice(&self.frame.to_le_bytes());
        out[8..].copy_from_slice(&self.position.to_le_bytes());
        out
    }

    /// Decodes it.
    #[must_use]
    pub fn from_bytes(bytes: [u8; Self::SIZE]) -> Self {
        let half = |from: usize| u64::from_le_bytes(std::array::from_fn(|n| bytes[from + n]));
        Self { frame: half(0), position: half(8) }
    }
}

/// How the frames of a stream are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameEncoding {
    /// Four bytes a pixel, RGBA. Sides are even, as 4:2:0 requires: the last column or row is
    /// repeated if necessary.
    Raw,
    /// Three planes, Y, Cb and Cr, the latter two with half as many columns and rows (4:2:0):
    /// BT.709, limited range. Sides are even as with [`FrameEncoding::Raw`].
    Yuv420,
    /// `FRAME` and three planes, as in Y4M.
    Y4m,
}

/// The header of a frame in Y4M.
pub const Y4M_FRAME: &[u8] = b"FRAME\n";

impl FrameEncoding {
    /// Bytes of a frame of this size.
    #[must_use]
    pub fn frame_bytes(self, size: [u32; 2]) -> u64 {
        let pixels = |[width, height]: [u32; 2]| u64::from(width) * u64::from(height);
        match self {
            Self::Raw => 4 * pixels(even(size)),
            Self::Yuv420 => 3 * pixels(even(size)) / 2,
            Self::Y4m => Y4M_FRAME.len() as u64 + 3 * pixels(size),
        }
    }
}

/// The next larger size with even sides.
#[must_use]
pub fn even(size: [u32; 2]) -> [u32; 2] {
    size.map(|side| side.next_multiple_of(2))
}

/// Frames per second as a fraction: exact for whole numbers and NTSC rates, otherwise in
/// thousandths.
#[must_use]
pub fn rational_fps(fps: f64) -> [u64; 2] {
    let whole = fps.round();
    if (fps - whole).abs() < 1e-9 && whole >= 1.0 {
        return [whole as u64, 1];
    }
    let ntsc = (fps * 1.001).round();
    if (ntsc / 1.001 - fps).abs() < 5e-3 && ntsc >= 1.0 {
        return [ntsc as u64 * 1000, 1001];
    }
    [((fps * 1000.0).round() as u64).max(1), 1000]
}

/// A matrix from R'G'B' to Y'CbCr, limited range.
///
/// Y4M cannot state which matrix was used. Players and encoders guess by size, so the matrix is
/// chosen in the same way: BT.709 for pictures at least 1280 wide or more than 576 high, BT.601 for
/// smaller ones. The choice is also written as the comment `XTV_MATRIX=BT709` (or `BT601`), which
/// other readers skip, and the range as `XCOLORRANGE=LIMITED`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Matrix {
    /// ITU-R BT.601-7.
    Bt601,
    /// ITU-R BT.709-6.
    Bt709,
}

impl Matrix {
    /// The matrix that players assume for pictures of this size.
    #[must_use]
    pub fn for_size([width, height]: [u32; 2]) -> Self {
        if width >= 1280 || height > 576 { Self::Bt709 } else { Self::Bt601 }
    }

    /// Its name in the header.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Bt601 => "BT601",
            Self::Bt709 => "BT709",
        }
    }
}

/// The line that a Y4M stream begins with.
#[must_use]
pub fn y4m_header(size: [u32; 2], fps: f64) -> String {
    let ([width, height], [n, d]) = (size, rational_fps(fps));
    let name = Matrix::for_size(size).name();
    format!("YUV4MPEG2 W{width} H{height} F{n}:{d} Ip A1:1 C444 XCOLORRANGE=LIMITED XTV_MATRIX={name}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_fractions() {
        assert_eq!(rational_fps(30.0), [30, 1]);
        assert_eq!(rational_fps(30000.0 / 1001.0), [30000, 1001]);
        assert_eq!(rational_fps(29.97), [30000, 1001]);
        assert_eq!(rational_fps(12.5), [12500, 1000]);
    }

    #[test]
    fn a_packet_travels_as_sixteen_bytes() {
        let packet = Packet { frame: 7, position: 1 << 40 };
        assert_eq!(Packet::from_bytes(packet.to_bytes()), packet);
        assert_eq!(packet.to_bytes()[..8], [7, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn frames_have_the_length_of_their_encoding() {
        assert_eq!(FrameEncoding::Raw.frame_bytes([3, 5]), 4 * 4 * 6);
        assert_eq!(FrameEncoding::Yuv420.frame_bytes([3, 5]), 24 + 2 * 6);
        assert_eq!(FrameEncoding::Y4m.frame_bytes([3, 5]), 6 + 3 * 15);
        let header = y4m_header([3, 1], 25.0);
        assert_eq!(header, "YUV4MPEG2 W3 H1 F25:1 Ip A1:1 C444 XCOLORRANGE=LIMITED XTV_MATRIX=BT601\n");
    }
}
