//! A strip: neighboring lines between their sweep and their shading. One per worker, used again.

use super::edges::{Edge, Edges};
use terravision_common::simd::{LANES, Simd};

/// Lines of a strip: eight blocks. What it has of a picture of 720 rows fits into a core's second
/// cache.
pub(super) const LINES: usize = 8 * LANES;

/// One over depth at the middle of a row, 0 for sky, and its change from row to row, of each line.
/// Behind the last line there is room to be read, not looked at.
#[derive(Debug, Clone)]
pub(super) struct StripRow {
    pub(super) nearness: [f32; LINES + LANES],
    pub(super) per_row: [f32; LINES + LANES],
}

/// Rows of sixteen lines: of each from its `low` row up to before its `high` one, in which it sees
/// `base + row·per_row`.
pub(super) struct Rows<S: Simd> {
    pub(super) low: S::Floats,
    pub(super) high: S::Floats,
    pub(super) base: S::Floats,
    pub(super) per_row: S::Floats,
}

/// The rows of neighboring lines, from the bottom.
#[derive(Debug)]
pub(super) struct Strip {
    rows: Vec<StripRow>,
    /// What lines see through holes: NaN where they meet none. Empty where no ground is a hole.
    beyond: Vec<StripRow>,
    /// Of each row a bit of each of sixteen lines that waits for what it sees through a hole.
    waiting: Vec<u32>,
    /// The same of lines that have passed a gap between tiles before what they see.
    behind_gap: Vec<u32>,
    /// Where the ground of each line ends and the sky begins: rows, not whole ones.
    pub(super) skyline: [f32; LINES + LANES],
    /// Where ground of each line ends before other ground, or the sky.
    pub(super) edges: Edges,
}

impl Default for Strip {
    fn default() -> Self {
        Self {
            rows: Vec::new(),
            beyond: Vec::new(),
            waiting: Vec::new(),
            behind_gap: Vec::new(),
            skyline: [0.0; LINES + LANES],
            edges: Edges::default(),
        }
    }
}

impl Strip {
    /// Takes memory for this many rows, if it is not there.
    pub(super) fn reserve(&mut self, rows: usize, has_holes: bool) {
        let empty = StripRow { nearness: [0.0; LINES + LANES], per_row: [0.0; LINES + LANES] };
        if self.rows.len() < rows {
            self.rows.resize(rows, empty.clone());
        }
        if has_holes && self.beyond.len() < rows {
            self.beyond.resize(rows, empty);
            self.waiting.resize(rows, 0);
            self.behind_gap.resize(rows, 0);
        }
    }

    /// Forgets edges and gaps of sixteen lines, those from `first` on.
    pub(super) fn begin(&mut self, first: usize) {
        self.edges.clear(first);
        self.behind_gap.fill(0);
    }

    pub(super) fn row(&self, row: usize) -> &StripRow {
        &self.rows[row]
    }

    /// What lines see in a row through holes.
    pub(super) fn beyond(&self, row: usize) -> Option<&StripRow> {
        self.beyond.get(row)
    }

    /// One over depth of what sixteen lines see in a row, which are those from `first` on.
    #[inline(always)]
    pub(super) fn nearness<S: Simd>(&self, simd: S, first: usize, row: usize) -> S::Floats {
        let lines = self.rows.get(row).and_then(|row| row.nearness.get(first..)?.first_chunk());
        lines.map_or(simd.floats(0.0), |lines| simd.load(lines))
    }

    /// Has sixteen lines wait in a row for what they see through a hole: sky, as long as nothing else
    /// is put.
    #[inline(always)]
    pub(super) fn wait<S: Simd>(&mut self, simd: S, first: usize, row: usize, waiting: u32) {
        let (Some(beyond), Some(bits)) = (self.beyond.get_mut(row), self.waiting.get_mut(row)) else { return };
        *bits = waiting;
        if let Some((lines, _)) = beyond.nearness.get_mut(first..).and_then(|row| row.split_first_chunk_mut()) {
            simd.store(simd.select(simd.mask(waiting), simd.floats(0.0), simd.floats(f32::NAN)), lines);
        }
        if let Some((lines, _)) = beyond.per_row.get_mut(first..).and_then(|row| row.split_first_chunk_mut()) {
            simd.store(simd.floats(0.0), lines);
        }
    }

    /// Notes that rows of sixteen lines are filled behind a gap, those of `gap`.
    #[inline(always)]
    pub(super) fn put_gap<S: Simd>(&mut self, simd: S, lines: &Rows<S>, gap: S::Mask) {
        let (from, to) = (simd.smallest(lines.low) as usize, simd.largest(lines.high) as usize);
        let Some(rows) = self.behind_gap.get_mut(from..to) else { return };
        for (bits, number) in rows.iter_mut().zip(from..) {
            let number = simd.floats(number as f32);
            *bits |= simd.bits(simd.at_most(lines.low, number) & simd.less(number, lines.high) & gap);
        }
    }

