//! Edges of ground against what lies behind it: pixels on them show a mix of both.
//!
//! A line of pixels knows to a fraction of a row where ground ends and what is behind it begins, be
//! it ground further away or the sky. Between two lines an edge is straight. So the share of a pixel
//! that is before the edge is known, and only what its middle does not see has to be looked up:
//!
//! ```text
//!   line        next line
//!    |   behind    |          a pixel here: the middle sees what is behind, a third of it is before:
//!    |        ___--*          a third of its color is that of the nearer ground, just below
//!    *__---''      |
//!    |   before    |
//! ```

use super::shade::{ONE_SKYLINE_PX, ONE_SURFACE, Shader};
use super::strip::{LINES, Strip};
use std::ops::Range;
use terravision_common::simd::{LANES, Simd};

/// Ground is behind other ground, and not the same, where its nearness is less by more than this
/// share.
pub(super) const BEHIND: f32 = 0.02;
/// Edges of a line that are kept: the lowest ones.
const MOST: usize = 12;
/// Edges of two lines are one edge if they are no further apart, rows, ...
const ONE_EDGE_PX: f32 = 8.0;
/// ... and the nearness of the nearer ground differs by less than this share.
const ONE_GROUND: f32 = 0.1;
/// What a pixel's middle sees is one side of an edge if their nearness differs by less than this
/// share.
const SAME: f32 = 0.1;
/// Smaller shares of a pixel are left out: nobody sees them.
const LEAST_SHARE: f32 = 1.0 / 32.0;
/// Pixels between two lines that a color is mixed into, at most.
const MOST_MIXES: usize = 256;

/// Where ground of a line ends before what lies behind it.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Edge {
    /// Rows, not whole ones.
    pub(super) at: f32,
    /// The first row whose middle sees what is behind.
    pub(super) behind: u32,
}

/// The edges of a strip's lines, each line's from the bottom.
#[derive(Debug)]
pub(super) struct Edges {
    of: Vec<[Edge; MOST]>,
    counts: [u8; LINES],
}

impl Default for Edges {
    fn default() -> Self {
        Self { of: vec![[Edge::default(); MOST]; LINES], counts: [0; LINES] }
    }
}

impl Edges {
    /// Forgets those of sixteen lines.
    pub(super) fn clear(&mut self, first: usize) {
        if let Some(counts) = self.counts.get_mut(first..first + LANES) {
            counts.fill(0);
        }
    }

    /// Adds one above those that the line has.
    pub(super) fn put(&mut self, line: usize, edge: Edge) {
        let (Some(edges), Some(count)) = (self.of.get_mut(line), self.counts.get_mut(line)) else { return };
        if let Some(free) = edges.get_mut(usize::from(*count)) {
            *free = edge;
            *count += 1;
        }
    }

    fn of(&self, line: usize) -> &[Edge] {
        &self.of[line][..usize::from(self.counts[line])]
    }
}

/// An edge from a line to the next one: where each has it, if it does.
#[derive(Debug, Clone, Copy)]
struct Segment {
    line: usize,
    ends: [Option<Edge>; 2],
}

/// Pixels that wait for their second color.
struct Mixes {
    list: [Mix; MOST_MIXES],
    count: usize,
}

impl Mixes {
    fn add(&mut self, mix: Option<Mix>) {
        if let (Some(mix), Some(free)) = (mix, self.list.get_mut(self.count)) {
            *free = mix;
            self.count += 1;
        }
    }
}

/// A pixel that a second color is mixed into.
#[derive(Debug, Clone, Copy, Default)]
struct Mix {
    /// In the sector, and in the picture.
    at: [u32; 2],
    pixel: [u32; 2],
    /// What is seen there: one over depth, 0 for sky, and its change from row to row.
    seen: [f32; 2],
    share: f32,
}

