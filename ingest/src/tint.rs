//! Colour from elevation where there is no picture: a hypsometric tint that fits the terrain's own
//! range, hill-shaded from the north west, as relief maps are.

use crate::store::{Level, Rect, Rgb};
use std::io;
use terravision_common::tint::{AT_ZERO_M, HeightColors, Palette};

/// Slope (rise over run, root mean square) that shading makes of any terrain: flat land gets
/// relief, too.
const SHADED_SLOPE: f64 = 0.3;

/// Height of the climatic snow line on Earth at every tenth degree of latitude, metres: highest in
/// the dry belts beside the tropics. Rounded from textbooks of physical geography; both hemispheres
/// alike.
const SNOW_LINE_M: [f32; 10] = [4800.0, 5000.0, 5300.0, 5000.0, 3600.0, 2300.0, 1300.0, 700.0, 200.0, 0.0];
/// More than this share of all posts at exactly 0 m is water: elevation models give the sea so,
/// where they have no depths.
const FLAT_SEA_SHARE: f64 = 0.005;

/// What a tint has to know of the place.
#[derive(Debug, Clone, Copy)]
pub struct Place<'a> {
    /// The body's name.
    pub body: &'a str,
    /// Latitude of the terrain's middle, degrees, where the CRS tells.
    pub latitude_deg: Option<f64>,
}

/// The snow line at a latitude, metres.
fn snow_line_m(latitude_deg: f64) -> f32 {
    let at = (latitude_deg.abs() / 10.0).clamp(0.0, 9.0);
    let (below, s) = ((at as usize).min(8), at);
    let [a, b] = [SNOW_LINE_M[below], SNOW_LINE_M[below + 1]];
    a + (s as f32 - below as f32) * (b - a)
}

/// Makes colour from the finest elevation level.
#[derive(Debug)]
pub struct Tint<'a> {
    posts: &'a Level<f32>,
    spacing_m: f64,
    /// Posts per texel.
    ratio: f64,
    /// Colours by height, and a factor on heights for shading.
    colors: HeightColors,
}

impl<'a> Tint<'a> {
    /// A tint for the terrain in `posts` (without voids, `spacing_m` apart), in texels of
    /// `texel_m`, for a place. `overview` is a coarser level of it, small enough to be looked at as
    /// a whole.
    ///
    /// # Errors
    /// What the file system says.
    pub fn new(
        posts: &'a Level<f32>,
        spacing_m: f64,
        texel_m: f64,
        overview: (&Level<f32>, f64),
        place: Place<'_>,
    ) -> io::Result<Self> {
        let Place { body, latitude_deg } = place;
        let (level, overview_m) = overview;
        let [w, h] = level.size().map(|v| v as usize);
        let heights = level.read(Rect::new([0, 0], [w, h]))?;
        let slopes =
            heights.chunks_exact(w).flat_map(|row| row.windows(2).map(|p| f64::from(p[1] - p[0]) / overview_m));
        let (count, sum) = slopes.fold((0.0, 0.0), |(n, sum), slope| (n + 1.0, sum + slope * slope));
        let slope = (sum / f64::max(count, 1.0)).sqrt();
        let is_earth = matches!(body, "Earth" | "unknown");
        let at_zero = heights.iter().filter(|z| z.abs() <= AT_ZERO_M).count();
        let mut sorted = heights;
        sorted.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        // Earth's seas end at 0; elsewhere 0 is only a height.
        let has_sea = body == "Earth" && at(0.02) < -5.0 && at(1.0) > 0.0;
        let has_flat_sea = body == "Earth" && at_zero as f64 > FLAT_SEA_SHARE * sorted.len() as f64 && at(1.0) > 0.0;
        let low = if has_sea || has_flat_sea { 0.0 } else { at(0.005) };
        Ok(Self {
            posts,
            spacing_m,
            ratio: texel_m / spacing_m,
            colors: HeightColors {
                palette: match body {
                    "Earth" | "Titan" | "unknown" => Palette::Earth,
                    "Mars" | "Venus" => Palette::Mars,
                    _ => Palette::Grey,
                },
                low_m: low,
                high_m: at(0.998).max(low + 1.0),
                has_sea,
                has_flat_sea,
                snow_line_m: is_earth.then(|| snow_line_m(latitude_deg.unwrap_or(45.0))),
                relief: (SHADED_SLOPE / slope.max(1e-9)).clamp(0.4, 40.0) as f32,
            },
        })
    }

    /// Its colours before they are shaded.
    #[must_use]
    pub fn colors(&self) -> HeightColors {
        self.colors
    }

    /// How bright a post is: light from the north west, 45 degrees high; flat ground is 1.
    fn shade(&self, spacing_m: f64, heights: &[f32], width: usize, at: usize) -> f32 {
        let run = 2.0 * spacing_m as f32;
        self.shade_of([(heights[at + 1] - heights[at - 1]) / run, (heights[at + width] - heights[at - width]) / run])
    }

    /// How bright a slope is, rise over run to the east and to the north.
    pub(crate) fn shade_of(&self, slope: [f32; 2]) -> f32 {
        let [dx, dy] = slope.map(|slope| slope * self.colors.relief);
        // Unit vector to the light: (-1/2, 1/2, 1/sqrt 2); normal: (-dx, -dy, 1).
        let cosine = (0.5 * dx - 0.5 * dy + std::f32::consts::FRAC_1_SQRT_2) / (1.0 + dx * dx + dy * dy).sqrt();
        (0.42 + 0.58 * cosine * std::f32::consts::SQRT_2).clamp(0.3, 1.3)
    }

