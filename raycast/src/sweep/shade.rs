//! Rows of a strip become pixels: place on the ground, footprint, color, some dozens of pixels at a
//! time.

use super::SweepDetail;
use super::fan::Fan;
use super::lanes::{floor, index, larger, smaller};
use super::strip::{LINES, Strip, StripRow};
use super::texels::{Slices, TilePaint, WIDE};
use crate::model::color::ColorLayout;
use crate::scene::Scene;
use crate::shade::{Canvas, OPAQUE_BLACK};
use glam::{Vec2, Vec3};
use std::ops::Range;

/// Two lines are interpolated between, unless their nearness differs by more than this share: then
/// one lies behind a crest.
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
    /// Column and row of the turned picture's lower left pixel, and from pixel to pixel along a row
    /// and up.
    pixel_steps: [[i32; 2]; 3],
    /// Direction through the lower left pixel, and from pixel to pixel along a row and up.
    directions: [Vec3; 3],
    /// The tile that pixels are likely over.
    current: Option<TilePaint<'a>>,
}

/// Pixels beside each other.
struct Pixels {
    /// One over depth, 0 for sky, and its change from row to row.
    nearness: [f32; WIDE],
    per_row: [f32; WIDE],
    depth: [f32; WIDE],
    /// What texels are chosen by: see [`Slices`].
    east: [f32; WIDE],
    north: [f32; WIDE],
    size: [f32; WIDE],
    reach_east: [f32; WIDE],
    reach_north: [f32; WIDE],
    /// Whether a pixel is ground that has no color yet: then 1.
    left: [u32; WIDE],
    color: [u32; WIDE],
}