impl Segment {
    /// Calls `each` with the edges between a line and the next one.
    #[inline(always)]
    fn between(strip: &Strip, line: usize, mut each: impl FnMut(Self)) {
        let [mut here, mut next] = [line, line + 1].map(|line| strip.edges.of(line));
        let before = |line: usize, edge: &Edge| strip.row(edge.behind as usize - 1).nearness[line];
        loop {
            let ends = match (here.first(), next.first()) {
                (None, None) => return,
                (Some(a), None) => [Some(*a), None],
                (None, Some(b)) => [None, Some(*b)],
                (Some(a), Some(b)) => {
                    let (near_a, near_b) = (before(line, a), before(line + 1, b));
                    let is_one = (a.at - b.at).abs() <= ONE_EDGE_PX
                        && (near_a - near_b).abs() <= ONE_GROUND * near_a.max(near_b);
                    if is_one {
                        [Some(*a), Some(*b)]
                    } else if a.at < b.at {
                        [Some(*a), None]
                    } else {
                        [None, Some(*b)]
                    }
                }
            };
            here = &here[usize::from(ends[0].is_some())..];
            next = &next[usize::from(ends[1].is_some())..];
            each(Self { line, ends });
        }
    }

    /// Rows that it may pass.
    fn rows(&self, [first, end]: [u32; 2]) -> Range<u32> {
        let ends = self.ends.into_iter().flatten().map(|edge| edge.at);
        let (low, high) = ends.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)));
        let [low, high] = [low - 1.0, high + 2.0].map(|row| (row.max(0.0) as u32).clamp(first, end));
        low..high
    }

    /// At a place between the lines: the row of the edge, by how much that changes to the next
    /// line, and the edge of the nearer line with that line's number.
    fn at(&self, share: f32) -> Option<(f32, f32, usize, Edge)> {
        let nearer = usize::from(share >= 0.5);
        let edge = self.ends[nearer]?;
        Some(match self.ends {
            [Some(a), Some(b)] => (a.at + share * (b.at - a.at), b.at - a.at, self.line + nearer, edge),
            _ => (edge.at, 0.0, self.line + nearer, edge),
        })
    }
}

