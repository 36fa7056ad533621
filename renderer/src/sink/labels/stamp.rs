//! Text and shapes as coverage, to be laid over pictures.

use ab_glyph::{Font, FontRef, Glyph, PxScale, ScaleFont, point};

/// Sub-steps of a pixel along a side, for the edges of shapes.
const STEPS: i32 = 4;
/// How much the halo around ink darkens.
const HALO: u32 = 150;

/// A rectangle of ink: how much of each pixel is covered, 0 to 255, with a margin for its halo.
#[derive(Debug, Clone, Default)]
pub(super) struct Stamp {
    pub(super) size: [usize; 2],
    coverage: Vec<u8>,
    /// Width of the halo, pixels.
    halo: usize,
}

impl Stamp {
    fn empty(size: [usize; 2], halo: usize) -> Self {
        let size = size.map(|side| side + 2 * halo);
        Self { size, coverage: vec![0; size[0] * size[1]], halo }
    }

    fn put(&mut self, [x, y]: [i32; 2], value: u8) {
        let at = [x, y].map(|v| v + self.halo as i32);
        if (0..2).all(|axis| (0..self.size[axis] as i32).contains(&at[axis])) {
            let texel = &mut self.coverage[at[1] as usize * self.size[0] + at[0] as usize];
            *texel = value.max(*texel);
        }
    }

    /// A line of text with letters `px` high.
    pub(super) fn text(font: &FontRef<'_>, px: f32, text: &str) -> Self {
        let font = font.as_scaled(PxScale::from(px));
        let mut glyphs: Vec<Glyph> = Vec::new();
        let mut end = 0.0;
        for letter in text.chars() {
            let id = font.glyph_id(letter);
            if let Some(before) = glyphs.last() {
                end += font.kern(before.id, id);
            }
            glyphs.push(id.with_scale_and_position(PxScale::from(px), point(end, font.ascent())));
            end += font.h_advance(id);
        }
        let mut stamp = Self::empty([end.ceil().max(0.0) as usize, font.height().ceil() as usize], halo_of(px));
        for outlined in glyphs.into_iter().filter_map(|glyph| font.outline_glyph(glyph)) {
            let corner = outlined.px_bounds().min;
            outlined.draw(|x, y, share| {
                let at = [corner.x as i32 + x as i32, corner.y as i32 + y as i32];
                stamp.put(at, (share * 255.0 + 0.5) as u8);
            });
        }
        stamp
    }

    /// A shape within a rectangle: of places in it, pixels from its upper left corner, whether they
    /// are inside.
    pub(super) fn shape(size: [usize; 2], px: f32, is_inside: impl Fn(f32, f32) -> bool) -> Self {
        let mut stamp = Self::empty(size, halo_of(px));
        let sub = |k: i32, of: i32| of as f32 + (k as f32 + 0.5) / STEPS as f32;
        for y in 0..size[1] as i32 {
            for x in 0..size[0] as i32 {
                let inside = (0..STEPS * STEPS).filter(|k| is_inside(sub(k % STEPS, x), sub(k / STEPS, y))).count();
                stamp.put([x, y], (inside as i32 * 255 / (STEPS * STEPS)) as u8);
            }
        }
        stamp
    }

    /// Lays it over a view, white with a dark halo, its upper left corner at `at` in the view. What
    /// lies outside of the view is left out.
    pub(super) fn draw(&self, view: &mut ViewPixels<'_>, at: [i32; 2]) {
        let halo = self.halo as i32;
        let [width, height] = self.size.map(|side| side as i32);
        for y in 0..height {
            for x in 0..width {
                let Some(texel) = view.texel([at[0] + x, at[1] + y]) else { continue };
                let ink = u32::from(self.coverage[(y * width + x) as usize]);
                let around = (y - halo..=y + halo).flat_map(|y| (x - halo..=x + halo).map(move |x| [x, y]));
                let around = around.filter(|[x, y]| (0..width).contains(x) && (0..height).contains(y));
                let shade = around.map(|[x, y]| self.coverage[(y * width + x) as usize]).max();
                let shade = 255 - u32::from(shade.unwrap_or(0)) * HALO / 255;
                for value in &mut texel[..3] {
                    let dark = u32::from(*value) * shade / 255;
                    *value = ((dark * (255 - ink) + 255 * ink + 127) / 255) as u8;
                }
            }
        }
    }
}

/// Width of a halo of letters `px` high.
fn halo_of(px: f32) -> usize {
    (px / 12.0).round().max(1.0) as usize
}

/// The pixels of a view in its frame's picture.
pub(super) struct ViewPixels<'a> {
    pub(super) rgba: &'a mut [u8],
    /// Width of the picture, pixels.
    pub(super) stride: usize,
    /// The view's upper left corner, and its size.
    pub(super) at: [usize; 2],
    pub(super) size: [usize; 2],
}

impl ViewPixels<'_> {
    fn texel(&mut self, [x, y]: [i32; 2]) -> Option<&mut [u8]> {
        let [x, y] = [usize::try_from(x).ok()?, usize::try_from(y).ok()?];
        let is_inside = x < self.size[0] && y < self.size[1];
        let start = 4 * ((self.at[1] + y) * self.stride + self.at[0] + x);
        self.rgba.get_mut(start..start + 4).filter(|_| is_inside)
    }
}
