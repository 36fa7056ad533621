//! Colour of the ground: square rasters of RGBA8 with mip levels, as the colour pool keeps them.

use glam::DVec2;
use terravision_common::database::color_tile_bytes;
use terravision_common::world::{COLOR_BORDER, COLOR_MIPS, World};

/// The layout of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColorLayout {
    /// Texels along a side, borders included.
    pub side: u32,
    /// Mip levels.
    pub mips: u32,
}

impl ColorLayout {
    /// That of a world's colour tiles.
    #[must_use]
    pub fn of(world: &World) -> Self {
        let layout = Self { side: world.color_stored(), mips: COLOR_MIPS };
        debug_assert_eq!(layout.bytes(), color_tile_bytes(world));
        layout
    }

    /// Bytes of a layer.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.mip(self.mips).0
    }

    /// The first byte of a mip, and its side.
    #[inline(always)]
    pub(crate) fn mip(&self, level: u32) -> (usize, u32) {
        let (mut start, mut side) = (0, self.side);
        for _ in 0..level {
            start += side as usize * side as usize * 4;
            side >>= 1;
        }
        (start, side)
    }
}

/// The layer from which a tile of ground has its colours, and the position of that layer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColorPlace {
    /// The layer.
    pub layer: u32,
    /// North west corner of the layer, borders included, world coordinates.
    pub north_west_in_world: DVec2,
    /// Side of a texel, metres.
    pub texel_m: f64,
}

impl ColorPlace {
    /// The place of a colour tile of a world: its node's lower left corner (lattice units) and
    /// level.
    #[must_use]
    pub fn of_tile(world: &World, layer: u32, origin: [u32; 2], level: u8) -> Self {
        let texel_m = world.color_spacing_m(level);
        let border = f64::from(COLOR_BORDER) * texel_m;
        let surface = world.plane();
        let corner = surface.foot_of_lattice(DVec2::from_array(origin.map(f64::from)));
        let north_west_in_world = corner + DVec2::new(-border, surface.node_side_m(level) + border);
        Self { layer, north_west_in_world, texel_m }
    }

    /// The place of a raster of `side` texels whose north west corner is here.
    #[must_use]
    pub fn new(layer: u32, north_west_in_world: DVec2, texel_m: f64) -> Self {
        Self { layer, north_west_in_world, texel_m }
    }
}
