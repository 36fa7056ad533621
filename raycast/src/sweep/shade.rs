//! Rows of a strip become pixels: place on the ground, footprint, color, sixteen pixels at a time.

use super::SweepDetail;
use super::fan::Fan;
use super::strip::{LINES, Strip, StripRow};
use super::texels::{Points, Taps, TilePaint};
use super::through::{Holes, Through};
use crate::exact::holes::MARK;
use crate::model::color::ColorLayout;
use crate::scene::Scene;
use crate::shade::Canvas;
use glam::Vec3;
use std::ops::Range;
use terravision_common::simd::{LANES, Simd, Sixteen};

/// Two lines are interpolated between, unless their nearness differs by more than this share: then
/// one lies behind a crest.
pub(super) const ONE_SURFACE: f32 = 0.02;
/// Skylines of two lines are one line, between which is interpolated, if they are no further apart.
pub(super) const ONE_SKYLINE_PX: f32 = 8.0;
/// Nearness of the furthest that is drawn, which keeps numbers finite.
pub(super) const LEAST_NEARNESS: f32 = 1e-9;
/// Times sixteen pixels that are looked at before they are colored, and those.
const AHEAD: usize = 8;
const AHEAD_PIXELS: u32 = (AHEAD * LANES) as u32;
/// Tasks of them: pixels over one tile each.
const TASKS: usize = 2 * AHEAD;
/// Numbers of lanes.
pub(super) const NUMBERS: Sixteen<f32> =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

/// What rows are shaded with.
pub(super) struct Shader<'a, S> {
    pub(super) simd: S,
    pub(super) canvas: &'a Canvas<'a>,
    scene: &'a Scene<'a>,
    pub(super) fan: &'a Fan,
    detail: &'a SweepDetail,
    layout: ColorLayout,
    /// Column and row of the turned picture's lower left pixel, and from pixel to pixel along a row
    /// and up.
    pixel_steps: [[i32; 2]; 3],
    /// Direction through the lower left pixel, and from pixel to pixel along a row and up.
    pub(super) directions: [Vec3; 3],
    /// The tile that pixels are likely over.
    current: Option<TilePaint<'a>>,
    /// That of a row's first pixels, over which the next row mostly begins, too.
    begun: Option<TilePaint<'a>>,
    /// Where ground may be a hole, or may have been filled.
    pub(super) holes: Option<Holes<'a>>,
}

/// Where a row is in its strip.
pub(super) struct RowPlace<'a> {
    row: &'a StripRow,
    /// What it sees through holes.
    pub(super) beyond: Option<&'a StripRow>,
    skyline: &'a [f32; LINES + LANES],
    /// Its middle.
    middle: f32,
    /// The last line.
    last: f32,
    /// Of its first pixel, and from pixel to pixel, lines.
    line: f32,
    per_pixel: f32,
}

/// Pixels beside each other: one over depth, 0 for sky, and its change from row to row.
pub(super) struct Seen<S: Simd> {
    pub(super) nearness: S::Floats,
    pub(super) per_row: S::Floats,
}

/// Pixels beside each other between two lines each: the first of those, the share of the way to the
/// next one, and whether the first one is nearer.
pub(super) struct Between<S: Simd> {
    pub(super) at: S::Words,
    pub(super) share: S::Floats,
    pub(super) is_here: S::Mask,
}

impl<'a, S: Simd> Shader<'a, S> {
    #[inline(always)]
    pub(super) fn new(simd: S, canvas: &'a Canvas<'a>, fan: &'a Fan, detail: &'a SweepDetail) -> Option<Self> {
        let scene = canvas.scene;
        let pixel_steps = fan.sector.as_ref()?.pixel_steps();
        let [column, row] = scene.view.steps();
        let direction = |[x, y]: [i32; 2]| column * x as f32 + row * y as f32;
        let [corner, along, up] = pixel_steps;
        let directions = [scene.view.direction_at(corner[0] as f32, corner[1] as f32), direction(along), direction(up)];
        let layout = scene.ground.shape().color;
        Some(Self {
            simd,
            canvas,
            scene,
            fan,
            detail,
            layout,
            pixel_steps,
            directions,
            current: None,
            begun: None,
            holes: None,
        })
    }

    /// Looks through holes from now on.
    pub(super) fn look_through_holes(&mut self) {
        self.holes = Holes::new(self.scene);
    }

