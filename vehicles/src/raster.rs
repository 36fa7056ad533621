//! Triangles and points into a picture with depth. Numbers are those of 32 bits, and of whole
//! 256ths of a pixel where edges are decided: every run gives the same bytes, and triangles that
//! share an edge leave no gap and draw no pixel twice.

use crate::model::Texture;

/// Places between two pixels that corners are taken to.
const SUBPIXELS: f32 = 256.0;
/// Corners farther out than this lie beyond any picture; nearer ones have products within 64 bits.
const FARTHEST_PX: f32 = 4e6;

/// A part of a picture, drawn into.
#[derive(Debug)]
pub struct Canvas<'a> {
    /// RGBA of the whole picture.
    pub rgba: &'a mut [u8],
    /// Near plane over depth of the whole picture; 0 where nothing is.
    pub nearness: &'a mut [f32],
    /// Pixels from a row of the picture to the next.
    pub stride: usize,
    /// Upper left corner of the part.
    pub at: [usize; 2],
    /// Width and height of the part.
    pub size: [usize; 2],
}

/// A corner of a triangle on the picture.
#[derive(Debug, Clone, Copy)]
pub struct Corner {
    /// Pixels from the part's upper left corner, right and down.
    pub place: [f32; 2],
    /// Near plane over depth.
    pub nearness: f32,
    /// Factor on red, green and blue.
    pub light: [f32; 3],
    /// Place in the texture.
    pub uv: [f32; 2],
}

/// What a triangle is painted with.
#[derive(Debug, Clone, Copy)]
pub struct Paint<'a> {
    /// Its colour, or a factor on the texture's, 0 to 1.
    pub rgb: [f32; 3],
    /// Its texture.
    pub texture: Option<&'a Texture>,
    /// Whether its back is drawn.
    pub is_double_sided: bool,
}

/// A line across which is outside, in whole subpixels: `a x + b y + c`, at least 0 inside.
#[derive(Clone, Copy)]
struct Edge {
    a: i64,
    b: i64,
    c: i64,
}

impl Edge {
    /// From a corner to the next, the inside at its right on the picture (whose y goes down). Of
    /// pixels on the edge itself those are inside whose edge is an upper or a left one.
    fn new(from: [i64; 2], to: [i64; 2]) -> Self {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let is_top_left = dy < 0 || (dy == 0 && dx > 0);
        let c = dy * from[0] - dx * from[1];
        Self { a: -dy, b: dx, c: if is_top_left { c } else { c - 1 } }
    }

    fn at(&self, x: i64, y: i64) -> i64 {
        self.a * x + self.b * y + self.c
    }
}

/// A quantity that is linear over the picture.
#[derive(Clone, Copy)]
struct Slope {
    origin: f32,
    per_x: f32,
    per_y: f32,
}

impl Slope {
    fn at(&self, x: f32, y: f32) -> f32 {
        self.origin + self.per_x * x + self.per_y * y
    }
}

