//! Bilinear samples of a mip level of colour, one texel at a time.

use crate::model::color::ColorLayout;
use glam::Vec2;

/// Four 8-bit channels in 16-bit lanes.
#[inline(always)]
fn lanes(texel: u32) -> u64 {
    u64::from(texel & 0x00ff_00ff) | u64::from(texel & 0xff00_ff00) << 24
}

/// The upper bytes of four 16-bit lanes, rounded.
#[inline(always)]
fn packed(lanes: u64) -> u32 {
    let rounded = lanes + 0x0080_0080_0080_0080;
    (rounded >> 8) as u32 & 0x00ff_00ff | (rounded >> 32) as u32 & 0xff00_ff00
}

/// A mip level of a layer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mip<'a> {
    texels: &'a [u8],
    side: u32,
}

impl<'a> Mip<'a> {
    /// Mip `level` of a layer; `None` when the layer is too short.
    #[inline(always)]
    pub(crate) fn new(layer: &'a [u8], layout: ColorLayout, level: u32) -> Option<Self> {
        let (start, side) = layout.mip(level);
        let texels = layer.get(start..start + side as usize * side as usize * 4)?;
        Some(Self { texels, side })
    }

    #[inline(always)]
    fn texel(&self, at: usize) -> u32 {
        match self.texels.get(4 * at..4 * at + 4) {
            Some(&[r, g, b, a]) => u32::from_le_bytes([r, g, b, a]),
            _ => 0,
        }
    }

    /// Bilinear colour at a point in texels from the mip's north west corner, in 16-bit lanes times
    /// 256.
    #[inline(always)]
    fn bilinear_lanes(&self, at: Vec2) -> u64 {
        let last = (self.side - 1) as f32;
        // The last cell of texels is valid up to its end.
        let x = (at.x - 0.5).clamp(0.0, last);
        let y = (at.y - 0.5).clamp(0.0, last);
        let (i, j) = ((x as u32).min(self.side.saturating_sub(2)), (y as u32).min(self.side.saturating_sub(2)));
        let u = ((x - i as f32) * 256.0) as u64;
        let v = ((y - j as f32) * 256.0) as u64;
        let first = j as usize * self.side as usize + i as usize;
        let below = first + self.side as usize;
        let texel = |at| lanes(self.texel(at));
        // The two weights add up to exactly 256, so that lanes never overflow.
        let (ne, se) = ((u * (256 - v)) >> 8, (u * v) >> 8);
        let sw = v - se;
        let nw = 256 - v - ne;
        texel(first) * nw + texel(first + 1) * ne + texel(below) * sw + texel(below + 1) * se
    }

    /// Bilinear colour at a point in texels from the mip's north west corner.
    #[inline(always)]
    pub(crate) fn bilinear(&self, at: Vec2) -> u32 {
        packed(self.bilinear_lanes(at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bilinear_is_within_a_step_of_the_exact_value(
            texels in prop::array::uniform16(any::<u8>()), x in 0.0f32..2.0, y in 0.0f32..2.0,
        ) {
            let mip = Mip::new(&texels, ColorLayout { side: 2, mips: 1 }, 0).unwrap();
            let found = mip.bilinear(Vec2::new(x, y)).to_le_bytes();
            let (u, v) = ((f64::from(x) - 0.5).clamp(0.0, 1.0), (f64::from(y) - 0.5).clamp(0.0, 1.0));
            for channel in 0..4 {
                let at = |k: usize| f64::from(texels[4 * k + channel]);
                let exact = (at(0) * (1.0 - u) + at(1) * u) * (1.0 - v) + (at(2) * (1.0 - u) + at(3) * u) * v;
                prop_assert!((f64::from(found[channel]) - exact).abs() < 3.6, "{} {exact}", found[channel]);
            }
        }
    }

    #[test]
    fn equal_texels_give_their_colour_everywhere_and_a_short_layer_none() {
        let texels = [10u8, 200, 255, 255].repeat(64 + 16);
        let layout = ColorLayout { side: 8, mips: 2 };
        assert_eq!(texels.len(), layout.bytes());
        for level in 0..2 {
            let mip = Mip::new(&texels, layout, level).unwrap();
            for k in 0..100 {
                let at = Vec2::new(k as f32 * 0.09 - 0.3, k as f32 * 0.07);
                assert_eq!(mip.bilinear(at).to_le_bytes(), [10, 200, 255, 255]);
            }
        }
        assert!(Mip::new(&texels[4..], layout, 1).is_none());
    }
}