impl<S: Simd> Shader<'_, S> {
    /// Mixes colors on the edges of a strip of these lines, whose pixels have been put.
    #[inline(always)]
    pub(super) fn soften(&mut self, strip: &Strip, lines: Range<usize>) {
        let mut mixes = Mixes { list: [Mix::default(); MOST_MIXES], count: 0 };
        for line in 0..lines.len().saturating_sub(1) {
            self.find_mixes(strip, line, &lines, &mut mixes);
            while mixes.count >= LANES {
                self.mix(&mut mixes);
            }
        }
        self.mix(&mut mixes);
    }

    /// Finds pixels on edges between a line and the next one.
    #[inline(never)]
    fn find_mixes(&self, strip: &Strip, line: usize, lines: &Range<usize>, mixes: &mut Mixes) {
        let Some(sector) = self.fan.sector else { return };
        let at = (lines.start + line) as f64;
        // The first and the last line have the pixels beside them, too.
        let [is_first, is_last] = [line == 0, line + 2 == lines.len()];
        Segment::between(strip, line, |segment| {
            for number in segment.rows(sector.rows) {
                let row = &self.fan.rows[number as usize];
                let from = if is_first { row.start(lines.start, sector.lines) } else { row.pixel_from(at) };
                let to = if is_last { row.start(lines.end, sector.lines) } else { row.pixel_from(at + 1.0) };
                for x in from..to {
                    let share = (row.line_at(x) - at).clamp(0.0, 1.0) as f32;
                    let lean = [share, row.lines_per_pixel() as f32];
                    mixes.add(self.mix_of((strip, lines), &segment, [x, number], lean));
                }
            }
        });
    }

    /// What is to be mixed into a pixel that an edge may pass. It lies at a share of the way between
    /// the segment's lines.
    fn mix_of(
        &self,
        (strip, lines): (&Strip, &Range<usize>),
        segment: &Segment,
        at: [u32; 2],
        [share, lines_per_px]: [f32; 2],
    ) -> Option<Mix> {
        let (row, by, line, edge) = segment.at(share)?;
        let number = at[1];
        // Of a box whose middle is that far from a straight edge.
        let before = 0.5 + (row - number as f32 - 0.5) / (1.0 + (by * lines_per_px).abs());
        if !(LEAST_SHARE..=1.0 - LEAST_SHARE).contains(&before) {
            return None;
        }
        let of = |number: u32| {
            let row = strip.row(number as usize);
            [row.nearness[line], row.per_row[line]]
        };
        let sides = [number.min(edge.behind - 1), number.max(edge.behind)];
        let [near, far] = sides.map(of);
        if far[0] >= near[0] * (1.0 - BEHIND) {
            return None;
        }
        let pixel = self.pixel(at);
        let (_, depth) = self.canvas.picture.get(pixel);
        let middle = if depth.is_nan() { 0.0 } else { 1.0 / depth };
        let sees = |side: f32| (middle - side).abs() <= SAME * side;
        let (share, seen, side) = if sees(near[0]) {
            // The next line's ground may go on above a line's last one: then nothing ends here.
            let above = self.nearness_at((strip, lines), [at[0], number + 1]);
            if above.is_some_and(|above| (above - near[0]).abs() <= BEHIND * near[0]) {
                return None;
            }
            (1.0 - before, far, sides[1])
        } else if sees(far[0]) {
            (before, near, sides[0])
        } else {
            return None;
        };
        // A hole shows what lies beyond it, and no edge.
        if self.is_hole(self.pixel([at[0], side]), seen[0]) {
            return None;
        }
        Some(Mix { at, pixel, seen, share })
    }

    /// One over depth of what a pixel between lines of the strip sees, as when it was put; 0 for sky.
    fn nearness_at(&self, (strip, lines): (&Strip, &Range<usize>), [x, number]: [u32; 2]) -> Option<f32> {
        let row = self.fan.rows.get(number as usize).filter(|row| (row.first..row.end).contains(&x))?;
        let line = row.line_at(x) - lines.start as f64;
        if line < 0.0 || line >= (lines.len() - 1) as f64 {
            return None;
        }
        let (at, share) = (line as usize, line.fract() as f32);
        let [here, next] = [at, at + 1].map(|at| strip.row(number as usize).nearness[at]);
        let [skyline, skyline_next] = [at, at + 1].map(|at| strip.skyline[at]);
        let (nearest, rise) = (if share < 0.5 { here } else { next }, skyline_next - skyline);
        if (next - here).abs() < nearest * ONE_SURFACE {
            return Some(here + share * (next - here));
        }
        let is_skyline = here.min(next) <= 0.0 && here.max(next) > 0.0 && rise.abs() < ONE_SKYLINE_PX;
        let is_ground = number as f32 + 0.5 < skyline + share * rise;
        Some(match (is_skyline, is_ground) {
            (false, _) => nearest,
            (true, false) => 0.0,
            (true, true) => here.max(next),
        })
    }

    /// Mixes the colors of up to sixteen pixels in, the last ones.
    #[inline(always)]
    fn mix(&mut self, mixes: &mut Mixes) {
        let first = mixes.count.saturating_sub(LANES);
        let some = &mixes.list[first..mixes.count];
        let zeros = [0.0; LANES];
        let (mut places, mut seen, mut sky) = ([zeros; 2], [zeros; 2], 0);
        for (k, mix) in some.iter().enumerate() {
            for axis in 0..2 {
                places[axis][k] = mix.at[axis] as f32;
                seen[axis][k] = mix.seen[axis];
            }
            sky |= u32::from(mix.seen[0] <= 0.0) << k;
        }
        let land = ((1 << some.len()) - 1) & !sky;
        let colors = self.colors_of(&places, &seen, land);
        let picture = self.canvas.picture;
        for (mix, color) in some.iter().zip(&colors) {
            let (before, depth) = picture.get(mix.pixel);
            picture.put(mix.pixel, mixed(before, *color, mix.share), depth);
        }
        mixes.count = first;
    }
}

/// A color with a share of another one.
fn mixed(color: u32, other: u32, share: f32) -> u32 {
    let share = (share * 256.0) as u32;
    let of =
        |shift: u32| ((color >> shift & 0xff) * (256 - share) + (other >> shift & 0xff) * share + 128) >> 8 << shift;
    of(0) | of(8) | of(16) | of(24)
}
