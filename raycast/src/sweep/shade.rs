//! Rows of a strip become pixels: place on the ground, footprint, color, sixteen pixels at a time.

use super::SweepDetail;
use super::fan::Fan;
use super::lanes::{Floats, LANES, floor, index, larger, smaller};
use super::strip::{LINES, Strip, StripRow};
use super::texels::{TilePaint, Wanted};
use crate::model::color::ColorLayout;
use crate::scene::Scene;
use crate::shade::{Canvas, OPAQUE_BLACK};
use glam::{Vec2, Vec3};
use std::ops::Range;

/// Two lines are interpolated between, unless their nearness differs by more than this share: then one lies behind a crest.
const ONE_SURFACE: f32 = 0.02;
/// Nearness of the furthest that is drawn, which keeps numbers finite.
const LEAST_NEARNESS: f32 = 1e-9;

/// What rows are shaded with.
pub(super) struct Shader<'a> {
    canvas: &'a Canvas<'a>,
    scene: &'a Scene<'a>,
    fan: &'a Fan,
    detail: &'a SweepDetail,
    layout: ColorLayout,
    /// Column and row of the turned picture's lower left pixel, and from pixel to pixel along a row and up.
    pixel_steps: [[i32; 2]; 3],
    /// Direction through the lower left pixel, and from pixel to pixel along a row and up.
    directions: [Vec3; 3],
    /// The tile that pixels are likely over.
    current: Option<TilePaint<'a>>,
}

/// Sixteen pixels beside each other.
struct Pixels {
    depth: Floats,
    /// Metres from the eye.
    east: Floats,
    north: Floats,
    wanted: Wanted,
}

impl<'a> Shader<'a> {
    pub(super) fn new(canvas: &'a Canvas<'a>, fan: &'a Fan, detail: &'a SweepDetail) -> Option<Self> {
        let scene = canvas.scene;
        let pixel_steps = fan.sector.as_ref()?.pixel_steps();
        let [column, row] = scene.view.steps();
        let [corner, along, up] = pixel_steps.map(|[x, y]| [x as f32, y as f32]);
        let by = |[x, y]: [f32; 2]| column * x + row * y;
        Some(Self {
            canvas,
            scene,
            fan,
            detail,
            layout: scene.ground.shape().color,
            pixel_steps,
            directions: [scene.view.direction_at(corner[0], corner[1]), by(along), by(up)],
            current: None,
        })
    }

    /// Shades all pixels of the strip of the lines `lines`; how many of them are ground.
    #[inline(always)]
    pub(super) fn shade(&mut self, strip: &Strip, lines: Range<usize>) -> u64 {
        let Some(sector) = self.fan.sector else { return 0 };
        let mut ground = 0;
        for number in sector.rows[0]..sector.rows[1] {
            let row = self.fan.rows[number as usize];
            let [from, to] = [lines.start, lines.end].map(|line| row.start(line, sector.lines));
            let per_pixel = row.lines_per_pixel() as f32;
            for x in (from..to).step_by(LANES) {
                let count = (to - x).min(LANES as u32) as usize;
                let line = (row.line_at(x) - lines.start as f64) as f32;
                ground +=
                    self.shade_pixels(strip.row(number as usize), [x, number], count, [line, per_pixel], lines.len());
            }
        }
        ground
    }

    /// Shades `count` pixels from this one on: `line` is that of its middle, counted in the strip.
    #[inline(always)]
    fn shade_pixels(
        &mut self,
        row: &StripRow,
        pixel: [u32; 2],
        count: usize,
        [line, per_pixel]: [f32; 2],
        lines: usize,
    ) -> u64 {
        let (nearness, per_row) = gather(row, [line, per_pixel], lines);
        let mut has_ground = false;
        for value in &nearness[..count] {
            has_ground |= *value > 0.0;
        }
        let mut colors = [self.canvas.sky; LANES];
        let mut depths = [f32::NAN; LANES];
        let mut ground = 0;
        if has_ground {
            let pixels = self.place(pixel, &nearness, &per_row);
            let mut left = [false; LANES];
            for k in 0..count {
                left[k] = nearness[k] > 0.0;
                ground += u64::from(left[k]);
            }
            for k in 0..LANES {
                depths[k] = if left[k] { pixels.depth[k] } else { f32::NAN };
            }
            self.paint(&pixels, &mut left, &mut colors);
        }
        self.put(pixel, &colors[..count], &depths[..count]);
        ground
    }