    /// Shades all pixels of the strip of the lines `lines`; how many of them are ground.
    #[inline(always)]
    pub(super) fn shade(&mut self, strip: &Strip, lines: Range<usize>) -> u64 {
        let Some(sector) = self.fan.sector else { return 0 };
        let mut ground = 0;
        let mut ahead = Ahead::NONE;
        for number in sector.rows[0]..sector.rows[1] {
            let row = self.fan.rows[number as usize];
            let [from, to] = [row.start(lines.start, sector.lines), row.start(lines.end, sector.lines)];
            let first_line = (row.line_at(from) - lines.start as f64) as f32;
            let mut place = RowPlace {
                row: strip.row(number as usize),
                beyond: strip.beyond(number as usize),
                skyline: &strip.skyline,
                middle: number as f32 + 0.5,
                last: (lines.len() - 1) as f32,
                line: first_line,
                per_pixel: row.lines_per_pixel() as f32,
            };
            self.current = self.begun;
            let mut x = from;
            while x < to {
                let end = to.min(x + AHEAD_PIXELS);
                ahead.clear();
                for first in (x..end).step_by(LANES) {
                    place.line = first_line + place.per_pixel * (first - from) as f32;
                    let count = (end - first).min(LANES as u32);
                    ground += self.pixels(&place, [first, number], count, &mut ahead);
                    if first == from {
                        self.begun = self.current;
                    }
                }
                ahead.color(self.simd);
                ahead.mark();
                self.put([x, number], (end - x) as usize, &ahead);
                x = end;
            }
        }
        ground
    }

    /// Looks at pixels beside each other; how many are ground.
    #[inline(always)]
    fn pixels(&mut self, place: &RowPlace<'_>, at: [u32; 2], count: u32, ahead: &mut Ahead<'a>) -> u64 {
        let simd = self.simd;
        let mut seen = self.seen(place);
        let within = (1u32 << count) - 1;
        let mut land = simd.bits(simd.less(simd.floats(0.0), seen.nearness)) & within;
        let mut depth = simd.floats(f32::NAN);
        let number = ahead.add(self.canvas.sky);
        if self.holes.is_some() && land != 0 {
            ahead.through[number] = self.look_through(&mut seen, place, at, land);
            land &= simd.bits(simd.less(simd.floats(0.0), seen.nearness));
        }
        if land != 0 {
            let depths = simd.floats(1.0) / simd.larger(seen.nearness, simd.floats(LEAST_NEARNESS));
            depth = simd.select(simd.mask(land), depths, depth);
            self.paint(&self.points(&seen, depths, at), land, number, ahead);
        }
        simd.store(depth, &mut ahead.depths[number]);
        u64::from(land.count_ones())
    }

    /// Between which lines pixels are.
    #[inline(always)]
    pub(super) fn between(&self, place: &RowPlace<'_>) -> Between<S> {
        let simd = self.simd;
        let line = simd.floats(place.line) + simd.floats(place.per_pixel) * simd.load(&NUMBERS);
        let line = simd.smaller(simd.larger(line, simd.floats(0.0)), simd.floats(place.last));
        let whole = simd.smaller(simd.floor(line), simd.floats(place.last - 1.0));
        let share = line - whole;
        Between { at: simd.index(whole), share, is_here: simd.less(share, simd.floats(0.5)) }
    }

    /// What is seen, out of the lines of a strip.
    #[inline(always)]
    fn seen(&self, place: &RowPlace<'_>) -> Seen<S> {
        let simd = self.simd;
        let Between { at, share, is_here } = self.between(place);
        let [here, next] = self.lines(place, &place.row.nearness, at);
        let [per_row_here, per_row_next] = self.lines(place, &place.row.per_row, at);
        let nearest = simd.select(is_here, here, next);
        let by = next - here;
        let is_one = simd.less(simd.magnitude(by), nearest * simd.floats(ONE_SURFACE));
        let mut seen = Seen {
            nearness: simd.select(is_one, here + share * by, nearest),
            per_row: simd.select(is_here, per_row_here, per_row_next),
        };
        let is_edge = simd.at_most(simd.smaller(here, next), simd.floats(0.0))
            & simd.less(simd.floats(0.0), simd.larger(here, next));
        if simd.any(is_edge) {
            let [skyline, skyline_next] = self.lines(place, place.skyline, at);
            let rise = skyline_next - skyline;
            let is_line = is_edge & simd.less(simd.magnitude(rise), simd.floats(ONE_SKYLINE_PX));
            let is_ground = simd.less(simd.floats(place.middle), skyline + share * rise);
            let ground = simd.select(is_ground, simd.larger(here, next), simd.floats(0.0));
            let is_ground_here = simd.less(next, here);
            seen.nearness = simd.select(is_line, ground, seen.nearness);
            seen.per_row = simd.select(is_line, simd.select(is_ground_here, per_row_here, per_row_next), seen.per_row);
        }
        seen
    }

