//! Sectors: a picture cut into up to four parts around the point where vertical lines meet in it,
//! so that one code serves any attitude.
//!
//! ```text
//!   level: one sector     looking down: four, around the foot   rolled: the camera is turned by quarters,
//!   | | | | | |            \   0   /                             so that vertical lines go up in a sector
//!   | | | | | |             \     /
//!   | | | | | |           3   foot   1
//!   | | | | | |             /  2  \
//! ```
//!
//! At a pixel the image of a vertical line has the direction `up = (v.x − X·v.z, v.y − Y·v.z)`,
//! where `v` is the world's vertical in the camera's axes and `X`, `Y` the pixel's place on the
//! plane of depth 1: no division, and nothing becomes infinite when the camera is level. A pixel is
//! in the sector in whose direction `up` points.

use glam::{DVec2, DVec3};
use std::ops::Range;
use terravision_common::camera::Camera;

/// Slopes of a plane's lines of sight beyond this are taken for this: straight down, and straight
/// up.
const STEEPEST: f64 = 1e6;

/// A pixel is between two lines; it looks at no line that is further away than this many.
const BESIDE: f64 = 2.0;

/// A part of a picture whose vertical lines go up, at 45 degrees at most.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sector {
    turn: Turn,
    /// Columns and rows of the turned picture.
    size: [u32; 2],
    focal_px: f64,
    /// Where the middle of the turned picture lies on the plane of depth 1.
    middle: [f64; 2],
    /// Axes of the turned camera.
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Rows that have pixels of this sector, counted from the bottom.
    pub(super) rows: [u32; 2],
    /// Where the row lies in which lines are counted, on the plane of depth 1, and how fast
    /// vertical lines go up there.
    reference: [f64; 2],
    /// Place of line 0 in the reference row, pixels from the middle, and lines to a pixel.
    first_px: f64,
    lines_per_px: f64,
    /// Lines.
    pub(super) lines: usize,
}

/// By how many quarters a sector's picture is turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Turn(u8);

impl Turn {
    /// From pixel to pixel in the picture, columns to the right and rows down: along a row of the
    /// sector, and up.
    fn steps(self) -> [[i32; 2]; 2] {
        match self.0 {
            0 => [[1, 0], [0, -1]],
            1 => [[0, 1], [1, 0]],
            2 => [[-1, 0], [0, 1]],
            _ => [[0, -1], [-1, 0]],
        }
    }
}

/// The first of `count` numbers for which a condition holds, which then holds for all that follow.
fn first_of(count: u32, is_true: impl Fn(u32) -> bool) -> u32 {
    if count == 0 || is_true(0) {
        return 0;
    }
    let (mut before, mut first) = (0, count);
    if !is_true(count - 1) {
        return count;
    }
    while first - before > 1 {
        let middle = before + (first - before) / 2;
        if is_true(middle) { first = middle } else { before = middle }
    }
    first
}

/// A row of a sector.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Row {
    /// Pixels of it that belong to the sector.
    pub(super) first: u32,
    pub(super) end: u32,
    /// Line that passes the middle of its first pixel, and from pixel to pixel.
    line: f64,
    per_pixel: f64,
}

/// A vertical plane through the eye: half of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Its direction on the ground, of length 1.
    pub(super) direction: DVec2,
    /// Of a point a metre away, `slope` metres above the eye: `rise + slope·v.y` pixels of height
    /// and `depth + slope·v.z` metres of depth, both on the plane of depth 1.
    pub(super) rise: f64,
    pub(super) depth: f64,
    /// Slopes of the lines of sight along the lower edge of the lowest row that is looked at, and
    /// along the upper edge of the highest.
    pub(super) slopes: [f64; 2],
}

impl Sector {
    /// The sectors of a camera's picture, those without a pixel left out, and the rows of each,
    /// from the bottom of its turned picture. `lines_per_px`: lines to a pixel where they are
    /// widest apart.
    pub(super) fn all(camera: &Camera, lines_per_px: f64, put: &mut impl FnMut(Self, &[Row]), rows: &mut Vec<Row>) {
        for quarters in 0..4 {
            let mut sector = Self::turned(camera, Turn(quarters), lines_per_px);
            if sector.count_lines(rows) {
                put(sector, rows);
            }
        }
    }