    /// Where pixels lie on the ground, and how large they are there.
    #[inline(always)]
    fn place(&self, [x, number]: [u32; 2], nearness: &Floats, per_row: &Floats) -> Pixels {
        let [corner, along, up] = self.directions;
        let first = corner + along * x as f32 + up * number as f32;
        let mut pixels = Pixels {
            depth: [0.0; LANES],
            east: [0.0; LANES],
            north: [0.0; LANES],
            wanted: Wanted { size: [0.0; LANES], reach: [[0.0; LANES]; 2] },
        };
        let per_focal = 1.0 / self.scene.view.focal_px();
        let [share_along, share_across] = [self.detail.footprint_along, self.detail.footprint_across];
        for k in 0..LANES {
            let at = k as f32;
            let (dx, dy) = (first.x + at * along.x, first.y + at * along.y);
            let depth = 1.0 / larger(nearness[k], LEAST_NEARNESS);
            pixels.depth[k] = depth;
            pixels.east[k] = dx * depth;
            pixels.north[k] = dy * depth;
            // From row to row depth changes by so much, and the ground's place along the line of sight with it.
            let by = per_row[k] * depth * depth;
            let length = (by * by * (dx * dx + dy * dy)).sqrt();
            pixels.wanted.size[k] = larger(share_along * length, share_across * per_focal * depth);
            pixels.wanted.reach[0][k] = 0.5 * share_along * by * dx;
            pixels.wanted.reach[1][k] = 0.5 * share_along * by * dy;
        }
        pixels
    }

    /// Colors pixels, tile by tile.
    #[inline(always)]
    fn paint(&mut self, pixels: &Pixels, left: &mut [bool; LANES], colors: &mut [u32; LANES]) {
        while let Some(k) = left.iter().position(|left| *left) {
            let point = Vec2::new(pixels.east[k], pixels.north[k]);
            let is_over = self.current.as_ref().is_some_and(|current| current.holds(point));
            if !is_over && let Some(tile) = self.scene.tile_at_point(point) {
                self.current = Some(TilePaint::new(self.canvas, tile, self.layout));
            }
            let Some(current) = &self.current else {
                colors[k] = OPAQUE_BLACK;
                left[k] = false;
                continue;
            };
            let painted = current.colors(&pixels.east, &pixels.north, &pixels.wanted, self.detail.has_two_taps);
            for n in 0..LANES {
                let is_mine = left[n] & ((n == k) | current.holds(Vec2::new(pixels.east[n], pixels.north[n])));
                colors[n] = if is_mine { painted[n] } else { colors[n] };
                left[n] &= !is_mine;
            }
        }
    }

    #[inline(always)]
    fn put(&self, [x, number]: [u32; 2], colors: &[u32], depths: &[f32]) {
        let [corner, along, up] = self.pixel_steps;
        let place =
            |x: u32| [0, 1].map(|axis| (corner[axis] + along[axis] * x as i32 + up[axis] * number as i32) as u32);
        if along == [1, 0] {
            self.canvas.picture.put_pairs(place(x), colors, depths);
            return;
        }
        for ((color, depth), x) in colors.iter().zip(depths).zip(x..) {
            self.canvas.picture.put(place(x), *color, *depth);
        }
    }
}

/// Nearness of sixteen pixels and its change from row to row, between the lines of a strip.
#[inline(always)]
fn gather(row: &StripRow, [line, per_pixel]: [f32; 2], lines: usize) -> (Floats, Floats) {
    let (mut share, mut at) = ([0.0; LANES], [0; LANES]);
    let last = (lines - 1) as f32;
    for k in 0..LANES {
        let place = smaller(larger(line + per_pixel * k as f32, 0.0), last);
        let whole = floor(place);
        share[k] = place - whole;
        at[k] = index(whole);
    }
    let (mut here, mut next) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
    for k in 0..LANES {
        let n = at[k] as usize % LINES;
        let m = (n + 1).min(lines - 1) % LINES;
        here[0][k] = row.nearness[n];
        here[1][k] = row.per_row[n];
        next[0][k] = row.nearness[m];
        next[1][k] = row.per_row[m];
    }
    let (mut nearness, mut per_row) = ([0.0; LANES], [0.0; LANES]);
    for k in 0..LANES {
        let (a, b) = (here[0][k], next[0][k]);
        let is_here = share[k] < 0.5;
        let nearest = if is_here { a } else { b };
        let by = b - a;
        let is_one = by.abs() < nearest * ONE_SURFACE;
        nearness[k] = if is_one { a + share[k] * by } else { nearest };
        per_row[k] = if is_here { here[1][k] } else { next[1][k] };
    }
    (nearness, per_row)
}