    /// Numbers of two neighboring lines each, of which `at` are the first.
    #[inline(always)]
    pub(super) fn lines(&self, place: &RowPlace<'_>, of: &[f32; LINES + LANES], at: S::Words) -> [S::Floats; 2] {
        let simd = self.simd;
        // Sixteen pixels mostly see no more lines than that.
        if place.per_pixel <= 1.0 && place.per_pixel >= 0.0 {
            let first = place.line.max(0.0).min(place.last - 1.0) as usize;
            if let Some(near) = of.get(first..).and_then(|of| of.first_chunk()) {
                return simd.near_pairs(near, at - simd.words(first as u32));
            }
        }
        simd.pairs(of, at)
    }

    /// Where pixels lie on the ground, and how large they are there.
    #[inline(always)]
    fn points(&self, seen: &Seen<S>, depth: S::Floats, [x, number]: [u32; 2]) -> Points<S> {
        let simd = self.simd;
        let [corner, along, up] = self.directions;
        let first = corner + along * x as f32 + up * number as f32;
        let number = simd.load(&NUMBERS);
        let dx = simd.floats(first.x) + simd.floats(along.x) * number;
        let dy = simd.floats(first.y) + simd.floats(along.y) * number;
        self.on_ground(seen, depth, [dx, dy])
    }

    /// The same along directions, metres east and north per metre of depth.
    #[inline(always)]
    fn on_ground(&self, seen: &Seen<S>, depth: S::Floats, [dx, dy]: [S::Floats; 2]) -> Points<S> {
        let simd = self.simd;
        // From row to row depth changes by this much, and the ground's place along the line of
        // sight with it.
        let by = seen.per_row * depth * depth * simd.floats(self.detail.footprint_along);
        let across = simd.floats(self.detail.footprint_across / self.scene.view.focal_px()) * depth;
        let half = simd.floats(0.5) * by;
        Points {
            east: dx * depth,
            north: dy * depth,
            squared_m: simd.larger(by * by * (dx * dx + dy * dy), across * across),
            reach_east: half * dx,
            reach_north: half * dy,
        }
    }

    /// Has the pixels of `land` colored, tile by tile.
    #[inline(always)]
    fn paint(&mut self, points: &Points<S>, land: u32, number: usize, ahead: &mut Ahead<'a>) {
        let simd = self.simd;
        let mut left = land;
        while left != 0 {
            let first = left & left.wrapping_neg();
            let mut mine = match &self.current {
                Some(current) => left & current.holds(simd, points),
                None => 0,
            };
            if mine & first == 0 {
                mine = first;
                let point = points.point(simd, first.trailing_zeros() as usize);
                if let Some(tile) = self.scene.tile_at_point(point) {
                    let current = TilePaint::new(self.canvas, tile, self.layout);
                    mine |= left & current.holds(simd, points);
                    self.current = Some(current);
                }
            }
            if ahead.is_full() {
                ahead.color(simd);
            }
            let task = ahead.task(number, mine);
            match &self.current {
                Some(current) => current.taps(simd, points, mine, self.detail.has_two_taps, &mut task.taps),
                // Black.
                None => task.taps = Taps::NONE,
            }
            left &= !mine;
        }
    }

    /// Puts pixels into the picture.
    #[inline(always)]
    fn put(&self, [x, number]: [u32; 2], count: usize, ahead: &Ahead<'a>) {
        let [_, along, _] = self.pixel_steps;
        let (colors, depths) = (ahead.colors.as_flattened(), ahead.depths.as_flattened());
        self.canvas.picture.put_along(self.pixel([x, number]), along, &colors[..count], &depths[..count]);
        for (first, through) in (x..).step_by(LANES).zip(&ahead.through[..ahead.count]) {
            if through.left != 0 {
                self.look_at_each([first, number], through.left);
            }
        }
    }