    /// Colours of a block of texels.
    ///
    /// # Errors
    /// What the file system says.
    pub fn block(&self, block: Rect) -> io::Result<Vec<Rgb>> {
        self.block_of(self.posts, self.spacing_m, self.ratio * self.spacing_m, block)
    }

    /// Colours of a block of texels of `texel_m`, from posts that are `spacing_m` apart.
    ///
    /// # Errors
    /// What the file system says.
    pub fn block_of(&self, posts: &Level<f32>, spacing_m: f64, texel_m: f64, block: Rect) -> io::Result<Vec<Rgb>> {
        // Texel centres lie (i + 1/2)·ratio posts from the origin.
        let ratio = texel_m / spacing_m;
        let place = |i: i64| (i as f64 + 0.5) * ratio;
        let first = block.origin.map(|v| place(v).floor() as i64 - 1);
        let last = [0, 1].map(|a| place(block.origin[a] + block.size[a] as i64 - 1).floor() as i64 + 3);
        let rect = Rect::new(first, [0, 1].map(|a| (last[a] - first[a]) as usize));
        let heights = posts.read(rect)?;
        let width = rect.size[0];
        let mut shades = vec![1.0f32; heights.len()];
        for row in 1..rect.size[1] - 1 {
            let inside = row * width + 1..(row + 1) * width - 1;
            let shade = |at| self.shade(spacing_m, &heights, width, at);
            inside.clone().map(shade).zip(&mut shades[inside]).for_each(|(value, shade)| *shade = value);
        }
        let mut out = Vec::with_capacity(block.area());
        for j in 0..block.size[1] {
            let y = place(block.origin[1] + j as i64) - first[1] as f64;
            for i in 0..block.size[0] {
                let x = place(block.origin[0] + i as i64) - first[0] as f64;
                let (column, row) = (x as usize, y as usize);
                let (s, t) = ((x - column as f64) as f32, (y - row as f64) as f32);
                let at = row * width + column;
                let mix = |v: &[f32]| {
                    let south = v[at] + s * (v[at + 1] - v[at]);
                    let north = v[at + width] + s * (v[at + width + 1] - v[at + width]);
                    south + t * (north - south)
                };
                let shade = mix(&shades);
                out.push(self.colors.color(mix(&heights)).map(|v| (v * shade).round().clamp(0.0, 255.0) as u8));
            }
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Colours of 64 x 64 posts, 30 m apart, as the heights have them.
    fn colors(body: &str, latitude_deg: f64, height: impl Fn(usize, usize) -> f32) -> Vec<Rgb> {
        let level = Level::create(std::env::temp_dir().as_path(), [64, 64]).unwrap();
        let all = Rect::new([0, 0], [64, 64]);
        let heights: Vec<f32> = (0..64 * 64).map(|k| height(k % 64, k / 64)).collect();
        level.write(all, &heights).unwrap();
        let place = Place { body, latitude_deg: Some(latitude_deg) };
        let tint = Tint::new(&level, 30.0, 30.0, (&level, 30.0), place).unwrap();
        tint.block(Rect::new([0, 0], [63, 63])).unwrap()
    }

    fn is_blue([r, g, b]: Rgb) -> bool {
        b > g && g > r
    }

    fn is_white([r, g, b]: Rgb) -> bool {
        let [low, high] = [r.min(g).min(b), r.max(g).max(b)];
        low > 150 && high - low < 12
    }

    #[test]
    fn the_sea_is_blue_also_where_the_model_has_no_depths() {
        // A coast: sea in the west, hills in the east.
        let coast = |i: usize, j: usize| if i < 20 { 0.0 } else { (i - 19) as f32 * 4.0 + (j % 5) as f32 };
        let picture = colors("Earth", 37.0, coast);
        assert!(
            picture
                .chunks_exact(63)
                .all(|row| row[..18].iter().all(|c| is_blue(*c)) && !row[22..].iter().any(|c| is_blue(*c)))
        );
        // Elsewhere 0 is a height like any other.
        assert!(!colors("Mars", 37.0, coast).iter().any(|c| is_blue(*c)));
        // A single post at 0 is not a sea.
        let spot = |i: usize, j: usize| if (i, j) == (9, 9) { 0.0 } else { 50.0 + (i + j) as f32 };
        assert!(!colors("Earth", 37.0, spot).iter().any(|c| is_blue(*c)));
    }

    #[test]
    fn snow_goes_by_latitude_and_by_height() {
        let ramp_to = |top: f32| move |i: usize, _: usize| top * (0.1 + 0.9 * i as f32 / 63.0);
        let whites = |latitude: f64, top: f32| {
            colors("Earth", latitude, ramp_to(top)).into_iter().filter(|c| is_white(*c)).count()
        };
        assert_eq!(whites(37.0, 292.0), 0, "a hill has none");
        assert_eq!(whites(10.0, 4000.0), 0, "nor have 4000 m in the tropics");
        assert!(whites(47.0, 4000.0) > 200, "the Alps have");
        assert!(whites(78.0, 1200.0) > 200, "and the far north");
        assert_eq!(snow_line_m(0.0), 4800.0);
        assert_eq!(snow_line_m(-45.0), 2950.0);
        assert_eq!(snow_line_m(95.0), 0.0);
    }
}