    /// A bit of each of the sixteen lines that have passed a gap in a row.
    pub(super) fn behind_gap(&self, row: usize) -> u32 {
        self.behind_gap.get(row).copied().unwrap_or(0)
    }

    /// Has lines that have passed a gap in a row, which are those from `first` on, see what they see
    /// beyond it.
    #[inline(always)]
    pub(super) fn close_gap<S: Simd>(&mut self, simd: S, first: usize, row: usize) {
        let (Some(bits), Some(beyond), Some(own)) =
            (self.behind_gap.get(row), self.beyond.get(row), self.rows.get_mut(row))
        else {
            return;
        };
        let passed = simd.mask(*bits);
        let own = [&mut own.nearness, &mut own.per_row];
        for (own, beyond) in own.into_iter().zip([&beyond.nearness, &beyond.per_row]) {
            let own = own.get_mut(first..).and_then(|row| row.split_first_chunk_mut());
            let beyond = beyond.get(first..).and_then(|row| row.first_chunk());
            if let (Some((own, _)), Some(beyond)) = (own, beyond) {
                simd.store_where(passed, simd.load(beyond), own);
            }
        }
    }

    /// A bit of each of the sixteen lines that wait in a row.
    pub(super) fn waiting(&self, row: usize) -> u32 {
        self.waiting.get(row).copied().unwrap_or(0)
    }

    /// Puts what lines that wait in a row see through a hole: one over depth, and its change from row to
    /// row. `found`: a bit of each.
    #[inline(always)]
    pub(super) fn put_beyond<S: Simd>(
        &mut self,
        simd: S,
        first: usize,
        row: usize,
        [nearness, per_row]: [S::Floats; 2],
        found: u32,
    ) {
        let (Some(beyond), Some(waiting)) = (self.beyond.get_mut(row), self.waiting.get_mut(row)) else { return };
        *waiting &= !found;
        let StripRow { nearness: all_nearness, per_row: all_per_row } = beyond;
        for (lines, of) in [(all_nearness, nearness), (all_per_row, per_row)] {
            if let Some((lines, _)) = lines.get_mut(first..).and_then(|row| row.split_first_chunk_mut()) {
                simd.store_where(simd.mask(found), of, lines);
            }
        }
    }

    /// Puts what one line sees in a row.
    pub(super) fn put(&mut self, row: usize, line: usize, nearness: f32, per_row: f32) {
        if let Some(row) = self.rows.get_mut(row) {
            row.nearness[line] = nearness;
            row.per_row[line] = per_row;
        }
    }

    /// Fills rows of sixteen lines, which are those from `first` on.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(&mut self, simd: S, first: usize, lines: &Rows<S>) {
        let (from, to) = (simd.smallest(lines.low) as usize, simd.largest(lines.high) as usize);
        let Some(rows) = self.rows.get_mut(from..to) else { return };
        for (row, number) in rows.iter_mut().zip(from..) {
            let number = simd.floats(number as f32);
            let (Some((nearness, _)), Some((per_row, _))) = (
                row.nearness.get_mut(first..).and_then(|row| row.split_first_chunk_mut::<LANES>()),
                row.per_row.get_mut(first..).and_then(|row| row.split_first_chunk_mut::<LANES>()),
            ) else {
                return;
            };
            let filled = simd.at_most(lines.low, number) & simd.less(number, lines.high);
            simd.store_where(filled, lines.base + number * lines.per_row, nearness);
            simd.store_where(filled, lines.per_row, per_row);
        }
    }

    /// Puts edges of those of sixteen lines for which `are` holds: where they are, and the first row
    /// behind each.
    #[inline(always)]
    pub(super) fn put_edges<S: Simd>(&mut self, simd: S, first: usize, [at, behind]: [S::Floats; 2], are: S::Mask) {
        let mut left = simd.bits(are);
        if left == 0 {
            return;
        }
        let mut places = [[0.0; LANES]; 2];
        simd.store(at, &mut places[0]);
        simd.store(behind, &mut places[1]);
        while left != 0 {
            let k = left.trailing_zeros() as usize % LANES;
            self.edges.put(first + k, Edge { at: places[0][k], behind: places[1][k] as u32 });
            left &= left - 1;
        }
    }

    /// The rows of sixteen lines from `next` on are sky, which begins at the rows `skyline`.
    #[inline(always)]
    pub(super) fn put_sky<S: Simd>(&mut self, simd: S, first: usize, [next, skyline]: [S::Floats; 2], rows: [f32; 2]) {
        if let Some((lines, _)) = self.skyline.get_mut(first..).and_then(|lines| lines.split_first_chunk_mut::<LANES>())
        {
            simd.store(skyline, lines);
        }
        let zero = simd.floats(0.0);
        self.fill(simd, first, &Rows { low: next, high: simd.floats(rows[1]), base: zero, per_row: zero });
    }
}