impl Pixels {
    const SKY: Self = Self {
        nearness: [0.0; WIDE],
        per_row: [0.0; WIDE],
        depth: [0.0; WIDE],
        east: [0.0; WIDE],
        north: [0.0; WIDE],
        size: [0.0; WIDE],
        reach_east: [0.0; WIDE],
        reach_north: [0.0; WIDE],
        left: [0; WIDE],
        color: [0; WIDE],
    };
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
        let mut pixels = Pixels::SKY;
        let mut ground = 0;
        for number in sector.rows[0]..sector.rows[1] {
            let row = self.fan.rows[number as usize];
            let [from, to] = [lines.start, lines.end].map(|line| row.start(line, sector.lines));
            let per_pixel = row.lines_per_pixel() as f32;
            for x in (from..to).step_by(WIDE) {
                let count = (to - x).min(WIDE as u32) as usize;
                let line = (row.line_at(x) - lines.start as f64) as f32;
                pixels.gather(strip.row(number as usize), [line, per_pixel], lines.len());
                let land = self.place(&mut pixels, [x, number], count);
                if land > 0 {
                    self.paint(&mut pixels, count);
                }
                self.put([x, number], &pixels.color[..count], &pixels.depth[..count]);
                ground += land;
            }
        }
        ground
    }

    /// Where pixels lie on the ground, and how large they are there; how many see ground.
    #[inline(always)]
    fn place(&self, pixels: &mut Pixels, [x, number]: [u32; 2], count: usize) -> u64 {
        let [corner, along, up] = self.directions;
        let first = corner + along * x as f32 + up * number as f32;
        let per_focal = 1.0 / self.scene.view.focal_px();
        let [share_along, share_across] = [self.detail.footprint_along, self.detail.footprint_across];
        let mut land = 0u32;
        for k in 0..WIDE {
            let at = k as i32 as f32;
            let (dx, dy) = (first.x + at * along.x, first.y + at * along.y);
            let nearness = pixels.nearness[k];
            let is_land = (nearness > 0.0) & ((k as u32) < count as u32);
            let depth = 1.0 / larger(nearness, LEAST_NEARNESS);
            pixels.depth[k] = if is_land { depth } else { f32::NAN };
            pixels.left[k] = u32::from(is_land);
            land = land.wrapping_add(u32::from(is_land));
            pixels.color[k] = self.canvas.sky;
            pixels.east[k] = dx * depth;
            pixels.north[k] = dy * depth;
            // From row to row depth changes by so much, and the ground's place along the line of
            // sight with it.
            let by = pixels.per_row[k] * depth * depth * share_along;
            let length = (by * by * (dx * dx + dy * dy)).sqrt();
            pixels.size[k] = larger(length, share_across * per_focal * depth);
            pixels.reach_east[k] = 0.5 * by * dx;
            pixels.reach_north[k] = 0.5 * by * dy;
        }
        u64::from(land)
    }

    /// Colors pixels, tile by tile.
    #[inline(always)]
    fn paint(&mut self, pixels: &mut Pixels, count: usize) {
        let mut painted = [0; WIDE];
        let mut is_mine = [0; WIDE];
        let mut begin = 0;
        while let Some(first) = (begin..count).find(|k| pixels.left[*k] != 0) {
            let point = Vec2::new(pixels.east[first], pixels.north[first]);
            let is_over = self.current.as_ref().is_some_and(|current| current.holds(point));
            if !is_over && let Some(tile) = self.scene.tile_at_point(point) {
                self.current = Some(TilePaint::new(self.canvas, tile, self.layout));
            }
            begin = first;
            let Some(current) = &self.current else {
                pixels.color[first] = OPAQUE_BLACK;
                pixels.left[first] = 0;
                continue;
            };
            let mut end = 0;
            for (k, is_mine) in is_mine.iter_mut().enumerate() {
                let is_over = current.holds(Vec2::new(pixels.east[k], pixels.north[k]));
                *is_mine = pixels.left[k] & u32::from(is_over | (k == first));
                let behind = (k as u32).wrapping_add(1) & 0u32.wrapping_sub(*is_mine);
                end = if behind > end { behind } else { end };
            }
            let range = first..end as usize;
            let slices = Slices {
                east: &pixels.east[range.clone()],
                north: &pixels.north[range.clone()],
                size: &pixels.size[range.clone()],
                reach_east: &pixels.reach_east[range.clone()],
                reach_north: &pixels.reach_north[range.clone()],
            };
            current.paint(&slices, self.detail.has_two_taps, &mut painted[range]);
            for (k, is_mine) in is_mine.iter().enumerate() {
                pixels.color[k] = if *is_mine != 0 { painted[k] } else { pixels.color[k] };
                pixels.left[k] &= !is_mine;
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

impl Pixels {
    /// Takes nearness and its change from row to row from the lines of a strip: `line` passes the
    /// middle of the first pixel.
    #[inline(always)]
    fn gather(&mut self, row: &StripRow, [line, per_pixel]: [f32; 2], lines: usize) {
        let (mut share, mut at) = ([0.0; WIDE], [0; WIDE]);
        let last = (lines - 1) as f32;
        for k in 0..WIDE {
            let place = smaller(larger(line + per_pixel * (k as i32 as f32), 0.0), last);
            let whole = floor(place);
            share[k] = place - whole;
            at[k] = index(whole);
        }
        let (mut here, mut next) = ([[0.0; WIDE]; 2], [[0.0; WIDE]; 2]);
        for k in 0..WIDE {
            let n = at[k] as usize % LINES;
            // The last line of a strip has none behind it, and no share of it.
            let m = n.wrapping_add(1) % LINES;
            here[0][k] = row.nearness[n];
            here[1][k] = row.per_row[n];
            next[0][k] = row.nearness[m];
            next[1][k] = row.per_row[m];
        }
        for k in 0..WIDE {
            let (a, b) = (here[0][k], next[0][k]);
            let is_here = share[k] < 0.5;
            let nearest = if is_here { a } else { b };
            let by = b - a;
            let is_one = by.abs() < nearest * ONE_SURFACE;
            self.nearness[k] = if is_one { a + share[k] * by } else { nearest };
            self.per_row[k] = if is_here { here[1][k] } else { next[1][k] };
        }
    }
}
