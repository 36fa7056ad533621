//! Colours of lines of pixels, averaged over the footprint of each pixel ([`super::footprint`]).
//!
//! Depth and position are plain loops over arrays, which compilers turn into vector instructions.
//! Neighbouring lines are painted together, a few pixels of each at a time: they share cache lines
//! of colour tiles and of the picture.

use super::canvas::{Canvas, OPAQUE_BLACK};
use super::footprint::Footprints;
use super::strip::{Line, Strips};
use crate::view::View;

/// Pixels of a line that are painted before those of the next line: as many as there are lines at a
/// time, 8 KiB in all, which fit into a core's L1 cache.
const CHUNK: usize = 32;

/// Colours and depths of [`CHUNK`] pixels of neighbouring lines.
type Rows = [[(u32, f32); Strips::MOST]; CHUNK];

impl Canvas<'_> {
    /// Colours the pixels of neighbouring lines and writes them to the picture.
    #[inline(never)]
    pub(crate) fn paint(&self, lines: &[Line], footprints: &Footprints) {
        let mut rows: Rows = [[(0, 0.0); Strips::MOST]; CHUNK];
        let longest = lines.iter().map(|line| line.pixels.len()).max().unwrap_or_default();
        let is_level = is_level(lines);
        for first in (0..longest).step_by(CHUNK) {
            for (at, line) in lines.iter().enumerate() {
                self.paint_chunk(line, footprints, first, at, &mut rows);
            }
            for (row, k) in rows.iter().zip(first..longest) {
                if is_level {
                    self.picture.put_row(lines[0].pixel(k), &row[..lines.len()]);
                    continue;
                }
                for (line, (color, depth)) in lines.iter().zip(row) {
                    if k < line.pixels.len() {
                        self.picture.put(line.pixel(k), *color, *depth);
                    }
                }
            }
        }
    }

    /// Colours and depths of the pixels of a line from `first` on, into column `at`.
    #[inline(always)]
    fn paint_chunk(&self, line: &Line, footprints: &Footprints, first: usize, at: usize, rows: &mut Rows) {
        let end = line.pixels.len().min(first + CHUNK);
        let Some(pixels) = line.pixels.get(first..end) else { return };
        let places = Places::new(&self.scene.view, pixels, &line.nearness[first..end]);
        for (k, (row, run)) in rows.iter_mut().zip(&line.run_of[first..end]).enumerate() {
            row[at] = match footprints.of(*run) {
                Some(footprint) => {
                    let layer = self.colors.get(footprint.layer as usize).copied().unwrap_or_default();
                    (footprint.color(layer, [places.east[k], places.south[k]]) | OPAQUE_BLACK, places.depth[k])
                }
                None => (self.sky, f32::NAN),
            };
        }
    }
}

/// Whether lines are columns from left to right whose pixels of one number are in one row.
fn is_level(lines: &[Line]) -> bool {
    let Some(first) = lines.first() else { return false };
    let ([x, bottom], Some([_, top])) = (first.pixel(0), first.pixels.last()) else { return false };
    lines.iter().zip(x..).all(|(line, x)| {
        let last = line.pixels.last().map(|last| last.map(u32::from));
        line.pixels.len() == first.pixels.len() && line.pixel(0) == [x, bottom] && last == Some([x, u32::from(*top)])
    })
}

/// Depth and position of pixels, metres east and south of the eye.
struct Places {
    depth: [f32; CHUNK],
    east: [f32; CHUNK],
    south: [f32; CHUNK],
}

impl Places {
    #[inline(always)]
    fn new(view: &View, pixels: &[[u16; 2]], nearness: &[f32]) -> Self {
        let mut places = Self { depth: [0.0; CHUNK], east: [0.0; CHUNK], south: [0.0; CHUNK] };
        let count = pixels.len().min(CHUNK);
        let (pixels, nearness) = (&pixels[..count], &nearness[..count]);
        let Self { depth, east, south } = &mut places;
        let (depth, east, south) = (&mut depth[..count], &mut east[..count], &mut south[..count]);
        for k in 0..count {
            let direction = view.direction_at(f32::from(pixels[k][0]), f32::from(pixels[k][1]));
            depth[k] = 1.0 / nearness[k];
            east[k] = direction.x * depth[k];
            south[k] = -direction.y * depth[k];
        }
        places
    }
}