    fn turned(camera: &Camera, turn: Turn, lines_per_px: f64) -> Self {
        let [right, up, forward] = camera.axes_in_world();
        let steps = turn.steps();
        let [along, upward] = steps.map(|[x, y]| right * f64::from(x) - up * f64::from(y));
        let middle_x = camera.picture_plane().middle_x();
        let [width, height] = [camera.width(), camera.height()];
        Self {
            turn,
            size: if turn.0.is_multiple_of(2) { [width, height] } else { [height, width] },
            focal_px: camera.focal_px(),
            middle: steps.map(|[x, _]| middle_x * f64::from(x)),
            right: along,
            up: upward,
            forward,
            rows: [0; 2],
            reference: [0.0; 2],
            first_px: 0.0,
            lines_per_px,
            lines: 0,
        }
    }

    /// Finds the rows and lines; whether there are any.
    fn count_lines(&mut self, rows: &mut Vec<Row>) -> bool {
        rows.clear();
        rows.extend((0..self.size[1]).map(|row| {
            let pixels = self.pixels(row);
            Row { first: pixels.start, end: pixels.end, ..Row::default() }
        }));
        let has_pixels = |row: &Row| row.first < row.end;
        let (Some(first), Some(last)) = (rows.iter().position(has_pixels), rows.iter().rposition(has_pixels)) else {
            return false;
        };
        self.rows = [first as u32, last as u32 + 1];
        self.lines_per_px *= self.closeness(rows, [first, last]);
        // Lines part, or meet, from row to row: they are counted where they are widest apart, so that
        // no pixel is between two that are further apart than asked.
        let upness = |row: usize| self.upness(self.place_y(row as u32));
        let row = if upness(first) < upness(last) { last } else { first };
        self.reference = [self.place_y(row as u32), upness(row)];
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (row, number) in rows.iter().zip(0..).filter(|(row, _)| has_pixels(row)) {
            for x in [row.first, row.end - 1] {
                let place = self.reference_px(x, number);
                low = low.min(place);
                high = high.max(place);
            }
        }
        self.first_px = low - 1.0 / self.lines_per_px;
        self.lines = ((high - low) * self.lines_per_px).ceil() as usize + 3;
        for (row, number) in rows.iter_mut().zip(0..) {
            self.place_lines(row, number);
        }
        true
    }

    /// How near to each other lines that lean are, where that is least, as a share of their distance
    /// along a row.
    fn closeness(&self, rows: &[Row], ends: [usize; 2]) -> f64 {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for row in ends {
            for x in [rows[row].first, rows[row].end - 1] {
                let lean = self.sideness(self.place_x(x)) / self.upness(self.place_y(row as u32));
                low = low.min(lean);
                high = high.max(lean);
            }
        }
        let least = low.max(-high).max(0.0);
        // At the foot itself lines lean to all sides.
        if least.is_finite() { 1.0 / (1.0 + least * least).sqrt() } else { 1.0 }
    }

    /// Works out which lines pass the pixels of a row.
    fn place_lines(&self, row: &mut Row, number: u32) {
        let x = row.first.min(self.size[0] - 1);
        let up = self.upness(self.place_y(number));
        row.per_pixel = if up > 0.0 { self.reference[1] / up * self.lines_per_px } else { 0.0 };
        row.line = (self.reference_px(x, number) - self.first_px) * self.lines_per_px;
    }

    /// The rows, of all, in which pixels are beside lines from `first` to `last`: where lines lean or
    /// meet, those at the sides leave the picture.
    pub(super) fn rows_of_lines(&self, rows: &[Row], first: usize, last: usize) -> [u32; 2] {
        let (first, last) = (first as f64 - BESIDE, last as f64 + BESIDE);
        let is_beside = |row: &Row| row.first < row.end && row.line <= last && row.line_at(row.end - 1) >= first;
        let begin = rows.iter().position(is_beside).unwrap_or_default();
        let end = rows.iter().rposition(is_beside).map_or(begin, |last| last + 1);
        [begin as u32, end as u32]
    }

    /// Place of a pixel's middle on the plane of depth 1.
    fn place_x(&self, x: u32) -> f64 {
        (f64::from(x) + 0.5 - 0.5 * f64::from(self.size[0])) / self.focal_px + self.middle[0]
    }

    fn place_y(&self, row: u32) -> f64 {
        (f64::from(row) + 0.5 - 0.5 * f64::from(self.size[1])) / self.focal_px + self.middle[1]
    }

    /// How fast a vertical line goes up in the picture, and sideways.
    fn upness(&self, y: f64) -> f64 {
        self.up.z - y * self.forward.z
    }

    fn sideness(&self, x: f64) -> f64 {
        self.right.z - x * self.forward.z
    }