impl Canvas<'_> {
    /// Draws a triangle where it is nearer than what is there. Its front is counter-clockwise as it
    /// is seen.
    pub fn triangle(&mut self, corners: &[Corner; 3], paint: &Paint<'_>) {
        if corners.iter().any(|corner| !corner.place.iter().all(|v| v.abs() < FARTHEST_PX)) {
            return;
        }
        let whole = |corner: &Corner| corner.place.map(|v| (v * SUBPIXELS).round() as i64);
        let mut order = [0, 1, 2];
        let mut places = [whole(&corners[0]), whole(&corners[1]), whole(&corners[2])];
        let cross =
            |p: &[[i64; 2]; 3]| (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0]);
        // With y down, what is counter-clockwise to the eye has a negative area.
        let area = cross(&places);
        if area == 0 || (area > 0 && !paint.is_double_sided) {
            return;
        }
        if area < 0 {
            order.swap(1, 2);
            places.swap(1, 2);
        }
        let Some([columns, rows]) = self.bounds(&places) else { return };
        let corners = order.map(|index| corners[index]);
        self.fill(&corners, &places, [columns, rows], paint);
    }

    /// Columns and rows of pixels whose middles may lie in a triangle.
    fn bounds(&self, places: &[[i64; 2]; 3]) -> Option<[[i64; 2]; 2]> {
        let mut bounds = [[0; 2]; 2];
        for axis in 0..2 {
            let (low, high) = places
                .iter()
                .fold((i64::MAX, i64::MIN), |(low, high), place| (low.min(place[axis]), high.max(place[axis])));
            let first = ((low + 127).div_euclid(256)).max(0);
            let end = ((high - 128).div_euclid(256) + 1).min(self.size[axis] as i64);
            if first >= end {
                return None;
            }
            bounds[axis] = [first, end];
        }
        Some(bounds)
    }

    fn fill(
        &mut self,
        corners: &[Corner; 3],
        places: &[[i64; 2]; 3],
        [columns, rows]: [[i64; 2]; 2],
        paint: &Paint<'_>,
    ) {
        let edges = [(0, 1), (1, 2), (2, 0)].map(|(from, to)| Edge::new(places[from], places[to]));
        // About the first corner, so that no digits are lost to where the triangle is.
        let points = places.map(|place| place.map(|v| v as f32 / SUBPIXELS));
        let origin = points[0];
        let [ux, uy] = [points[1][0] - origin[0], points[1][1] - origin[1]];
        let [vx, vy] = [points[2][0] - origin[0], points[2][1] - origin[1]];
        let determinant = ux * vy - uy * vx;
        if determinant == 0.0 {
            return;
        }
        let slope = |values: [f32; 3]| {
            let [du, dv] = [values[1] - values[0], values[2] - values[0]];
            Slope {
                origin: values[0],
                per_x: (du * vy - dv * uy) / determinant,
                per_y: (dv * ux - du * vx) / determinant,
            }
        };
        let nearness = slope(corners.map(|corner| corner.nearness));
        let range = corners
            .iter()
            .fold([f32::MAX, 0.0f32], |[low, high], corner| [low.min(corner.nearness), high.max(corner.nearness)]);
        let light = [0, 1, 2].map(|channel| slope(corners.map(|corner| corner.light[channel])));
        let texture = paint.texture.map(|texture| {
            let uv = [0, 1].map(|axis| slope(corners.map(|corner| corner.uv[axis] * corner.nearness)));
            (texture, uv, texels(texture, corners, determinant))
        });
        for y in rows[0]..rows[1] {
            let start = (self.at[1] + y as usize) * self.stride + self.at[0];
            let middle = 256 * y + 128;
            let down = (y as f32 + 0.5) - origin[1];
            for x in columns[0]..columns[1] {
                if edges.iter().any(|edge| edge.at(256 * x + 128, middle) < 0) {
                    continue;
                }
                let right = (x as f32 + 0.5) - origin[0];
                // Between the corners, whatever rounding says.
                let near = nearness.at(right, down).clamp(range[0], range[1]);
                let pixel = start + x as usize;
                let Some(kept) = self.nearness.get_mut(pixel) else { return };
                if near <= *kept {
                    continue;
                }
                *kept = near;
                let mut rgb = paint.rgb;
                if let Some((texture, uv, texels)) = &texture {
                    let color = texture.color([0, 1].map(|axis| uv[axis].at(right, down) / near), *texels);
                    rgb = [0, 1, 2].map(|channel| rgb[channel] * color[channel]);
                }
                let lit = [0, 1, 2].map(|channel| rgb[channel] * light[channel].at(right, down));
                put(self.rgba, pixel, lit);
            }
        }
    }

    /// Draws a square point of `side` pixels about a place, where it is nearer than what is there.
    pub fn point(&mut self, place: [f32; 2], side: f32, nearness: f32, rgb: [f32; 3]) {
        let range = |axis: usize| {
            let first = (place[axis] - 0.5 * side).round().max(0.0) as usize;
            let end = (place[axis] + 0.5 * side).round().clamp(0.0, self.size[axis] as f32) as usize;
            first..end
        };
        for y in range(1) {
            for x in range(0) {
                let pixel = (self.at[1] + y) * self.stride + self.at[0] + x;
                if let Some(kept) = self.nearness.get_mut(pixel).filter(|kept| nearness > **kept) {
                    *kept = nearness;
                    put(self.rgba, pixel, rgb);
                }
            }
        }
    }
}

/// Texels of a texture beside each other in a pixel.
fn texels(texture: &Texture, corners: &[Corner; 3], determinant: f32) -> f32 {
    let size = texture.size();
    let along = |index: usize, axis: usize| (corners[index].uv[axis] - corners[0].uv[axis]) * size[axis];
    let area = along(1, 0) * along(2, 1) - along(1, 1) * along(2, 0);
    (area / determinant).abs().sqrt()
}

/// A colour, 0 to 1, as a pixel that shows no ground that was made up.
fn put(rgba: &mut [u8], pixel: usize, rgb: [f32; 3]) {
    if let Some(texel) = rgba.get_mut(4 * pixel..4 * pixel + 4) {
        let [r, g, b] = rgb.map(|v| (v * 255.0 + 0.5) as u8);
        texel.copy_from_slice(&[r, g, b, 255]);
    }
}

#[cfg(test)]
mod tests;