    /// Where a pixel of the sector is in the picture.
    #[inline(always)]
    pub(super) fn pixel(&self, [x, number]: [u32; 2]) -> [u32; 2] {
        let [corner, along, up] = self.pixel_steps;
        [0, 1].map(|axis| (corner[axis] + along[axis] * x as i32 + up[axis] * number as i32) as u32)
    }

    /// Colors of sixteen pixels anywhere in the sector: their columns and rows, one over depth and its
    /// change from row to row. Sky is what is not `land`: a bit of each.
    #[inline(always)]
    pub(super) fn colors_of(
        &mut self,
        places: &[Sixteen<f32>; 2],
        seen: &[Sixteen<f32>; 2],
        land: u32,
    ) -> Sixteen<u32> {
        let simd = self.simd;
        let [x, number] = places.each_ref().map(|of| simd.load(of));
        let [nearness, per_row] = seen.each_ref().map(|of| simd.load(of));
        let [corner, along, up] = self.directions;
        let dx = simd.floats(corner.x) + simd.floats(along.x) * x + simd.floats(up.x) * number;
        let dy = simd.floats(corner.y) + simd.floats(along.y) * x + simd.floats(up.y) * number;
        let depth = simd.floats(1.0) / simd.larger(nearness, simd.floats(LEAST_NEARNESS));
        let points = self.on_ground(&Seen { nearness, per_row }, depth, [dx, dy]);
        let mut ahead = Ahead::NONE;
        let number = ahead.add(self.canvas.sky);
        self.paint(&points, land, number, &mut ahead);
        ahead.color(simd);
        ahead.colors[number]
    }
}

/// Pixels of a row that are looked at before they are colored: texels that are not in a cache are
/// then fetched while other pixels are worked on.
#[derive(Debug)]
struct Ahead<'a> {
    /// Colors and depths, sixteen at a time.
    colors: [Sixteen<u32>; AHEAD],
    depths: [Sixteen<f32>; AHEAD],
    through: [Through; AHEAD],
    count: usize,
    tasks: [Task<'a>; TASKS],
    task_count: usize,
}

/// Pixels over one tile that have no color yet.
#[derive(Debug, Clone, Copy)]
struct Task<'a> {
    /// Which sixteen, and a bit of each that is meant.
    number: usize,
    mine: u32,
    taps: Taps<'a>,
}

impl<'a> Ahead<'a> {
    const NONE: Self = Self {
        colors: [[0; LANES]; AHEAD],
        depths: [[0.0; LANES]; AHEAD],
        through: [Through { filled: 0, left: 0 }; AHEAD],
        count: 0,
        tasks: [Task { number: 0, mine: 0, taps: Taps::NONE }; TASKS],
        task_count: 0,
    };

    #[inline(always)]
    fn clear(&mut self) {
        self.count = 0;
        self.task_count = 0;
    }

    /// Adds sixteen pixels of this color; their number.
    #[inline(always)]
    fn add(&mut self, color: u32) -> usize {
        let number = self.count.min(AHEAD - 1);
        self.count = number + 1;
        self.colors[number] = [color; LANES];
        self.through[number] = Through::default();
        number
    }

    #[inline(always)]
    fn is_full(&self) -> bool {
        self.task_count == TASKS
    }

    /// A task to be filled in. There is room.
    #[inline(always)]
    fn task(&mut self, number: usize, mine: u32) -> &mut Task<'a> {
        let at = self.task_count.min(TASKS - 1);
        self.task_count = at + 1;
        let task = &mut self.tasks[at];
        (task.number, task.mine) = (number, mine);
        task
    }

    /// Colors pixels of tasks.
    #[inline(always)]
    fn color<S: Simd>(&mut self, simd: S) {
        for task in &self.tasks[..self.task_count] {
            let color = &mut self.colors[task.number];
            let colors = simd.select_words(simd.mask(task.mine), task.taps.colors(simd), simd.load_words(color));
            simd.store_words(colors, color);
        }
        self.task_count = 0;
    }

    /// Marks pixels whose ground was filled.
    #[inline(always)]
    fn mark(&mut self) {
        for (through, colors) in self.through[..self.count].iter().zip(&mut self.colors) {
            let mut filled = through.filled;
            while filled != 0 {
                colors[filled.trailing_zeros() as usize % LANES] &= !MARK;
                filled &= filled - 1;
            }
        }
    }
}
