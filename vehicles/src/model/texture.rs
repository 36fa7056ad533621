//! Textures: pictures, and the same in half of their size, and half of that.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Most pixels along a side.
const MOST_SIDE: usize = 4096;

/// A picture, RGB, and smaller ones of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    levels: Vec<Level>,
}

#[derive(Debug, Clone, PartialEq)]
struct Level {
    size: [usize; 2],
    rgb: Vec<[u8; 3]>,
}

impl Texture {
    /// Of a PNG or a JPEG file's bytes.
    ///
    /// # Errors
    /// Why it cannot be decoded.
    pub(super) fn decode(bytes: &[u8]) -> Result<Self, String> {
        let too_large = |[width, height]: [usize; 2]| {
            format!("a picture of {width}x{height} pixels, expected at most {MOST_SIDE} a side")
        };
        if bytes.starts_with(&[0xff, 0xd8]) {
            let options = DecoderOptions::new_fast()
                .set_strict_mode(true)
                .set_max_width(MOST_SIDE)
                .set_max_height(MOST_SIDE)
                .jpeg_set_out_colorspace(ColorSpace::RGB);
            let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
            let rgb = decoder.decode().map_err(|error| error.to_string())?;
            let size = decoder.info().map_or([0; 2], |info| [usize::from(info.width), usize::from(info.height)]);
            return Self::new(size, rgb.as_chunks::<3>().0.to_vec()).ok_or_else(|| too_large(size));
        }
        let mut reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), image::ImageFormat::Png);
        let mut limits = image::Limits::default();
        (limits.max_image_width, limits.max_image_height) = (Some(MOST_SIDE as u32), Some(MOST_SIDE as u32));
        reader.limits(limits);
        let picture = reader.decode().map_err(|error| error.to_string())?.into_rgb8();
        let size = [picture.width() as usize, picture.height() as usize];
        let rgb = picture.into_raw().as_chunks::<3>().0.to_vec();
        Self::new(size, rgb).ok_or_else(|| too_large(size))
    }

    /// `None` where there are not as many pixels as the size says, or none.
    pub(super) fn new(size: [usize; 2], rgb: Vec<[u8; 3]>) -> Option<Self> {
        if size.contains(&0) || rgb.len() != size[0] * size[1] {
            return None;
        }
        let mut levels = vec![Level { size, rgb }];
        while let Some(half) = levels.last().filter(|level| level.size != [1, 1]).map(Level::half) {
            levels.push(half);
        }
        Some(Self { levels })
    }

    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> [f32; 2] {
        self.levels.first().map_or([1.0; 2], |level| level.size.map(|side| side as f32))
    }

    /// The colour at a place, 0 to 1 from the upper left corner, repeated beyond; `texels` of the
    /// finest level's are beside each other in a pixel. Between texels it is linear.
    #[must_use]
    pub fn color(&self, [u, v]: [f32; 2], texels: f32) -> [f32; 3] {
        let wanted = texels.max(1.0).log2().round() as usize;
        let Some(level) = self.levels.get(wanted.min(self.levels.len().saturating_sub(1))) else { return [0.0; 3] };
        let place = |value: f32, side: usize| {
            let at = (value - value.floor()) * side as f32 - 0.5;
            let first = at.floor();
            let whole = first as isize;
            [whole.rem_euclid(side as isize) as usize, (whole + 1).rem_euclid(side as isize) as usize, 0]
                .map(|texel| (texel, at - first))
        };
        let ([left, right, _], [top, bottom, _]) = (place(u, level.size[0]), place(v, level.size[1]));
        let at = |x: usize, y: usize| level.rgb[y * level.size[0] + x].map(f32::from);
        let (a, b) = (at(left.0, top.0), at(right.0, top.0));
        let (c, d) = (at(left.0, bottom.0), at(right.0, bottom.0));
        let mix = |from: f32, to: f32, share: f32| from + (to - from) * share;
        std::array::from_fn(|i| mix(mix(a[i], b[i], left.1), mix(c[i], d[i], left.1), top.1) / 255.0)
    }

    /// Its mean colour, 0 to 1.
    #[must_use]
    pub(super) fn mean(&self) -> [f32; 3] {
        self.levels.last().and_then(|level| level.rgb.first()).map_or([0.0; 3], |rgb| rgb.map(|v| f32::from(v) / 255.0))
    }
}

impl Level {
    fn half(&self) -> Self {
        let size = self.size.map(|side| (side / 2).max(1));
        let at = |x: usize, y: usize| self.rgb[y.min(self.size[1] - 1) * self.size[0] + x.min(self.size[0] - 1)];
        let mut rgb = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            for x in 0..size[0] {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(right, down)| at(2 * x + right, 2 * y + down));
                let mean = |channel: usize| (four.iter().map(|rgb| u32::from(rgb[channel])).sum::<u32>() + 2) / 4;
                rgb.push(std::array::from_fn(|channel| mean(channel) as u8));
            }
        }
        Self { size, rgb }
    }
}
