//! Formats of the colour tiles in a run's pool: the format of texels, and the layout of mip levels.
//!
//! ```text
//!  mip 0: 264 x 264            mip 1: 132 x 132   mip 2: 66 x 66
//!  ┌───────────────────┐       ┌─────────┐        ┌────┬┐
//!  │ 66 x 66 blocks    │       │ 33 x 33 │        │ 17 x 17 blocks: the last column and the last row
//!  └───────────────────┘       └─────────┘        └────┴┘ reach two texels beyond the picture
//! ```
//!
//! Levels lie back to back, row 0 in the north. Blocks of a compressed format are 4 x 4 texels;
//! beyond the picture, blocks at the edge repeat its last texels, which are never sampled.

mod compress;

pub use compress::compress_tile;

use crate::world::COLOR_MIPS;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Side of a block of a compressed format, texels.
pub const BLOCK_SIDE: u32 = 4;

/// Format of the texels in the pool of colour tiles; the same for a whole run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TexelFormat {
    /// Four bytes per texel.
    #[default]
    Rgba8,
    /// BC1: half a byte per texel, lossy. Only graphics devices sample it.
    Bc1,
}

/// The place of a mip level in a tile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MipPlace {
    /// Its side, texels.
    pub side: u32,
    /// Bytes from the start of the tile; a multiple of the format's unit.
    pub offset: u64,
    /// Its bytes.
    pub bytes: u64,
}

impl TexelFormat {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rgba8 => "rgba8",
            Self::Bc1 => "bc1",
        }
    }

    /// Whether texels are stored in compressed blocks, which only a device can sample.
    #[must_use]
    pub const fn is_compressed(self) -> bool {
        matches!(self, Self::Bc1)
    }

    /// Bytes of the smallest unit: a texel, or a block.
    #[must_use]
    pub const fn unit_bytes(self) -> u64 {
        match self {
            Self::Rgba8 => 4,
            Self::Bc1 => 8,
        }
    }

    /// Bytes of a square of texels.
    #[must_use]
    pub const fn square_bytes(self, side: u32) -> u64 {
        let units = if self.is_compressed() { side.div_ceil(BLOCK_SIDE) } else { side };
        units as u64 * units as u64 * self.unit_bytes()
    }

    /// The mip levels of a tile, `side` texels wide with its border.
    pub fn mips(self, side: u32) -> impl Iterator<Item = MipPlace> {
        (0..COLOR_MIPS).scan(0, move |offset, mip| {
            let side = side >> mip;
            let place = MipPlace { side, offset: *offset, bytes: self.square_bytes(side) };
            *offset += place.bytes;
            Some(place)
        })
    }

    /// Bytes of a tile with its mip levels, `side` texels wide with its border.
    #[must_use]
    pub fn tile_bytes(self, side: u32) -> u64 {
        self.mips(side).map(|mip| mip.bytes).sum()
    }
}

impl fmt::Display for TexelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_lie_back_to_back_in_whole_blocks() {
        let places =
            |format: TexelFormat, side| format.mips(side).map(|m| (m.side, m.offset, m.bytes)).collect::<Vec<_>>();
        assert_eq!(places(TexelFormat::Rgba8, 264), [(264, 0, 278_784), (132, 278_784, 69_696), (66, 348_480, 17_424)]);
        // 66 x 66, 33 x 33 and 17 x 17 blocks of 8 bytes.
        assert_eq!(places(TexelFormat::Bc1, 264), [(264, 0, 34_848), (132, 34_848, 8_712), (66, 43_560, 2_312)]);
        // The smallest tiles: 6 texels are two blocks.
        assert_eq!(places(TexelFormat::Bc1, 24), [(24, 0, 288), (12, 288, 72), (6, 360, 32)]);
        for side in [24u32, 40, 72, 136, 264, 520, 1032] {
            for format in [TexelFormat::Rgba8, TexelFormat::Bc1] {
                let mips: Vec<MipPlace> = format.mips(side).collect();
                assert!(mips.iter().all(|mip| mip.offset % format.unit_bytes() == 0));
                assert_eq!(mips.last().map(|mip| mip.offset + mip.bytes), Some(format.tile_bytes(side)));
            }
            let ratio = TexelFormat::Rgba8.tile_bytes(side) as f64 / TexelFormat::Bc1.tile_bytes(side) as f64;
            assert!((7.0..=8.0).contains(&ratio), "{side}: {ratio}");
        }
    }
}