    /// Pixels of a row that belong to this sector. By exactly the same numbers, but for their
    /// signs, in all sectors: each pixel belongs to one.
    fn pixels(&self, row: u32) -> Range<u32> {
        let up = self.upness(self.place_y(row));
        let width = self.size[0];
        let is_foot = |x: u32| self.turn.0 == 0 && up == 0.0 && self.sideness(self.place_x(x)) == 0.0;
        // Whether a pixel's line leans to this side by more than half a right angle. To one side
        // before the place where vertical lines are upright, to the other one behind it: rounded
        // numbers keep that order, too.
        let is_past = |x: u32, side: f64| {
            let side = self.sideness(self.place_x(x)) * side;
            if self.turn.0.is_multiple_of(2) { side > up } else { side >= up }
        };
        if up <= 0.0 && !(up == 0.0 && self.turn.0 == 0) {
            return 0..0;
        }
        let before = if self.forward.z < 0.0 { -1.0 } else { 1.0 };
        let first = first_of(width, |x| !is_past(x, before));
        let end = first_of(width, |x| is_past(x, -before)).max(first);
        if up > 0.0 || (first..end).all(is_foot) { first..end } else { 0..0 }
    }

    /// Where the vertical line through a pixel passes the reference row, pixels from its middle.
    fn reference_px(&self, x: u32, row: u32) -> f64 {
        let (x, y) = (self.place_x(x), self.place_y(row));
        let by = (self.reference[0] - y) / self.upness(y);
        let place = x + self.sideness(x) * by;
        // At the foot itself all lines meet.
        if place.is_finite() { place * self.focal_px } else { x * self.focal_px }
    }

    /// The plane of a line, of which these rows are looked at.
    pub(super) fn plane(&self, line: usize, rows: [u32; 2]) -> Plane {
        let x = (self.first_px + line as f64 / self.lines_per_px) / self.focal_px;
        let y = self.reference[0];
        let sight = self.forward + self.right * x + self.up * y;
        let across = sight.truncate();
        // Straight down and straight up no line passes the reference row.
        let direction = across.try_normalize().unwrap_or(DVec2::Y);
        let rise = direction.dot(self.up.truncate());
        let depth = direction.dot(self.forward.truncate());
        let slope = |edge: u32, otherwise: f64| {
            let y = (f64::from(edge) - 0.5 * f64::from(self.size[1])) / self.focal_px + self.middle[1];
            let up = self.upness(y);
            let slope = (y * depth - rise) / up;
            if up > 0.0 && slope.is_finite() { slope.clamp(-STEEPEST, STEEPEST) } else { otherwise }
        };
        let slopes = [slope(rows[0], -STEEPEST), slope(rows[1], STEEPEST)];
        Plane { direction, rise, depth, slopes }
    }

    /// What slopes are multiplied with for a plane's height and depth.
    pub(super) fn per_slope(&self) -> [f64; 2] {
        [self.up.z, self.forward.z]
    }

    /// Where the line of sight passes the rows of the turned picture, from its lower edge.
    pub(super) fn sight_row(&self) -> f64 {
        0.5 * f64::from(self.size[1]) - self.middle[1] * self.focal_px
    }

    /// Column and row in the picture of the turned picture's lower left pixel, and from pixel to
    /// pixel along a row and up.
    pub(super) fn pixel_steps(&self) -> [[i32; 2]; 3] {
        let [along, up] = self.turn.steps();
        let corner = [0, 1].map(|axis| {
            let is_from_end = along[axis] + up[axis] < 0;
            let side = self.size[usize::from((axis == 1) != (self.turn.0 % 2 == 1))] as i32;
            if is_from_end { side - 1 } else { 0 }
        });
        [corner, along, up]
    }
}

impl Row {
    /// The line at the middle of pixel `x`.
    pub(super) fn line_at(&self, x: u32) -> f64 {
        self.line + self.per_pixel * (f64::from(x) - f64::from(self.first))
    }

    /// From pixel to pixel.
    pub(super) fn lines_per_pixel(&self) -> f64 {
        self.per_pixel
    }

    /// The first pixel of those that lines from this one on belong to: they are nearer to it, or to
    /// one behind it, than to the one before. `count`: lines of the sector.
    pub(super) fn start(&self, line: usize, count: usize) -> u32 {
        if line == 0 {
            return self.first;
        }
        if line >= count {
            return self.end;
        }
        self.pixel_from(line as f64 - 0.5)
    }

    /// The first pixel whose middle is on a line or behind it.
    pub(super) fn pixel_from(&self, line: f64) -> u32 {
        let by = line - self.line;
        if self.per_pixel == 0.0 {
            return if by <= 0.0 { self.first } else { self.end };
        }
        let x = f64::from(self.first) + (by / self.per_pixel).ceil();
        x.clamp(f64::from(self.first), f64::from(self.end)) as u32
    }
}
